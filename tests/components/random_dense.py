"""A random dense QP with a semidefinite Hessian, and judges of answers to dense QPs."""

from __future__ import annotations

import dataclasses

import numpy as np

from verification.oracles.qp import QuadraticProgram, from_solution, residuals

RESIDUAL = 1e-10  # optimality conditions, relative to the size of their terms
OBJECTIVE = 1e-10  # relative to |g|'|z| + |z|'|H||z|
MINIMISER = 1e-7  # relative to max(unit, |z|), times max(1, condition 1e-8)


def semidefinite(rng: np.random.Generator, n: int, m: int) -> QuadraticProgram:
    """A Hessian of any rank below n: 0, diagonal, or with a condition number of up to 1e6 on its range."""
    rank = int(rng.integers(0, n))
    factor = rng.normal(size=(rank, n)) * np.geomspace(1, rng.choice([1.0, 1e3]), rank)[:, None]
    diagonal = np.diag(np.append(np.zeros(1), (rng.random(n - 1) < 0.5) * 1.0))
    H = [factor.T @ factor, diagonal, np.zeros((n, n))][int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    return from_solution(rng, n, m, H=H, weights=(2, 2, 2, 1), degenerate=rng.choice([0.0, 0.3]))


def wrong_answer(qp: QuadraticProgram, z: np.ndarray, mult: np.ndarray, unique: bool) -> str:
    """Faults of an answer with their figures; empty if there is none."""
    worst = residuals(qp, z, mult)
    if not np.any(qp.g) and np.max(np.abs(qp.H @ z + qp.rows.T @ mult)) < RESIDUAL:
        worst = dataclasses.replace(worst, stationarity=0.0)  # all terms are rounding errors: a feasibility problem
    if worst.worst > RESIDUAL:
        return f"{worst}"
    assert qp.z is not None
    size = np.abs(qp.g) @ np.abs(qp.z) + np.abs(qp.z) @ np.abs(qp.H) @ np.abs(qp.z)
    # The difference of the objectives without cancellation: d'(H (z + z*)/2 + g).
    d = z - qp.z
    error = abs(d @ (qp.H @ (z + qp.z) / 2 + qp.g))
    if error > OBJECTIVE * size:
        return f"objective {error / size:.1e}"
    unit = 1 / np.sqrt(np.diag(qp.H)) if unique else np.ones(len(z))
    scaled = qp.H * np.outer(unit, unit)
    condition = float(np.linalg.cond(scaled)) if unique else 1.0
    distance = np.max(np.abs(d / unit)) / max(np.max(np.abs(qp.z / unit)), np.finfo(float).tiny)
    if unique and distance > MINIMISER * max(1.0, condition * 1e-8):
        return f"minimiser {distance:.1e}"
    return ""


def wrong_certificate(qp: QuadraticProgram, f: np.ndarray) -> str:
    """Faults of the weights f of an infeasible problem: f'C must vanish and its bound be negative."""
    C, n = qp.rows, len(qp.g)
    bound = np.where(f > 0, qp.upper, qp.lower)[f != 0]
    value = f[f != 0] @ bound
    rest = np.abs(f @ C)
    reach = np.where(np.isfinite(qp.lower[:n]) & np.isfinite(qp.upper[:n]), np.maximum(-qp.lower, qp.upper)[:n], 1e3)
    if not np.any(f) or not np.max(np.abs(f)) <= 1.0:
        return "no certificate"
    if np.any(rest > 1e-9 * (np.abs(f) @ np.abs(C))):
        return f"combination {np.max(rest):.1e}"
    return "" if value + rest @ np.abs(reach) < 0 else f"bound {value:.1e}"
