"""Do gcc and clang, from -O0 to -O3, produce the same controller? All builds receive the recorded samples of one run.

The other flags are those of the profile "fast": products and sums may be contracted, so that rounding differs between
the builds. The figure shows differences beyond rounding.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.lib import scenarios
from benchmarks.lib.closed_loop import Scenario, disturbed
from benchmarks.lib.house.ratios import scenario_of
from benchmarks.lib.house.timed import TIMED, Sample
from benchmarks.lib.quality import package_name, written
from benchmarks.lib.report import Report
from nmpc_codegen import Controller, build, generate
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.lowering.render import Sources
from nmpc_codegen.runtime.build import PROFILES

DRIVER = Path(__file__).with_name("replay.c")
COMPILERS = ("gcc", "clang")
FLAGS = ("-std=c99", *(flag for flag in PROFILES["fast"].flags if not flag.startswith("-O")))
LEVELS = ("-O0", "-O1", "-O2", "-O3")
LIMIT = 1e-9
SAMPLES = 100
JOBS = 2
#: All examples, each in the setting in which it is timed.
CASES = (*TIMED, Sample("timed cart_pole", scenarios.CART_POLE.make, scenarios.CART_POLE.options))


def measure(report: Report, cases: Sequence[Sample] = CASES, n: int = SAMPLES) -> None:
    """compiler_disagreement: difference of the controls from those of gcc -O0, over the largest value of each control.

    compiler_disagreement_status: samples whose status differs. Absent without both compilers.
    """
    if any(shutil.which(compiler) is None for compiler in COMPILERS):
        print("compiler_disagreement: absent, it needs gcc and clang")
        return
    for sample in cases:
        x = record(build(sample.make(), sample.options), scenario_of(sample), n)
        u, status = replays(generate(sample.make(), sample.options), x)
        case = sample.name.removeprefix("timed ")
        report.add("compiler_disagreement", disagreement(u), case=case, limit=LIMIT, n=u.shape[1], profile="gcc, clang")
        differ = int(np.count_nonzero(np.any(status != status[0], axis=0)))
        report.add("compiler_disagreement_status", differ, "samples", case=case, limit=0, n=n, profile="gcc, clang")


def disagreement(u: Array) -> float:
    """max |u - u_0| / max |u_0| per control over (builds, samples, nu); NaN if a control is not finite."""
    scale = np.maximum(np.max(np.abs(u[0]), axis=0), np.finfo(float).tiny)
    return float(np.max(np.abs(u - u[0]) / scale))


def record(controller: Controller, scenario: Scenario, n: int) -> Array:
    """(n, nx): measured states of a closed loop under the declared reference, with the events of the scenario."""
    random = np.random.default_rng(1)
    x, found = np.array(scenario.x0, dtype=float), []
    for k in range(n):
        if k % scenario.period == 0:
            x = disturbed(scenario, x, random, controller.integrate)
        found.append(x)
        x = np.asarray(controller.integrate(x, controller.step(x), scenario.dt))
    return np.array(found)


def replays(
    sources: Sources, x: Array, builds: Sequence[tuple[str, str]] = tuple(product(COMPILERS, LEVELS))
) -> tuple[Array, Array]:
    """Controls (builds, samples, nu) and status (builds, samples) of every build (compiler, level), gcc -O0 first."""
    name = package_name(sources)
    text = "\n".join(" ".join(repr(float(v)) for v in row) for row in x)
    with written(sources) as folder, ThreadPoolExecutor(JOBS) as pool:

        def replay(which: tuple[str, str]) -> Array:
            with tempfile.TemporaryDirectory() as program:
                command = [*which, *FLAGS, f"-DNAME={name}", f"-DMACRO={name.upper()}", f'-DPACKAGE="{name}.c"']
                command += [f"-I{folder}", str(DRIVER), "-o", f"{program}/replay", "-lm"]
                subprocess.run(command, check=True)
                done = subprocess.run([f"{program}/replay"], input=text, capture_output=True, text=True, check=True)
            return np.array([[float(v) for v in line.split()] for line in done.stdout.splitlines()])

        found = np.array(list(pool.map(replay, builds)))
    return found[:, :, 1:], found[:, :, 0]
