"""The same problem in other units: every state, control and row is divided by a random power of ten."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from benchmarks.lib.convergence.problems import StartProblem, problems
from benchmarks.lib.report import Report
from nmpc_codegen import OCP, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.statement import Statement

Array = np.ndarray
DECADES = 3  # units are between 1e-3 and 1e3
SEEDS = 5
EXAMPLES = ("crane", "reactor", "cart_pole", "quadrotor", "chain", "fermenter")


@dataclass(frozen=True, eq=False)
class Units:
    """x = x_unit y_x, u = u_unit y_u; rows are divided by numbers of the generator."""

    x: Array
    u: Array
    rows: np.random.Generator

    @classmethod
    def of(cls, ocp: OCP, seed: int) -> Units:
        """Random ones."""
        random = np.random.default_rng([13, seed])
        sizes = ocp.x.numel(), ocp.u.numel()
        x, u = (10.0 ** random.uniform(-DECADES, DECADES, size) for size in sizes)
        return cls(x, u, random)


def in_units(ocp: OCP, units: Units) -> OCP:
    """The problem for the signals divided by their units, without parameters."""
    new = OCP(ocp.name, N=ocp.N) if ocp.dt is None else OCP(ocp.name, intervals=ocp.dt)
    for signals, declare, unit in ((ocp.states, new.state, units.x), (ocp.controls, new.control, units.u)):
        for d in signals:
            part = unit[d.signal.offset : d.signal.offset + d.signal.size]
            more = {"initial": np.atleast_1d(d.signal.value) / part} if signals is ocp.states else {}
            declare(d.signal.name, size=d.signal.size, **more)

    def new_text(expression: object) -> object:
        old = ca.vertcat(ocp.x, ocp.u, ocp.x_start, ocp.x_end)
        same = [units.x * new.x, units.u * new.u, units.x * new.x_start, units.x * new.x_end]
        return ca.substitute(ca.SX(expression), old, ca.vertcat(*same))

    rhs = ca.vertcat(*(ocp.derivatives[i] for i in range(units.x.size)))
    new.dynamics(new_text(rhs) / units.x, discrete=bool(ocp.discrete))
    _add_costs(ocp, new, new_text)
    for statement in ocp.statements:
        _add_rows(new, statement, new_text(statement.expression), units)
    if ocp.free:
        new.free_initial(*(new.x[i] for i in sorted(ocp.free)))
    if ocp.accumulators:
        new.accumulator(*(new.x[i] for i in sorted(ocp.accumulators)))
    return new


def _add_costs(ocp: OCP, new: OCP, new_text: object) -> None:
    squares = {"start": new.start_least_squares, "terminal": new.terminal_least_squares}
    general = {"start": new.start_cost, "terminal": new.terminal_cost}
    for r in ocp.residuals:
        y = new_text(r.y)
        if r.stage == "path":
            new.least_squares(y, r.weight, reference=r.reference, scale_with_dt=r.scale_with_dt)
        else:
            squares[r.stage](y, r.weight, reference=r.reference)
    for c in ocp.costs:
        if c.stage == "path":
            new.stage_cost(new_text(c.expression), integrate=c.integrate, scale_with_dt=c.scale_with_dt)
        else:
            general[c.stage](new_text(c.expression))


def _add_rows(new: OCP, statement: Statement, h: object, units: Units) -> None:
    """A bound is divided by the unit of its signal, so that it remains one; a row by a unit of its own."""
    symbols, scale = ca.vertcat(new.x, new.u), np.concatenate([units.x, units.u])
    for i, name in enumerate(statement.names):
        slope = np.array(ca.DM(ca.jacobian(h[i], symbols)).full()).ravel() if _is_linear(h[i], symbols) else None
        bound = slope is not None and np.count_nonzero(slope) == 1 and abs(slope.sum()) == scale[slope != 0]
        d = scale[slope != 0][0] if bound else 10.0 ** units.rows.uniform(-DECADES, DECADES)
        expression = symbols[int(np.flatnonzero(slope)[0])] if bound else h[i] / d
        lower, upper = statement.lower[i] / d, statement.upper[i] / d
        soft = None if statement.soft is None else (statement.soft[0] * d, statement.soft[1] * d * d)
        more = {"soft": soft, "name": "row_" + name.replace("[", "_").replace("]", "")}
        if statement.at is None:
            new.boundary(lower, expression, upper, **more)
        else:
            new.subject_to(lower, expression, upper, at=statement.at, **more)


def _is_linear(h: object, symbols: object) -> bool:
    return not ca.depends_on(ca.jacobian(h, symbols), symbols) and ca.depends_on(h, symbols)


def measure(report: Report, scale: float = 1.0) -> None:
    """Iterations of solve() in random units over those in the units of the example, from the first cold start."""
    for problem in problems():
        if problem.name in EXAMPLES:
            _measure(report, problem, max(1, round(scale * SEEDS)))


def _measure(report: Report, problem: StartProblem, seeds: int) -> None:
    ocp = problem.make()
    start = problem.start(0)
    plain = build(ocp, problem.options(), profile="fast").solve(start)
    for seed in range(seeds):
        units = Units.of(ocp, seed)
        other = in_units(ocp, units)
        assert classify(other).nx == start.size
        found = build(other, problem.options(), profile="fast").solve(start / units.x)
        solved = found.status.name == plain.status.name == "OK"
        ratio = max(1, found.iterations) / max(1, plain.iterations) if solved else np.inf
        case = f"{problem.name}, {found.status.name} {found.iterations}, {plain.status.name} {plain.iterations}"
        report.add("unit_sensitivity", ratio, case=case, limit=2)
