"""Controllers that do not recover from one bad datum are counted."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from verification.robustness.episodes import EPISODES, Outcome, run
from verification.robustness.subjects import Candidate, candidates, in_processes

LEAST = 8  # controllers


def measure(report: Report, asked: Run) -> None:
    """Measure all controllers with the same number of episodes; at a small scale some of them are drawn."""
    chosen = asked.some(candidates(), LEAST)
    count = max(1, math.ceil(1.05 * EPISODES * asked.scale / len(chosen)))
    report_outcomes(report, [c for _, c in chosen], in_processes(run, chosen, count))


def report_outcomes(report: Report, chosen: list[Candidate], outcomes: list[Outcome]) -> None:
    """Report sums, and one line per controller that did not recover or found another solution."""
    total = sum(o.episodes for o in outcomes)
    report.add("controllers", len(chosen), case="all")
    report.add("episodes", total, case="all")
    report.add("compared", sum(o.compared for o in outcomes), case="all", n=total)
    report.add("lock-ups", sum(o.lockups for o in outcomes), case="all", n=total, limit=0)
    report.add("other solutions", sum(len(o.other_solutions) for o in outcomes), case="all", n=total)
    every: dict[str, list[int]] = {}
    for candidate, out in zip(chosen, outcomes, strict=True):
        for kind, samples in out.recovery.items():
            every.setdefault(kind, []).extend(samples)
        if out.lockups or out.other_solutions:
            report.add("episodes", out.episodes, case=str(candidate))
            report.add("lock-ups", out.lockups, case=str(candidate), n=out.episodes, limit=0)
            report.add("other solutions", len(out.other_solutions), case=str(candidate), n=out.episodes)
        for line in out.examples[:2]:
            print(f'--replay "{candidate}/{line.partition(",")[0]}": {line.partition(", ")[2]}')
    if not every:
        return
    slowest = max(every, key=lambda kind: np.percentile(every[kind], 99))
    samples = float(np.percentile(every[slowest], 99))
    report.add("99 % are back after", samples, "samples", case="all", n=len(every[slowest]))
