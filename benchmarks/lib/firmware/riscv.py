"""Packages for the target riscv32 are measured: flash memory, and functions that they need besides math.h."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.lib.firmware.loops import loops, package, small
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen.firmware.certificate import measure
from nmpc_codegen.firmware.toolchain import LEVELS
from nmpc_codegen.targets import TARGETS
from verification.quality import ALLOWED


def cores(report: Report, asked: Run) -> None:
    """Measure the small controllers of all loops; the certificate includes linking them."""
    target = TARGETS["riscv32"]
    for loop in asked.cases(loops()):
        name, sources = package(loop, replace(small(loop), target=target.name))
        found = {level: measure(sources, name, target, level) for level in LEVELS}
        for level, certificate in found.items():
            foreign = sorted(set(certificate.math_functions) - ALLOWED)
            case = f"{loop.name}, small, -{level}" + (f": {', '.join(foreign)}" if foreign else "")
            report.add("riscv_foreign_functions", len(foreign), case=case, limit=0, profile=level, target=target.name)
        best = min(found, key=lambda level: found[level].flash_bytes)
        flash, case = found[best].flash_bytes, f"{loop.name}, small, -{best}"
        report.add(f"{loop.name}_flash_bytes_riscv", flash, "B", case=case, profile=best, target=target.name)
