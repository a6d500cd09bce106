"""The cost-to-go of the linear-quadratic problem at a steady state is computed for a Hessian that may be indefinite.

    P = Q + A'PA - (S' + A'PB)(R + B'PB)^{-1}(S + B'PA),   H = [Q S'; S R],   u = -K x

Strictly active rows C w = 0 are eliminated first. The states that can satisfy them for ever are the largest subspace V
for which some u keeps C (x, u) = 0 and A x + B u in V (Wonham, Linear Multivariable Control, section 4.3); on it
x = T xi, u = K_c xi + N v. The Riccati equation in (xi, v) has cross terms.

SciPy returns matrices also where there is no stabilising solution. Therefore the residual, the closed loop and the sign
of R + B'PB are checked. P itself may be indefinite: with an economic cost it is not a distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from nmpc_codegen.economic.linear_quadratic import LinearQuadratic, curvature_scaling
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.problem import Array

#: Largest residual relative to P; largest modulus of an eigenvalue of the closed loop; singular values that count as 0.
RESIDUAL, STABLE, RANK = 1e-7, 1.0 - 1e-9, 1e-9


@dataclass(frozen=True, eq=False)
class CostToGo:
    """The cost-to-go has P (n, n) and the feedback u = -K x, K (m, n), on a subspace with the given basis."""

    P: Array
    K: Array
    subspace: Array
    residual: float
    radius: float  # spectral radius of A - B K on the subspace


@dataclass(frozen=True, eq=False)
class Reduced:
    """The reduced problem is x = T xi, u = Kc xi + N v, xi+ = A xi + B v, with cost 1/2 (xi, v)' H (xi, v)."""

    T: Array
    Kc: Array
    N: Array
    A: Array
    B: Array
    H: Array


def eliminate(lq: LinearQuadratic) -> Reduced:
    """Return the problem on the subspace of the strictly active rows."""
    n = lq.n
    T = np.eye(n)
    while True:
        outside = scipy.linalg.null_space(T.T).T if T.shape[1] else np.eye(n)
        on_u = np.vstack([lq.C[:, n:], outside @ lq.B])
        on_x = np.vstack([lq.C[:, :n], outside @ lq.A]) @ T
        left = scipy.linalg.null_space(on_u.T, rcond=RANK).T if len(on_u) else np.zeros((0, 0))
        free = scipy.linalg.null_space(left @ on_x, rcond=RANK) if len(left) else np.eye(T.shape[1])
        if free.shape[1] == T.shape[1]:
            break
        T = T @ free
    Kc = -np.linalg.pinv(on_u, rcond=RANK) @ on_x if len(on_u) else np.zeros((lq.m, T.shape[1]))
    N = scipy.linalg.null_space(on_u, rcond=RANK) if len(on_u) else np.eye(lq.m)
    Z = np.block([[T, np.zeros((n, N.shape[1]))], [Kc, N]])
    return Reduced(T, Kc, N, T.T @ (lq.A @ T + lq.B @ Kc), T.T @ lq.B @ N, Z.T @ lq.H @ Z)


def cost_to_go(lq: LinearQuadratic, names: tuple[str, ...] = ()) -> CostToGo:
    """Return P and K of the infinite horizon, in the units of the problem; ``names`` of the states are for errors.

    Raises:
        ProblemError: the Riccati equation has no stabilising solution.
    """
    d = curvature_scaling(lq)
    scaled = lq.scale(d)
    size = max(float(np.abs(np.linalg.eigvalsh(scaled.H)).max()), np.finfo(float).tiny)
    r = eliminate(LinearQuadratic(scaled.A, scaled.B, scaled.H / size, scaled.C))
    _refuse_uncontrolled(r, names, lq.active)
    P, K, residual = _riccati(r)
    radius = float(np.abs(np.linalg.eigvals(r.A - r.B @ K)).max(initial=0.0))
    if not radius <= STABLE:
        raise ProblemError(_no_solution(f"an eigenvalue of its closed loop has modulus {radius:.8f}"))
    dx, du = d[: lq.n], d[lq.n :]
    P = size * (r.T @ P @ r.T.T) / np.outer(dx, dx)
    feedback = (-(r.Kc - r.N @ K) @ r.T.T) * du[:, None] / dx
    basis = scipy.linalg.orth(r.T * dx[:, None]) if r.T.shape[1] else r.T
    return CostToGo((P + P.T) / 2, feedback, basis, residual, radius)


