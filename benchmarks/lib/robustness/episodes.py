"""One bad datum, then good ones: controllers that do not find back."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.lib.report import Report
from verification.robustness.episodes import EPISODES, Outcome, run
from verification.robustness.subjects import Candidate, candidates, in_processes


def measure(report: Report, scale: float = 1.0) -> None:
    """All controllers take the same share."""
    chosen = candidates()
    count = math.ceil(1.05 * EPISODES * scale / len(chosen))
    report_outcomes(report, chosen, in_processes(run, chosen, count), scale)


def report_outcomes(report: Report, chosen: tuple[Candidate, ...], outcomes: list[Outcome], scale: float) -> None:
    """Sums, and one line per controller."""
    total = sum(o.episodes for o in outcomes)
    report.add("episodes", total, limit=EPISODES * scale, at_least=True)
    report.add("episodes_compared", sum(o.compared for o in outcomes), n=total)
    report.add("lockups", sum(o.lockups for o in outcomes), case="all", n=total, limit=0)
    report.add("other_solutions", sum(len(o.other_solutions) for o in outcomes), case="all", n=total)
    every: dict[str, list[int]] = {}
    for candidate, out in zip(chosen, outcomes, strict=True):
        kinds = [f"{n} {kind} never OK" for kind, n in sorted(out.never_ok.items())]
        kinds += [f"{n} {kind} elsewhere" for kind, n in sorted(out.elsewhere.items())]
        case = ": ".join([str(candidate), ", ".join(kinds)]) if kinds else str(candidate)
        report.add("lockups", out.lockups, case=case, n=out.episodes, limit=0)
        for line in out.other_solutions:
            report.add("other_solutions", 1, case=f"{candidate}/{line}", n=out.episodes)
        for kind, samples in out.recovery.items():
            every.setdefault(kind, []).extend(samples)
        for line in out.examples[:2]:
            print(f'--replay "{candidate}/{line.partition(",")[0]}": {line.partition(", ")[2]}')
    for kind, samples in every.items():
        report.add("recovery_p99", float(np.percentile(samples, 99)), "samples", case=kind, n=len(samples))
