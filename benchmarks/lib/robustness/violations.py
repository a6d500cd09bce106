"""Infeasible QPs: the verdict, the row that is named and its violation, against linear programs.

    python -m benchmarks --only robustness/violations [--scale S]

A relaxed QP has an l1 weight on all rows but the bounds of controls. If the weight is large, its point minimises the
sum of the violations, which a linear program (HiGHS) finds on another route.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.optimize import linprog

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import Controller, Status, build
from nmpc_codegen.frontend.classify import classify
from verification.oracles.stage_qp import Array, Point, Shape, StageQP, row_values
from verification.qp.draw import draw
from verification.qp.stage_package import SOLVERS, answer, options, rounded, stage_ocp
from verification.routes import PURE

QPS = 1500  # per solver
WEIGHT = 1e6
#: Distance of sums from the least one, relative to the terms of the row.
TOLERANCE = 1e-5


def least_violation(qp: StageQP, largest: bool, weight: Array | float = 1.0) -> float:
    """Least largest violation, or least sum of violations times ``weight``, of the rows by points within the bounds of
    the controls.

    The variables are the controls, to which the states are affine, and the violations.
    """
    N, nu = qp.shape.N, qp.shape.nu
    constant = _values(qp, np.zeros((N, nu)))
    columns = [_values(qp, unit.reshape(N, nu)) - constant for unit in np.eye(N * nu)]
    value, m = np.array(columns).T, len(constant)
    slack = -np.ones((m, 1)) if largest else -np.eye(m)
    above, below = np.isfinite(qp.upper), np.isfinite(qp.lower)
    A = np.vstack([np.hstack([value, slack])[above], np.hstack([-value, slack])[below]])
    b = np.concatenate([(qp.upper - constant)[above], (constant - qp.lower)[below]])
    bounds = [*zip(qp.lower_u.ravel(), qp.upper_u.ravel(), strict=True), *[(0, None)] * slack.shape[1]]
    found = linprog(np.append(np.zeros(N * nu), np.ones(slack.shape[1]) * weight), A, b, bounds=bounds, method="highs")
    return float(found.fun) if found.status == 0 else math.nan


def _values(qp: StageQP, du: Array) -> Array:
    """Values of the rows at these controls."""
    dx = [qp.dx0]
    for S, b, u in zip(qp.S, qp.b, du, strict=True):
        dx.append(S @ np.concatenate([dx[-1], u]) + b)
    return row_values(qp, np.array(dx), du)


def violations(qp: StageQP, point: Point) -> Array:
    """Violations of the rows at a point, recomputed from its controls."""
    value = _values(qp, point.du)
    return np.maximum(np.maximum(value - qp.upper, qp.lower - value), 0.0)


@dataclasses.dataclass
class Count:
    """Verdicts on infeasible QPs and what is wrong with them."""

    qps: int = 0
    not_relaxed: int = 0
    sums: int = 0
    stated: int = 0
    examples: list[str] = dataclasses.field(default_factory=list)

    def fault(self, kind: str, number: int, text: str) -> None:
        """One more of a kind."""
        setattr(self, kind, getattr(self, kind) + 1)
        self.examples.append(f"infeasible/{number}: {text}")


def _weights(qp: StageQP, controller: Controller) -> Array:
    """Penalties of the rows relative to the largest: the inverse of their scales, as the controller has found them."""
    rows = classify(stage_ocp(qp.shape)).qp_rows
    scale = np.array([controller.view("row_scale")[row] for _, _, _, row in rows])
    weight = 1.0 / np.where(scale > 0, scale, 1.0)
    return np.asarray(weight / weight.max())


def check(count: Count, number: int, controller: Controller) -> None:
    """A relaxed QP against the linear program."""
    qp = rounded(draw("infeasible", number), "double")
    controller.reset()
    found = answer(controller, qp)
    weight = _weights(qp, controller)
    least = least_violation(qp, largest=False, weight=weight)
    if math.isnan(least):
        return  # the linear program itself has failed
    count.qps += 1
    if found.status != Status.RELAXED:
        count.fault("not_relaxed", number, found.status.name)
        return
    amount, stats = violations(qp, found.point), controller.stats
    size = 1 + float(np.max(np.abs(_values(qp, found.point.du))))
    if abs(amount @ weight - least) > TOLERANCE * size:
        count.fault("sums", number, f"violations {amount @ weight:.3e}, least sum {least:.3e}")
    if abs(abs(stats.violation) - amount.max()) > TOLERANCE * size or stats.violated_row is None:
        count.fault("stated", number, f"largest violation {amount.max():.3e}, stated {stats.violation:.3e}")


def measure(report: Report, asked: Run) -> None:
    """Every solver with a relaxation."""
    relaxed = dataclasses.replace(PURE, relaxation=WEIGHT)
    for solver in asked.cases(SOLVERS):
        count, controllers = Count(), dict[Shape, Controller]()
        for number in range(asked.share(QPS)):
            shape = draw("infeasible", number).shape
            if shape not in controllers:
                chosen = dataclasses.replace(options(solver, "double"), algorithm=relaxed)
                controllers[shape] = build(stage_ocp(shape), chosen, profile="fast")
            check(count, number, controllers[shape])
        report.add("relaxation_missing", count.not_relaxed / count.qps, case=solver, n=count.qps)
        report.add("violation_sum_unconfirmed", count.sums, case=solver, n=count.qps, limit=0)
        report.add("violation_stated_unconfirmed", count.stated, case=solver, n=count.qps, limit=0)
        print("\n".join(f"{solver}: {text}" for text in count.examples[:6]))
