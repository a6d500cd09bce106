"""Operations of the samples of closed loops are counted: the worst against the median, soft rows against none."""

from __future__ import annotations

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import Status, build
from verification.robustness.work import (
    IN_USE,
    closed_loops,
    control_difference,
    count,
    record,
    soft_loops,
    soft_rows,
    steps_of,
)


def worst_over_median(report: Report, asked: Run) -> None:
    """Measure all loops of the other benchmarks."""
    for loop in asked.cases(closed_loops()):
        steps = steps_of(loop, asked.scale)
        recorded = record(loop, steps, [])
        (found,) = count(loop, recorded)
        worst, middle = int(np.argmax(found.operations)), float(np.median(found.operations))
        case = f"{loop.name}: median {middle:,.0f}, worst {found.operations[worst]:,.0f} at sample {worst}"
        report.add("worst_over_median", found.operations[worst] / middle, case=case, n=steps, limit=12)
        report.add("counted_control_error", control_difference(recorded, found), case=loop.name, n=steps)


def soft_over_hard(report: Report, asked: Run) -> None:
    """Measure loops with soft rows, then without: their bounds are opened at run time, and all else is alike."""
    for loop in asked.cases(soft_loops()):
        steps = steps_of(loop, asked.scale)
        opened = soft_rows(build(loop.make(), loop.options, profile="fast"))
        used, free = record(loop, steps, []), record(loop, steps, opened)
        with_rows, without = count(loop, used, free)
        share = float(np.mean(used.in_use))
        report.add("soft_in_use", share, case=loop.name, n=steps, limit=IN_USE, at_least=True)
        chosen = with_rows.operations[used.in_use] if used.in_use.any() else np.array([np.nan])
        with_them, middle = float(np.median(chosen)), float(np.median(without.operations))
        failed = int(np.sum(with_rows.status != Status.OK))
        case = f"{loop.name}: {with_them:,.0f}, without {middle:,.0f}, worst {np.max(chosen):,.0f}, {failed} not OK"
        report.add("soft_over_hard", with_them / middle, case=case, n=len(chosen), limit=4)
        report.add(
            "counted_control_error", control_difference(used, with_rows), case=f"{loop.name}, soft rows", n=steps
        )


def measure(report: Report, asked: Run) -> None:
    """Measure both ratios."""
    worst_over_median(report, asked)
    soft_over_hard(report, asked)
