"""The heat rod with 100 states and 2 controls: memory and time of an iteration, against multiple shooting and IPOPT."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.lib.report import Report
from examples import heat_rod
from nmpc_codegen import RK4, Controller, ExplicitRungeKutta, NoCondensing, Options, RiccatiActiveSet, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, node_data

REPEATS = 20
X0 = np.full(heat_rod.STATES, heat_rod.START)


def median_ms(call: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Median time (ms)."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def measure(report: Report) -> None:
    """Bytes, ms per iteration, and the distance of the first plan from IPOPT's solution."""
    given = heat_rod.options()
    ours = build(heat_rod.build_ocp(), given)
    other = Options(
        integrator=ExplicitRungeKutta(RK4, steps=heat_rod.STEPS),
        condensing=NoCondensing(),
        qp=RiccatiActiveSet(fallback=None),
        online=given.online,
        solve=False,
    )
    shooting = build(heat_rod.build_ocp(), other)
    problem = classify(heat_rod.build_ocp())
    reference, data = Reference(problem, replace(CLASSICAL, steps=heat_rod.STEPS)), node_data(problem, x0=X0)
    start = time.perf_counter()
    found = reference.solve(data)
    ipopt_ms = 1e3 * (time.perf_counter() - start) / max(1, found.iterations)
    for case, controller in (("adjoint shooting", ours), ("multiple shooting, Riccati", shooting)):
        report.add("rod_struct_bytes", controller.nbytes, "bytes", case=case)
        report.add("rod_iteration_ms", iteration_ms(controller), "ms", case=case, n=REPEATS)
        report.add("rod_control_error", plan_error(controller, found.u), "degC", case=case)
    report.add("rod_iteration_ms", ipopt_ms, "ms", case="CasADi and IPOPT", n=found.iterations)


def iteration_ms(controller: Controller) -> float:
    """Median time of a sample from a cold start."""

    def sample() -> None:
        controller.reset()
        controller.step(X0)

    return median_ms(sample)


def plan_error(controller: Controller, exact: np.ndarray) -> float:
    """Largest error (degC) of the controls after five samples without a shift at the same state."""
    controller.reset()
    for _ in range(5):
        if "samples" in controller.description.members("solver"):
            controller.view("samples")[...] = 0
        controller.step(X0)
    return float(np.abs(controller.u - exact).max())
