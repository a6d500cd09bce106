"""Loops come to rest; samples that are not OK, and decisions that depend on units, are counted."""

from __future__ import annotations

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from verification.robustness import at_rest

DRAWS = 200


def measure(report: Report, asked: Run) -> None:
    """Measure draws of the sweep, and every problem of it in other units."""
    for seed in range(asked.share(DRAWS)):
        package, out = at_rest.run(seed)
        report.add("wrong_at_rest", sum(out.wrong.values()), case=f"{package}, {out}", n=out.samples, limit=0)
    for name in asked.cases(at_rest.IN_UNITS):
        for seed in range(asked.share(at_rest.UNITS)):
            found = at_rest.differences(name, seed)
            report.add(
                "other_decisions", len(found), case=f"{name}, units {seed}: {', '.join(found) or 'none'}", limit=0
            )
