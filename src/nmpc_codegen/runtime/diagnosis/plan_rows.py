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
    return by_node(stored, d.N) if stored.size else np.zeros((d.N + 1, 0))


def by_node(stored: Array, N: int) -> Array:
    """Data of all nodes 0..N, a copy, from their own, or from those that the path and the end share."""
    nodes = slice(None) if len(stored) == N + 1 else [*[0] * N, -1]
    return np.array(stored[nodes], dtype=np.float64)


def append_solved(described: PackageDescription, p: Array, z: Array) -> Array:
    """Parameters, and behind them what expressions read: of the algebraic variables z those that Newton's method finds,
    NaN for derivatives of states, which are no outputs, and slopes, which no value depends on."""
    known, names = dict(zip(described.names.algebraic, z.T, strict=True)), described.newton
    solved = [known.get(name, np.full(len(p), np.nan)) for name in names]
    return np.column_stack([p, *solved, np.zeros((len(p), len(names) ** 2))])


def plan_data(ctrl: Memory) -> Array:
    """What expressions of all nodes read in place of p."""
    return append_solved(ctrl.description, whole_parameters(ctrl), ctrl.z)


def path_reference(ctrl: Memory) -> Array:
    """Reference of the path residual at node 0, (ny,); the declared one if it is fixed."""
    if ctrl.description.online["reference"] == "fixed":
        return np.array([residual.reference for residual in ctrl.description.residuals])
    stored = np.asarray(ctrl.member("yref"), dtype=np.float64)
    return stored[0] if len(stored) else np.zeros(ctrl.dims.ny)


def row_values(ctrl: Memory, x: Array, u: Array, p: Array, z: Array, end: bool = False) -> Array:
    """Values of all general rows, (n, number of rows), NaN for other rows.

    x (n, nx and the states behind those of the user), u (n, nu), p (n, np and what is behind the parameters of the
    user), z (n, number of algebraic variables); end: those of the end of the horizon.
    """
    program, solved = ctrl.description.program, len(ctrl.description.newton)
    out = np.full((len(x), len(program.rows)), np.nan)
    places = {i: place[end] for i, place in enumerate(program.rows) if place[end] >= 0}
    size = max(1, MOST_VALUES // (1 + len(program.steps) + solved**2))
    for begin in range(0, len(x) if places else 0, size):
        some = slice(begin, begin + size)
        with np.errstate(all="ignore"):
            read = append_solved(ctrl.description, p[some], z[some])
            values = program.values(x[some], u[some], read, places.values())
        for i, place in places.items():
            out[some, i] = values[place]
    return out


def values_at_nodes(ctrl: Memory, x: Array, u: Array, p: Array, z: Array) -> Array:
    """Values of all rows at the nodes of n plans, (n, N+1, number of rows), those of bare states and controls too; NaN
    for coupled rows. The arguments are those of row_values() for n plans: (n, N+1, ...), u (n, N, nu)."""
    n, N, nx = len(x), ctrl.dims.N, ctrl.dims.nx
    held, rows = np.append(u, u[:, -1:], axis=1), ctrl.description.rows
    found = np.empty((n, N + 1, len(rows)))
    for end, nodes in ((False, slice(0, N)), (True, slice(N, N + 1))):
        count = n * (1 if end else N)
        xs, us, ps, zs = (a[:, nodes].reshape(count, a.shape[2]) for a in (x, held, p, z))
        found[:, nodes] = row_values(ctrl, xs, us, ps, zs, end).reshape(found[:, nodes].shape)
    for i, row in enumerate(rows):
        if (place := row.variable(nx)) is not None:
            found[..., i] = x[..., place] if place < nx else held[..., place - nx]
    return found


def imposed_nodes(row: Row) -> list[int]:
    """Nodes at which a row is imposed on a plan: x_0 is given."""
    return [k for k in row.nodes if k or row.kind != "state"]


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
    parts = ctrl.whole_x, ctrl.u, whole_parameters(ctrl), ctrl.z
    x, u, p, z = (np.asarray(part, dtype=np.float64)[None] for part in parts)
    found = values_at_nodes(ctrl, x, u, p, z)[0]
    worst = []
    for number, row in enumerate(ctrl.description.rows):
        if row.hard and not row.is_coupled:
            values = found[:, number]
            nodes = (k for k in imposed_nodes(row) if is_hard(ctrl, number, k))
            most = float(np.nanmax(np.abs(values), initial=ctrl.description.row_scales[number]))
            at = (_violation(row, k, float(values[k]), most, *bounds_at(ctrl, number, k)) for k in nodes)
            worst += sorted((v for v in at if v.amount > NEGLIGIBLE * v.size), key=lambda v: -v.amount)[:1]
    return sorted(worst, key=lambda v: -v.amount / v.size)


def _violation(row: Row, node: int, value: float, most: float, lower: float, upper: float) -> Violation:
    size = max((abs(b) for b in (lower, upper) if np.isfinite(b)), default=0.0)
    return Violation(row, node, max(value - upper, lower - value), max(size, most))
