"""Bytes of struct, code and stack are measured in single precision on a Cortex-M4F, and operations are counted."""

from __future__ import annotations

import shutil

from benchmarks.lib.firmware.loops import package, with_precision
from benchmarks.lib.firmware.sizes import real_time_stack
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.loops import LOOPS, module_of, package_of
from nmpc_codegen import worst_case
from nmpc_codegen.firmware.certificate import certify
from nmpc_codegen.targets import TARGETS


def sizes(report: Report, asked: Run) -> None:
    """Measure struct, code, stack with the default options and without solve(), -O2; struct in double precision."""
    for loop in asked.cases(LOOPS):
        double = module_of(loop).description.report.ram_bytes
        report.add("struct, double", double, "B", case=loop.name, profile="")
        if shutil.which(f"{TARGETS['cortex-m4f'].compiler}gcc"):
            name, sources = package(loop, with_precision(loop, "single").options)
            found = certify(sources, name, TARGETS["cortex-m4f"])
            report.add("struct", found.struct_bytes, "B", case=loop.name, profile="O2")
            report.add("code", found.flash_bytes, "B", case=loop.name, profile="O2")
            report.add("code, real time", found.flash_bytes_real_time, "B", case=loop.name, profile="O2")
            report.add("stack", found.stack_worst, "B", case=loop.name, profile="O2")
            report.add("stack, real time", real_time_stack(found), "B", case=loop.name, profile="O2")


def counts(report: Report, asked: Run) -> None:
    """Count operations of the linearisation and of the worst sample from the text, and characters."""
    for loop in asked.cases(LOOPS):
        module = module_of(loop)
        stated = module.description.report
        report.add("linearisation", stated.linearization_operations, "operations", case=loop.name, profile="")
        report.add("worst sample", worst_case(package_of(loop))["sample"], "operations", case=loop.name, profile="")
        report.add("source", len(package_of(loop)[f"{module.name}.c"]), "B", case=loop.name, profile="")
