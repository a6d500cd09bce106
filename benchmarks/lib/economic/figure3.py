"""Figure 3 of [Z20]: closed-loop losses of nine schemes on the evaporation process, 400 samples of a minute.

    loss = (J - J_converged) / (l_s 400) 100 %,   J = sum l(x, u) of the plant from x_0 = x_s + (0, dP)

Eight schemes are generated controllers. The ninth, the constant indefinite H, has no QP that a convex solver accepts:
its steps are those of kkt_step(), with X2 = 25 as an equation at the nodes 1..N-1.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from benchmarks.lib.economic import schemes
from benchmarks.lib.economic.schemes import CONVERGED, EXACT, IDENTITY, LETEMPC, TRACK, TUNED, Loop, Scheme
from benchmarks.lib.report import Report
from nmpc_codegen.economic import kkt_step
from verification.economic.evaporation import N, shooting, tuning
from verification.economic.sqp import Array, Plan, quadratic_program, steady_plan, stepped

SAMPLES, SHORT = 400, 30
DISTURBANCES = (1.0, 2.0, 4.0, 7.0, 10.0)  # kPa
SCHEMES = (
    *(CONVERGED, EXACT, TUNED, IDENTITY),
    *(schemes.LETEMPC_CONVERGED, LETEMPC, schemes.TRACK_CONVERGED, TRACK),
)
INDEFINITE = "indefinite H"
Losses = dict[str, float]


@cache
def losses(dP: float, samples: int = SAMPLES, compared: tuple[Scheme, ...] = SCHEMES) -> tuple[Losses, int, float]:
    """Loss of every scheme but the first, in percent; failed samples; last distance of the loop with M from x_s."""
    t = tuning()
    runs = Loop("evaporation", tuple(t.x_s + np.array([0.0, dP])), samples, 1.0).runs(compared)
    costs = {name: run.cost for name, run in runs.items()}
    costs[INDEFINITE] = indefinite(dP, samples)
    best = costs.pop(CONVERGED.name)
    found = {name: (cost - best) / t.cost / samples * 100 for name, cost in costs.items()}
    last = float(np.abs(runs[TUNED.name].x[-1] - t.x_s).max())
    return found, sum(run.failed for run in runs.values()), last


def indefinite(dP: float, samples: int) -> float:
    """Cost of the real-time iteration with the Hessian of the Lagrangian at the steady state, indefinite, as it is."""
    t, problem = tuning(), shooting()
    node, plan = problem.functions(), steady_plan(t, N)
    x, total = t.x_s + np.array([0.0, dP]), 0.0
    for _ in range(samples):
        plan = stepped(plan, kkt_step(quadratic_program(problem, node, plan, t.H), x - plan.x[0]))
        Phi, cost, _ = (np.asarray(v, dtype=float).ravel() for v in problem.stage.values(np.append(x, plan.u[0])))
        x, total = Phi, total + float(cost[0])
        plan = _shifted(plan, t.x_s, t.u_s)
    return total


def _shifted(plan: Plan, x_s: Array, u_s: Array) -> Plan:
    lam, mu = np.vstack([plan.lam[1:], plan.lam[-1:]]), np.vstack([plan.mu[1:], plan.mu[-1:]])
    return Plan(np.vstack([plan.x[1:], x_s]), np.vstack([plan.u[1:], u_s]), lam, mu)


def ordered(found: Losses) -> bool:
    """Tracking > identity > LETEMPC > max(M, exact), all with one step per sample."""
    last = max(found[TUNED.name], found[EXACT.name])
    return found[TRACK.name] > found[IDENTITY.name] > found[LETEMPC.name] > last


def measure(report: Report) -> None:
    """Losses and their order; the loop with M reaches the steady state (Theorem 11); the linear term of LETEMPC."""
    equivalent = (CONVERGED, TUNED, schemes.LETEMPC_CONVERGED, schemes.QUADRATIC_CONVERGED)
    for name, loss in losses(2.0, SHORT, equivalent)[0].items():
        report.add("letempc_loss", loss, "%", case=f"{name}, dP = 2", profile="", n=SHORT)
    for dP in DISTURBANCES:
        found, failed, last = losses(dP)
        for name, loss in found.items():
            report.add("figure3_loss", loss, "%", case=f"{name}, dP = {dP:g}", profile="", n=SAMPLES)
        gap, case = abs(found[TUNED.name] - found[EXACT.name]), f"dP = {dP:g}"
        report.add("figure3_gap", gap, "%", limit=1e-6, case=f"M and exact, {case}")
        report.add("figure3_order", float(ordered(found) and gap <= 1e-6), limit=1, at_least=True, case=case)
        report.add("figure3_failed", failed, limit=0, case=case, n=SAMPLES * len(SCHEMES))
        report.add("theorem11_distance", last / dP, limit=1e-3, case=f"M, after {SAMPLES} samples, of {case}")
