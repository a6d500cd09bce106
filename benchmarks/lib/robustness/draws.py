"""Loops that one full step per sample does not bring nearer are compared with solve() in every sample."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import Options
from verification.loops.flights import Judged, judge
from verification.loops.plants import DRAWS, LOOPS, PROBLEMS

#: Options of the host and of a board.
FORMS = {"as built": Options(), "board": Options(target="cortex-m7")}
#: Largest fraction of samples that are not OK, and most QPs per sample.
NOT_OK = 0.05


def measure(report: Report, asked: Run) -> None:
    """Report faults of loops by draw and form."""
    numbers = asked.cases(range(PROBLEMS))
    for form, options in FORMS.items():
        for draw in DRAWS:
            jobs = [(draw, number, LOOPS, options) for number in numbers]
            with ProcessPoolExecutor(2) as pool:
                _report(report, f"{draw}, {form}", list(pool.map(judge, *zip(*jobs, strict=True))))


def _report(report: Report, case: str, found: list[Judged]) -> None:
    """Print the loops with faults by name, and report the figures of all."""
    loops = [(one.name, number, loop) for one in found for number, loop in enumerate(one.loops)]
    for name, number, loop in loops:
        if loop.faults:
            print(f"{case}: {name}/{number}: {'; '.join(loop.faults)}")
    flown = [loop for _, _, loop in loops if loop.counts]
    samples = sum(loop.mine.samples for loop in flown)
    report.add("lost", sum(bool(loop.faults) for loop in flown), "loops", case=case, n=len(flown), limit=0)
    report.add("not_ok", sum(loop.mine.bad for loop in flown) / samples, "share", case=case, n=samples, limit=NOT_OK)
    report.add("iterations", sum(loop.mine.iterations for loop in flown) / len(flown), case=case, n=samples)
