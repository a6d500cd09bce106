"""QP solvers are tested by optimality conditions, problems built backwards from a solution, and enumeration.

min 1/2 z'Hz + g'z   s.t.  lower <= (z, A z) <= upper
H z + g + mult[:n] + A' mult[n:] = 0,   mult >= 0 at an upper bound, <= 0 at a lower one, 0 in between
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

LOWER, FREE, UPPER, EQUAL = -1, 0, 1, 2


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """A QP has its solution ``z`` and multipliers ``mult`` if they are known.

    ``state``: the constructed state of each row.
    """

    H: np.ndarray
    g: np.ndarray
    A: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    z: np.ndarray | None = None
    mult: np.ndarray | None = None
    state: np.ndarray | None = None

    @property
    def rows(self) -> np.ndarray:
        """Return the identity on top of A."""
        return np.vstack([np.eye(len(self.g)), self.A])

    @property
    def data(self) -> tuple[np.ndarray, ...]:
        return self.H, self.g, self.A, self.lower, self.upper


@dataclass(frozen=True)
class Residuals:
    """Residuals are violations of the optimality conditions, each relative to the magnitude of its terms."""

    stationarity: float
    feasibility: float
    sign: float

    @property
    def worst(self) -> float:
        return max(self.stationarity, self.feasibility, self.sign)


def residuals(qp: QuadraticProgram, z: np.ndarray, mult: np.ndarray, penalty: np.ndarray | float = np.inf) -> Residuals:
    """Return the relative residuals at (z, mult).

    stationarity: |H z + g + C'mult| / (|H||z| + |g| + |C'||mult|) in the largest norm, C = rows.
    feasibility: violation / (|bound| + |c_i||z|_max + 1e-20); sign: |mult_i| relative to the
    largest, times the relative distance (at most 1) from the bound that its sign selects.
    ``penalty``: a general row is replaced by the cost penalty * violation. A row whose multiplier is at this
    limit may be violated on that side; |mult| > penalty counts as a sign violation of 1.
    Multipliers have the unit of the cost over that of a row. A constant cost (H = 0, g = 0) provides no unit, and every
    multiplier of a solution is 0; the residuals are then relative to 1, so that rounding errors are not compared with
    themselves.
    """
    unit = np.finfo(float).tiny if np.any(qp.H) or np.any(qp.g) else 1.0
    C = qp.rows
    limit = np.concatenate([np.full(len(z), np.inf), np.broadcast_to(penalty, len(qp.A))])
    terms = np.abs(qp.H) @ np.abs(z) + np.abs(qp.g) + np.abs(C.T) @ np.abs(mult)
    stationarity = np.max(np.abs(qp.H @ z + qp.g + C.T @ mult)) / max(np.max(terms), unit)
    value = C @ z
    size = np.abs(C) @ np.full(len(z), np.max(np.abs(z), initial=0.0)) + 1e-20
    over = np.where(np.isfinite(qp.upper), value - qp.upper, -np.inf)
    under = np.where(np.isfinite(qp.lower), qp.lower - value, -np.inf)
    over = np.where(mult >= limit, np.minimum(over, 0.0), over)
    under = np.where(mult <= -limit, np.minimum(under, 0.0), under)
    bound = np.where(np.isfinite(qp.upper), np.abs(qp.upper), 0) + np.where(np.isfinite(qp.lower), np.abs(qp.lower), 0)
    feasibility = np.max(np.maximum(over, under) / (size + bound), initial=0.0)
    distance = np.where(mult > 0, -over, np.where(mult < 0, -under, 0.0)) / (size + bound)
    weight = np.abs(mult) / max(np.max(np.abs(mult), initial=0.0), unit)
    sign = np.max(weight * np.minimum(1.0, np.abs(distance)), initial=float(np.any(np.abs(mult) > limit)))
    return Residuals(float(stationarity), float(max(feasibility, 0.0)), float(sign))


def hessian(rng: np.random.Generator, n: int, condition: float) -> np.ndarray:
    """Return a positive definite matrix with random eigenvectors, and eigenvalues from 1 to ``condition``."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    H = (Q * np.geomspace(1.0, condition, n)) @ Q.T if n > 1 else np.array([[condition]])
    return np.asarray((H + H.T) / 2)


