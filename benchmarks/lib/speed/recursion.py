"""riccati_peak_fraction_<nx>: rate of the factorisation on stages as a fraction of the measured peak of one core."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

from benchmarks.lib.report import Report
from benchmarks.lib.speed.loops import LOOPS, Loop, units
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.runtime.build import PROFILES, find_compiler, host
from verification.closed_loop import compile_driver, pinned_core

HERE = Path(__file__).parent
#: Example -> least fraction.
LIMITS = {"chain3": None, "chain5": 0.35, "chain7": 0.4}


def printed(command: list[str]) -> float:
    """The first number that a program prints, run on the core of all timings."""
    core = pinned_core()
    run = subprocess.run(
        command, check=True, capture_output=True, text=True, preexec_fn=lambda: os.sched_setaffinity(0, core)
    )
    return float(run.stdout.split()[0])


def peak_gflops() -> float:
    """Largest rate of multiplications and additions in the widest vectors of this processor."""
    width = 64 if host(None, "fast").avx512 else 32
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder, "peak")
        command = [*find_compiler(), *PROFILES["fast"].flags, f"-DBYTES={width}", str(HERE / "peak.c")]
        subprocess.run([*command, "-o", str(program)], check=True)
        return printed([str(program)])


def stage_operations(n: int, m: int) -> float:
    """Operations of one stage that makes use of symmetry: P S, S'(P S), L D L' of the controls, K, the new P."""
    product = 2 * n * n * (n + m)
    square = n * (n + m) * (n + m + 1)
    return product + square + m**3 / 3 + m * m * n + n * (n + 1) * m


def factorisation_us(loop: Loop) -> tuple[float, int]:
    """Time of one factorisation in the unit for this processor, and its lanes."""
    prefix, _, hosted, lanes = units(loop)
    with tempfile.TemporaryDirectory() as folder:
        program = compile_driver(hosted, prefix, Path(folder), driver=HERE / "recursion.c")
        return printed([str(program), *(repr(float(v)) for v in loop.scenario.x0)]), lanes


def measure(report: Report) -> None:
    """Times, rates and fractions of the chains."""
    peak = peak_gflops()
    report.add("peak_gflops", peak, "Gflop/s")
    for loop in LOOPS:
        if loop.name not in LIMITS:
            continue
        problem = classify(loop.make())
        time, lanes = factorisation_us(loop)
        rate = 1e-3 * problem.N * stage_operations(problem.nx, problem.nu) / time
        report.add(f"riccati_factorisation_us_{problem.nx}", time, "us", case=loop.name, n=400, lanes=lanes)
        report.add(f"riccati_gflops_{problem.nx}", rate, "Gflop/s", case=loop.name, n=400, lanes=lanes)
        report.add(
            f"riccati_peak_fraction_{problem.nx}",
            rate / peak,
            case=loop.name,
            n=400,
            limit=LIMITS[loop.name],
            at_least=True,
            lanes=lanes,
        )
