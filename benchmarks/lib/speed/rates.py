"""What rates of controls cost: the time of a sample with a penalty, or a limit, of every rate over that without, in one
run, on condensed and on stage QPs."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.choice import ROUTES
from benchmarks.lib.speed.in_turn import in_turn
from benchmarks.lib.speed.loops import LOOPS, for_target, module_of, package_of
from nmpc_codegen import OCP
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.scales import scales
from nmpc_codegen.targets import NATIVE
from verification.closed_loop import compile_driver, run_driver
from verification.robustness.work import Loop

RUNS = 5
#: Part of the scale of its cost that a control which crosses its scale in an interval costs, and how often it may: so
#: little, and so often, that the loop stays what it is.
PRICE, FASTEST = 1e-7, 1e3
#: The loops of least-squares problems that are condensed in reasonable time.
CASES = tuple(loop for loop in LOOPS if loop.name in ("crane", "cstr", "quadrotor", "cart_pole", "chain3"))
#: Route -> largest ratio that a penalty may have.
LIMITS = {"dense": 1.1}


def measure(report: Report, asked: Run) -> None:
    """rate_cost, rate_limit: medians of a sample with them over that of the plain problem, native."""
    for loop in asked.cases(CASES):
        for route in ("dense", "stages", "interior point"):
            condensing, qp = ROUTES[route]
            there = replace(loop, options=replace(loop.options, condensing=condensing, qp=qp))
            loops = [there, _with_rates(there, limit=False), _with_rates(there, limit=True)]
            with ExitStack() as stack:
                programs = []
                for each in (for_target(one, NATIVE) for one in loops):
                    folder = Path(stack.enter_context(TemporaryDirectory()))
                    program = compile_driver(package_of(each), module_of(each).name, folder)
                    programs.append(partial(run_driver, program, each.scenario, runs=1, steps=loop.steps // 2))
                plain, *others = (min(t.total for t in times) for times in in_turn(programs, RUNS))
            case, n = f"{loop.name}, {route}", RUNS * loop.steps // 2
            for key, value in zip(("rate_cost", "rate_limit"), others, strict=True):
                limit = LIMITS.get(route) if key == "rate_cost" else None
                report.add(key, value / plain, case=case, n=n, limit=limit, target=NATIVE)


def _with_rates(loop: Loop, limit: bool) -> Loop:
    """The loop with a penalty, or a limit, of the rate of every control."""

    def make() -> OCP:
        ocp = loop.make()
        problem = classify(ocp)
        sizes, fastest = scales(problem), max(1.0 / dt for dt in problem.dt)
        u = sizes.z[problem.nx :]
        if limit:
            ocp.subject_to(-FASTEST * fastest * u, ocp.rate(ocp.u), FASTEST * fastest * u, name="rates")
        else:
            weight = PRICE * sizes.cost / (fastest * u) ** 2
            ocp.least_squares(ocp.rate(ocp.u), weight, names=[f"rate_{j}" for j in range(problem.nu)])
        return ocp

    nu = 0 if limit else int(classify(loop.make()).nu)
    points = tuple((np.concatenate([y, np.zeros(nu)]), y_N) for y, y_N in loop.scenario.set_points)
    return replace(loop, make=make, scenario=replace(loop.scenario, set_points=points))
