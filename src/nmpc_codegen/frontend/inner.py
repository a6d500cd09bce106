"""States behind those of the user: what a node knows of the one before it, and its time.

    t_{k+1} = t_k + dt_k     (t' = 1 along an interval),   v_{k+1} = u_k

Their maps are constant, so that kernels, integrators and second derivatives stay as they are; at node 0 they are known.
Where blocks of controls begin, and the lengths of the intervals before the nodes, are parameters behind those of the
user.
"""

from __future__ import annotations

import re
from dataclasses import replace

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError, warn
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Algebra, Array, Inner, Problem, Row, Signal, Stage, symbols
from nmpc_codegen.frontend.scales import Scales, scales
from nmpc_codegen.ir.casadi_types import Expression, Function, elements, part

#: Derivatives below this are rounding errors.
EQUAL = 1e-9


def inner_of(ocp: OCP) -> Inner:
    """The states that the expressions of the OCP need."""
    found = {symbol.element_hash() for expression in _expressions(ocp) for symbol in ca.symvar(expression)}
    held = tuple(sorted(ocp.blocks))
    previous = (j for j in sorted(ocp.remembered) if j in held or ocp.remembered[j].element_hash() in found)
    rates, time = (symbol.element_hash() in found for symbol in (ocp.interval_before, ocp.clock))
    return Inner(tuple(previous), rates, time, held, idle=not ocp.controls)


def control_signals(ocp: OCP) -> tuple[Signal, ...]:
    """The controls; one that acts on nothing where a problem has components of x_0 alone to choose."""
    found = tuple(d.signal for d in ocp.controls)
    return found or (Signal("none", 1, "", (0.0,), 0, True, (1.0,)),)


def node_data(ocp: OCP, dt: tuple[float, ...]) -> Array:
    """(N + 1, data): 1 where a block of a control begins; the length of the interval before, at node 0 the first."""
    blocks = np.zeros((ocp.N + 1, len(ocp.blocks)))
    for i, j in enumerate(sorted(ocp.blocks)):
        blocks[np.cumsum((0, *ocp.blocks[j])), i] = 1.0
    lengths = np.array([[dt[0], *dt]]).T
    return np.hstack([blocks, lengths[:, : inner_of(ocp).interval]])


def data_signals(ocp: OCP, dt: tuple[float, ...]) -> tuple[Signal, ...]:
    """The parameters of these data."""
    names = [e for d in ocp.controls for e in d.signal.elements]
    found = [(f"block start({names[j]})", "", 1.0) for j in sorted(ocp.blocks)]
    found += [("interval before", ocp.time_unit, dt[0])] * inner_of(ocp).interval
    return tuple(Signal(n, 1, unit, (v,), ocp.p.numel() + i, True) for i, (n, unit, v) in enumerate(found))


def data_symbols(ocp: OCP, p: Expression) -> tuple[list[Expression], list[Expression]]:
    """Symbols of the OCP for parameters, the length of the interval before and what Newton's method finds, and their
    places in p."""
    own, held, more = ocp.p.numel(), len(ocp.blocks), ocp.node_data
    places = elements(p)
    return [ocp.p, *([ocp.interval_before] * inner_of(ocp).interval), more], [*places[:own], *places[own + held :]]


def effective_controls(ocp: OCP, x: Expression, u: Expression, p: Expression) -> Expression:
    """The controls that act at a node: u_j where a block begins, else that of the node before."""
    inner, own, first = inner_of(ocp), ocp.x.numel(), ocp.p.numel()
    acting = [] if inner.idle else elements(u)
    for i, j in enumerate(inner.held):
        begins, before = p[first + i], x[own + inner.places[j]]
        acting[j] = begins * u[j] + (1 - begins) * before
    return ca.vertcat(ca.SX(0, 1), *acting)


def _with_ties(problem: Problem, sizes: Scales) -> Problem:
    """The problem with residuals that tie controls to those of the node before where no block begins."""
    held, path = problem.inner.held, problem.path
    ties = []
    for i, j in enumerate(held):
        begins = path.p[problem.np - problem.inner.data + i]
        before = path.x[problem.measured + problem.inner.places[j]]
        weight = float(np.sqrt(sizes.cost)) / float(sizes.z[problem.nx + j])
        ties.append(weight * (1 - begins) * (path.u[j] - before))
    return replace(problem, path=replace(path, ties=ca.vertcat(*ties)))


