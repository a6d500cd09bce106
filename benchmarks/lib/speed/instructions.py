"""Instructions of a sample are counted: here without AVX-512 by callgrind, and on an emulated Cortex-M4F."""

from __future__ import annotations

import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.lib import callgrind
from benchmarks.lib.firmware.loops import package, recorded, with_precision
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.loops import LOOPS, module_of, package_of, without_avx512
from nmpc_codegen.firmware.verify import verify
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.runtime.native import runs
from nmpc_codegen.targets import TARGETS
from verification.closed_loop import compile_driver
from verification.robustness.work import Loop

M4F, AVX2 = TARGETS["cortex-m4f"], TARGETS["x86-64-v3"]
#: Portable C as build() compiles it, and this machine's target, both without instructions unknown to valgrind.
AS_BUILT, OF_NATIVE = "as built, AVX2", "native, AVX2"
SAMPLES = 40  # at every scale, as the mean depends on this number


def measure(report: Report, asked: Run) -> None:
    """Measure the mean instructions over the samples.

    Forms are portable C, portable and native C without AVX-512, and the M4F in single precision with -O2.
    """
    forms = ("portable", *([AS_BUILT] if runs(AVX2) else ()), OF_NATIVE) if callgrind.available() else ()
    loops = [(loop, form) for loop in asked.cases(LOOPS) for form in forms]
    jobs = [(loop, form, package_of(without_avx512(loop) if form == OF_NATIVE else loop)) for loop, form in loops]
    with ThreadPoolExecutor(2) as pool:
        counted = pool.map(lambda job: _counted(*job), jobs)
        for (loop, form, sources), count in zip(jobs, counted, strict=True):
            if count is not None:
                per_sample = count / SAMPLES
                report.add(
                    form, per_sample, "instructions", case=loop.name, n=SAMPLES, target=sources.description.target
                )
    if all(shutil.which(tool) for tool in (f"{M4F.compiler}gcc", M4F.emulator[0])):
        for loop in asked.cases(LOOPS):
            _emulated(report, loop)


def _counted(loop: Loop, form: str, sources: Sources) -> int | None:
    flags = (*PROFILES["fast"].flags, *(AVX2.flags if form == AS_BUILT else ()))
    with tempfile.TemporaryDirectory() as folder:
        program = compile_driver(sources, module_of(loop).name, Path(folder), flags)
        arguments = ["1", str(SAMPLES), *loop.scenario.arguments()]
        return callgrind.instructions(program, arguments, callgrind.PHASES)


def _emulated(report: Report, loop: Loop) -> None:
    there = with_precision(loop, "single")
    inputs, (name, sources) = recorded(there, SAMPLES), package(loop, there.options)
    found = verify(sources, name, inputs, M4F)
    report.add("M4F, median", found.run.median, "instructions", case=loop.name, n=SAMPLES, profile="O2")
    report.add("M4F, worst", found.run.worst, "instructions", case=loop.name, n=SAMPLES, profile="O2")
    report.add("M4F, mismatches", len(found.mismatches), case=loop.name, n=SAMPLES, limit=0, profile="O2")
