"""The evaporation process: its tuning, the statements of [Z20] about Hessians, multipliers and iterates, Figure 1."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import scipy.linalg
import scipy.sparse

from examples import evaporation
from nmpc_codegen import ProblemError
from nmpc_codegen.economic import Tuning, corrected_multipliers, kkt_step
from nmpc_codegen.economic.stage import steady_stage
from nmpc_codegen.economic.steps import constraint_matrix
from nmpc_codegen.frontend.classify import classify
from verification.economic.sqp import Plan, Shooting, iterate, quadratic_program, steady_plan

N = 200
START = np.array([35.0, 49.743])
PAPER = np.array([25.0, 49.743, 191.713, 215.888, 6210.38])
ITERATIONS = {"exact": 8, "tuned": 8, "corrected": 8, "identity": 40}


@cache
def tuning() -> Tuning:
    """M with eta = 1."""
    return evaporation.tuned(N)


@cache
def shooting(intervals: int = N) -> Shooting:
    """X2 = 25 at the nodes 1..N-1, x_N = x_s."""
    t = tuning()
    stage = steady_stage(classify(evaporation.build_ocp(intervals)), evaporation.options())
    rows = tuple(stage.rows.names.index(name) for name in t.active)
    bounds = np.where(t.mu_s < 0, stage.rows.lower[list(rows)], stage.rows.upper[list(rows)])
    return Shooting(stage, intervals, rows, bounds, t.x_s)


def refused_with_reason() -> float:
    """1 if eta = 0 is refused and the message names the active bound and eta=1."""
    try:
        evaporation.tuned(N, eta=0)
    except ProblemError as error:
        return float("X2" in str(error) and "eta=1" in str(error))
    return 0.0


def reduced_hessian_error() -> float:
    """Largest difference of Z'MZ and Z'HZ relative to Z'HZ, on the null space of x_0, dynamics and active rows."""
    t, problem = tuning(), shooting()
    exact = quadratic_program(problem, problem.functions(), steady_plan(t, N), None)
    rows = constraint_matrix(exact).toarray()
    Z = scipy.linalg.null_space(rows)
    M = scipy.sparse.block_diag([*(t.M for _ in range(N)), np.zeros((2, 2))])
    H = scipy.sparse.block_diag([*exact.H, np.zeros((2, 2))])
    reduced_M, reduced_H = Z.T @ (M @ Z), Z.T @ (H @ Z)
    return float(np.abs(reduced_M - reduced_H).max() / np.abs(reduced_H).max())


def negative_eigenvalues(with_rows: bool) -> int:
    """Of the reduced exact Hessian at the steady state, with or without the active rows in the null space."""
    t, problem = tuning(), shooting()
    exact = quadratic_program(problem, problem.functions(), steady_plan(t, N), None)
    rows = constraint_matrix(exact).toarray()
    if not with_rows:
        keep = np.ones(len(rows), dtype=bool)
        keep[(N + 1) * 2 : (N + 1) * 2 + N - 1] = False
        rows = rows[keep]
    Z = scipy.linalg.null_space(rows)
    H = scipy.sparse.block_diag([*exact.H, np.zeros((2, 2))])
    return int(np.count_nonzero(np.linalg.eigvalsh(Z.T @ (H @ Z)) < 0))


def first_steps() -> tuple[object, object]:
    """The first steps from the steady state with the exact Hessian and with M."""
    t, problem = tuning(), shooting()
    node, plan = problem.functions(), steady_plan(t, N)
    return tuple(  # type: ignore[return-value]
        kkt_step(quadratic_program(problem, node, plan, hessian), START - plan.x[0]) for hessian in (None, t.M)
    )


def first_step_error() -> float:
    """Largest difference of the primal steps relative to the step."""
    exact, tuned = first_steps()
    difference = max(np.abs(exact.dx - tuned.dx).max(), np.abs(exact.du - tuned.du).max())  # type: ignore[attr-defined]
    return float(difference / max(np.abs(exact.dx).max(), np.abs(exact.du).max()))  # type: ignore[attr-defined]


def first_step_dual_error(corrected: bool) -> float:
    """Largest difference of the multipliers lam_1, ..., lam_N after the first step, absolute; they are of size 300.

    At node 0 the difference contains the multiple of X2 = 25, a row that node 0 does not have.
    """
    exact, tuned = first_steps()
    if corrected:
        tuned = corrected_multipliers(tuning(), tuned)  # type: ignore[arg-type]
    return float(np.abs(exact.lam - tuned.lam)[1:].max())  # type: ignore[attr-defined]


@cache
def figure1() -> dict[str, tuple[Plan, list[float], list[float]]]:
    """Plans, sizes of the steps and residuals of every Hessian."""
    return {name: iterate(shooting(), tuning(), START, name, n) for name, n in ITERATIONS.items()}


def steps_to(sizes: list[float], tolerance: float) -> float:
    """Number of steps until one is shorter than the tolerance; one more than there are if none is."""
    return float(next((i + 1 for i, size in enumerate(sizes) if size < tolerance), len(sizes) + 1))


def figure1_order() -> float:
    """1 if the exact Hessian needs fewest steps, M at most four more, and the identity does not get there."""
    exact, tuned, identity = (steps_to(figure1()[name][1], 1e-6) for name in ("exact", "tuned", "identity"))
    rate = rates(figure1()["tuned"][1])
    return float(exact <= tuned <= exact + 4 and max(rate) < 0.1 and identity > 40)


def rates(sizes: list[float]) -> list[float]:
    """Ratios of successive steps between 1 and 1e-9, where neither the start nor rounding rules."""
    return [b / a for a, b in pairwise(sizes) if a < 1 and b > 1e-9]


def admissible(plan: Plan) -> float:
    """1 if the working set is right: all path rows hold at the nodes 1..N-1, and mu has the sign of its bound."""
    stage = shooting().stage
    h = np.array([np.asarray(stage.values(w)[2], dtype=float).ravel() for w in plan.w])
    inside = np.all(h[1:] <= stage.rows.upper + 1e-8) and np.all(h[1:] >= stage.rows.lower - 1e-8)
    return float(inside and np.all(plan.mu[1:] * np.sign(tuning().mu_s) > 0))
