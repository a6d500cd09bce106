"""Counted operations of samples against the worst case that worst_case() finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import AugmentedLagrangian, Options, worst_case
from verification.robustness.work import Loop, closed_loops, soft_loops
from verification.robustness.worst import package_of, played

#: Loops that are counted with the augmented Lagrangian within a minute.
AUGMENTED = ("crane", "cstr", "cart_pole", "quadrotor")


def against_worst_case(report: Report, loop: Loop, asked: Run) -> None:
    """All samples against the stated worst case."""
    stated = worst_case(package_of(loop))["sample"]
    found = played(loop, asked.scale).every
    case = f"{loop.name}: stated {stated:,}, worst seen {np.max(found):,.0f}"
    report.add("worst_case_exceeded", int(np.sum(found > stated)), case=case, n=len(found), limit=0)
    report.add("worst_case_over_seen", stated / float(np.max(found)), case=loop.name, n=len(found))


def measure(report: Report, asked: Run) -> None:
    """Worst cases of all loops."""
    for loop in asked.cases((*closed_loops(), *soft_loops(), *augmented_loops())):
        against_worst_case(report, loop, asked)


def augmented_loops() -> list[Loop]:
    """Those of the loops that the augmented Lagrangian controls, too."""
    known = {loop.name: loop for loop in closed_loops()}
    found = []
    for name in AUGMENTED:
        options = Options(integrator=known[name].options.integrator, algorithm=AugmentedLagrangian())
        found.append(replace(known[name], name=f"{name}, augmented Lagrangian", options=options))
    return found
