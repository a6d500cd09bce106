"""Implicit schemes are measured: distance from IPOPT's optima, closed loops, and computing time against RK4."""

from __future__ import annotations

import subprocess
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.lib import callgrind
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from examples import chain, crane, quadrotor
from nmpc_codegen import OCP, RK4, SDIRK3, Controller, ExplicitRungeKutta, ImplicitRungeKutta, Options, build, generate
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.package.sources import Sources
from verification import stiff
from verification.quality import compile_c, package_name, written
from verification.stiff import Moving, Stiff

#: Largest distance from optima.
OPTIMUM = 1e-8
#: Loops of a problem; least ratio of explicit to implicit time at equal accuracy; most bytes of code.
LOOPS, FASTER, CODE = 20, 25.0, 100_000
#: Number of timed calls of a step.
CALLS = 400


def measure(report: Report, asked: Run) -> None:
    """Measure all figures, with a line per problem."""
    for name in asked.cases(stiff.PROBLEMS):
        case = stiff.PROBLEMS[name]
        optimum(report, name, case)
        loops(report, name, case, stiff.Plant(case.make()), asked.share(LOOPS, 3))
    _reactor(report, asked.share(CALLS, 20))
    ocps: dict[str, Callable[[], OCP]] = {
        "crane": crane.build_ocp,
        "chain3": lambda: chain.build_ocp(3),
        "quadrotor": quadrotor.build_ocp,
    }
    for name in asked.cases(ocps):
        _beside_rk4(report, name, ocps[name])


# -- problems ---------------------------------------------------------------------------------------------------------


def optimum(report: Report, name: str, case: Stiff, options: Options | None = None, figure: str = "optimum") -> None:
    """Report the distance from IPOPT's optimum of the same discretisation."""
    error, iterations = stiff.distance_from_optimum(case, options, "fast")
    report.add(figure, error, case=name, limit=OPTIMUM)
    report.add(f"{figure}, iterations", iterations, case=name)


def loops(report: Report, name: str, case: Stiff, plant: Moving, count: int) -> None:
    """Report closed loops with default options."""
    ctrl = stiff.controller(case)
    found = [stiff.run(case, ctrl, plant, seed) for seed in range(count)]
    for outcome in found:
        if outcome.lost:
            print(f"{name}: {outcome.lost}")
    samples = count * case.samples
    report.add("loops lost", sum(bool(outcome.lost) for outcome in found), case=name, n=count, limit=0)
    report.add("not OK", samples - sum(o.statuses["OK"] for o in found), case=name, n=samples)


def _reactor(report: Report, calls: int) -> None:
    """Report the time of a sample with the default scheme against RK4 with as many steps as it needs, and the code.

    Both have a Gauss-Newton Hessian and the same QP solver.
    """
    ocp = stiff.reactor()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        explicit = build(ocp, Options(integrator=ExplicitRungeKutta(RK4, steps=1600), solve=False), "fast")
    implicit = build(ocp, Options(solve=False), "fast")
    x = classify(ocp).x_initial
    slow, fast = _time(explicit, x, max(5, calls // 20)), _time(implicit, x, calls)
    report.add("sample", fast, "us", case="reactor", n=calls)
    report.add("explicit over implicit", slow / fast, case="reactor", limit=FASTER, at_least=True)
    report.add("code", code_bytes(generate(ocp)), "B", case="reactor", limit=CODE)


def _time(ctrl: Controller, x: Array, calls: int) -> float:
    """Return the median time of a step (us)."""
    found = []
    for _ in range(calls):
        start = time.perf_counter()
        ctrl.step(x)
        found.append((time.perf_counter() - start) * 1e6)
    return float(np.median(found))


def code_bytes(sources: Sources) -> float:
    """Return the bytes of code and constants, -O2."""
    with written(sources) as folder:
        compile_c(folder, "-std=c99", "-O2", "-c", f"{package_name(sources)}.c", "-o", "unit.o")
        text = subprocess.run(["size", str(folder / "unit.o")], capture_output=True, text=True, check=True).stdout
    return float(text.splitlines()[1].split()[0])


# -- beside RK4 -------------------------------------------------------------------------------------------------------

_DRIVER = """#include "{name}.h"
static {name}_solver_t s;
static {name}_real x[{NAME}_NX], u[{NAME}_NU];
static volatile int status;
__attribute__((noinline)) void sample(void) {{ status = {name}_step(&s, x, u); }}
int main(void)
{{
    {name}_init(&s);
    for (int i = 0; i < {NAME}_NX; i++) {{
        x[i] = s.x[0][i];
    }}
    for (int n = 0; n < 20; n++) {{
        sample();
    }}
    return 0;
}}
"""


def _beside_rk4(report: Report, name: str, make: Callable[[], OCP]) -> None:
    """Report operations of an interval, code and instructions of a sample, of SDIRK3 and of RK4 with one step."""
    given = Options(solve=False)
    for scheme, integrator in (("RK4", ExplicitRungeKutta(RK4, 1)), ("SDIRK3", ImplicitRungeKutta(SDIRK3, 1, 2))):
        sources = generate(make(), replace(given, integrator=integrator))
        operations = sources.description.report.operations["integrator_interval"].total
        report.add(f"interval, {scheme}", operations, "operations", case=name)
        report.add(f"code, {scheme}", code_bytes(sources), "B", case=name)
        if callgrind.available():
            with written(sources) as folder:
                count = callgrind.instructions(_driver(sources, folder), [], ["sample"])
            if count is not None:
                report.add(f"sample, {scheme}", count / 20, "instructions", case=name)


def _driver(sources: Sources, folder: Path) -> Path:
    name = package_name(sources)
    (folder / "driver.c").write_text(_DRIVER.format(name=name, NAME=name.upper()), encoding="utf-8")
    compile_c(folder, "-std=gnu99", "-O2", "driver.c", f"{name}.c", "-o", "driver", "-lm")
    return folder / "driver"
