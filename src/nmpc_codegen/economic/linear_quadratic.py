"""The linear-quadratic problem at a steady state has a frequency function, which decides on its dissipativity.

    x+ = A x + B u,   1/2 w' H w,   C w = 0 (strictly active rows),   w = (x, u)
    N(z) spans { w : A x + B u = z x, C w = 0 },   pi(theta) = min eig N* H N,  z = exp(i theta)

There are symmetric dP and F with H + [A'dP A - dP, A'dP B; B'dP A, B'dP B] + C'F C > 0 if and only if pi > 0 on the
whole unit circle (Kalman, Yakubovich and Popov; Rantzer, Systems and Control Letters 28, 1996, with Finsler's lemma for
the rows). This decides without a semidefinite solver, whose verdict may depend on units.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.linalg
import scipy.optimize

from nmpc_codegen.economic.stage import Rows, SteadyStage
from nmpc_codegen.economic.stationary import SteadyState
from nmpc_codegen.frontend.problem import Array

FREQUENCIES = 721
#: Values of the frequency function up to this one, relative to H, count as 0.
POSITIVE = 1e-12


@dataclass(frozen=True, eq=False)
class LinearQuadratic:
    """The problem at a steady state is x+ = A x + B u with the cost 1/2 w' H w, w = (x, u), and active rows C w = 0.

    H_f (n, n) and D (b, n) at node N, None if the end is fixed.
    """

    A: Array
    B: Array
    H: Array
    C: Array
    H_f: Array | None = None
    D: Array | None = None
    active: tuple[str, ...] = ()
    active_terminal: tuple[str, ...] = ()
    size: Array | None = None  # (n + m,) typical magnitudes of w, where they are known

    @property
    def n(self) -> int:
        return len(self.A)

    @property
    def m(self) -> int:
        return int(self.B.shape[1])

    def rotate(self, P: Array, after: Array | None = None) -> Array:
        """Return Hcal(P) = [A'QA - P, A'QB; B'QA, B'QB].

        Q is ``after``, the matrix at the end of the interval, or P.
        """
        AB = np.hstack([self.A, self.B])
        found: Array = AB.T @ (P if after is None else after) @ AB
        found[: self.n, : self.n] -= P
        return found

    def scale(self, d: Array) -> LinearQuadratic:
        """Return the problem in w / d; rows of C and D have norm 1."""
        dx, du = d[: self.n], d[self.n :]
        return LinearQuadratic(
            A=self.A * dx / dx[:, None],
            B=self.B * du / dx[:, None],
            H=self.H * np.outer(d, d),
            C=_unit_rows(self.C * d),
            H_f=None if self.H_f is None else self.H_f * np.outer(dx, dx),
            D=None if self.D is None else _unit_rows(self.D * dx),
        )

    def without_rows(self) -> LinearQuadratic:
        """Return the problem without strictly active rows."""
        D = None if self.D is None else self.D[:0]
        return LinearQuadratic(self.A, self.B, self.H, self.C[:0], self.H_f, D, size=self.size)


def _unit_rows(C: Array) -> Array:
    return C / np.linalg.norm(C, axis=1, keepdims=True) if len(C) else C


def linear_quadratic(stage: SteadyStage, steady: SteadyState, *, gauss_newton: bool = False) -> LinearQuadratic:
    """Expand the problem at a steady state.

    With ``gauss_newton``, H = J' W J instead of the Hessian of the Lagrangian.
    """
    w, n = steady.w, stage.nx
    AB, _, J = (np.asarray(v, dtype=float) for v in stage.jacobians(w))
    if gauss_newton and stage.gauss_newton is not None:
        H = np.asarray(ca.Function("H", [stage.w], [stage.gauss_newton])(w), dtype=float)
    else:
        H = np.asarray(stage.hessian(w, steady.lam, steady.mu), dtype=float)
    rows, end = stage.rows, stage.terminal_rows
    active = list(steady.active)
    H_f: Array | None = None
    D = np.zeros((0, n))
    names: tuple[str, ...] = ()
    if not stage.point_terminal:
        V = ca.Function("V", [stage.x], [*ca.hessian(stage.terminal_cost, stage.x), end.h, ca.jacobian(end.h, stage.x)])
        H_f, slope, g, G = (np.asarray(v, dtype=float) for v in V(steady.x))
        strict = _strict_terminal(g.ravel(), G, end, steady.lam - slope.ravel(), {rows.names[i] for i in active})
        D, names = G[strict], tuple(end.names[i] for i in strict)
    return LinearQuadratic(
        AB[:, :n], AB[:, n:], (H + H.T) / 2, J[active], H_f, D, tuple(rows.names[i] for i in active), names, steady.size
    )


def _strict_terminal(g: Array, G: Array, rows: Rows, force: Array, on_path: set[str]) -> list[int]:
    """Return the rows at their bound with a multiplier nu of its sign, G' nu = lam_s - dV_f / dx.

    Equations belong to them, and so do rows that are strictly active on the path ([Z20], equation (15)), although a
    terminal cost with the slope lam_s gives these no multiplier.
    """
    size = 1e-8 * np.maximum(1.0, np.abs(g))
    near = [i for i in range(len(g)) if min(abs(g[i] - rows.lower[i]), abs(g[i] - rows.upper[i])) <= size[i]]
    if not near:
        return []
    signs = np.array([1.0 if abs(g[i] - rows.upper[i]) <= size[i] else -1.0 for i in near])
    equations = [i for i in near if rows.lower[i] == rows.upper[i]]
    columns = np.vstack([G[near] * signs[:, None], -G[equations]])
    nu, _ = scipy.optimize.nnls(columns.T, force)
    least = 1e-9 * max(1.0, float(np.abs(force).max()))
    held = set(equations) | {i for i in near if rows.names[i] in on_path}
    return [i for i, value in zip(near, nu[: len(near)], strict=True) if value > least or i in held]


@dataclass(frozen=True)
class Frequency:
    """The least value of the frequency function is given with its angle theta (rad per interval)."""

    least: float
    theta: float

    @property
    def positive(self) -> bool:
        return self.least > POSITIVE


def frequency_function(lq: LinearQuadratic) -> Frequency:
    """Return the least value of the frequency function over 0 <= theta <= pi.

    w is scaled so that the diagonal of H has magnitude 1; the sign of the result does not depend on it. A grid is
    refined around its least values. The result is +inf if the active rows determine w.
    """
    scaled = lq.scale(curvature_scaling(lq))
    size = max(float(np.abs(np.linalg.eigvalsh(scaled.H)).max()), np.finfo(float).tiny)

    def value(theta: float) -> float:
        z = np.exp(1j * theta)
        rows = np.vstack([np.hstack([scaled.A - z * np.eye(lq.n), scaled.B.astype(complex)]), scaled.C])
        basis = scipy.linalg.null_space(rows, rcond=1e-12)
        if not basis.shape[1]:
            return np.inf
        return float(np.linalg.eigvalsh(basis.conj().T @ scaled.H @ basis)[0]) / size

    grid = np.concatenate([[0.0], np.geomspace(1e-4, np.pi, FREQUENCIES)])
    values = np.array([value(theta) for theta in grid])
    at = int(np.argmin(values))
    if not np.isfinite(values[at]):
        return Frequency(np.inf, 0.0)
    ends = float(grid[max(at - 1, 0)]), float(grid[min(at + 1, len(grid) - 1)])
    refined = scipy.optimize.minimize_scalar(value, bounds=ends, method="bounded")
    if refined.fun < values[at]:
        return Frequency(float(refined.fun), float(refined.x))
    return Frequency(float(values[at]), float(grid[at]))


def curvature_scaling(lq: LinearQuadratic) -> Array:
    """Return d_i = 1 / sqrt |H_ii|; a variable without curvature gets the largest of the others.

    If typical magnitudes are known, d stays within a factor of 1000 of them, up to a common factor.
    """
    if lq.size is not None:
        curvature = np.abs(np.diag(lq.H)) * lq.size**2
        largest = float(curvature.max())
        return lq.size / np.sqrt(np.maximum(curvature, 1e-6 * largest) if largest > 0 else 1.0)
    diagonal = np.abs(np.diag(lq.H))
    flat = diagonal <= 1e-12 * max(float(diagonal.max()), np.finfo(float).tiny)
    d = 1.0 / np.sqrt(np.where(flat, 1.0, diagonal))
    d[flat] = d[~flat].max() if np.any(~flat) else 1.0
    return np.asarray(d)
