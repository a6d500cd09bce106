"""Dense oracles of the stage QP: all variables in one vector, solved by one KKT matrix.

min  sum_{k<NS} 1/2 z_k'Q_k z_k + g_k'z_k  +  1/2 x_NS'Q_NS x_NS + g_NS'x_NS,   z = (x, u)
s.t. x_{k+1} = S_k z_k + b_k,   x_0 given except for its free components
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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


@dataclass(frozen=True, eq=False)
class StageQP:
    """A StageProblem with bounds on (u, rows), rows (ng, nz) at the stages ``at``; soft rows have a finite penalty.

    x, u, mult: the solution from which it was built, if any.
    """

    problem: StageProblem
    rows: np.ndarray
    at: tuple[int, ...]
    lower: np.ndarray
    upper: np.ndarray
    penalty: np.ndarray
    curvature: np.ndarray
    x: np.ndarray | None = None
    u: np.ndarray | None = None
    mult: np.ndarray | None = None
    state: np.ndarray | None = None

    def values(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """u, then the rows."""
        nx, ns = self.problem.nx, self.problem.ns
        rows = [a[:nx] @ x[k] + (a[nx:] @ u[k] if k < ns else 0.0) for a, k in zip(self.rows, self.at, strict=True)]
        return np.concatenate([u.ravel(), rows])

    def objective(self, x: np.ndarray, u: np.ndarray) -> float:
        """The cost, including the penalties of soft rows."""
        p = self.problem
        z = np.concatenate([x[:-1], u], axis=1)
        cost = sum(0.5 * v @ Q @ v + g @ v for v, Q, g in zip(z, p.Q, p.g, strict=True))
        cost += 0.5 * x[-1] @ p.Q_N @ x[-1] + p.g_N @ x[-1]
        v, n = self.values(x, u), u.size
        violation = np.maximum(0.0, np.maximum(v - self.upper, self.lower - v))[n:]
        soft = np.isfinite(self.penalty)
        return float(cost + self.penalty[soft] @ violation[soft] + 0.5 * self.curvature[soft] @ violation[soft] ** 2)


@dataclass(frozen=True)
class Residuals:
    """Violations of the optimality conditions, relative to the magnitude of their terms."""

    dynamics: float
    stationarity: float
    feasibility: float
    sign: float

    @property
    def worst(self) -> float:
        return max(self.dynamics, self.stationarity, self.feasibility, self.sign)


def residuals(qp: StageQP, x: np.ndarray, u: np.ndarray, mult: np.ndarray) -> Residuals:
    """Relative residuals at (x, u, mult); lam by the adjoint recursion, so that stationarity is that of the controls.

    sign: the part of |mult| that is not at a bound: |mult| / max|mult| times the relative distance, at most 1; for a
    soft row with violation v also the difference between |mult| and penalty + curvature v, or what exceeds penalty.
    """
    p = qp.problem
    ns, nx, nv = p.ns, p.nx, u.size
    w = np.concatenate([np.append(a, b) for a, b in zip(x[:-1], u, strict=True)] + [x[-1]])
    E, e = p.dynamics
    size_w = max(np.abs(w).max(), 1e-20)
    dynamics = np.max(np.abs(E @ w - e) / (np.abs(E) @ np.abs(w) + np.abs(e) + 1e-12 * size_w))
    grad = p.hessian @ w + p.gradient
    terms = np.abs(p.hessian) @ np.abs(w) + np.abs(p.gradient)
    for a, k, m in zip(qp.rows, qp.at, mult[nv:], strict=True):
        part = p.z(k)
        grad[part] += m * a[: part.stop - part.start]
        terms[part] += np.abs(m * a[: part.stop - part.start])
    for k in range(ns):
        grad[p.u(k)] += mult[:nv].reshape(ns, -1)[k]
        terms[p.u(k)] += np.abs(mult[:nv].reshape(ns, -1)[k])
    lam, lam_terms = grad[p.x(ns)], terms[p.x(ns)]
    stationarity = 0.0
    for k in range(ns - 1, -1, -1):
        z, t = grad[p.z(k)] + p.S[k].T @ lam, terms[p.z(k)] + np.abs(p.S[k]).T @ lam_terms
        lam, lam_terms = z[:nx], t[:nx]
        stationarity = max(stationarity, np.max(np.abs(z[nx:]) / np.maximum(t[nx:], 1e-300), initial=0.0))
    if p.free:
        free = list(p.free)
        stationarity = max(stationarity, np.max(np.abs(lam[free]) / np.maximum(lam_terms[free], 1e-300)))
    v = qp.values(x, u)
    component = np.concatenate([np.abs(x).max(axis=0), np.abs(u).max(axis=0)])
    size = np.concatenate([np.tile(component[nx:], ns), np.abs(qp.rows) @ component if len(qp.rows) else []])
    penalty = np.concatenate([np.full(nv, np.inf), qp.penalty])
    curvature = np.concatenate([np.zeros(nv), qp.curvature])
    feasibility = sign = 0.0
    largest = max(np.abs(mult).max(), 1e-300)
    for i in range(len(v)):
        over = v[i] - qp.upper[i] if np.isfinite(qp.upper[i]) else -np.inf
        under = qp.lower[i] - v[i] if np.isfinite(qp.lower[i]) else -np.inf
        scale = size[i] + sum(abs(t) for t in (qp.lower[i], qp.upper[i]) if np.isfinite(t)) + 1e-12 * size_w
        violation = max(over, under, 0.0)
        if np.isinf(penalty[i]):
            feasibility = max(feasibility, violation / scale)
            allowed = np.inf
        else:
            allowed = penalty[i] + curvature[i] * violation
            sign = max(sign, (abs(mult[i]) - allowed) / largest)
            if violation > 1e-9 * scale:
                wanted = allowed if over > 0 else -allowed
                sign = max(sign, abs(mult[i] - wanted) / largest)
        distance = over if mult[i] > 0 else under
        if mult[i] != 0 and distance < 0:
            sign = max(sign, min(1.0, -distance / scale) * abs(mult[i]) / largest)
    return Residuals(float(dynamics), float(stationarity), float(feasibility), float(sign))


def constructed(
    rng: np.random.Generator,
    problem: StageProblem,
    rows: np.ndarray,
    at: tuple[int, ...],
    weights: tuple[float, ...] = (1, 3, 1, 0, 0),
    degenerate: float = 0.0,
    margin: float = 0.1,
) -> StageQP:
    """A QP built backwards from a KKT point: all data of ``problem`` but g are kept, including x_0.

    ``weights``: of the states lower, free, upper, equal, violated; controls are never violated.
    """
    ns, nx, nu = problem.ns, problem.nx, problem.nu
    u = rng.normal(size=(ns, nu))
    x = np.zeros((ns + 1, nx))
    x[0] = problem.x_0
    for k in range(ns):
        x[k + 1] = problem.S[k] @ np.append(x[k], u[k]) + problem.b[k]
    nv, ng = u.size, len(rows)
    empty = np.full(nv + ng, np.inf)
    qp = StageQP(problem, rows, at, -empty, empty, np.full(ng, np.inf), np.zeros(ng))
    value = qp.values(x, u)
    chance = np.array(weights) / sum(weights)
    state = rng.choice([LOWER, FREE, UPPER, EQUAL, VIOLATED], size=nv + ng, p=chance)
    state[:nv][state[:nv] == VIOLATED] = FREE
    room = rng.exponential(size=(2, nv + ng)) + margin
    room[rng.random((2, nv + ng)) < 0.2] = np.inf
    lower = np.where((state == LOWER) | (state == EQUAL), value, value - room[0])
    upper = np.where((state == UPPER) | (state == EQUAL), value, value + room[1])
    mult = rng.exponential(size=nv + ng) * np.where(rng.random(nv + ng) < degenerate, 0.0, 1.0)
    mult = np.where(state == FREE, 0.0, mult) * np.where(state == LOWER, -1, 1)
    mult = np.where(state == EQUAL, mult * rng.choice([-1, 1], size=nv + ng), mult)
    penalty, curvature = np.full(ng, np.inf), rng.choice([0.0, 1.0, 10.0], size=ng) * rng.random(ng)
    for m in range(ng):
        c = nv + m
        if state[c] == VIOLATED:
            penalty[m] = rng.choice([0.0, 1.0]) * rng.exponential()
            violation, side = rng.exponential() + margin, rng.choice([-1, 1])
            (upper if side > 0 else lower)[c] = value[c] - side * violation
            (lower if side > 0 else upper)[c] = value[c] - side * (violation + rng.exponential() + margin)
            mult[c] = side * (penalty[m] + curvature[m] * violation)
        elif weights[-1] > 0:
            penalty[m] = abs(mult[c]) + rng.exponential() + margin
    g, g_N = _gradient(rng, qp, x, u, mult)
    problem = replace(problem, g=g, g_N=g_N)
    return StageQP(problem, rows, at, lower, upper, penalty, curvature, x, u, mult, state)


def _gradient(
    rng: np.random.Generator, qp: StageQP, x: np.ndarray, u: np.ndarray, mult: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """g and g_N that make (x, u, mult) stationary with random multipliers of the dynamics."""
    p = qp.problem
    ns, nx, nv = p.ns, p.nx, u.size
    lam = rng.normal(size=(ns + 1, nx))
    lam[0, list(p.free)] = 0.0
    z = np.concatenate([x[:-1], u], axis=1)
    g = np.stack([-p.Q[k] @ z[k] - p.S[k].T @ lam[k + 1] for k in range(ns)])
    g[:, :nx] += lam[:-1]
    g[:, nx:] -= mult[:nv].reshape(ns, -1)
    g_N = lam[-1] - p.Q_N @ x[-1]
    for a, k, m in zip(qp.rows, qp.at, mult[nv:], strict=True):
        if k < ns:
            g[k] -= m * a
        else:
            g_N -= m * a[:nx]
    return g, g_N
