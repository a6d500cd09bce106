"""Counted operations of samples against the worst case that worst_case() finds."""

from __future__ import annotations

import numpy as np

from benchmarks.lib.report import Report
from nmpc_codegen import worst_case
from verification.robustness.work import Loop, closed_loops, soft_loops
from verification.robustness.worst import package_of, played


def against_worst_case(report: Report, loop: Loop, scale: float) -> None:
    """All samples against the stated worst case."""
    stated = worst_case(package_of(loop))["sample"]
    found = played(loop, scale).every
    case = f"{loop.name}: stated {stated:,}, worst seen {np.max(found):,.0f}"
    report.add("worst_case_exceeded", int(np.sum(found > stated)), case=case, n=len(found), limit=0)
    report.add("worst_case_over_seen", stated / float(np.max(found)), case=loop.name, n=len(found))


def measure(report: Report, scale: float = 1.0) -> None:
    """Worst cases of all loops."""
    for loop in (*closed_loops(), *soft_loops()):
        against_worst_case(report, loop, scale)
