"""Instructions of a sample: on this processor without AVX-512, by callgrind; on an emulated Cortex-M4F."""

from __future__ import annotations

import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.lib import callgrind
from benchmarks.lib.firmware.loops import recorded
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.loops import LOOPS, Loop, exported, hosted, module_of, on_target
from nmpc_codegen.firmware.targets import TARGETS
from nmpc_codegen.firmware.toolchain import EMULATOR, PREFIX
from nmpc_codegen.firmware.verify import verify
from nmpc_codegen.lowering.render import Sources
from verification.closed_loop import compile_driver
from verification.robustness.work import Loop as Recordable

#: Functions of closed_loop.c between whose entry and return instructions are counted.
PHASES = ("preparation", "feedback_phase")
SAMPLES = 200  # at scale 1


def measure(report: Report, run: Run) -> None:
    """exported, native without AVX-512: mean over the samples; M4F: single precision, -O2."""
    samples = run.share(SAMPLES, 30)
    forms = {"exported": exported, "native, AVX2": lambda loop: hosted(loop, avx512=False)[0]}
    jobs = [(loop, form, forms[form](loop)) for loop in LOOPS for form in (forms if callgrind.available() else ())]
    with ThreadPoolExecutor(2) as pool:
        counted = pool.map(lambda job: _counted(job[0], job[2], samples), jobs)
        for (loop, form, _), count in zip(jobs, counted, strict=True):
            if count is not None:
                per_sample = count / samples
                report.add(form, per_sample, "instructions", case=loop.name, n=samples, profile=callgrind.MARCH)
    if shutil.which(f"{PREFIX}gcc") and shutil.which(EMULATOR):
        for loop in LOOPS:
            _emulated(report, loop, samples)


def _counted(loop: Loop, sources: Sources, samples: int) -> int | None:
    with tempfile.TemporaryDirectory() as folder:
        program = compile_driver(sources, module_of(loop).name, Path(folder), callgrind.FLAGS)
        arguments = ["1", str(samples), *loop.scenario().arguments()]
        return callgrind.instructions(program, arguments, PHASES)


def _emulated(report: Report, loop: Loop, samples: int) -> None:
    there = on_target(loop)
    inputs = recorded(Recordable(loop.name, loop.make, there.options, loop.scenario()), samples)
    found = verify(exported(there), module_of(there).name, inputs, TARGETS["cortex-m4f"])
    report.add("M4F, median", found.run.median, "instructions", case=loop.name, n=samples, profile="O2")
    report.add("M4F, worst", found.run.worst, "instructions", case=loop.name, n=samples, profile="O2")
    report.add("M4F, mismatches", len(found.mismatches), case=loop.name, n=samples, limit=0, profile="O2")
