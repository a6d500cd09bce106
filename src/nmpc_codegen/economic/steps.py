"""One SQP step with any Hessian is solved as an equality-constrained quadratic program.

    min  sum_k 1/2 dw_k' H_k dw_k + g_k' dw_k + 1/2 dx_N' H_N dx_N + g_N' dx_N
    s.t. dx_0 given,  dx_{k+1} = A_k dx_k + B_k du_k + b_k,  C_k dw_k = c_k,  D dx_N = d

The rows are those of a working set. The system of optimality conditions is solved as it is, so H_k may be indefinite as
long as it is positive definite on the null space of the constraints: an economic cost has such Hessians, and working
sets that contain the active rows (without them the reduced Hessian may have as many negative eigenvalues as intervals).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from nmpc_codegen.economic.convex_hessian import Tuning
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.problem import Array


@dataclass(frozen=True, eq=False)
class StageQp:
    """The data of a step with N intervals, n states, m controls.

    Attributes:
        A: (N, n, n), state matrices of the dynamics.
        B: (N, n, m), control matrices of the dynamics.
        b: (N, n), gaps.
        H: (N, n+m, n+m), Hessians.
        g: (N, n+m), gradients.
        C: N arrays (rows, n+m), slopes of the rows in the working set.
        c: N arrays (rows,), their right-hand sides.
        H_N: (n, n), Hessian of the end.
        g_N: (n,), gradient of the end.
        D: (rows, n), slopes of the rows in the working set at the end.
        d: (rows,), their right-hand sides.
    """

    A: Array
    B: Array
    b: Array
    H: Array
    g: Array
    C: Sequence[Array]
    c: Sequence[Array]
    H_N: Array
    g_N: Array
    D: Array
    d: Array


@dataclass(frozen=True, eq=False)
class Step:
    """A step of SQP has dx, du and multipliers.

    Attributes:
        dx: (N+1, n), step of the states.
        du: (N, m), step of the controls.
        lam: (N+1, n), multipliers of the dynamics.
        mu: N arrays, multipliers of the rows C.
        nu: multipliers of the rows D.
    """

    dx: Array
    du: Array
    lam: Array
    mu: tuple[Array, ...]
    nu: Array

    @property
    def dw(self) -> Array:
        """Return (dx_k, du_k) of all intervals, (N, n+m)."""
        return np.hstack([self.dx[:-1], self.du])


def constraint_matrix(qp: StageQp) -> scipy.sparse.csc_matrix:
    """Return the Jacobian of all equations as a sparse matrix.

    Its rows are x_0 (-1), the dynamics ([A B] - 1), the C_k and D; its columns (w_0, ..., w_{N-1}, x_N).
    """
    N, n, m = len(qp.A), qp.A.shape[1], qp.B.shape[2]
    AB = np.concatenate([qp.A, qp.B], axis=2)
    first = np.arange(N) * (n + m)
    E = np.eye(n, n + m)
    ahead, nodes = [*first, N * (n + m)], np.arange(N + 1) * n
    dynamics = _blocks([*[-E] * N, -np.eye(n), *AB], [*nodes, *nodes[1:]], [*ahead, *first])
    rows = [*(np.asarray(C).reshape(-1, n + m) for C in qp.C), qp.D.reshape(-1, n)]
    starts = np.concatenate([[0], np.cumsum([len(C) for C in rows])])
    end = N * (n + m) + n
    held = _blocks(rows, [*starts[:-1]], ahead)
    return _matrix([(dynamics, 0, 0), (held, (N + 1) * n, 0)], ((N + 1) * n + int(starts[-1]), end))


Triplets = tuple[Array, Array, Array]


def _blocks(blocks: Sequence[Array], rows: Sequence[int], columns: Sequence[int]) -> Triplets:
    """Return values, rows and columns of dense blocks whose first entries are at (rows, columns)."""
    values = [np.ravel(block) for block in blocks]
    i = [row + np.repeat(np.arange(len(b)), b.shape[1]) for b, row in zip(blocks, rows, strict=True)]
    j = [column + np.tile(np.arange(b.shape[1]), len(b)) for b, column in zip(blocks, columns, strict=True)]
    return np.concatenate(values), np.concatenate(i), np.concatenate(j)


def _matrix(parts: Sequence[tuple[Triplets, int, int]], shape: tuple[int, int]) -> scipy.sparse.csc_matrix:
    """Return the sum of triplets, each shifted by a number of rows and columns."""
    values = np.concatenate([v for (v, _, _), _, _ in parts])
    i = np.concatenate([i + down for (_, i, _), down, _ in parts])
    j = np.concatenate([j + right for (_, _, j), _, right in parts])
    found = scipy.sparse.coo_matrix((values, (i, j)), shape=shape).tocsc()
    found.eliminate_zeros()
    return found


def kkt_step(qp: StageQp, dx0: Array) -> Step:
    """Solve the optimality conditions with the rows C, D as equations.

    L = cost + lam_0'(dx0 - dx_0) + lam_{k+1}'(A dx_k + B du_k + b - dx_{k+1}) + mu_k'(C dw_k - c) + nu'(D dx_N - d)

    Args:
        qp: data of the step.
        dx0: (n,), step of x_0.

    Raises:
        ProblemError: the conditions are singular: the rows depend on each other.
    """
    N, n, m = len(qp.A), qp.A.shape[1], qp.B.shape[2]
    nw = N * (n + m) + n
    G = constraint_matrix(qp).tocoo()
    at = [*np.arange(N + 1) * (n + m)]
    H = _blocks([*qp.H, qp.H_N], at, at)
    size = nw + G.shape[0]
    K = _matrix([(H, 0, 0), ((G.data, G.row, G.col), nw, 0), ((G.data, G.col, G.row), 0, nw)], (size, size))
    right = np.concatenate([-qp.g.ravel(), -qp.g_N, -dx0, -qp.b.ravel(), *qp.c, qp.d])
    singular = "kkt_step: the optimality conditions are singular; do rows of the working set depend?"
    try:
        factors = scipy.sparse.linalg.splu(K)
    except RuntimeError as error:
        raise ProblemError(singular) from error
    solution = factors.solve(right)
    solution = solution + factors.solve(right - K @ solution)
    if not np.all(np.isfinite(solution)):
        raise ProblemError(singular)
    dw, dx_N = solution[: nw - n].reshape(N, n + m), solution[nw - n : nw]
    ends = nw + (N + 1) * n + np.concatenate([[0], np.cumsum([len(c) for c in qp.c])]).astype(int)
    return Step(
        dx=np.vstack([dw[:, :n], dx_N]),
        du=dw[:, n:],
        lam=solution[nw : nw + (N + 1) * n].reshape(N + 1, n),
        mu=tuple(solution[ends[k] : ends[k + 1]] for k in range(N)),
        nu=solution[ends[-1] :],
    )


def corrected_multipliers(tuning: Tuning, step: Step) -> Step:
    """Return the multipliers of the step with H, computed from those of the same step with M.

        lam_k += dP dx_k / alpha,   mu_k += eta F C dw_k / alpha,   nu -= eta G D dx_N / alpha

    At the steady state both steps agree in dx, du, and so corrected also in the multipliers; further away the
    correction removes the part of the error that is linear in the step. The mu_k belong to the strictly active rows at
    the nodes where the step has as many rows. Rows on states only have no multiplier at node 0, where x_0 is given;
    their term C'F C dw_0 / alpha is then subtracted from lam_0.

    Args:
        tuning: the result of tune().
        step: the step with M.

    Source: Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020), section V.A, dashed in Fig. 1.
    """
    P, F, G = tuning.dP / tuning.alpha, tuning.F / tuning.alpha, tuning.G / tuning.alpha
    lam = step.lam + step.dx @ P
    mu = tuple(
        m + F @ tuning.C @ w if tuning.eta and len(m) == len(F) else m for m, w in zip(step.mu, step.dw, strict=True)
    )
    nu = step.nu
    if tuning.eta and not len(mu[0]):
        lam[0] -= (tuning.C.T @ (F @ (tuning.C @ step.dw[0])))[: lam.shape[1]]
    if tuning.M_f is None:
        # With x_N fixed there is no M_f, and the multipliers of x_N are lam_N itself, up to their sign.
        return Step(step.dx, step.du, lam, mu, nu)
    if tuning.eta and len(G) and len(nu) == len(G):
        nu = nu - G @ tuning.D @ step.dx[-1]
    return Step(step.dx, step.du, lam, mu, nu)
