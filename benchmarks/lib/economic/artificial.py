"""Figure 2 of [Z20]: a tracking problem, rotated backwards into an economic one, solved by SQP with exact Hessians.

l_rot = 10 |x - x_s|^2 + 0.1 |u - u_s|^2,   Lambda = 100 |x - x_s|^2,   l = l_rot - Lambda(x) + Lambda(Phi(x, u))
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.lib.economic.evaporation import START, shooting, steps_to, tuning
from benchmarks.lib.economic.sqp import Array, Plan, quadratic_program, steady_plan, stepped
from benchmarks.lib.report import Report
from nmpc_codegen.economic import kkt_step

N, STEPS = 200, 12
STATE, CONTROL, STORAGE = 10.0, 0.1, 100.0


@dataclass(frozen=True, eq=False)
class Run:
    """Sizes of the steps, distances from the solution, the last plan."""

    sizes: list[float]
    errors: list[float]
    plan: Plan


def run(rotated: bool, steps: int = STEPS) -> Run:
    """SQP with full steps from the steady state, whose multipliers vanish in both forms."""
    t, problem = tuning(), replace(shooting(N), rows=(), bounds=np.zeros(0))
    x_s = ca.DM(t.x_s)

    def storage(x: Any) -> Any:
        return STORAGE * ca.sumsqr(x - x_s)

    def tracking(w: Any) -> Any:
        return STATE * ca.sumsqr(w[:2] - x_s) + CONTROL * ca.sumsqr(w[2:] - ca.DM(t.u_s))

    node = problem.functions(None if rotated else lambda x, x_next: storage(x_next) - storage(x), tracking)
    plan = replace(steady_plan(t, N), lam=np.zeros((N + 1, 2)), mu=np.zeros((N, 0)))
    plans, sizes = [plan], []
    for _ in range(steps):
        dx_N = plan.x[-1] - t.x_s
        end = (np.zeros(2), np.zeros((2, 2))) if rotated else (-2 * STORAGE * dx_N, -2 * STORAGE * np.eye(2))
        step = kkt_step(quadratic_program(problem, node, plan, None, end), START - plan.x[0])
        sizes.append(float(np.linalg.norm(_flat(step.dx, step.du))))
        plan = stepped(plan, step)
        plans.append(plan)
    errors = [float(np.linalg.norm(_flat(p.x - plan.x, p.u - plan.u))) for p in plans]
    return Run(sizes, errors, plan)


def _flat(x: Array, u: Array) -> Array:
    return np.concatenate([x.ravel(), u.ravel()])


def measure(report: Report) -> None:
    """Both forms have the same solution; steps that either needs."""
    original, rotated = run(False), run(True)
    for name, found in (("original", original), ("rotated", rotated)):
        report.add("figure2_steps_to_1e-6", steps_to(found.sizes, 1e-6), case=name, profile="")
    difference = np.abs(original.plan.u - rotated.plan.u).max()
    report.add("figure2_solution_error", float(difference), limit=1e-6, case="u, original and rotated", profile="")
