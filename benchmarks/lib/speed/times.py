"""Times of a sample and of its feedback phase are measured in the three forms of programs.py, and against peers.

Total and feedback: minimum over the rounds of the median over the steps. Worst: the same of the largest total of a
step, where the total of a step is its minimum over the runs of a round, which are all alike. The ratio to the best peer
compares with a figure of another machine; both are divided by the time of the reference kernel on their machine.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.in_turn import in_turn
from benchmarks.lib.speed.loops import LOOPS
from benchmarks.lib.speed.programs import Program, compile_programs
from benchmarks.lib.speed.reference import REFERENCE, reference_kernel_us
from verification.closed_loop import Timing

#: Least total (us) of ACADO and acados, whatever their options, in the closed loops of this page: with disturbances, on
#: the machine of REFERENCE, gcc 12 -O3 -march=native. Nobody has measured the cart-pole.
PEERS = {
    "crane": 5.2,
    "cstr": 11.0,
    "bioreactor": 59.7,
    "quadrotor": 70.9,
    "chain3": 128.0,
    "chain5": 375.0,
    "chain7": 836.0,
    "chain5_N160": 2107.0,
}
ROUNDS, LEAST = 20, 5  # rounds at scale 1, and least number of rounds
KERNEL = "reference kernel"


def measure(report: Report, run: Run) -> None:
    """Measure total, feedback, worst/median, peers, failed, QP iterations of every loop in every form.

    A round runs all programs once, so that a slow minute of the machine affects some rounds of every program.
    """
    theirs = {program.case: program for program in run.base_programs}
    with tempfile.TemporaryDirectory() as folder:
        ours = compile_programs(Path(folder), run.cases(LOOPS))
        programs = [p for one in ours for p in (one, theirs.get(one.case)) if p is not None]
        kernels: list[float] = []
        calls = [program.run for program in programs]
        found = in_turn(calls, run.share(ROUNDS, LEAST), lambda: kernels.append(reference_kernel_us()))
    reference, times = min(kernels), dict(zip(map(id, programs), found, strict=True))
    report.add("total", reference, "us", case=KERNEL, n=len(kernels))
    if known := report.baseline.values.get(f"{report.topic}/{KERNEL}/total"):
        report.baseline.carry(reference / known)
    before = Report()
    before.topic = report.topic
    for program in ours:
        _add(report, program, times[id(program)], reference)
        if program.case in theirs:
            _add(before, program, times[id(theirs[program.case])], reference)
    report.baseline.take(before.records)


def _add(report: Report, program: Program, times: list[Timing], reference: float) -> None:
    case, n, target = program.case, sum(t.samples for t in times), program.target
    total, feedback = min(t.total for t in times), min(t.feedback for t in times)
    report.add("total", total, "us", case=case, n=n, target=target)
    report.add("feedback", feedback, "us", case=case, n=n, target=target)
    report.add("worst/median", min(t.worst for t in times) / total, case=case, n=n, target=target)
    if program.loop in PEERS:
        ratio = total * REFERENCE / reference / PEERS[program.loop]
        report.add("to best peer", ratio, case=case, n=n, target=target)
    report.add("failed", max(t.failed for t in times), "steps", case=case, n=n, target=target)
    report.add("QP iterations", times[0].qp_iterations, "per step", case=case, n=n, target=target)
    report.add("most QP iterations", times[0].qp_iterations_max, "per step", case=case, n=n, target=target)
