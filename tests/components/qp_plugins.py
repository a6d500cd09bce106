"""CasADi's conic plugins on stage QPs: variables [x_0 u_0 x_1 ... x_N], rows [gap_0 rows_0 gap_1 ...]."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from verification.oracles.stage_qp import Array, Point, StageQP, dynamics_matrix, row_values

#: No output, and accurate enough for both solvers to give the same answer.
OPTIONS: dict[str, dict[str, Any]] = {
    "qpoases": {"printLevel": "none", "sparse": False},
    "proxqp": {"proxqp": {"eps_abs": 1e-9, "verbose": False}},
}


@dataclass(frozen=True, eq=False)
class Formulation:
    """min 1/2 w'Hw + g'w,  lba <= A w <= uba,  lbx <= w <= ubx; soft rows have two slacks each at the end of w."""

    H: sp.csc_matrix
    g: Array
    A: sp.csc_matrix
    lba: Array
    uba: Array
    lbx: Array
    ubx: Array


def stage_form(qp: StageQP) -> Formulation:
    """All of dx and du; state bounds as simple bounds, gaps and general rows stage by stage."""
    s, rows = qp.shape, qp.rows
    nz, n = s.nx + s.nu, s.N * (s.nx + s.nu) + s.nx
    lbx, ubx = np.full(n, -np.inf), np.full(n, np.inf)
    at = np.arange(s.N)[:, None] * nz + s.nx + np.arange(s.nu)
    lbx[at], ubx[at] = qp.lower_u - qp.u, qp.upper_u - qp.u
    lbx[s.free : s.nx] = ubx[s.free : s.nx] = qp.dx0[s.free :]
    soft = np.isfinite(rows.l1)
    plain = (rows.kind == 0) & ~soft
    where = rows.node[plain] * nz + rows.index[plain]
    lbx[where], ubx[where] = qp.lower[plain] - qp.c[plain], qp.upper[plain] - qp.c[plain]
    general = np.flatnonzero(~plain)
    R = sp.lil_matrix((len(general), n))
    for i, m in enumerate(general):
        k = rows.node[m]
        width = nz if k < s.N else s.nx
        R[i, k * nz : k * nz + width] = qp.C[m, :width]
        if rows.kind[m] == 2:
            R[i, : s.nx] = qp.C0[m]
    D = dynamics_matrix(qp)[s.nx :]
    gap_node = np.repeat(np.arange(s.N), s.nx)
    order = np.lexsort((np.r_[0 * gap_node, 1 + 0 * general], np.r_[gap_node, rows.node[general]]))
    A = sp.vstack([D, R.tocsr()]).tocsr()[order]
    lba = np.append(-qp.b.ravel(), (qp.lower - qp.c)[general])[order]
    uba = np.append(-qp.b.ravel(), (qp.upper - qp.c)[general])[order]
    H = sp.block_diag([*qp.Q, qp.Q_N], format="csc")
    form = Formulation(H, np.append(qp.g.ravel(), qp.g_N), A.tocsc(), lba, uba, lbx, ubx)
    place = np.argsort(order)[s.N * s.nx :][soft[general]]  # rows of A that are soft
    return _with_slacks(form, place, rows.l1[general][soft[general]], rows.l2[general][soft[general]])


def _with_slacks(f: Formulation, place: Array, l1: Array, l2: Array) -> Formulation:
    """Row i of the soft ones: lower <= value + below - above <= upper, cost l1 v + l2/2 v^2 of each."""
    m = len(place)
    if not m:
        return f
    E = sp.csc_matrix((np.ones(m), (place, np.arange(m))), shape=(f.A.shape[0], m))
    return Formulation(
        sp.block_diag([f.H, sp.diags(l2), sp.diags(l2)], format="csc"),
        np.concatenate([f.g, l1, l1]),
        sp.hstack([f.A, E, -E]).tocsc(),
        f.lba,
        f.uba,
        np.append(f.lbx, np.zeros(2 * m)),
        np.append(f.ubx, np.full(2 * m, np.inf)),
    )


def solve(name: str, f: Formulation) -> tuple[bool, Array]:
    """(success, w) of a plugin."""
    H, A = _sparsity(f.H), _sparsity(f.A)
    options = {"error_on_fail": False, "print_time": False} | OPTIONS[name]
    solver = ca.conic(f"{name}_solver", name, {"h": H, "a": A}, options)
    h, a = _values(H, f.H), _values(A, f.A)
    found = solver(h=h, g=f.g, a=a, lba=f.lba, uba=f.uba, lbx=f.lbx, ubx=f.ubx)
    return bool(solver.stats()["success"]), np.array(found["x"]).ravel()


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Discard banners that the library of a solver writes to the file descriptor of stdout."""
    saved, sink = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    try:
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(sink)


def _sparsity(m: sp.spmatrix) -> Any:
    m = m.tocsc()
    m.sort_indices()
    rows, columns = m.shape
    return ca.Sparsity(rows, columns, m.indptr.tolist(), m.indices.tolist())


def _values(pattern: Any, m: sp.spmatrix) -> Any:
    row, col = (np.array(index, dtype=int) for index in pattern.get_triplet())
    return ca.DM(pattern, np.asarray(m.tocsr()[row, col]).ravel() if len(row) else np.zeros(0))


def point_of(qp: StageQP, w: Array) -> Point:
    """dx, du from the variables of stage_form(); multipliers are not evaluated."""
    s = qp.shape
    nz = s.nx + s.nu
    z = np.append(w[: s.N * nz + s.nx], np.zeros(s.nu)).reshape(s.N + 1, nz)
    return Point(z[:, : s.nx], z[:-1, s.nx :], np.zeros((s.N, s.nu)), np.zeros(len(qp.rows)))


def violation(qp: StageQP, p: Point) -> float:
    """Largest violation of hard rows and bounds."""
    value, hard = row_values(qp, p.dx, p.du), np.isinf(qp.rows.l1)
    rows = np.maximum(value - qp.upper, qp.lower - value)[hard]
    controls = np.maximum(qp.u + p.du - qp.upper_u, qp.lower_u - qp.u - p.du)
    return float(max(np.max(rows, initial=0.0), np.max(controls, initial=0.0)))
