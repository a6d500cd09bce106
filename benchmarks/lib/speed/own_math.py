"""math="own": errors of the functions, bits of an emulated target against the host's, times against math.h."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.in_turn import in_turn
from examples import crane, cstr, quadrotor
from nmpc_codegen import Options, generate
from nmpc_codegen.firmware.delivery import record_loop
from nmpc_codegen.firmware.verify import verify
from nmpc_codegen.package.program import OF_TWO
from nmpc_codegen.package.struct_layout import Precision
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.runtime.native import native
from nmpc_codegen.targets import TARGETS
from verification.closed_loop import compile_driver, run_driver
from verification.own_functions import (
    LIMIT,
    SAMPLES,
    SCALAR_ONLY,
    arguments,
    evaluate,
    exact,
    library,
    names,
    pairs,
    ulps,
)
from verification.scenarios import of_sample
from verification.timed import TIMED

BOARDS: tuple[tuple[str, Precision], ...] = (("cortex-m4f", "single"), ("cortex-m7", "double"))
LOOPS = {"crane": crane, "cstr": cstr, "quadrotor": quadrotor}
RATIO_LIMIT = 1.25
RUNS, STEPS = 40, 400


def measure(report: Report, asked: Run) -> None:
    """math_ulp, math_host_target_mismatches, own_math_ratio."""
    for precision in asked.cases(("double", "single")):
        for profile in asked.cases(("fast", "verify")):
            errors(report, precision == "single", profile, asked.share(SAMPLES, 100))
    bits(report, asked)
    times(report, asked)


def errors(report: Report, single: bool, profile: str, samples: int) -> None:
    """Every function, one number at a time and in lanes, with and without contraction."""
    dtype, avx512 = np.float32 if single else np.float64, native().avx512 and profile == "fast"
    with tempfile.TemporaryDirectory() as folder:
        loaded = library(Path(folder), single, 8, avx512, (*PROFILES[profile].flags, *native().of_machine))
        for name in names():
            random = np.random.default_rng(1)
            x, y = pairs(dtype, random, samples) if name in OF_TWO else (arguments(dtype, random, samples),) * 2
            values = exact(name, x, y)
            for lanes, prefix in ((1, "own"), (8, "lanes")):
                if lanes > 1 and name in SCALAR_ONLY:
                    continue
                worst = ulps(evaluate(loaded, f"{prefix}_{name}", x, y), values).max()
                case = f"{name}, {'single' if single else 'double'}"
                report.add("math_ulp", worst, "ulp", case=case, n=x.size, limit=LIMIT, profile=profile, target=prefix)


def bits(report: Report, asked: Run) -> None:
    """Samples of closed loops whose controls on the emulated board differ in a bit; absent without its tools."""
    m4f = TARGETS["cortex-m4f"]
    if shutil.which(f"{m4f.compiler}gcc") is None or shutil.which(m4f.emulator[0]) is None:
        print("math_host_target_mismatches: there is no ARM compiler or no emulator")
        return
    for name, example in asked.cases(LOOPS.items()):
        for board, precision in asked.cases(BOARDS):
            sources = generate(example.build_ocp(), Options(math="own", precision=precision, target=board))
            verdict = verify(sources, name, record_loop(sources, name), TARGETS[board])
            case = f"{name} on {board}"
            report.add(
                "math_host_target_mismatches", verdict.bits, case=case, n=verdict.samples, limit=0, profile="verify"
            )


def times(report: Report, asked: Run) -> None:
    """A real-time iteration of portable C with its own functions over one with those of math.h, in turn."""
    runs, steps = asked.share(RUNS, 2), asked.share(STEPS, 20)
    for sample in asked.cases(TIMED):
        prefix = sample.make().name
        options = sample.options or Options()
        with ExitStack() as stack:
            folders = [Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(2)]
            pair = [generate(sample.make(), replace(options, math=math)) for math in ("libm", "own")]
            programs = [compile_driver(files, prefix, folder) for files, folder in zip(pair, folders, strict=True)]
            scenario = of_sample(sample)
            loops = [partial(run_driver, program, scenario, runs=1, steps=steps) for program in programs]
            found = in_turn(loops, runs)
        libm, own = (min(t.total for t in timings) for timings in found)
        report.add("own_math_ratio", own / libm, "to libm", case=prefix, limit=RATIO_LIMIT, n=runs * steps)
