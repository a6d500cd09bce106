"""Values of the rows at a plan, and what they violate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.program import Array
from nmpc_codegen.package.signals import Row
from nmpc_codegen.runtime.memory import Memory

#: Violations up to this part of the size of a row are rounding, or what a QP solver leaves.
NEGLIGIBLE = 1e-6

#: Values of steps of a program that are in memory at once.
MOST_VALUES = 2**21


@dataclass(frozen=True)
class Violation:
    """A row outside its bounds by ``amount``; ``size``: its scale, or its largest finite bound or value in the plan."""

    row: Row
    node: int
    amount: float
    size: float

    def __str__(self) -> str:
        return f"row {self.row.name!r} at node {self.node} is violated by {self.amount:.3g}"


def start_parameters(ctrl: Memory) -> Array:
    """Parameters of node 0, (np,); the declared ones if they are fixed."""
    if ctrl.description.online["parameter"] == "fixed":
        return np.array([v for s in ctrl.description.parameters for v in s.value])
    stored = ctrl.member("p")
    own = ctrl.dims.np
    return np.asarray(stored[0, :own], dtype=np.float64) if stored.size else np.zeros(own)


def parameters(ctrl: Memory) -> Array:
    """Parameters of all nodes, (N+1, np); the declared ones if they are fixed."""
    return whole_parameters(ctrl)[:, : ctrl.dims.np]


def whole_parameters(ctrl: Memory) -> Array:
    """The same with those behind the parameters of the user."""
    d = ctrl.dims
    if ctrl.description.online["parameter"] == "fixed":
        return np.tile(start_parameters(ctrl), (d.N + 1, 1))
    stored = ctrl.member("p")
    if len(stored) == d.N + 1 or not stored.size:
        return np.asarray(stored, dtype=np.float64).reshape(d.N + 1, -1)
    return np.array([*([stored[0]] * d.N), stored[-1]], dtype=np.float64)


def append_solved(described: PackageDescription, p: Array, z: Array) -> Array:
    """Parameters, and behind them what expressions read: of the algebraic variables z those that Newton's method finds,
    NaN for derivatives of states, which are no outputs, and slopes, which no value depends on."""
    known, names = dict(zip(described.names.algebraic, z.T, strict=True)), described.newton
    solved = [known.get(name, np.full(len(p), np.nan)) for name in names]
    return np.column_stack([p, *solved, np.zeros((len(p), len(names) ** 2))])


def plan_data(ctrl: Memory) -> Array:
    """What expressions of all nodes read in place of p."""
    return append_solved(ctrl.description, np.asarray(whole_parameters(ctrl), dtype=np.float64), ctrl.z)


def path_reference(ctrl: Memory) -> Array:
    """Reference of the path residual at node 0, (ny,); the declared one if it is fixed."""
    if ctrl.description.online["reference"] == "fixed":
        return np.array([residual.reference for residual in ctrl.description.residuals])
    stored = np.asarray(ctrl.member("yref"), dtype=np.float64)
    return stored[0] if len(stored) else np.zeros(ctrl.dims.ny)


def row_values(ctrl: Memory, x: Array, u: Array, p: Array, end: bool = False) -> Array:
    """Values of all general rows at x (n, nx and the states behind those of the user), u (n, nu), p (n, np) -> (n,
    number of rows), NaN for other rows.

    end: those of the end of the horizon.
    """
    program = ctrl.description.program
    out = np.full((len(x), len(program.rows)), np.nan)
    places = {i: place[end] for i, place in enumerate(program.rows) if place[end] >= 0}
    size = max(1, MOST_VALUES // max(1, len(program.steps)))
    for begin in range(0, len(x) if places else 0, size):
        some = slice(begin, begin + size)
        with np.errstate(all="ignore"):
            values = program.values(x[some], u[some], p[some], places.values())
        for i, place in places.items():
            out[some, i] = values[place]
    return out


def bounds_at(ctrl: Memory, row: int, node: int) -> tuple[float, float]:
    """Present bounds of scalar row number ``row`` at a node."""
    info = ctrl.description.rows[row]
    if ctrl.description.online["bounds"] == "fixed":
        return info.lower, info.upper
    lower, upper = (_copy_at(ctrl, which, node)[row] for which in ("lower", "upper"))
    return float(lower), float(upper)


def is_hard(ctrl: Memory, row: int, node: int) -> bool:
    """True if scalar row number ``row`` is hard at a node at present."""
    info = ctrl.description.rows[row]
    if info.soft is None or ctrl.description.online["soft"] == "fixed":
        return info.hard
    number = sum(r.soft is not None for r in ctrl.description.rows[:row])
    return bool(np.isinf(_copy_at(ctrl, "soft_l1", node)[number]))


def _copy_at(ctrl: Memory, member: str, node: int) -> Array:
    """Data of a node: its own, or those that the path, or the end, shares."""
    stored: Array = ctrl.view(member)
    own: Array = stored[node if len(stored) == ctrl.dims.N + 1 else 0 if node < ctrl.dims.N else -1]
    return own


def path_bounds(ctrl: Memory, row: int) -> tuple[float, float]:
    """Smallest lower and largest upper bound of a scalar row at present over its nodes before the end, else at it."""
    nodes = [k for k in ctrl.description.rows[row].nodes if k < ctrl.dims.N] or [ctrl.dims.N]
    found = [bounds_at(ctrl, row, k) for k in nodes]
    return min(lower for lower, _ in found), max(upper for _, upper in found)


def violations(ctrl: Memory) -> list[Violation]:
    """Hard rows that the plan violates, at their worst nodes; those that are worst in their size come first."""
    x, u, p = (np.asarray(v, dtype=np.float64) for v in (ctrl.x, ctrl.u, plan_data(ctrl)))
    held = np.append(u, u[-1:], axis=0)
    whole = np.asarray(ctrl.whole_x, dtype=np.float64)
    path, end = row_values(ctrl, whole[:-1], u, p[:-1]), row_values(ctrl, whole[-1:], held[-1:], p[-1:], end=True)
    general = np.append(path, end, axis=0)
    worst = []
    for number, row in enumerate(ctrl.description.rows):
        if row.hard and not row.is_coupled:
            place = row.variable(ctrl.dims.nx)
            values = general[:, number] if place is None else np.hstack([x, held])[:, place]
            measured = place is not None and place < ctrl.dims.nx  # x_0 is given
            nodes = (k for k in row.nodes if (k or not measured) and is_hard(ctrl, number, k))
            most = float(np.nanmax(np.abs(values), initial=ctrl.description.row_scales[number]))
            found = (_violation(row, k, float(values[k]), most, *bounds_at(ctrl, number, k)) for k in nodes)
            worst += sorted((v for v in found if v.amount > NEGLIGIBLE * v.size), key=lambda v: -v.amount)[:1]
    return sorted(worst, key=lambda v: -v.amount / v.size)


def _violation(row: Row, node: int, value: float, most: float, lower: float, upper: float) -> Violation:
    size = max((abs(b) for b in (lower, upper) if np.isfinite(b)), default=0.0)
    return Violation(row, node, max(value - upper, lower - value), max(size, most))
