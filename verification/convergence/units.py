"""A problem is stated in other units: every state, control, row and the cost are divided by a random power of ten."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import OCP
from nmpc_codegen.frontend.statement import Statement

Array = np.ndarray
DECADES = 3  # units are between 1e-3 and 1e3
COST_DECADES = 6  # costs are multiplied by 1e-6 to 1e6


@dataclass(frozen=True, eq=False)
class Units:
    """x = x_unit y_x, u = u_unit y_u.

    Rows are divided by numbers of the generator, the cost is multiplied by ``cost``.
    """

    x: Array
    u: Array
    rows: np.random.Generator
    cost: float = 1.0

    @classmethod
    def of(cls, ocp: OCP, seed: int) -> Units:
        """Draw random units for a problem."""
        random = np.random.default_rng([13, seed])
        sizes = ocp.x.numel(), ocp.u.numel()
        x, u = (10.0 ** random.uniform(-DECADES, DECADES, size) for size in sizes)
        return cls(x, u, random, 10.0 ** random.uniform(-COST_DECADES, COST_DECADES))


def in_units(ocp: OCP, units: Units) -> OCP:
    """Return the problem for the signals divided by their units, without parameters."""
    new = OCP(ocp.name, N=ocp.N) if ocp.dt is None else OCP(ocp.name, intervals=ocp.dt)
    for signals, declare, unit in ((ocp.states, new.state, units.x), (ocp.controls, new.control, units.u)):
        for d in signals:
            part = unit[d.signal.offset : d.signal.offset + d.signal.size]
            more = {"initial": np.atleast_1d(d.signal.value) / part} if signals is ocp.states else {}
            if d.signal.scale:
                more["scale"] = np.array(d.signal.scale) / part
            declare(d.signal.name, size=d.signal.size, **more)

    def new_text(expression: Any) -> Any:
        old = ca.vertcat(ocp.x, ocp.u, ocp.x_start, ocp.x_end)
        same = [units.x * new.x, units.u * new.u, units.x * new.x_start, units.x * new.x_end]
        return ca.substitute(ca.SX(expression), old, ca.vertcat(*same))

    rhs = ca.vertcat(*(ocp.derivatives[i] for i in range(units.x.size)))
    new.dynamics(new_text(rhs) / units.x, discrete=bool(ocp.discrete))
    _add_costs(ocp, new, new_text, units)
    for statement in ocp.statements:
        _add_rows(new, statement, new_text(statement.expression), units)
    if ocp.free:
        new.free_initial(*(new.x[i] for i in sorted(ocp.free)))
    if ocp.accumulators:
        new.accumulator(*(new.x[i] for i in sorted(ocp.accumulators)))
    return new


def _in_own_units(ocp: OCP, new: OCP, old: Any, text: Any, units: Units) -> tuple[Any, Array]:
    """Return a residual whose elements that are signals remain signals, and the units of its elements."""
    y, d = [], np.ones(text.numel())
    for i in range(text.numel()):
        element, symbol = ocp.element(old[i]), text[i]
        if element is not None and element.kind in ("state", "control"):
            signals, scale = (new.x, units.x) if element.kind == "state" else (new.u, units.u)
            symbol, d[i] = signals[element.index], scale[element.index]
        y.append(symbol)
    return ca.vertcat(*y), d


def _add_costs(ocp: OCP, new: OCP, new_text: Callable[[Any], Any], units: Units) -> None:
    squares = {"start": new.start_least_squares, "terminal": new.terminal_least_squares}
    general = {"start": new.start_cost, "terminal": new.terminal_cost}
    for r in ocp.residuals:
        y, d = _in_own_units(ocp, new, r.y, new_text(r.y), units)
        weight = units.cost * r.weight * np.outer(d, d)
        more: dict[str, Any] = {"reference": r.reference / d}
        if r.scale:
            more["scale"] = np.array(r.scale) / d
        if r.stage == "path":
            new.least_squares(y, weight, scale_with_dt=r.scale_with_dt, **more)
        else:
            squares[r.stage](y, weight, **more)
    for c in ocp.costs:
        if c.stage == "path":
            new.stage_cost(units.cost * new_text(c.expression), integrate=c.integrate, scale_with_dt=c.scale_with_dt)
        else:
            general[c.stage](units.cost * new_text(c.expression))


def _add_rows(new: OCP, statement: Statement, h: Any, units: Units) -> None:
    """Add rows in their units: a bound is divided by the unit of its signal, any other row by a unit of its own."""
    symbols, scale = ca.vertcat(new.x, new.u), np.concatenate([units.x, units.u])
    for i, name in enumerate(statement.names):
        slope = np.array(ca.DM(ca.jacobian(h[i], symbols)).full()).ravel() if _is_linear(h[i], symbols) else None
        d, expression = 10.0 ** units.rows.uniform(-DECADES, DECADES), None
        if slope is not None and np.count_nonzero(slope) == 1 and abs(slope.sum()) == scale[slope != 0]:
            d, expression = scale[slope != 0][0], symbols[int(np.flatnonzero(slope)[0])]
        expression = h[i] / d if expression is None else expression
        lower, upper = statement.lower[i] / d, statement.upper[i] / d
        weights = (units.cost * d, units.cost * d * d)
        soft = None if statement.soft is None else (statement.soft[0] * weights[0], statement.soft[1] * weights[1])
        more: dict[str, Any] = {"soft": soft, "name": "row_" + name.replace("[", "_").replace("]", "")}
        if statement.at is None:
            new.boundary(lower, expression, upper, **more)
        else:
            new.subject_to(lower, expression, upper, at=statement.at, **more)


def _is_linear(h: Any, symbols: Any) -> bool:
    return not ca.depends_on(ca.jacobian(h, symbols), symbols) and ca.depends_on(h, symbols)
