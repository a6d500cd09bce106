"""Schemes for an economic cost on two problems: loss in closed loop, times, memory and size of the code.

The bioreactor runs the loop of loop.py with S +20 %; its loss is relative to the optimal orbit. The evaporation process
starts 10 kPa above its best pressure; its loss is the cost beyond the best steady state, relative to that of the exact
Hessian without regularisation of the stages, over 120 samples. A plan starts at the orbit or at the steady state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from benchmarks.lib.augmented.loop import JUMPS, OPTIMUM, SAMPLES, fastest
from benchmarks.lib.augmented.text import text_bytes
from benchmarks.lib.report import Report
from examples import bioreactor, evaporation
from nmpc_codegen import (
    OCP,
    RK4,
    AugmentedLagrangian,
    Controller,
    ExactHessian,
    ExplicitRungeKutta,
    Mirror,
    Options,
    ProblemError,
    Project,
    build,
)
from nmpc_codegen.economic import steady_state, tune
from verification.routes import PURE

EXACT = {
    "exact, mirrored stages": Mirror(level="stage"),
    "exact, mirrored reduced": Mirror(level="reduced"),
    "exact, projected stages": Project(level="stage"),
    "exact, projected reduced": Project(level="reduced"),
}
TUNED, AUGMENTED = "economic Gauss-Newton", "augmented Lagrangian"
#: Samples of the evaporation process; pressure above the best one.
MINUTES, DP = 120, 10.0


@dataclass(frozen=True)
class Figures:
    """Loss in percent, failed samples, times in us of a sample."""

    loss: float
    failed: int
    median: float
    worst: float


@dataclass(frozen=True, eq=False)
class Problem:
    """An OCP, its integration steps, the shift of the plan, its closed loop."""

    make: Callable[[], OCP]
    steps: int
    shift: str | None
    run: Callable[[Controller, int], Figures]

    def options(self, name: str) -> Options:
        """Options of a scheme; ProblemError where there is no constant Hessian."""
        integrator = ExplicitRungeKutta(RK4, steps=self.steps)
        if name == AUGMENTED:
            return Options(integrator=integrator, algorithm=AugmentedLagrangian(shift=self.shift))
        hessian = (
            ExactHessian(EXACT[name]) if name in EXACT else tune(self.make(), Options(integrator=integrator)).hessian()
        )
        return Options(integrator=integrator, hessian=hessian, algorithm=replace(PURE, shift=self.shift))


def orbit(controller: Controller, repeats: int) -> Figures:
    """The bioreactor with S +20 %; the last 48 h count."""
    loop, us = fastest(controller, JUMPS["S +20 %"], repeats)
    produced = bioreactor.productivity(loop, SAMPLES - bioreactor.N, SAMPLES)  # type: ignore[arg-type]
    return Figures(100 * (1 - produced / OPTIMUM), loop.failed, float(np.median(us)), float(us.max()))


@cache
def stage() -> tuple[Any, Any]:
    """Cost of the evaporation process, as a function of (x, u), and its best steady state."""
    from nmpc_codegen.economic.stage import steady_stage
    from nmpc_codegen.frontend.classify import classify

    ocp = evaporation.build_ocp()
    return steady_stage(classify(ocp), evaporation.options()), steady_state(ocp, evaporation.options())


def _minutes(controller: Controller) -> tuple[float, int, np.ndarray]:
    model, best = stage()
    controller.reset()
    controller.x[...], controller.u[...] = best.x, best.u
    x, cost, failed, us = best.x + np.array([0.0, DP]), 0.0, 0, []
    controller.solve(x, tol=1e-6)
    for _ in range(MINUTES):
        u = controller.step(x)
        failed += controller.status != 0
        us.append((controller.stats.prepare_ns + controller.stats.feedback_ns) / 1e3)
        cost += float(model.values(np.append(x, u))[1]) - best.cost
        x = np.asarray(controller.integrate(x, u, 1.0))
    return cost, failed, np.array(us)


@cache
def reference() -> float:
    """Cost beyond the steady state with converged plans."""
    model, best = stage()
    controller = build(evaporation.build_ocp(), evaporation.options())
    controller.x[...], controller.u[...] = best.x, best.u
    x, cost = best.x + np.array([0.0, DP]), 0.0
    for _ in range(MINUTES):
        u = controller.solve(x, tol=1e-8).u[0]
        cost += float(model.values(np.append(x, u))[1]) - best.cost
        x = np.asarray(controller.integrate(x, u, 1.0))
    return cost


def pressure(controller: Controller, repeats: int) -> Figures:
    """The evaporation process from 10 kPa above its best pressure; the plan starts converged."""
    runs = [_minutes(controller) for _ in range(repeats)]
    us = np.min([times for _, _, times in runs], axis=0)
    cost, failed, _ = runs[0]
    return Figures(100 * (cost / reference() - 1), failed, float(np.median(us)), float(us.max()))


PROBLEMS = {
    "bioreactor": Problem(lambda: bioreactor.build_ocp(soft=True), bioreactor.STEPS, "periodic", orbit),
    "evaporation": Problem(evaporation.build_ocp, 1, None, pressure),
}


def measure(report: Report, scale: float) -> None:
    """Every scheme on both problems; a scheme that a problem does not admit is named with the reason."""
    repeats = max(2, round(5 * scale))
    for problem, given in PROBLEMS.items():
        for name in (*EXACT, TUNED, AUGMENTED):
            case, ocp = f"{problem}: {name}", given.make()
            try:
                options = given.options(name)
            except ProblemError as error:
                print(f"{case}: {error}")
                report.add("scheme_refused", 1, case=case, profile="")
                continue
            controller = build(ocp, options)
            found = given.run(controller, repeats)
            report.add("scheme_loss", found.loss, "%", case=case, n=repeats)
            report.add("scheme_failed", found.failed, case=case)
            report.add("scheme_median_us", found.median, "us", case=case, n=repeats)
            report.add("scheme_worst_us", found.worst, "us", case=case, n=repeats)
            report.add("scheme_ram", controller.description.report.ram_bytes, "bytes", case=case)
            report.add("scheme_code", text_bytes(ocp, options), "bytes", case=case)
