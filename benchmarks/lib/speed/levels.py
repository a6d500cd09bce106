"""Samples that do less: the first part of the feedback phase alone, and preparations that keep what they have."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.loops import LOOPS, for_target, module_of, package_of, with_algorithm
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.targets import NATIVE
from verification.closed_loop import Timing, compile_driver, run_driver
from verification.robustness.work import Loop

ROUNDS = 5


def first_control(report: Report, asked: Run) -> None:
    """feedback_first_us: the first part of the feedback phase, which returns the control of the predicted set."""
    for loop in asked.cases(LOOPS):
        times, target = _timed(with_algorithm(loop, levels=True), "-DFIRST")
        report.add("feedback_first_us", times.feedback, "us", case=loop.name, n=times.samples, limit=0.3, target=target)


def levels(report: Report, asked: Run) -> None:
    """total_b_us, total_c_us, total_d_us: a sample whose preparation keeps derivatives and factors."""
    for loop in asked.cases(LOOPS):
        there = with_algorithm(loop, levels=True)
        for number, level in ((1, "b"), (2, "c"), (3, "d")):
            times, target = _timed(there, f"-DLEVEL={number}")
            report.add(f"total_{level}_us", times.total, "us", case=loop.name, n=times.samples, target=target)


def _timed(loop: Loop, flag: str) -> tuple[Timing, str]:
    sources = package_of(for_target(loop, NATIVE))
    with tempfile.TemporaryDirectory() as folder:
        program = compile_driver(sources, module_of(loop).name, Path(folder), (*PROFILES["fast"].flags, flag))
        return run_driver(program, loop.scenario, runs=ROUNDS, steps=loop.steps), sources.description.target
