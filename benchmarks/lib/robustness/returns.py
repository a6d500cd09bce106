"""The contract of a return under hostile data: controls outside of their bounds, unknown statuses."""

from __future__ import annotations

import math
from collections import Counter

from benchmarks.lib.report import Report
from nmpc_codegen import Status
from verification.robustness.returns import KNOWN, RETURNS, Outcome, run
from verification.robustness.subjects import Candidate, augmented, candidates, in_processes, shooting


def measure(report: Report, scale: float = 1.0) -> None:
    """All controllers take the same share."""
    chosen = (*candidates(), *augmented(), *shooting())
    count = math.ceil(RETURNS * scale / len(chosen))
    report_outcomes(report, chosen, in_processes(run, chosen, count), scale)


def report_outcomes(report: Report, chosen: tuple[Candidate, ...], outcomes: list[Outcome], scale: float) -> None:
    """Sums, and a line for every violation."""
    total = sum(o.returns for o in outcomes)
    report.add("hostile_returns", total, limit=RETURNS * scale, at_least=True)
    report.add("hostile_problems", len({c.subject.name for c in chosen}), limit=11, at_least=True)
    count = sum(sum(o.violations.values()) for o in outcomes)
    report.add("contract_violations", count, case="all", n=total, limit=0)
    for candidate, out in zip(chosen, outcomes, strict=True):
        for what, n in out.violations.items():
            case = f"{candidate}: {what}; {out.first[what]}"
            report.add("contract_violations", n, case=case, n=out.returns, limit=0)
    every: Counter[int] = Counter()
    for out in outcomes:
        every += out.status
    for status, n in sorted(every.items()):
        name = Status(status).name if status in KNOWN else str(status)
        report.add("hostile_status_share", n / total, case=name, n=total)
