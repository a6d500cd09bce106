"""Dense oracles of the stage QP: all variables in one vector, solved by one KKT matrix.

min  sum_{k<NS} 1/2 z_k'Q_k z_k + g_k'z_k  +  1/2 x_NS'Q_NS x_NS + g_NS'x_NS,   z = (x, u)
s.t. x_{k+1} = S_k z_k + b_k,   x_0 given except for its free components
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class StageProblem:
    """Cost and dynamics. S (NS, nx, nz), b (NS, nx), Q (NS, nz, nz), Q_N (nx, nx), g (NS, nz), g_N (nx), x_0 (nx)."""

    S: np.ndarray
    b: np.ndarray
    Q: np.ndarray
    Q_N: np.ndarray
    g: np.ndarray
    g_N: np.ndarray
    x_0: np.ndarray
    free: tuple[int, ...] = ()

    @property
    def ns(self) -> int:
        return len(self.S)

    @property
    def nx(self) -> int:
        return int(self.S.shape[1])

    @property
    def nu(self) -> int:
        return int(self.S.shape[2]) - self.nx

    @property
    def size(self) -> int:
        """Entries of (x_0, u_0, x_1, u_1, .., x_NS)."""
        return self.ns * (self.nx + self.nu) + self.nx

    def x(self, k: int) -> slice:
        start = k * (self.nx + self.nu)
        return slice(start, start + self.nx)

    def u(self, k: int) -> slice:
        start = k * (self.nx + self.nu) + self.nx
        return slice(start, start + self.nu)

    def z(self, k: int) -> slice:
        start = k * (self.nx + self.nu)
        return slice(start, start + self.nx + (self.nu if k < self.ns else 0))

    @property
    def hessian(self) -> np.ndarray:
        H = np.zeros((self.size, self.size))
        for k in range(self.ns):
            H[self.z(k), self.z(k)] = self.Q[k]
        H[self.x(self.ns), self.x(self.ns)] = self.Q_N
        return H

    @property
    def gradient(self) -> np.ndarray:
        return np.concatenate([*self.g, self.g_N])

    @property
    def dynamics(self) -> tuple[np.ndarray, np.ndarray]:
        """E, e with E w = e: rows of x_0 first (free components left out), then of x_1 .. x_NS."""
        given = [i for i in range(self.nx) if i not in self.free]
        E = np.zeros((len(given) + self.ns * self.nx, self.size))
        E[: len(given)] = np.eye(self.nx, self.size)[given]
        for k in range(self.ns):
            row = len(given) + k * self.nx
            E[row : row + self.nx, self.z(k)] = -self.S[k]
            E[row : row + self.nx, self.x(k + 1)] = np.eye(self.nx)
        return E, np.concatenate([self.x_0[given], self.b.ravel()])


def random_problem(
    rng: np.random.Generator, ns: int, nx: int, nu: int, free: tuple[int, ...] = (), radius: float = 1.0
) -> StageProblem:
    """Dynamics of the given spectral radius, definite Hessian blocks."""
    S = rng.normal(size=(ns, nx, nx + nu))
    for A in S[:, :, :nx]:
        A *= radius / max(np.max(np.abs(np.linalg.eigvals(A))), 1e-3)
    factor = rng.normal(size=(ns, nx + nu, nx + nu))
    Q = factor @ factor.transpose(0, 2, 1) / (nx + nu) + 0.1 * np.eye(nx + nu)
    factor_N = rng.normal(size=(nx, nx))
    Q_N = factor_N @ factor_N.T / nx
    b, g, g_N = rng.normal(size=(ns, nx)), rng.normal(size=(ns, nx + nu)), rng.normal(size=nx)
    return StageProblem(S, b, Q, Q_N, g, g_N, rng.normal(size=nx), free)


def equality_solution(problem: StageProblem, rows: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
    """(w, lam, mult) of the problem with further equations rows w = values; lam is (NS, nx), of x_1 .. x_NS.

    H w + g + rows'mult + E'lam_of_E = 0 with E x_{k+1} - S z = b; lam_{k+1} multiplies S_k z_k + b_k - x_{k+1}.
    """
    E, e = problem.dynamics
    H, n = problem.hessian, problem.size
    C = np.vstack([E, rows])
    K = np.block([[H, C.T], [C, np.zeros((len(C), len(C)))]])
    solution = np.linalg.solve(K, np.concatenate([-problem.gradient, e, values]))
    w, multipliers = solution[:n], solution[n:]
    lam = -multipliers[len(E) - problem.ns * problem.nx : len(E)]
    return w, lam.reshape(problem.ns, problem.nx), multipliers[len(E) :]


LOWER, FREE, UPPER, EQUAL, VIOLATED = -1, 0, 1, 2, 3
