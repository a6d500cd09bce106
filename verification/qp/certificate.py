"""HiGHS decides whether a QP has a feasible point, on its condensed rows."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from verification.oracles.stage_qp import Array, StageQP
from verification.oracles.stage_qp_random import condensed_rows

# Violation of the rows, in their units, above which a QP is infeasible and below which it is feasible; else undecided.
CONTRADICTION, ROUNDING = 1e-6, 1e-9


def least_violation(qp: StageQP, A: Array, value: Array) -> float:
    """Return min t >= 0 such that all hard rows hold up to t and all control bounds hold; inf if that is infeasible.

    A, value: the condensed rows of the QP.
    """
    hard = np.isinf(qp.rows.l1)
    above, below = hard & np.isfinite(qp.upper), hard & np.isfinite(qp.lower)
    rows = np.vstack([A[above], -A[below]])
    right = np.append((qp.upper - value)[above], (value - qp.lower)[below])
    if not len(rows):
        return 0.0
    bounds = np.column_stack([(qp.lower_u - qp.u).ravel(), (qp.upper_u - qp.u).ravel()])
    if np.any(bounds[:, 0] > bounds[:, 1]):
        return np.inf
    size = np.maximum(np.max(np.abs(rows), axis=1), 1.0)  # the LP in units in which its tolerance is meaningful
    cost = np.append(np.zeros(A.shape[1]), 1.0)
    answer = linprog(
        cost, np.column_stack([rows / size[:, None], -1 / size]), right / size, bounds=[*bounds, (0.0, None)],
        method="highs", options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )  # fmt: skip
    return float(answer.x[-1]) if answer.status == 0 else np.nan


def rounding(qp: StageQP, A: Array, value: Array) -> float:
    """Return the accuracy of the hard rows in double precision: eps times the largest sum of terms of their values."""
    hard = np.isinf(qp.rows.l1)
    range_u = np.maximum(np.abs(qp.lower_u - qp.u), np.abs(qp.upper_u - qp.u)).ravel()
    terms = np.abs(A) @ np.where(np.isfinite(range_u), range_u, 1.0) + np.abs(value)
    return float(np.finfo(float).eps * np.max(terms[hard], initial=0.0))


def certificate(qp: StageQP) -> str:
    """Return "feasible", "infeasible", "undecided", or "not finite" if the plan cannot be linearised."""
    if not all(np.all(np.isfinite(a)) for a in (qp.S, qp.b, qp.Q, qp.g, qp.C, qp.c)):
        return "not finite"
    A, value = condensed_rows(qp)
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(value))):
        return "not finite"  # the plan overflows over the horizon
    if rounding(qp, A, value) > CONTRADICTION:
        return "undecided"  # undecidable in double precision
    t = least_violation(qp, A, value)
    if t > CONTRADICTION:
        return "infeasible"
    return "feasible" if t < ROUNDING else "undecided"
