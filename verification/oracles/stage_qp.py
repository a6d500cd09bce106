"""NumPy evaluates stage QPs and their optimality conditions, independently of every solver.

    min   sum_{k<N} 1/2 z_k' Q_k z_k + g_k' z_k  +  1/2 dx_N' Q_N dx_N + g_N' dx_N  +  penalties of violated soft rows
    s.t.  dx_0 = xhat - x_0 (except its free components),   dx_{k+1} = S_k z_k + b_k,   z_k = (dx_k, du_k)
          lower <= c_m + C_m z_{k(m)} + C0_m dx_0 <= upper,   lower_u <= u + du <= upper_u

A soft row costs l1 v + l2/2 v^2 if its value violates its bounds by v. Multipliers are > 0 at an upper bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, onenormest

Array = np.ndarray

#: (l1, l2) of the soft row of index i, in turn.
SOFT = ((2.0, 0.0), (1.0, 0.5), (0.0, 3.0), (0.3, 10.0))
TINY = np.finfo(float).tiny
REDUNDANT = 1e-13  # replaces the zero block of K


@dataclass(frozen=True, order=True)
class Shape:
    """A shape has the dimensions of a stage QP, for which a package is built.

    ``controls``: the first so many controls are bounded (None: all); ``states``: the first so many states are bounded
    at nodes 1 .. N; ``path``: general rows on (x, u) at nodes 0 .. N-1; ``pure``: general rows on x at nodes 1 .. N;
    ``end``: general rows at node N; ``coupled``: rows on (x_0, x_N); ``soft``: indices of the soft ones in the list
    (states, path, pure, end, coupled); ``free``: the first so many components of x_0 are free; their state bounds and
    the pure rows then also hold at node 0.
    """

    nx: int
    nu: int
    N: int
    controls: int | None = None
    states: int = 0
    path: int = 0
    pure: int = 0
    end: int = 0
    coupled: int = 0
    soft: tuple[int, ...] = ()
    free: int = 0

    def __str__(self) -> str:
        more = [f"{n}={getattr(self, n)}" for n in ("states", "path", "pure", "end", "coupled", "soft", "free")]
        given = [text for text in more if not text.endswith(("=0", "=()"))]
        controls = [] if self.controls is None else [f"controls={self.controls}"]
        return ",".join([f"{self.nx}x{self.nu}x{self.N}", *controls, *given])

    @property
    def bounded(self) -> int:
        """Return the number of bounded controls."""
        return self.nu if self.controls is None else self.controls

    @property
    def user_rows(self) -> int:
        """Return the number of scalar rows as a user states them, without control bounds."""
        return self.states + self.path + self.pure + self.end + self.coupled

    @property
    def penalties(self) -> tuple[tuple[float, float] | None, ...]:
        """Return (l1, l2) of every user row, None for a hard one."""
        return tuple(SOFT[i % len(SOFT)] if i in self.soft else None for i in range(self.user_rows))


@dataclass(frozen=True, eq=False)
class Rows:
    """The QP rows of a shape are sorted by (node, kind, index): kind 0 state bound, 1 general row, 2 coupled row.

    ``user``: index of the user's row; ``l1`` (infinite: hard), ``l2``.
    """

    node: Array
    kind: Array
    index: Array
    user: Array
    l1: Array
    l2: Array

    def __len__(self) -> int:
        return len(self.node)


@cache
def rows_of(shape: Shape) -> Rows:
    """Return the QP rows besides the control bounds."""
    found = sorted(_listed(shape))
    node, kind, index, user = (np.array([r[i] for r in found], dtype=int) for i in range(4))
    soft = [shape.penalties[i] for i in user]
    l1 = np.array([np.inf if p is None else p[0] for p in soft])
    l2 = np.array([0.0 if p is None else p[1] for p in soft])
    return Rows(node, kind, index, user, l1, l2)


def _listed(s: Shape) -> Iterator[tuple[int, int, int, int]]:
    """Yield (node, kind, index, index of the user's row)."""
    first = 0 if s.free else 1
    for i in range(s.states):
        yield from ((k, 0, i, i) for k in range(0 if i < s.free else 1, s.N + 1))
    user = s.states
    for i in range(s.path):
        yield from ((k, 1, i, user + i) for k in range(s.N))
    user += s.path
    for i in range(s.pure):
        yield from ((k, 1, s.path + i, user + i) for k in range(first, s.N))
        yield (s.N, 1, i, user + i)
    user += s.pure
    for i in range(s.end):
        yield (s.N, 1, s.pure + i, user + i)
    user += s.end
    for i in range(s.coupled):
        yield (s.N, 2, i, user + i)


@dataclass(frozen=True, eq=False)
class Point:
    """A point has dx (N+1, nx), du (N, nu), multipliers of control bounds (N, nu) and of the rows (ng,)."""

    dx: Array
    du: Array
    mult_u: Array
    mult: Array


@dataclass(frozen=True, eq=False)
class StageQP:
    """A stage QP uses only nx, nu, N and free of its shape.

    Q (N, nz, nz) and Q_N are symmetric; rows C (ng, nz) (x part only at node N), C0 (ng, nx), c (ng,).
    ``optimum``: the point from which it was built; None: infeasible, and ``proof`` = (weights of du bounds, of rows)
    combines bounds to a contradiction. ``unique``: the minimiser is unique. ``growth``: bound of the growth of
    |A_k ... A_0| per interval. ``unit_x``, ``unit_u``: size of the variables. ``kind``, ``seed``: its origin.
    """

    shape: Shape
    rows: Rows
    S: Array
    b: Array
    Q: Array
    Q_N: Array
    g: Array
    g_N: Array
    C: Array
    C0: Array
    c: Array
    lower: Array
    upper: Array
    lower_u: Array
    upper_u: Array
    x: Array
    u: Array
    dx0: Array
    optimum: Point | None
    proof: tuple[Array, Array] | None
    unit_x: Array
    unit_u: Array
    unique: bool = True
    growth: float = 1.0
    kind: str = ""
    seed: int = 0

    def __repr__(self) -> str:
        return f"StageQP({self.shape}, {self.kind!r}, {self.seed})"


def stacked(dx: Array, du: Array) -> Array:
    """Return z_k (N+1, nz), with zeros instead of u_N."""
    return np.hstack([dx, np.vstack([du, np.zeros((1, du.shape[1]))])])


def row_values(qp: StageQP, dx: Array, du: Array) -> Array:
    """Return the values of the rows, (ng,)."""
    return np.asarray(qp.c + np.einsum("mi,mi->m", qp.C, stacked(dx, du)[qp.rows.node]) + qp.C0 @ dx[0])


def row_sizes(qp: StageQP, dx: Array, du: Array) -> Array:
    """Return the sum of the absolute values of the terms of every row."""
    z = np.abs(stacked(dx, du))[qp.rows.node]
    return np.asarray(np.abs(qp.c) + np.einsum("mi,mi->m", np.abs(qp.C), z) + np.abs(qp.C0) @ np.abs(dx[0]))


def cost_gradient(qp: StageQP, p: Point, absolute: bool = False) -> tuple[Array, Array]:
    """Return the gradient of cost and rows in z_k (N, nz) and dx_N (nx,), without the dynamics.

    Or the sums of its |terms|.
    """
    f = np.abs if absolute else (lambda a: a)
    nx, N = qp.shape.nx, qp.shape.N
    z = f(stacked(p.dx, p.du))
    G = np.empty_like(z)
    G[:N] = f(qp.g) + np.einsum("kij,kj->ki", f(qp.Q), z[:N])
    G[:N, nx:] += f(p.mult_u)
    G[N] = 0.0
    G[N, :nx] = f(qp.g_N) + f(qp.Q_N) @ z[N, :nx]
    np.add.at(G, qp.rows.node, f(qp.C) * f(p.mult)[:, None])
    G[0, :nx] += f(qp.C0).T @ f(p.mult)
    return G[:N], G[N, :nx]


def recover_lam(qp: StageQP, p: Point) -> Array:
    """Return lam (N+1, nx) by the adjoint recursion from stationarity in the states."""
    G, G_N = cost_gradient(qp, p)
    nx = qp.shape.nx
    lam = np.empty_like(p.dx)
    lam[-1] = G_N
    for k in range(qp.shape.N - 1, -1, -1):
        lam[k] = G[k, :nx] + qp.S[k, :, :nx].T @ lam[k + 1]
    lam[0, : qp.shape.free] = 0.0
    return lam


def fitted_lam(qp: StageQP, p: Point) -> Array:
    """Return lam that makes the Lagrangian stationary in the least-squares sense.

    The recursion amplifies rounding errors if the dynamics are unstable.
    """
    nx, nu, N, free = qp.shape.nx, qp.shape.nu, qp.shape.N, qp.shape.free
    G, G_N = cost_gradient(qp, p)
    M = dynamics_matrix(qp).T
    keep = np.r_[free : (N + 1) * nx]
    M = M[:, keep].tocsc()
    unit = np.concatenate([np.tile(np.concatenate([qp.unit_x, qp.unit_u]), N), qp.unit_x])
    dual = 1 / np.tile(qp.unit_x, N + 1)[keep]
    M = sp.diags(unit) @ M @ sp.diags(dual)
    right = -unit * np.concatenate([G.ravel(), G_N])
    n, m = M.shape
    assert n == N * (nx + nu) + nx
    factor = SparseQR(sp.bmat([[sp.eye(n), M], [M.T, None]], format="csc"))
    solution = factor.solve(np.concatenate([right, np.zeros(m)]))
    lam = np.zeros((N + 1) * nx)
    lam[keep] = dual * solution[n:]
    return lam.reshape(N + 1, nx)


class SparseQR:
    """CasADi computes QR factors of a sparse matrix, with RuntimeError if it is singular.

    SciPy's SuperLU passes invalid dimensions to BLAS for some of these matrices, and may fault; CasADi's interface to
    MUMPS returns garbage for some of them without an error.
    """

    def __init__(self, K: sp.csc_matrix) -> None:
        K = sp.csc_matrix(K)
        K.sort_indices()
        rows, columns = K.shape
        pattern = ca.Sparsity(rows, columns, K.indptr.tolist(), K.indices.tolist())
        self._matrix = ca.DM(pattern, K.data)
        self._solver = ca.Linsol("factors", "qr", pattern)
        self._solver.sfact(self._matrix)
        self._solver.nfact(self._matrix)

    def solve(self, right: Array) -> Array:
        """Return K^-1 right, (n,)."""
        return np.asarray(self._solver.solve(self._matrix, ca.DM(right))).ravel()


def dynamics_matrix(qp: StageQP) -> sp.csr_matrix:
    """Return D of the rows -dx_0 and S_k z_k - dx_{k+1} in the variables (z_0, .., z_{N-1}, dx_N)."""
    nx, nu, N = qp.shape.nx, qp.shape.nu, qp.shape.N
    n = N * (nx + nu) + nx
    states = (np.arange(N + 1)[:, None] * (nx + nu) + np.arange(nx)).ravel()
    minus = sp.csr_matrix((-np.ones(len(states)), (np.arange(len(states)), states)), shape=(len(states), n))
    S = sp.hstack([sp.block_diag(list(qp.S), format="csr"), sp.csr_matrix((N * nx, nx))])
    return (minus + sp.vstack([sp.csr_matrix((nx, n)), S])).tocsr()


@dataclass(frozen=True)
class Residuals:
    """Residuals are violations of the optimality conditions, each relative to the magnitude of its terms."""

    stationarity: float
    dynamics: float
    feasibility: float
    rows: float

    @property
    def worst(self) -> float:
        """Return the largest violation; NaN if one of them is NaN."""
        return float(np.max([self.stationarity, self.dynamics, self.feasibility, self.rows]))


def residuals(qp: StageQP, p: Point) -> Residuals:
    """Return the relative residuals of a point.

    stationarity: gradient of the Lagrangian in z_k over the largest sum of its terms' sizes, in units of the variables,
    with lam recovered by recursion, or fitted if the dynamics are unstable; dynamics: gaps, relative in the same way;
    feasibility: violation of bounds and hard rows over |bound| + size of the terms; rows: see natural_residual().
    """
    lam = recover_lam(qp, p) if qp.growth <= 1.05 else fitted_lam(qp, p)
    stationarity, size = _stationarity(qp, p, lam)
    return Residuals(stationarity, _gaps(qp, p), *_rows_and_bounds(qp, p, size))


def _stationarity(qp: StageQP, p: Point, lam: Array) -> tuple[float, float]:
    """Return (residual, size of the largest gradient in units of cost)."""
    nx, N = qp.shape.nx, qp.shape.N
    units = np.concatenate([qp.unit_x, qp.unit_u])
    G, G_N = cost_gradient(qp, p)
    G += np.einsum("kji,kj->ki", qp.S, lam[1:])
    G[:, :nx] -= lam[:N]
    T, T_N = cost_gradient(qp, p, absolute=True)
    T += np.einsum("kji,kj->ki", np.abs(qp.S), np.abs(lam[1:]))
    T[:, :nx] += np.abs(lam[:N])
    size = max(np.max(T * units), np.max((T_N + np.abs(lam[N])) * qp.unit_x), TINY)
    worst = np.max(np.append((np.abs(G) * units).ravel(), np.abs(G_N - lam[N]) * qp.unit_x))
    return float(worst / size), float(size)


def _gaps(qp: StageQP, p: Point) -> float:
    free = qp.shape.free
    z = stacked(p.dx, p.du)[:-1]
    gap = np.abs(p.dx[1:] - np.einsum("kij,kj->ki", qp.S, z) - qp.b) / qp.unit_x
    size = np.abs(p.dx[1:]) + np.einsum("kij,kj->ki", np.abs(qp.S), np.abs(z)) + np.abs(qp.b)
    start = np.abs(p.dx[0] - qp.dx0)[free:] / qp.unit_x[free:]
    start_size = max(np.max(np.abs(qp.dx0) / qp.unit_x), TINY)
    return float(np.max(np.append(start / start_size, gap / max(np.max(size / qp.unit_x), TINY))))


def _rows_and_bounds(qp: StageQP, p: Point, gradient: float) -> tuple[float, float]:
    """Return (feasibility, rows).

    ``gradient``: size of the gradient in units of cost, which makes multipliers relative.
    """
    units = np.concatenate([qp.unit_x, qp.unit_u])
    largest = max(np.max(np.abs(stacked(p.dx, p.du)) / units), TINY)
    unit = np.concatenate([np.tile(qp.unit_u, qp.shape.N), np.abs(qp.C) @ units + np.abs(qp.C0) @ qp.unit_x + TINY])
    value = np.concatenate([(qp.u + p.du).ravel(), row_values(qp, p.dx, p.du)])
    lower, upper = (np.concatenate([a.ravel(), r]) for a, r in ((qp.lower_u, qp.lower), (qp.upper_u, qp.upper)))
    size = largest * unit + np.abs(np.append(qp.u.ravel(), qp.c)) + _finite(lower) + _finite(upper)
    none = np.zeros(p.mult_u.size)
    l1, l2 = np.append(none + np.inf, qp.rows.l1), np.append(none, qp.rows.l2)
    violation = np.where(np.isinf(l1), np.maximum(np.maximum(value - upper, lower - value), 0.0) / size, 0.0)
    mult = np.append(p.mult_u.ravel(), p.mult)
    rows = natural_residual(value, mult, lower, upper, l1, l2, size * unit / gradient) / size
    return float(np.max(violation, initial=0.0)), float(np.max(rows, initial=0.0))


def natural_residual(value: Array, mult: Array, lower: Array, upper: Array, l1: Array, l2: Array, tau: Array) -> Array:
    """Return |value - prox(value + tau mult)|, prox that of tau times the penalty l1 v + l2/2 v^2 of the violation v.

    It vanishes if and only if mult is a subgradient of the penalty at value: sign, complementarity, and of a violated
    soft row mult = l1 + l2 v in one formula. l1 infinite: a hard row, whose prox is the projection.
    """
    y = value + tau * mult
    hard = np.isinf(l1)
    allowed = tau * np.where(hard, 0.0, l1)
    over, under = (np.maximum(excess - allowed, 0.0) / (1 + tau * l2) for excess in (y - upper, lower - y))
    over, under = np.where(hard, 0.0, over), np.where(hard, 0.0, under)
    inside = np.minimum(np.maximum(y, lower), upper)
    return np.asarray(np.abs(value - (inside + over - under)))


def _finite(a: Array) -> Array:
    return np.where(np.isfinite(a), np.abs(a), 0.0)


def distance(qp: StageQP, p: Point, other: Point | None = None) -> float:
    """Return the largest difference of dx, du from the optimum or another point, in units, relative to the largest."""
    reference = other or qp.optimum
    assert reference is not None
    pairs = ((p.dx, reference.dx, qp.unit_x), (p.du, reference.du, qp.unit_u))
    size = max(1.0, *(float(np.max(np.abs(b) / unit, initial=0.0)) for _, b, unit in pairs))
    return max(float(np.max(np.abs(a - b) / unit, initial=0.0)) for a, b, unit in pairs) / size


def objective_error(qp: StageQP, p: Point) -> float:
    """Return |f(p) - f(optimum)| over the size of its terms, without cancellation: d'(H (z + z*)/2 + g), d = z - z*."""
    assert qp.optimum is not None
    z, best = stacked(p.dx, p.du), stacked(qp.optimum.dx, qp.optimum.du)
    nx, N = qp.shape.nx, qp.shape.N
    d, middle = z - best, (z + best) / 2
    error = np.sum(d[:N] * (qp.g + np.einsum("kij,kj->ki", qp.Q, middle[:N])))
    error += d[N, :nx] @ (qp.g_N + qp.Q_N @ middle[N, :nx])
    error += penalty(qp, p) - penalty(qp, qp.optimum)
    a = np.abs(best)
    size = np.sum(a[:N] * (np.abs(qp.g) + np.einsum("kij,kj->ki", np.abs(qp.Q), a[:N])))
    size += a[N, :nx] @ (np.abs(qp.g_N) + np.abs(qp.Q_N) @ a[N, :nx]) + penalty(qp, qp.optimum)
    return float(abs(error) / max(size, TINY))


def penalty(qp: StageQP, p: Point) -> float:
    """Return the cost of the violated soft rows."""
    value = row_values(qp, p.dx, p.du)
    v = np.maximum(np.maximum(value - qp.upper, qp.lower - value), 0.0)
    soft = np.isfinite(qp.rows.l1)
    return float(np.sum(qp.rows.l1[soft] * v[soft] + qp.rows.l2[soft] * v[soft] ** 2 / 2))


def sparse_form(qp: StageQP) -> tuple[sp.csc_matrix, Array, sp.csr_matrix, sp.csr_matrix]:
    """Return H, gradient, dynamics D and rows R in w = (z_0, .., z_{N-1}, dx_N): D w + (dx_0, b) = 0."""
    s = qp.shape
    nz = s.nx + s.nu
    H = sp.block_diag([*qp.Q, qp.Q_N], format="csc")
    n, rows = H.shape[0], qp.rows
    R = np.zeros((len(rows), n)) if len(rows) * n < 2_000_000 else sp.lil_matrix((len(rows), n))
    for m, k in enumerate(rows.node):
        width = nz if k < s.N else s.nx
        R[m, k * nz : k * nz + width] = qp.C[m, :width]
    R[:, : s.nx] = R[:, : s.nx] + qp.C0
    gradient = np.concatenate([qp.g.ravel(), qp.g_N])
    return H, gradient, dynamics_matrix(qp), sp.csr_matrix(R)


def condition(qp: StageQP, exact: bool = False) -> float:
    """Estimate |K|_1 |P K^-1|_1 of the KKT matrix K at the optimum in units of the variables, P = primal part.

    The larger of two: with all active rows, and with those that carry a multiplier. Where rows are redundant on purpose
    K is regularised by REDUNDANT. ``exact``: from dense decompositions, which allow rows that depend on others by
    chance or nearly so; the estimate would be too small for them.
    """
    assert qp.optimum is not None
    s, p = qp.shape, qp.optimum
    unit = np.concatenate([np.tile(np.concatenate([qp.unit_x, qp.unit_u]), s.N), qp.unit_x])
    H, _, D, R = sparse_form(qp)
    D = D[s.free :]
    scale = sp.diags(unit)
    H = scale @ H @ scale
    H = H / max(abs(H).max(), TINY)
    value = row_values(qp, p.dx, p.du)
    size = _finite(qp.lower) + _finite(qp.upper) + 1e-9 * row_sizes(qp, p.dx, p.du) + TINY
    near = np.minimum(np.abs(value - qp.lower), np.abs(value - qp.upper)) / size < 1e-9
    saturated = np.isfinite(qp.rows.l1) & (np.abs(p.mult) > qp.rows.l1) & (qp.rows.l2 == 0)
    z = np.arange(s.N)[:, None] * (s.nx + s.nu) + s.nx + np.arange(s.nu)
    at_bound = np.minimum(np.abs(qp.u + p.du - qp.lower_u), np.abs(qp.u + p.du - qp.upper_u)) <= 1e-9 * (
        np.abs(p.du) + np.abs(qp.u) + qp.unit_u
    )
    found = []
    for rows, controls in ((near, at_bound), (p.mult != 0, p.mult_u != 0)):
        identity = sp.eye(len(unit), format="csr")[z[controls]]
        A = sp.vstack([D, R[np.flatnonzero(rows & ~saturated)]]) @ scale
        A = sp.vstack([A, identity])
        A = sp.diags(1 / np.maximum(abs(A).max(axis=1).toarray().ravel(), TINY)) @ A
        delta = REDUNDANT if qp.kind == "redundant" else 0.0
        found.append(_dense_primal_condition(H, A) if exact else _primal_condition(H, A, delta))
    return max(found)


def _dense_primal_condition(H: sp.spmatrix, A: sp.spmatrix) -> float:
    """Return |P K^-1|_2 |K|_1, where singular values of A below rounding do not count.

    On the null space Z of A the primal part is W = Z (Z'HZ)^-1 Z', on its range (I - W H) A^+.
    """
    U, s, V = np.linalg.svd(A.toarray())
    rank = int(np.sum(s > 1e-14 * len(s) * s[0]))
    Z, pseudo = V[rank:].T, V[:rank].T / s[:rank] @ U[:, :rank].T
    W = Z @ np.linalg.solve(Z.T @ H @ Z, Z.T)
    inverse = np.hstack([W, pseudo - W @ (H @ pseudo)])
    largest = max(abs(H).sum(axis=0).max() + abs(A).sum(axis=0).max(), abs(A).sum(axis=1).max())
    return float(np.linalg.norm(inverse, 2) * largest)


def _primal_condition(H: sp.spmatrix, A: sp.spmatrix, delta: float) -> float:
    """Estimate |P K^-1|_1 |K|_1 for K = [H A'; A -delta I]."""
    n, m = H.shape[0], A.shape[0]
    K = sp.bmat([[H, A.T], [A, -delta * sp.eye(m)]], format="csc")
    try:
        factor = SparseQR(K)
    except RuntimeError:
        return np.inf

    def primal(v: Array) -> Array:
        v = np.array(v, dtype=float)
        v[n:] = 0.0
        return v

    inverse = LinearOperator(
        K.shape,
        matvec=lambda v: primal(factor.solve(np.ravel(v))),
        rmatvec=lambda v: factor.solve(primal(np.ravel(v))),
    )
    return float(onenormest(inverse) * abs(K).sum(axis=0).max())
