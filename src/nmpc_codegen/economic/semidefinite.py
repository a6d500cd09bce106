"""A semidefinite program makes the Hessians of an economic cost positive definite ([Z20], equation (8)).

    min beta + rho1 |F| + rho2 |G|
    s.t. I <= alpha H_k + Hcal(dP_k, dP_k+1) + eta C_k'F_k C_k <= beta I,    I <= alpha H_f - dP - eta D'G D <= beta I
    Hcal(dP_k, dP_k+1) = [A'dP_k+1 A - dP_k, A'dP_k+1 B; B'dP_k+1 A, B'dP_k+1 B]

over the intervals k of a period, dP_P = dP_0; the steady state is the period P = 1, and only this period may have an
end. H is divided by its largest |eigenvalue| first, w by a scaling, rows of C and D by their norms; |.| is the largest
spectral norm. In the units of the problem M = H + (Hcal + eta C'F C) / alpha and M_f = H_f - (dP + eta D'G D) / alpha.

Sources: Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020), section IV, called [Z20] here,
whose equation (11) omits the division by alpha; Zanon, Gros and Diehl, "A periodic tracking MPC that is locally
equivalent to periodic economic MPC", IFAC World Congress 2017.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmpc_codegen.economic.linear_quadratic import LinearQuadratic, curvature_scaling
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.runtime.extras import extra

#: Least alpha, with which the least eigenvalue of M is ten times the largest of H. As a solution may be multiplied by
#: any factor > 1, this excludes no M, but where rows leave no freedom alpha would go to 0, and M would forget H.
LEAST_ALPHA = 0.1
#: Amount by which matrices of an accepted solution may be below I; entries up to ROUNDING of the diagonal count as 0.
SLACK, ROUNDING = 1e-3, 1e-12


@dataclass(frozen=True)
class Weights:
    """The program has weights: eta is 1 if strictly active rows may be used, else 0.

    Rho1, rho2 >= 0 penalise F and G.
    """

    rho1: float = 1e-3
    rho2: float = 1e-3
    eta: int = 1

    def __post_init__(self) -> None:
        for name in ("rho1", "rho2"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < np.inf:
                raise OptionError(f"{name}={value!r}; expected a number >= 0")
        if isinstance(self.eta, bool) or not isinstance(self.eta, int) or self.eta not in (0, 1):
            raise OptionError(f"eta={self.eta!r}; expected 0 or 1")


@dataclass(frozen=True, eq=False)
class ConvexityProof:
    """The proof is a solution in the units of the problem.

    ``beta`` bounds the condition number in the scaling in which the solution was found.
    """

    dP: Array  # (n, n)
    F: Array  # (a, a)
    G: Array  # (b, b)
    alpha: float
    beta: float
    M: Array  # (n + m, n + m)
    M_f: Array | None  # (n, n)
    scaling: Array  # (n + m,)
    status: str


def convexify(lq: LinearQuadratic, weights: Weights, scaling: Array) -> ConvexityProof | str:
    """Solve the program of a steady state in w / scaling; return the status of the solver if that fails."""
    found = convexify_period([lq], weights, scaling)
    return found if isinstance(found, str) else found[0]


def convexify_period(period: Sequence[LinearQuadratic], weights: Weights, scaling: Array) -> list[ConvexityProof] | str:
    """Solve the program of a period in w / scaling; return a certificate of every interval, with one alpha and beta."""
    extra("clarabel", "tune()")
    cp = extra("cvxpy", "tune()")
    stages = [lq.scale(scaling) for lq in period]
    size = max(float(np.abs(np.linalg.eigvalsh(s.H)).max()) for s in stages)
    size = size if size > 0 else 1.0
    n, alpha, beta = stages[0].n, cp.Variable(), cp.Variable()
    storages = [cp.Variable((n, n), symmetric=True) for _ in stages]
    matrices, multiples, E = [], [], np.eye(n, n + stages[0].m)
    for k, s in enumerate(stages):
        AB = np.hstack([s.A, s.B])
        X = alpha * (s.H / size) + AB.T @ storages[(k + 1) % len(stages)] @ AB - E.T @ storages[k] @ E
        F = cp.Variable((len(s.C), len(s.C)), symmetric=True) if weights.eta and len(s.C) else None
        multiples.append(F)
        matrices.append(X if F is None else X + s.C.T @ F @ s.C)
    largest = [cp.norm(F, 2) for F in multiples if F is not None]
    objective = beta + (weights.rho1 * cp.maximum(*largest, 0) if largest else 0)
    G, end = None, stages[0]
    if end.H_f is not None:
        Y = alpha * (end.H_f / size) - storages[0]
        if weights.eta and end.D is not None and len(end.D):
            G = cp.Variable((len(end.D), len(end.D)), symmetric=True)
            Y, objective = Y - end.D.T @ G @ end.D, objective + weights.rho2 * cp.norm(G, 2)
        matrices.append(Y)
    limits = [
        c for Z in matrices for c in ((Z + Z.T) / 2 >> np.eye(Z.shape[0]), (Z + Z.T) / 2 << beta * np.eye(Z.shape[0]))
    ]
    program = cp.Problem(cp.Minimize(objective), [*limits, alpha >= LEAST_ALPHA])
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
    solved = _Solved(scaling, size / float(alpha.value), float(beta.value), program.status)
    dP = [solved.storage(P.value) for P in storages]
    after = [*dP[1:], dP[0]]
    return [
        solved.certificate(lq, here, there, F, G)
        for lq, here, there, F in zip(period, dP, after, multiples, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Solved:
    """Solutions are converted to the units of the problem; ``unit`` = 1 / alpha."""

    d: Array
    unit: float
    beta: float
    status: str

    def storage(self, value: Any) -> Array:
        """Return dP in the units of the problem."""
        n = len(value)
        found: Array = np.asarray(value) / np.outer(self.d[:n], self.d[:n])
        return found

    def certificate(self, lq: LinearQuadratic, dP: Array, after: Array, F: Any, G: Any) -> ConvexityProof:
        """Return the certificate of an interval with the storage dP at its start and ``after`` at its end."""
        F_value, G_value = _multiples(F, lq.C, self.d), _multiples(G, lq.D, self.d[: lq.n])
        M = lq.H + self.unit * (lq.rotate(dP, after) + lq.C.T @ F_value @ lq.C)
        M_f = None
        if lq.H_f is not None and lq.D is not None:
            M_f = lq.H_f - self.unit * (dP + lq.D.T @ G_value @ lq.D)
            M_f = clear((M_f + M_f.T) / 2)
        M = clear((M + M.T) / 2)
        return ConvexityProof(dP, F_value, G_value, 1.0 / self.unit, self.beta, M, M_f, self.d, self.status)


def _multiples(value: Any, C: Array | None, scale: Array) -> Array:
    """Return F or G for rows whose norm is not 1; zero where the program has none."""
    if C is None or value is None:
        return np.zeros((0, 0) if C is None else (len(C), len(C)))
    norms = np.linalg.norm(C * scale, axis=1)
    return np.asarray(value.value) / np.outer(norms, norms)


def clear(M: Array) -> Array:
    """Return M without entries |M_ij| <= 1e-12 sqrt |M_ii M_jj|, so that the generated code has no products with them.

    They are rounding errors of variables that the problem does not couple.
    """
    size = np.sqrt(np.abs(np.diag(M)))
    return np.where(np.abs(M) > ROUNDING * np.outer(size, size), M, 0.0)


def scalings(lq: LinearQuadratic, w: Array) -> dict[str, Array]:
    """Return scalings of w by name, in the order in which they are tried.

    "none" gives the least condition number in the units of the problem; "curvature" makes the diagonal of H equal to 1;
    "magnitude" makes w at the steady state equal to 1.
    """
    size = np.abs(w)
    size = np.where(size > 1e-6 * max(float(size.max()), 1.0), size, 1.0) if lq.size is None else lq.size
    return {
        "none": np.ones(len(w)),
        "curvature": curvature_scaling(lq),
        "magnitude": size,
    }
