"""The dense active-set solver on random QPs built from known KKT points, and on infeasible ones.

    python -m verification.qp.random_dense

Every answer is judged by quantities that NumPy recomputes from the data: optimality conditions, objective and, if it is
unique, the minimiser against the constructed one; for infeasible problems the certificate.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from verification.oracles.qp import QuadraticProgram, from_solution, infeasible, residuals
from verification.qp.harness import QP, library

#: (NV, NG); for each of them a problem of every class is built in turn.
DIMENSIONS = (
    *((1, 0), (1, 1), (1, 3), (2, 0), (2, 2), (3, 1), (3, 8), (4, 0), (4, 4), (5, 2), (6, 12), (8, 0)),
    *((8, 3), (10, 4), (10, 20), (12, 12), (15, 5), (16, 40), (20, 0), (20, 10), (25, 25), (30, 8), (40, 0), (40, 40)),
)
RESIDUAL = 1e-10  # optimality conditions, relative to the size of their terms
OBJECTIVE = 1e-10  # relative to |g|'|z| + |z|'|H||z|
MINIMISER = 1e-7  # relative to max(unit, |z|), times max(1, condition 1e-8)

Build = Callable[[np.random.Generator, int, int], QuadraticProgram]


def _redundant(rng: np.random.Generator, n: int, m: int) -> QuadraticProgram:
    """Rows repeated with other factors, combinations of rows, and rows that equal bounds."""
    A = rng.normal(size=(m, n))
    for j in range(m // 2, m):
        first = rng.normal(size=max(1, m // 2)) * (rng.random(max(1, m // 2)) < 0.5)
        A[j] = [first[: m // 2] @ A[: m // 2], rng.choice([-2, -1, 0.3, 1]) * A[0], np.eye(n)[rng.integers(n)]][j % 3]
    return from_solution(rng, n, m, A=A, degenerate=rng.choice([0.0, 0.5]))


def _scaled(rng: np.random.Generator, n: int, m: int) -> QuadraticProgram:
    """Variables, rows and cost in units of 1e-6 to 1e6."""
    qp = from_solution(rng, n, m, degenerate=rng.choice([0.0, 0.3]))
    unit, row = 10 ** rng.uniform(-6, 6, n), 10 ** rng.uniform(-6, 6, m)
    return _in_units(qp, unit, row, 10 ** rng.uniform(-6, 6))


def _in_units(qp: QuadraticProgram, unit: np.ndarray, row: np.ndarray, cost: float) -> QuadraticProgram:
    """The same problem for z * unit, (A z) * row and cost * objective; active bounds remain active exactly."""
    assert qp.z is not None
    assert qp.mult is not None
    both = np.concatenate([unit, row])
    H, A = cost * qp.H / np.outer(unit, unit), qp.A / unit * row[:, None]
    z, mult = qp.z * unit, cost * qp.mult / both
    value = np.concatenate([z, A @ z])
    state = qp.state
    lower = np.where((state == -1) | (state == 2), value, qp.lower * both)
    upper = np.where((state == 1) | (state == 2), value, qp.upper * both)
    g = -(H @ z + mult[: len(z)] + A.T @ mult[len(z) :])
    return dataclasses.replace(qp, H=H, g=g, A=A, lower=lower, upper=upper, z=z, mult=mult)


def _semidefinite(rng: np.random.Generator, n: int, m: int) -> QuadraticProgram:
    """A Hessian of any rank below n: 0, diagonal, or with a condition number of up to 1e6 on its range."""
    rank = int(rng.integers(0, n))
    factor = rng.normal(size=(rank, n)) * np.geomspace(1, rng.choice([1.0, 1e3]), rank)[:, None]
    diagonal = np.diag(np.append(np.zeros(1), (rng.random(n - 1) < 0.5) * 1.0))
    H = [factor.T @ factor, diagonal, np.zeros((n, n))][int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    return from_solution(rng, n, m, H=H, weights=(2, 2, 2, 1), degenerate=rng.choice([0.0, 0.3]))


CLASSES: dict[str, Build] = {
    "regular": lambda rng, n, m: from_solution(rng, n, m, weights=(1, 4, 1, 0.5)),
    "degenerate": lambda rng, n, m: from_solution(rng, n, m, degenerate=0.5),
    "redundant": _redundant,
    "equal_bounds": lambda rng, n, m: from_solution(rng, n, m, weights=(0, 1, 0, 2)),
    "all_active": lambda rng, n, m: from_solution(rng, n, m, weights=(1, 0, 1, 0), degenerate=0.2),
    "none_active": lambda rng, n, m: from_solution(rng, n, m, weights=(0, 1, 0, 0)),
    "condition": lambda rng, n, m: from_solution(rng, n, m, condition=10 ** rng.uniform(4, 8)),
    "scaled": _scaled,
    "semidefinite": _semidefinite,
}
UNIQUE = frozenset(CLASSES) - {"semidefinite"}


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


def random_qp_statistics(n_feasible: int = 5000, n_infeasible: int = 500, seed: int = 0) -> dict[str, Any]:
    """Counts over random QPs; every second QP is solved from the working set of another one, every first from none.

    qp_wrong_answers: wrong answers with status OK, and invalid certificates; qp_capped: iteration limit or a
    repeated working set; qp_failed: numerical failure. ``qp_examples`` describes up to ten of the problems counted.
    """
    library(*DIMENSIONS[0])  # creates the directory
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda size: library(*size), DIMENSIONS))
    warm = {size: QP(*size) for size in DIMENSIONS}
    names = tuple(CLASSES)
    keys = ("problems", "wrong", "capped", "failed", "false_infeasible", "missed_infeasible")
    table = {name: dict.fromkeys((*keys, "iterations_mean", "iterations_max"), 0.0) for name in (*names, "infeasible")}
    examples: list[str] = []
    total = dict.fromkeys(table, 0)
    for i in range(n_feasible + n_infeasible):
        rng = np.random.default_rng([seed, i])
        name = names[i % len(names)] if i < n_feasible else "infeasible"
        sizes = DIMENSIONS if i < n_feasible else tuple(size for size in DIMENSIONS if size[1] > 0)
        size = sizes[i // len(names) % len(sizes)] if i < n_feasible else sizes[i % len(sizes)]
        qp = CLASSES[name](rng, *size) if i < n_feasible else infeasible(rng, *size)
        solver = warm[size] if i // (len(names) * len(DIMENSIONS)) % 2 else QP(*size)
        status = solver.run(*qp.data)
        row = table[name]
        row["problems"] += 1
        total[name] += int(solver["iterations"])
        row["iterations_max"] = max(row["iterations_max"], int(solver["iterations"]))
        found = _judge(name, qp, solver, status)
        if found:
            row[found[0]] += 1
            examples.append(f"{name} {i} {size}: {found[0]} {found[1]}")
    for name, row in table.items():
        row["iterations_mean"] = total[name] / max(1, row["problems"])
    return _summary(table, examples)


def _judge(name: str, qp: QuadraticProgram, solver: QP, status: str) -> tuple[str, str] | None:
    """(column, explanation) of a problem that was not solved correctly."""
    if status in ("ITERATION_LIMIT", "STALLED"):
        return "capped", status
    if status == "NUMERICAL_FAILURE":
        return "failed", status
    if name == "infeasible":
        if status == "OK":
            return "missed_infeasible", ""
        wrong = wrong_certificate(qp, np.array(solver["certificate"][: len(qp.lower)]))
        return ("wrong", wrong) if wrong else None
    if status == "INFEASIBLE":
        return "false_infeasible", ""
    wrong = wrong_answer(qp, solver.z, solver.mult, name in UNIQUE)
    return ("wrong", wrong) if wrong else None


def _summary(table: dict[str, dict[str, float]], examples: list[str]) -> dict[str, Any]:
    def total(key: str) -> int:
        return int(sum(row[key] for row in table.values()))

    count = total("problems")
    return {
        "qp_problems": count,
        "qp_wrong_answers": total("wrong"),
        "qp_capped": total("capped"),
        "qp_failed": total("failed"),
        "qp_false_infeasible": total("false_infeasible"),
        "qp_missed_infeasible": total("missed_infeasible"),
        "qp_iterations_mean": sum(r["iterations_mean"] * r["problems"] for r in table.values()) / max(1, count),
        "qp_iterations_max": int(max(r["iterations_max"] for r in table.values())),
        "qp_classes": table,
        "qp_examples": examples[:10],
    }


if __name__ == "__main__":
    print(json.dumps(random_qp_statistics(), indent=1))