def _refuse_uncontrolled(r: Reduced, names: tuple[str, ...], active: tuple[str, ...]) -> None:
    """Raise ProblemError if a mode that does not decay is influenced by no control (Hautus test)."""
    values, left = np.linalg.eig(r.A.T) if len(r.A) else (np.zeros(0), np.zeros((0, 0)))
    size = max(1.0, float(np.abs(r.B).max(initial=0.0)))
    for value, v in zip(values, left.T, strict=True):
        if abs(value) > STABLE and np.abs(v @ r.B).max(initial=0.0) <= RANK * size:
            part = np.abs(r.T @ v)
            who = ", ".join(name for name, p in zip(names, part, strict=False) if p > 0.1 * part.max())
            held = f" while the strictly active rows {', '.join(active)} hold" if active else ""
            raise ProblemError(
                f"the steady state cannot be stabilised: no control moves a mode of {who or 'the states'} that changes "
                f"by the factor {abs(value):.6g} per interval{held}; "
                + (
                    "move these bounds, or fix x_N instead"
                    if active
                    else "name states that grow for ever by ocp.cyclic()"
                )
            )


def _riccati(r: Reduced) -> tuple[Array, Array, float]:
    """Return P, K and the relative residual in the reduced coordinates."""
    n = len(r.A)
    Q, S, R = r.H[:n, :n], r.H[n:, :n], r.H[n:, n:]
    if not n:
        return np.zeros((0, 0)), np.zeros((r.B.shape[1], 0)), 0.0
    try:
        if r.B.shape[1]:
            P = scipy.linalg.solve_discrete_are(r.A, r.B, Q, R, s=S.T)
        else:
            P = scipy.linalg.solve_discrete_lyapunov(r.A.T, Q)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ProblemError(_no_solution(str(error))) from error
    for _ in range(2):
        P, K, residual = _refine(r, (P + P.T) / 2)
    if not residual <= RESIDUAL:
        raise ProblemError(_no_solution(f"its residual is {residual:.2g} of P"))
    if K.shape[0] and np.linalg.eigvalsh(R + r.B.T @ P @ r.B)[0] <= 0:
        raise ProblemError(_no_solution("R + B'PB is not positive definite"))
    return P, K, residual


def _refine(r: Reduced, P: Array) -> tuple[Array, Array, float]:
    """Take one Newton step, a Lyapunov equation, if it reduces the residual."""
    K, rest = _residual(r, P)
    size = max(float(np.abs(P).max()), 1.0)
    closed = r.A - r.B @ K
    if np.abs(np.linalg.eigvals(closed)).max() < 1:
        better = P + scipy.linalg.solve_discrete_lyapunov(closed.T, rest)
        K_new, rest_new = _residual(r, better)
        if np.abs(rest_new).max() < np.abs(rest).max():
            return better, K_new, float(np.abs(rest_new).max()) / size
    return P, K, float(np.abs(rest).max()) / size


def _residual(r: Reduced, P: Array) -> tuple[Array, Array]:
    """Return K and Q + A'PA - (S' + A'PB) K - P."""
    n = len(r.A)
    Q, S, R = r.H[:n, :n], r.H[n:, :n], r.H[n:, n:]
    G = S + r.B.T @ P @ r.A
    K: Array = np.zeros((0, n))
    if len(R):
        K = np.asarray(np.linalg.lstsq(R + r.B.T @ P @ r.B, G, rcond=None)[0])
    return K, Q + r.A.T @ P @ r.A - G.T @ K - P


def _no_solution(why: str) -> str:
    return (
        f"the Riccati equation at the steady state has no stabilising solution: {why}; the cost is not dissipative "
        "there (add curvature to it, or integrate it with the dynamics), or does not depend on a state that does not "
        "decay (weigh it, or ocp.cyclic for one that grows for ever)"
    )
