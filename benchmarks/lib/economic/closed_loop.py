"""Figure 3 of [Z20]: closed-loop losses of nine schemes on the evaporation process, 400 samples of a minute.

    loss = (J - J_converged) / (l_s 400) 100 %,   J = sum l(x, u) of the plant from x_0 = x_s + (0, dP)

A scheme has a cost (economic, LETEMPC, tracking), a Hessian and a number of SQP steps per sample; "converged" repeats
steps until they vanish. X2 = 25 is an equation at the nodes 1..N-1, whose multipliers are checked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.lib.economic.evaporation import N, shooting, tuning
from benchmarks.lib.economic.sqp import Array, Plan, quadratic_program, steady_plan, stepped
from benchmarks.lib.report import Report
from nmpc_codegen.economic import kkt_step, letempc_cost, tracking_cost

SAMPLES, DP = 400, 2.0
#: Weights 1/2 w'Ww of 10 x'x + 0.1 u'u.
TRACKING = (20.0, 20.0, 0.2, 0.2)
CONVERGED, LARGEST_STEP = 12, 1e-7


@dataclass(frozen=True)
class Scheme:
    """A cost and a Hessian by name.

    cost: "economic", "letempc", "tracking"; hessian: "exact", "tuned" (M), "indefinite" (H), "identity", or "own" (of a
    quadratic cost).
    """

    name: str
    cost: str
    hessian: str
    converged: bool = False


SCHEMES = (
    Scheme("economic converged", "economic", "exact", converged=True),
    Scheme("exact", "economic", "exact"),
    Scheme("Gauss-Newton", "economic", "tuned"),
    Scheme("constant H", "economic", "indefinite"),
    Scheme("identity", "economic", "identity"),
    Scheme("LETEMPC converged", "letempc", "exact", converged=True),
    Scheme("LETEMPC", "letempc", "own"),
    Scheme("tracking converged", "tracking", "exact", converged=True),
    Scheme("tracking", "tracking", "own"),
)


@dataclass(frozen=True)
class Loop:
    """Total cost, the last distance from the steady state, and the largest multiplier of the wrong sign."""

    cost: float
    distance: float
    wrong_sign: float


def run(scheme: Scheme, dP: float = DP, samples: int = SAMPLES) -> Loop:
    """One closed loop; the plan moves by one interval per sample, with the steady state appended."""
    t, problem = tuning(), shooting()
    node, hessian = problem.functions(cost=_cost(scheme.cost)), _hessian(scheme)
    plan = steady_plan(t, N)
    if scheme.cost != "economic":
        plan = Plan(plan.x, plan.u, np.zeros_like(plan.lam), plan.mu * (scheme.cost == "letempc"))
    x, total, wrong = t.x_s + np.array([0.0, dP]), 0.0, 0.0
    sign = np.sign(t.mu_s)
    for _ in range(samples):
        for _ in range(CONVERGED if scheme.converged else 1):
            step = kkt_step(quadratic_program(problem, node, plan, hessian), x - plan.x[0])
            plan = stepped(plan, step)
            if max(np.abs(step.dx).max(), np.abs(step.du).max()) < LARGEST_STEP:
                break
        wrong = max(wrong, float(np.max(-plan.mu[1:] * sign)))
        Phi, cost, _ = (np.asarray(v, dtype=float).ravel() for v in problem.stage.values(np.append(x, plan.u[0])))
        x, total = Phi, total + float(cost[0])
        plan = _shifted(plan, t.x_s, t.u_s)
    return Loop(total, float(np.abs(x - t.x_s).max()), wrong)


def _shifted(plan: Plan, x_s: Array, u_s: Array) -> Plan:
    lam, mu = np.vstack([plan.lam[1:], plan.lam[-1:]]), np.vstack([plan.mu[1:], plan.mu[-1:]])
    return Plan(np.vstack([plan.x[1:], x_s]), np.vstack([plan.u[1:], u_s]), lam, mu)


def _cost(name: str) -> Any:
    """A cost of w instead of the economic one."""
    t = tuning()
    if name == "letempc":
        return lambda w: letempc_cost(t, w[:2], w[2:])
    if name == "tracking":
        return lambda w: tracking_cost(t, w[:2], w[2:], TRACKING)
    return None


def _hessian(scheme: Scheme) -> Array | None:
    constant = {"tuned": tuning().M, "indefinite": tuning().H, "identity": np.eye(4)}
    own = {"letempc": tuning().M, "tracking": np.diag(TRACKING)}
    return own[scheme.cost] if scheme.hessian == "own" else constant.get(scheme.hessian)


def loops(dP: float = DP, samples: int = SAMPLES) -> dict[str, Loop]:
    """The closed loop of every scheme."""
    return {scheme.name: run(scheme, dP, samples) for scheme in SCHEMES}


def losses(found: dict[str, Loop], samples: int = SAMPLES) -> dict[str, float]:
    """Loss of every scheme but the first one, which is the baseline, in percent."""
    best, *others = found
    return {name: (found[name].cost - found[best].cost) / tuning().cost / samples * 100 for name in others}


def measure(report: Report) -> None:
    """Losses and their order; the loop with M reaches the steady state (Theorem 11)."""
    runs = loops()
    found = losses(runs)
    for name, loss in found.items():
        report.add("figure3_loss", loss, "%", case=f"{name}, dP = {DP:g}", profile="", n=SAMPLES)
    order = found["tracking"] > found["identity"] > found["LETEMPC"] > max(found["Gauss-Newton"], found["exact"])
    close = abs(found["Gauss-Newton"] - found["exact"]) <= 1e-6
    report.add("figure3_order", float(order and close), limit=1, at_least=True, case=f"dP = {DP:g}", profile="")
    report.add("figure3_gap", abs(found["Gauss-Newton"] - found["exact"]), "%", limit=1e-6, profile="")
    loop = runs["Gauss-Newton"]
    report.add("theorem11_distance", loop.distance, limit=1e-3, case=f"M, after {SAMPLES} samples", profile="")
    report.add("figure3_wrong_sign", loop.wrong_sign, limit=0, case="multipliers of X2 >= 25, M", profile="")
