"""Figure 4 of [Z20]: closed-loop losses of energy-optimal driving, 30 s, over the size of the side step at 8 s.

    loss = (J - J_converged) / (|l_s| 300) 100 %,   J = sum of the economic cost of 300 intervals of 0.1 s

The obstacle is at 80 m until 6 s. The lane moves sideways at 8 s: "foreseen", in the references of the nodes from the
first sample on, or "unforeseen", at 8 s. The plan of the first sample is converged.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from benchmarks.lib.economic import schemes
from benchmarks.lib.economic.schemes import (
    CONVERGED,
    EXACT,
    IDENTITY,
    LETEMPC,
    MOST,
    TOLERANCE,
    TUNED,
    Array,
    Loop,
    Scheme,
    subject,
)
from benchmarks.lib.report import Report
from examples import driving
from nmpc_codegen import Controller, Status

SAMPLES = 300
SIDE_STEPS = (0.0, 0.5, 1.0, 2.0, 3.0)  # m
SCHEMES = (CONVERGED, EXACT, TUNED, IDENTITY, schemes.LETEMPC_CONVERGED, LETEMPC)
MOVE, CLEARED = round(driving.MOVE / driving.SAMPLING), round(driving.CLEARED / driving.SAMPLING)
#: Agreement of M and exact, and resolution of a loss, both relative to |l_s| 300.
CLOSE = 1e-5


def loop(side: float, foreseen: bool) -> Loop:
    """The closed loop with a side step in m."""

    def event(n: int, c: Controller, x: Array) -> Array:
        if n <= CLEARED:
            driving.schedule(n, c)
        if foreseen and n == 0:
            for k in range(MOVE + 1, driving.N + 1):
                c.set_parameter("lane", side, node=k)
        if foreseen and n <= MOVE:
            c.set_parameter("lane", side, node=MOVE - n)
        if not foreseen and n == MOVE:
            c.set_parameter("lane", side)
        return x

    def origin(n: int) -> Array:
        return np.array([0.0, side * (n >= MOVE), 0.0, 0.0, 0.0])

    start, drift = (0.0, 0.0, driving.SPEED, 0.0, 0.0), (driving.SPEED * driving.SAMPLING, 0.0, 0.0, 0.0, 0.0)
    return Loop("driving", start, SAMPLES, driving.SAMPLING, event, origin, warm=True, drift=drift)


@cache
def losses(side: float, foreseen: bool) -> dict[str, float]:
    """Loss of every scheme but the first, as a share of |l_s| 300; inf if it diverges."""
    costs = {name: run.cost for name, run in loop(side, foreseen).runs(SCHEMES).items()}
    best = costs.pop(CONVERGED.name)
    return {name: (cost - best) / abs(subject("driving").tuning.cost) / SAMPLES for name, cost in costs.items()}


def first_plan(scheme: Scheme) -> float:
    """Full steps from constant speed to the plan of the first sample, which ends at the obstacle; MOST + 1 if none."""
    c = schemes.controllers("driving", SCHEMES)[scheme].copy()
    begun = loop(0.0, False)
    driving.schedule(0, c)
    begun.start(c)
    found = c.solve(np.array(begun.x0), tol=TOLERANCE, max_iterations=MOST, globalization="full_step")
    return float(found.iterations if found.status == Status.OK else MOST + 1)


def ordered(found: dict[str, float]) -> bool:
    """M within 1e-5 of exact, LETEMPC worse than both, the identity diverges."""
    better = max(found[TUNED.name], found[EXACT.name])
    close = abs(found[TUNED.name] - found[EXACT.name]) <= CLOSE
    return close and found[LETEMPC.name] > better and not np.isfinite(found[IDENTITY.name])


def measure(report: Report) -> None:
    """Losses and their order; the order is required where the side step is foreseen."""
    for scheme in (EXACT, TUNED):
        report.add("figure4_first_plan_iterations", first_plan(scheme), case=scheme.name)
    for foreseen in (True, False):
        word = "foreseen" if foreseen else "unforeseen"
        for side in SIDE_STEPS:
            found = losses(side, foreseen)
            case = f"{side:g} m, {word}"
            diverged = not np.isfinite(found[IDENTITY.name])
            report.add("figure4_identity_diverges", float(diverged), limit=1, at_least=True, case=case, n=SAMPLES)
            for name, loss in found.items():
                if name != IDENTITY.name:
                    key = "figure4_loss" if foreseen else "figure4_unforeseen_loss"
                    report.add(key, loss * 100, "%", case=f"{name}, {case}", n=SAMPLES)
            if foreseen:
                gap = abs(found[TUNED.name] - found[EXACT.name])
                report.add("figure4_gap", gap, limit=CLOSE, case=f"M and exact, {case}")
                report.add("figure4_order", float(ordered(found)), limit=1, at_least=True, case=case)