def from_solution(
    rng: np.random.Generator,
    n: int,
    m: int,
    condition: float = 1e2,
    weights: tuple[float, float, float, float] = (1, 2, 1, 1),
    degenerate: float = 0.0,
    scale: float = 1.0,
    A: np.ndarray | None = None,
    H: np.ndarray | None = None,
) -> QuadraticProgram:
    """Return a QP built backwards from a chosen KKT point.

    ``weights``: of the states lower, free, upper, equal of a row; ``degenerate``: share of the active rows whose
    multiplier is zero; ``scale``: variables are spread over scale^-1 .. scale.
    """
    H = hessian(rng, n, condition) if H is None else H
    A = rng.normal(size=(m, n)) if A is None else A
    z = rng.normal(size=n)
    C = np.vstack([np.eye(n), A])
    state = rng.choice([LOWER, FREE, UPPER, EQUAL], size=n + m, p=np.array(weights) / sum(weights))
    mult = np.where(state == FREE, 0.0, rng.exponential(size=n + m)) * np.where(state == LOWER, -1, 1)
    mult = np.where(state == EQUAL, mult * rng.choice([-1, 1], size=n + m), mult)
    mult = np.where(rng.random(n + m) < degenerate, 0.0, mult)
    units = np.exp(rng.uniform(-np.log(scale), np.log(scale), n)) if scale > 1 else np.ones(n)
    z, H, A = z * units, H / np.outer(units, units), A / units
    mult[:n] /= units
    value = C @ (z / units)
    value[:n] = z
    value[n:] = A @ z
    margin = rng.exponential(size=(2, n + m)) + 0.1
    margin[:, :n] *= units
    margin[rng.random((2, n + m)) < 0.2] = np.inf
    lower = np.where((state == LOWER) | (state == EQUAL), value, value - margin[0])
    upper = np.where((state == UPPER) | (state == EQUAL), value, value + margin[1])
    g = -(H @ z + mult[:n] + A.T @ mult[n:])
    return QuadraticProgram(H, g, A, lower, upper, z, mult, state)


def infeasible(rng: np.random.Generator, n: int, m: int, condition: float = 1e2) -> QuadraticProgram:
    """Return a QP without feasible point, with its Farkas certificate as ``mult``.

    With weights w >= 0 of some rows, sum_j w_j a_j = s row r, so row r is bounded by s sum_j w_j upper_j;
    the lower bound of row r is put above that. m >= 1.
    """
    A = rng.normal(size=(m, n))
    others = rng.choice(n + m - 1, size=rng.integers(1, min(n + m - 1, n) + 1), replace=False)
    weight = rng.exponential(size=len(others)) + 0.1
    A[-1] = weight @ np.vstack([np.eye(n), A[:-1]])[others]
    z = rng.normal(size=n)
    value = np.concatenate([z, A @ z])
    lower, upper = value - rng.exponential(size=n + m) - 0.1, value + rng.exponential(size=n + m) + 0.1
    lower[-1] = weight @ upper[others] + rng.exponential() + 0.01
    upper[-1] = lower[-1] + rng.choice([0.0, 1.0, np.inf])
    certificate = np.zeros(n + m)
    certificate[others] = weight
    certificate[-1] = -1.0
    sign = rng.choice([-1.0, 1.0])  # the mirrored problem uses the other sides
    if sign < 0:
        lower, upper = -upper, -lower
    return QuadraticProgram(hessian(rng, n, condition), rng.normal(size=n), A, lower, upper, mult=sign * certificate)


def by_enumeration(qp: QuadraticProgram, tolerance: float = 1e-9) -> np.ndarray | None:
    """Return the minimiser found by trying every working set, or None if no set is feasible; for tiny QPs only."""
    n, C = len(qp.g), qp.rows
    choices = []
    for lo, up in zip(qp.lower, qp.upper, strict=True):
        sides = [None] if lo < up else []
        choices.append(sides + [t for t in {lo, up} if np.isfinite(t)])
    best, least = None, np.inf
    for choice in itertools.product(*choices):
        active = [i for i, t in enumerate(choice) if t is not None]
        E = C[active]
        K = np.block([[qp.H, E.T], [E, np.zeros((len(active), len(active)))]])
        right = np.concatenate([-qp.g, [choice[i] for i in active]])
        solution = np.linalg.lstsq(K, right, rcond=1e-12)[0]
        z = solution[:n]
        feasible = np.all(C @ z >= qp.lower - tolerance) and np.all(C @ z <= qp.upper + tolerance)
        if feasible and np.max(np.abs(K @ solution - right)) < tolerance:
            cost = 0.5 * z @ qp.H @ z + qp.g @ z
            if cost < least:
                best, least = z, cost
    return best
