"""The semidefinite program that makes the Hessian of an economic cost positive definite ([Z20], equation (8)).

    min beta + rho1 |F| + rho2 |G|
    s.t. I <= alpha H + Hcal(dP) + eta C'F C <= beta I,    I <= alpha H_f - dP - eta D'G D <= beta I
    Hcal(dP) = [A'dP A - dP, A'dP B; B'dP A, B'dP B]

H is divided by its largest |eigenvalue| first, w by a scaling, rows of C and D by their norms; |.| is the spectral
norm. In the units of the problem M = H + (Hcal(dP) + eta C'F C) / alpha and M_f = H_f - (dP + eta D'G D) / alpha.

Source: Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020), section IV, called [Z20] here. Its
equation (11) omits the division by alpha.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nmpc_codegen.economic.linear_quadratic import LinearQuadratic, curvature_scaling
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.runtime.extras import extra

#: How far below I the matrices of an accepted solution may be; entries, relative to the diagonal, that count as 0.
SLACK, ROUNDING = 1e-3, 1e-12


@dataclass(frozen=True)
class Weights:
    """eta is 0 or 1: whether strictly active rows may be used; rho1, rho2 >= 0 penalise F and G."""

    rho1: float = 1e-3
    rho2: float = 1e-3
    eta: int = 1

    def __post_init__(self) -> None:
        for name in ("rho1", "rho2"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < np.inf:
                raise OptionError(f"tune: {name}={value!r}; expected a number >= 0")
        if isinstance(self.eta, bool) or not isinstance(self.eta, int) or self.eta not in (0, 1):
            raise OptionError(f"tune: eta={self.eta!r}; expected 0 or 1")


@dataclass(frozen=True, eq=False)
class Certificate:
    """A solution in the units of the problem; ``beta`` bounds the condition number in the scaling in which it was
    found."""

    dP: Array  # (n, n)
    F: Array  # (a, a)
    G: Array  # (b, b)
    alpha: float
    beta: float
    M: Array  # (n + m, n + m)
    M_f: Array | None  # (n, n)
    scaling: Array  # (n + m,)
    status: str


def convexify(lq: LinearQuadratic, weights: Weights, scaling: Array) -> Certificate | str:
    """Solve the program in w / scaling; the status of the solver if that fails."""
    extra("clarabel", "tune()")
    cp = extra("cvxpy", "tune()")
    s = lq.scaled(scaling)
    size = float(np.abs(np.linalg.eigvalsh(s.H)).max())
    size = size if size > 0 else 1.0
    dP, alpha, beta = cp.Variable((lq.n, lq.n), symmetric=True), cp.Variable(), cp.Variable()
    AB, E = np.hstack([s.A, s.B]), np.eye(lq.n, lq.n + lq.m)
    X = alpha * (s.H / size) + AB.T @ dP @ AB - E.T @ dP @ E
    objective = beta
    F = G = None
    if weights.eta and len(s.C):
        F = cp.Variable((len(s.C), len(s.C)), symmetric=True)
        X, objective = X + s.C.T @ F @ s.C, objective + weights.rho1 * cp.norm(F, 2)
    matrices = [X]
    if s.H_f is not None:
        Y = alpha * (s.H_f / size) - dP
        if weights.eta and s.D is not None and len(s.D):
            G = cp.Variable((len(s.D), len(s.D)), symmetric=True)
            Y, objective = Y - s.D.T @ G @ s.D, objective + weights.rho2 * cp.norm(G, 2)
        matrices.append(Y)
    limits = [
        c for Z in matrices for c in ((Z + Z.T) / 2 >> np.eye(Z.shape[0]), (Z + Z.T) / 2 << beta * np.eye(Z.shape[0]))
    ]
    program = cp.Problem(cp.Minimize(objective), [*limits, alpha >= 1e-9])
    try:
        program.solve(solver="CLARABEL")
    except cp.SolverError as error:
        return f"failed: {error}"
    if alpha.value is None or float(alpha.value) <= 0:
        return str(program.status)
    values = [(np.asarray(Z.value) + np.asarray(Z.value).T) / 2 for Z in matrices]
    least = min(float(np.linalg.eigvalsh(value)[0]) for value in values)
    if not least >= 1 - SLACK:
        return f"{program.status}, but the least eigenvalue is {least:.3g} instead of 1"
    return _certificate(lq, scaling, size / float(alpha.value), dP, F, G, values, float(beta.value), program.status)


def _certificate(
    lq: LinearQuadratic, d: Array, unit: float, dP: Any, F: Any, G: Any, values: list[Array], beta: float, status: str
) -> Certificate:
    """Back to the units of the problem; ``unit`` = 1 / alpha."""
    dx = d[: lq.n]

    def rows(value: Any, C: Array | None, scale: Array) -> Array:
        if C is None or value is None:
            return np.zeros((0, 0) if C is None else (len(C), len(C)))
        norms = np.linalg.norm(C * scale, axis=1)
        return np.asarray(value.value) / np.outer(norms, norms)

    P, F_value, G_value = np.asarray(dP.value) / np.outer(dx, dx), rows(F, lq.C, d), rows(G, lq.D, dx)
    M = lq.H + unit * (lq.rotated(P) + lq.C.T @ F_value @ lq.C)
    M_f = None
    if lq.H_f is not None and lq.D is not None:
        M_f = lq.H_f - unit * (P + lq.D.T @ G_value @ lq.D)
        M_f = cleared((M_f + M_f.T) / 2)
    return Certificate(P, F_value, G_value, 1.0 / unit, beta, cleared((M + M.T) / 2), M_f, d, status)


def cleared(M: Array) -> Array:
    """M without entries |M_ij| <= 1e-12 sqrt |M_ii M_jj|, so that the generated code has no products with them.

    They are rounding errors of variables that the problem does not couple.
    """
    size = np.sqrt(np.abs(np.diag(M)))
    return np.where(np.abs(M) > ROUNDING * np.outer(size, size), M, 0.0)


def scalings(lq: LinearQuadratic, w: Array) -> dict[str, Array]:
    """Scalings of w by name, in the order in which they are tried.

    "none": least condition number in the units of the problem; "curvature": the diagonal of H becomes 1; "magnitude":
    w at the steady state becomes 1.
    """
    size = np.abs(w)
    size = np.where(size > 1e-6 * max(float(size.max()), 1.0), size, 1.0) if lq.size is None else lq.size
    return {
        "none": np.ones(len(w)),
        "curvature": curvature_scaling(lq),
        "magnitude": size,
    }
