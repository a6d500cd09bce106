"""Replays on the boards are compared with the host and the certificates: controls, stack, instructions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.lib.firmware.loops import SAMPLES, loops, package, recorded, with_precision
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import worst_case
from nmpc_codegen.firmware.certificate import Certificate, certify
from nmpc_codegen.firmware.verify import Verdict, verify
from nmpc_codegen.options import Precision
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.targets import TARGETS
from verification.counting import count_mismatches
from verification.robustness.work import Loop, count, record

BOARDS: tuple[tuple[str, Precision], ...] = (("cortex-m4f", "single"), ("cortex-m7", "double"))

#: Loop -> limit on its median instructions in single precision.
INSTRUCTIONS = {"crane": 30_000, "quadrotor": 900_000}

#: Loops whose functions are counted one by one; the functions of an exact Hessian cannot be called that way.
COUNTED = ("crane", "cstr", "quadrotor", "cart_pole", "chain3")


def boards(report: Report, asked: Run) -> None:
    """Measure every loop on both boards."""
    samples = asked.share(SAMPLES, 20)
    for loop in asked.cases(loops()):
        for board, precision in asked.cases(BOARDS):
            one(report, with_precision(loop, precision), board, samples)


def one(report: Report, loop: Loop, board: str, samples: int) -> None:
    """Measure a loop on a board."""
    target = TARGETS[board]
    inputs, (name, sources) = recorded(loop, samples), package(loop, loop.options)
    certificate = certify(sources, name, target)
    verdict = verify(sources, name, inputs, target, "O2", certificate.stack_worst)
    case = f"{loop.name} on {board}"
    error = f"{case}: largest difference {verdict.error:.1e} of the range, {verdict.statuses} statuses"
    report.add("emulator_mismatches", len(verdict.mismatches), case=error, n=samples, limit=0, profile="verify")
    report.add("libm_bit_mismatches", verdict.bits, case=case, n=samples, profile="verify")
    failed = int(np.sum(inputs.status != 0))
    report.add("recorded_not_ok", failed, case=case, n=samples, profile="verify")
    stack(report, certificate, verdict, case)
    mismatches(report, certificate, sources[f"{name}.json"], case)
    instructions(report, loop, verdict, board)


def bits(report: Report, asked: Run) -> None:
    """Compare controls with the host bit for bit, on both boards with the package's elementary functions."""
    samples = asked.share(SAMPLES, 20)
    for loop in asked.cases(loops()):
        for board, precision in asked.cases(BOARDS):
            there = with_precision(loop, precision)
            own = replace(there, options=replace(there.options, math="own"))
            inputs, (name, sources) = recorded(own, samples), package(own, own.options)
            verdict = verify(sources, name, inputs, TARGETS[board], "O2")
            other = verdict.bits + verdict.statuses
            report.add("bit_mismatches", other, case=f"{loop.name} on {board}", n=samples, limit=0, profile="verify")


def stack(report: Report, certificate: Certificate, verdict: Verdict, case: str) -> None:
    """Compare the painted stack of all entry points with the certificate."""
    used = verdict.run.stack
    over = [entry for entry, size in used.items() if size > certificate.stack_bytes[entry]]
    note = f"{case}: {', '.join(over)}" if over else case
    report.add("stack_violations", len(over), case=note, n=len(used), limit=0, profile="verify")
    tightest = max(used, key=lambda entry: used[entry])
    ratio = certificate.stack_bytes[tightest] / used[tightest]
    report.add("stack_certified_over_painted", ratio, case=f"{case}: {tightest}", profile="verify")


def mismatches(report: Report, certificate: Certificate, description: str, case: str) -> None:
    """Compare the struct of the certificate with the description."""
    stated = PackageDescription.from_json(description)
    wrong = certificate.struct_bytes != stated.dtype().itemsize
    wrong += certificate.struct_bytes != stated.report.ram_bytes
    wrong += bool(certificate.double_functions) and certificate.precision == "single"
    report.add("certificate_mismatches", int(wrong), case=case, n=3, limit=0, profile="verify")


def instructions(report: Report, loop: Loop, verdict: Verdict, board: str) -> None:
    """Report median and worst instructions of a sample, with the default options."""
    precision = "" if board == "cortex-m4f" else "_double"
    run, limit = verdict.run, INSTRUCTIONS.get(loop.name) if not precision else None
    key, note = f"{loop.name}_instructions{precision}", f"{board} -O2, emulated, default options"
    report.add(key, run.median, "instructions", case=note, n=verdict.samples, limit=limit, profile="verify")
    report.add(f"{key}_worst", run.worst, "instructions", case=note, n=verdict.samples, profile="verify")


def counts(report: Report, asked: Run) -> None:
    """Compare the operations of certificates: every function's with a count, every sample's with the worst case."""
    samples = asked.share(SAMPLES, 20)
    for loop in asked.cases(loops()):
        if loop.name in COUNTED:
            wrong, case = count_mismatches(loop.make(), loop.options), f"{loop.name}: operations"
            report.add("certificate_mismatches", len(wrong), case=case, limit=0, profile="counted")
        stated = worst_case(package(loop, loop.options)[1])["sample"]
        (found,) = count(loop, record(loop, samples, []))
        case = f"{loop.name}: stated {stated:,}, worst seen {found.every.max():,.0f}"
        over = int(np.sum(found.every > stated))
        report.add("worst_case_exceeded", over, case=case, n=samples, limit=0, profile="counted")
