"""Schemes for an economic cost on the bioreactor: loss in closed loop, times, memory and size of the code."""

from __future__ import annotations

import numpy as np

from benchmarks.lib.augmented.loop import JUMPS, OPTIMUM, SAMPLES, fastest
from benchmarks.lib.report import Report
from examples import bioreactor
from nmpc_codegen import (
    RK4,
    AugmentedLagrangian,
    ExactHessian,
    ExplicitRungeKutta,
    Mirror,
    Options,
    Project,
    RealTimeIteration,
    build,
    generate,
)

EXACT = {
    "exact, mirrored stages": Mirror(level="stage"),
    "exact, mirrored reduced": Mirror(level="reduced"),
    "exact, projected stages": Project(level="stage"),
    "exact, projected reduced": Project(level="reduced"),
}


def schemes() -> dict[str, Options]:
    """Name -> options, all with 3 RK4 steps and the periodic shift."""
    integrator = ExplicitRungeKutta(RK4, steps=3)
    found = {
        name: Options(integrator=integrator, hessian=ExactHessian(kind), algorithm=RealTimeIteration(shift="periodic"))
        for name, kind in EXACT.items()
    }
    found["augmented Lagrangian"] = Options(integrator=integrator, algorithm=AugmentedLagrangian(shift="periodic"))
    return found


def measure(report: Report, scale: float) -> None:
    """The loop with S + 20 %, whose last 48 h are compared with the optimal orbit."""
    repeats = max(3, round(5 * scale))
    for name, options in schemes().items():
        ocp = bioreactor.build_ocp(soft=True)
        controller = build(ocp, options)
        loop, us = fastest(controller, JUMPS["S +20 %"], repeats)
        produced = bioreactor.productivity(loop, SAMPLES - bioreactor.N, SAMPLES)  # type: ignore[arg-type]
        report.add("scheme_loss", 1 - produced / OPTIMUM, case=name)
        report.add("scheme_failed", loop.failed, case=name)
        report.add("scheme_median_us", float(np.median(us)), "us", case=name, n=repeats)
        report.add("scheme_worst_us", float(us.max()), "us", case=name, n=repeats)
        report.add("scheme_ram", controller.description.report.ram_bytes, "bytes", case=name)
        report.add("scheme_code", len(generate(ocp, options)[f"{ocp.name}.c"]), "characters", case=name)
