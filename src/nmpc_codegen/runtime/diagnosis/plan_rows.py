"""The rows of a problem are evaluated at a plan, and their violations are found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.program import Array
from nmpc_codegen.package.signals import Row
from nmpc_codegen.runtime.memory import Memory

#: Violations up to this fraction of the size of a row are rounding, or the tolerance of a QP solver.
NEGLIGIBLE = 1e-6

#: Largest number of intermediate values of a program in memory at once.
MOST_VALUES = 2**21


@dataclass(frozen=True)
class Violation:
    """A violation is a row that is outside its bounds by ``amount``.

    ``size`` is its scale, or its largest finite bound or value in the plan.
    """

    row: Row
    node: int
    amount: float
    size: float

    def __str__(self) -> str:
        return f"row {self.row.name!r} at node {self.node} is violated by {self.amount:.3g}"


def start_parameters(ctrl: Memory) -> Array:
    """Return the parameters of node 0, (np,); the declared ones if they are fixed."""
    if ctrl.description.online["parameter"] == "fixed":
        return np.array([v for s in ctrl.description.parameters for v in s.value])
    stored = ctrl.member("p")
    own = ctrl.dims.np
    return np.asarray(stored[0, :own], dtype=np.float64) if stored.size else np.zeros(own)


def parameters(ctrl: Memory) -> Array:
    """Return the parameters of all nodes, (N+1, np); the declared ones if they are fixed."""
    return whole_parameters(ctrl)[:, : ctrl.dims.np]


def whole_parameters(ctrl: Memory) -> Array:
    """Return the parameters of all nodes with those that the compiler has added, (N+1, np + added)."""
    d = ctrl.dims
    if ctrl.description.online["parameter"] == "fixed":
        return np.tile(start_parameters(ctrl), (d.N + 1, 1))
    stored = ctrl.member("p")
    return by_node(stored, d.N) if stored.size else np.zeros((d.N + 1, 0))


def by_node(stored: Array, N: int) -> Array:
    """Return a copy of the data of all nodes 0..N.

    ``stored`` has a row for each node, or one for the path and one for the end.
    """
    nodes = slice(None) if len(stored) == N + 1 else [*[0] * N, -1]
    return np.array(stored[nodes], dtype=np.float64)


def append_solved(described: PackageDescription, p: Array, z: Array) -> Array:
    """Append the results of Newton's method to the parameters p (n, np), as expressions read them.

    These are algebraic variables from z, NaN for derivatives of states, which are no outputs, and 0 for slopes, on
    which no value depends.
    """
    known, names = dict(zip(described.names.algebraic, z.T, strict=True)), described.newton
    solved = [known.get(name, np.full(len(p), np.nan)) for name in names]
    return np.column_stack([p, *solved, np.zeros((len(p), len(names) ** 2))])


def plan_data(ctrl: Memory) -> Array:
    """Return the numbers that expressions at all nodes use for p."""
    return append_solved(ctrl.description, whole_parameters(ctrl), ctrl.z)


def path_reference(ctrl: Memory) -> Array:
    """Return the reference of the path residual at node 0, (ny,); the declared one if it is fixed."""
    if ctrl.description.online["reference"] == "fixed":
        return np.array([residual.reference for residual in ctrl.description.residuals])
    stored = np.asarray(ctrl.member("yref"), dtype=np.float64)
    return stored[0] if len(stored) else np.zeros(ctrl.dims.ny)


def row_values(ctrl: Memory, x: Array, u: Array, p: Array, z: Array, end: bool = False) -> Array:
    """Return the values of all general rows, (n, number of rows), NaN for other rows.

    Args:
        ctrl: the controller.
        x: states with those that the compiler has added, (n, nx + added).
        u: controls (n, nu).
        p: parameters with those that the compiler has added, (n, np + added).
        z: algebraic variables (n, number of them).
        end: evaluate the rows of the end of the horizon.
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
    """Return the values of all rows at the nodes of n plans, (n, N+1, number of rows).

    Rows on single states and controls are included; coupled rows are NaN. The arguments are those of row_values() for n
    plans: (n, N+1, ...), u (n, N, nu).
    """
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
    """Return the nodes at which a row constrains a plan; rows on states do not constrain x_0, which is given."""
    return [k for k in row.nodes if k or row.kind != "state"]


def bounds_at(ctrl: Memory, row: int, node: int) -> tuple[float, float]:
    """Return the present bounds of scalar row number ``row`` at a node."""
    info = ctrl.description.rows[row]
    if ctrl.description.online["bounds"] == "fixed":
        return info.lower, info.upper
    lower, upper = (_copy_at(ctrl, which, node)[row] for which in ("lower", "upper"))
    return float(lower), float(upper)


def is_hard(ctrl: Memory, row: int, node: int) -> bool:
    """Return True if scalar row number ``row`` is hard at a node at present."""
    info = ctrl.description.rows[row]
    if info.soft is None or ctrl.description.online["soft"] == "fixed":
        return info.hard
    number = sum(r.soft is not None for r in ctrl.description.rows[:row])
    return bool(np.isinf(_copy_at(ctrl, "soft_l1", node)[number]))


def _copy_at(ctrl: Memory, member: str, node: int) -> Array:
    """Return the data of a node: its own, or those that the path, or the end, shares."""
    stored: Array = ctrl.view(member)
    own: Array = stored[node if len(stored) == ctrl.dims.N + 1 else 0 if node < ctrl.dims.N else -1]
    return own


def path_bounds(ctrl: Memory, row: int) -> tuple[float, float]:
    """Return the smallest lower and largest upper present bound of a scalar row over its nodes.

    Node N counts only if the row holds nowhere else.
    """
    nodes = [k for k in ctrl.description.rows[row].nodes if k < ctrl.dims.N] or [ctrl.dims.N]
    found = [bounds_at(ctrl, row, k) for k in nodes]
    return min(lower for lower, _ in found), max(upper for _, upper in found)


def violations(ctrl: Memory) -> list[Violation]:
    """Return the hard rows that the plan violates, at their worst nodes, largest relative violation first."""
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
