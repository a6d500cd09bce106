"""Instructions of a sample: on this processor without AVX-512, by callgrind; on an emulated Cortex-M4F."""

from __future__ import annotations

import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.lib import callgrind
from benchmarks.lib.firmware.loops import package, recorded, with_precision
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.loops import LOOPS, exported, hosted, module_of
from nmpc_codegen.firmware.targets import TARGETS
from nmpc_codegen.firmware.toolchain import EMULATOR, PREFIX
from nmpc_codegen.firmware.verify import verify
from nmpc_codegen.package.sources import Sources
from verification.closed_loop import compile_driver
from verification.robustness.work import Loop

#: Functions of closed_loop.c between whose entry and return instructions are counted.
PHASES = ("preparation", "feedback_phase")
SAMPLES = 40  # at every scale, as a mean depends on them


def measure(report: Report, _: Run) -> None:
    """exported, native without AVX-512: mean over the samples; M4F: single precision, -O2."""
    forms = {"exported": exported, "native, AVX2": lambda loop: hosted(loop, avx512=False)[0]}
    jobs = [(loop, form, forms[form](loop)) for loop in LOOPS for form in (forms if callgrind.available() else ())]
    with ThreadPoolExecutor(2) as pool:
        counted = pool.map(lambda job: _counted(job[0], job[2]), jobs)
        for (loop, form, _), count in zip(jobs, counted, strict=True):
            if count is not None:
                per_sample = count / SAMPLES
                report.add(form, per_sample, "instructions", case=loop.name, n=SAMPLES, profile=callgrind.MARCH)
    if shutil.which(f"{PREFIX}gcc") and shutil.which(EMULATOR):
        for loop in LOOPS:
            _emulated(report, loop)


def _counted(loop: Loop, sources: Sources) -> int | None:
    with tempfile.TemporaryDirectory() as folder:
        program = compile_driver(sources, module_of(loop).name, Path(folder), callgrind.FLAGS)
        arguments = ["1", str(SAMPLES), *loop.scenario.arguments()]
        return callgrind.instructions(program, arguments, PHASES)


def _emulated(report: Report, loop: Loop) -> None:
    there = with_precision(loop, "single")
    inputs, (name, sources) = recorded(there, SAMPLES), package(loop, there.options)
    found = verify(sources, name, inputs, TARGETS["cortex-m4f"])
    report.add("M4F, median", found.run.median, "instructions", case=loop.name, n=SAMPLES, profile="O2")
    report.add("M4F, worst", found.run.worst, "instructions", case=loop.name, n=SAMPLES, profile="O2")
    report.add("M4F, mismatches", len(found.mismatches), case=loop.name, n=SAMPLES, limit=0, profile="O2")