def _expressions(ocp: OCP) -> list[Expression]:
    return [
        *ocp.derivatives.values(),
        *ocp.maps.values(),
        *(r.y for r in ocp.residuals),
        *(c.expression for c in ocp.costs),
        *(s.expression for s in ocp.statements),
        *(s.end for s in ocp.statements if s.end is not None),
    ]


def inner_symbols(ocp: OCP) -> list[Expression]:
    """The symbols of the OCP for these states."""
    inner = inner_of(ocp)
    previous = [ocp.remembered[j] for j in inner.previous]
    return [*([ocp.clock] * inner.time), *previous]


def inner_signals(ocp: OCP, path: Stage, rows: tuple[Row, ...], dt: tuple[float, ...]) -> tuple[Signal, ...]:
    """These states with what they are at first: the time 0, references of controls inside their bounds."""
    inner, offset = inner_of(ocp), ocp.x.numel()
    names = [(e, d.signal.unit) for d in ocp.controls for e in d.signal.elements]
    found: list[tuple[str, str, float, tuple[float, ...]]] = []
    found += [("time", ocp.time_unit, 0.0, (sum(dt),))] * inner.time
    found += [(f"previous({names[j][0]})", names[j][1], _first_control(ocp, path, rows, j), ()) for j in inner.previous]
    return tuple(
        Signal(name, 1, unit, (value,), offset + i, True, scale) for i, (name, unit, value, scale) in enumerate(found)
    )


def _first_control(ocp: OCP, path: Stage, rows: tuple[Row, ...], j: int) -> float:
    """The control of the first plan, inside its bounds."""
    known = np.concatenate([np.zeros(0), *(np.ravel(d.signal.value) for d in ocp.parameters)])
    p = np.concatenate([known, np.zeros(int(path.p.numel()) - known.size)])
    value, target = 0.0, path.target_of(path.nx + j)
    if target is not None:
        found = float(ca.Function("target", [path.p, target[1]], [target[0]])(p, path.reference))
        value = found if np.isfinite(found) else 0.0
    for row in rows:
        if row.kind == "control" and row.index == j:
            value = float(np.clip(value, row.lower, row.upper))
    return value


def dynamics_of(ocp: OCP, path: Stage, dt: tuple[float, ...]) -> tuple[Function, tuple[int, ...], Function | None]:
    """The dynamics f(x, u, p), with the derivative 0 of states that are maps; their positions and their values at the
    next node (x, u, p, dt). A discrete map has these states in itself.

    Raises:
        ProblemError: a discrete map on a grid of different intervals asks for their lengths.
    """
    inner, own, nu = inner_of(ocp), ocp.x.numel(), path.nu
    x, u, p, length = symbols(path.nx, nu, int(path.p.numel()))
    acting = effective_controls(ocp, x, u, p)
    symbols_, places = data_symbols(ocp, p)
    old, new = ca.vertcat(ocp.x, *inner_symbols(ocp), ocp.u, *symbols_), ca.vertcat(x, acting, *places)
    stated = {**ocp.derivatives, **ocp.maps}
    f = elements(ca.substitute(ca.vertcat(*(stated[i] for i in range(own))), old, new))
    if ocp.discrete and inner.time and len(set(dt)) > 1:
        raise ProblemError(f"OCP '{ocp.name}': time of a discrete map requires intervals of one length")
    controls = [acting[j] for j in inner.previous]
    if ocp.discrete:
        time = [x[own] + dt[0]] if inner.time else []
        return _function("f", [x, u, p], [*f, *time, *controls]), (), None
    maps = (*sorted(ocp.maps), *range(own + inner.time, path.nx))
    jumps = [*(f[i] for i in sorted(ocp.maps)), *controls]
    rates = [*(ca.SX(0) if i in ocp.maps else f[i] for i in range(own))]
    rates += [ca.SX(int(inner.time and i == own)) for i in range(own, path.nx)]
    return _function("f", [x, u, p], rates), maps, _function("g", [x, u, p, length], jumps) if maps else None


def _function(name: str, inputs: list[Expression], values: list[Expression]) -> Function:
    return ca.Function(name, inputs, [ca.densify(ca.vertcat(*values))], ["x", "u", "p", "dt"][: len(inputs)], [name])


