"""CasADi's conic plugins on stage QPs: the same QP in the form that suits each plugin.

Stage form, variables [x_0 u_0 x_1 ... x_N], rows [gap_0 rows_0 gap_1 ...], is what HPIPM, FATROP and OSQP take; daqp
and qpOASES, dense solvers, also accept the condensed QP, which the caller then has to condense.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from verification.oracles.stage_qp import Array, Point, StageQP, dynamics_matrix, row_values

#: No output, and accurate enough for all solvers to give the same answer.
OPTIONS: dict[str, dict[str, Any]] = {
    "hpipm": {"hpipm": {"mode": "speed_abs", "iter_max": 50}, "inf": 1e4},
    "fatrop": {"structure_detection": "manual", "fatrop": {"print_level": 0, "tol": 1e-8}},
    "osqp": {"osqp": {"verbose": False, "eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 20000, "polish": True}},
    "daqp": {"daqp": {}},
    "qpoases": {"printLevel": "none", "sparse": False},
    "highs": {"highs": {"output_flag": False}},
    "proxqp": {"proxqp": {"eps_abs": 1e-9, "verbose": False}},
}
STAGE_STRUCTURED = ("hpipm", "fatrop")


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
    nx: tuple[int, ...] = ()
    nu: tuple[int, ...] = ()
    ng: tuple[int, ...] = ()


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
    counts = tuple(int(np.sum(rows.node[general] == k)) for k in range(s.N + 1))
    form = Formulation(
        H, np.append(qp.g.ravel(), qp.g_N), A.tocsc(), lba, uba, lbx, ubx, (s.nx,) * (s.N + 1), (s.nu,) * s.N, counts
    )
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


def _states(qp: StageQP) -> tuple[Array, Array]:
    """dx_k = G_k du + x_k: G (N+1, nx, N nu), x (N+1, nx)."""
    s = qp.shape
    G, x = np.zeros((s.N + 1, s.nx, s.N * s.nu)), np.zeros((s.N + 1, s.nx))
    x[0] = qp.dx0
    for k in range(s.N):
        G[k + 1] = qp.S[k, :, : s.nx] @ G[k]
        G[k + 1, :, k * s.nu : (k + 1) * s.nu] += qp.S[k, :, s.nx :]
        x[k + 1] = qp.S[k, :, : s.nx] @ x[k] + qp.b[k]
    return G, x


class Plugin:
    """One conic solver for QPs that fit into the union of the patterns of ``forms``; it stores its last solution."""

    def __init__(self, name: str, forms: Sequence[Formulation], dense: bool = False, **more: Any) -> None:
        form, n = forms[0], len(forms[0].g)
        if dense:
            self.H, self.A = ca.Sparsity.dense(n, n), ca.Sparsity.dense(*form.A.shape)
        else:
            self.H, self.A = (_sparsity(sum(abs(getattr(f, m)) for f in forms)) for m in ("H", "A"))
        self.name = name
        options: dict[str, Any] = {"error_on_fail": False, "print_time": False, "record_time": True}
        options |= OPTIONS.get(name, {}) | more
        if name in STAGE_STRUCTURED and form.nx:
            options |= {"N": len(form.nu), "nx": form.nx, "nu": (*form.nu, 0), "ng": form.ng}
        self.solver = ca.conic(f"{name}_solver", name, {"h": self.H, "a": self.A}, options)
        self.last: dict[str, Any] = {}

    def solve(self, f: Formulation, *, warm: bool = False) -> tuple[bool, Array]:
        """(success, w); started from the last solution if ``warm``, else without one."""
        h, a = (_values(self.H, f.H), _values(self.A, f.A))
        start = {}
        if warm and self.last:
            start = {"x0": self.last["x"], "lam_x0": self.last["lam_x"], "lam_a0": self.last["lam_a"]}
        self.last = self.solver(h=h, g=f.g, a=a, lba=f.lba, uba=f.uba, lbx=f.lbx, ubx=f.ubx, **start)
        self.stats = self.solver.stats()
        return bool(self.stats["success"]), np.array(self.last["x"]).ravel()

    @property
    def time(self) -> float:
        """Time (us) of the last solve by CasADi's clock; only that of the solver if the plugin states it separately."""
        return 1e6 * float(self.stats.get("t_wall_solver") or self.stats["t_wall_total"])


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
