"""Returns under hostile data are checked: controls outside of their bounds, unknown statuses."""

from __future__ import annotations

import math
from collections import Counter

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import Status
from verification.robustness.returns import RETURNS, Outcome, run
from verification.robustness.subjects import Candidate, augmented, candidates, in_processes, shooting

LEAST = 8  # controllers


def measure(report: Report, asked: Run) -> None:
    """Measure all controllers with the same number of returns; at a small scale some of them are drawn."""
    chosen = asked.some([*candidates(), *augmented(), *shooting()], LEAST)
    count = max(1, math.ceil(RETURNS * asked.scale / len(chosen)))
    report_outcomes(report, [c for _, c in chosen], in_processes(run, chosen, count))


def report_outcomes(report: Report, chosen: list[Candidate], outcomes: list[Outcome]) -> None:
    """Report sums, and a line for every violation."""
    total = sum(o.returns for o in outcomes)
    report.add("controllers", len(chosen), case="all")
    report.add("returns", total, case="all")
    count = sum(sum(o.violations.values()) for o in outcomes)
    report.add("violations", count, case="all", n=total, limit=0)
    every: Counter[int] = Counter()
    for candidate, out in zip(chosen, outcomes, strict=True):
        every += out.status
        for what, n in out.violations.items():
            case = f"{candidate}: {what}; {out.first[what]}"
            report.add("violations", n, case=case, n=out.returns, limit=0)
    report.add("OK", every[int(Status.OK)] / total, "share", case="all", n=total)