def complete_inner(problem: Problem, sampling_time: float | None) -> Problem:
    """The problem with what is known of these states when the time between samples is known."""
    problem = _with_interval_before(problem, sampling_time)
    if problem.inner.idle:
        return replace(problem, path=replace(problem.path, ties=problem.path.u))
    return _with_ties(problem, scales(problem)) if problem.inner.held else problem


def _with_interval_before(problem: Problem, sampling_time: float | None) -> Problem:
    """The problem with the time since the sample before as the length of the interval before node 0, and without such
    lengths where all are the same."""
    period = sampling_time or problem.dt[0]
    if not problem.inner.interval:
        return problem
    if not problem.uniform or period != problem.dt[0]:
        data = problem.node_data.copy()
        data[0, -1] = period
        return replace(problem, node_data=data)
    fewer, last = int(problem.path.p.numel()) - 1, problem.np - 1

    def complete(p: Expression) -> Expression:
        """The parameters with the length of the interval before, which is in front of what Newton's method finds."""
        return ca.vertcat(part(p, 0, last), period, part(p, last))

    def stage(old: Stage) -> Stage:
        p = ca.SX.sym("p", fewer)

        def reduce(value: Expression) -> Expression:
            return ca.densify(ca.substitute(value, old.p, complete(p)))

        return replace(
            old,
            p=p,
            y=reduce(old.y),
            h=reduce(old.h),
            cost=None if old.cost is None else reduce(old.cost),
            cost_rate=None if old.cost_rate is None else reduce(old.cost_rate),
        )

    x, u, p, dt = symbols(problem.nx, problem.nu, fewer)
    jump = problem.jump
    return replace(
        problem,
        parameters=problem.parameters[:-1],
        dynamics=_function("f", [x, u, p], [problem.dynamics(x, u, complete(p))]),
        start=stage(problem.start),
        path=stage(problem.path),
        terminal=stage(problem.terminal),
        inner=replace(problem.inner, interval=False),
        jump=None if jump is None else _function("g", [x, u, p, dt], [jump(x, u, complete(p), dt)]),
        node_data=problem.node_data[:, :-1],
        algebra=_with_period(problem, period),
    )


def _with_period(problem: Problem, period: float) -> Algebra | None:
    """The algebraic variables with a fixed length of the interval before, the last parameter."""
    if problem.algebra is None:
        return None
    x, u, p, _ = symbols(problem.nx, problem.nu, problem.np - 1)
    z = ca.SX.sym("z", problem.algebra.size)
    values, equations = (
        ca.Function("of_z", [x, u, p, z], [f(x, u, ca.vertcat(p, period), z)])
        for f in (problem.algebra.values, problem.algebra.equations)
    )
    return replace(problem.algebra, values=values, equations=equations)


#: Names of states that are meant to be controls of the node before.
_MEANT = re.compile(r"(^|_)(last|prev|previous|old|before|delayed)(_|$|\d)", re.IGNORECASE)


def warn_of_integrals(ocp: OCP) -> None:
    """Warn of a state that is meant to remember a control and integrates it: last' = u, and u - last in the problem."""
    names = [e for d in ocp.states for e in d.signal.elements]
    for i, derivative in sorted(ocp.derivatives.items()):
        control = ocp.element(derivative)
        if ocp.discrete or control is None or control.kind != "control":
            continue
        u, x = ocp.u[control.index], ocp.x[i]
        compared = any(_is_difference(e, u, x) for expression in _expressions(ocp) for e in elements(expression))
        if compared or _MEANT.search(names[i]):
            warn(
                f"dynamics: '{names[i]}' is the integral of {control.name}, not its last value; the control of the "
                f"node before is ocp.previous({control.name}), its slope ocp.rate({control.name})"
            )


def _is_difference(expression: Expression, u: Expression, x: Expression) -> bool:
    """True if the expression depends on u and x through u - x alone."""
    found = {s.element_hash() for s in ca.symvar(expression)}
    if not {u.element_hash(), x.element_hash()} <= found:
        return False
    change = ca.jacobian(expression, u) + ca.jacobian(expression, x)
    free = ca.symvar(change)
    at = ca.Function("change", [ca.vertcat(ca.SX(0, 1), *free)], [ca.densify(change)])
    draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, len(free)))
    return all(abs(float(at(draw))) < EQUAL for draw in draws)
