"""Random QPs of 13 classes through every QP solver of ours, in both precisions."""

from __future__ import annotations

import math
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

from benchmarks.lib.report import Report
from verification.qp.draw import CLASSES
from verification.qp.stage_package import SCALARS, SOLVERS
from verification.qp.verdicts import (
    BEYOND_SINGLE,
    CHUNK,
    QPS,
    SHOWN,
    UNSOLVED_LIMITS,
    Tallies,
    Tally,
    controllers,
    run_chunk,
    take_packages,
)


def measure(report: Report, scale: float = 1.0) -> None:
    """Every class has the same number of QPs."""
    per_class = math.ceil(QPS * scale / len(CLASSES))
    jobs = [
        (kind, range(first, min(first + CHUNK, per_class)))
        for first in range(0, per_class, CHUNK)
        for kind in CLASSES
    ]  # fmt: skip
    tallies: Tallies = {}
    spawn = multiprocessing.get_context("spawn")  # no copies of the threads that have compiled
    with ProcessPoolExecutor(2, mp_context=spawn, initializer=take_packages, initargs=(controllers(),)) as pool:
        for found in pool.map(run_chunk, jobs):
            for key, tally in found.items():
                tallies.setdefault(key, Tally()).merge(tally)
    report_tallies(report, tallies, scale)


def report_tallies(report: Report, tallies: Tallies, scale: float) -> None:
    """Sums and shares by class and solver, and how to see an example again."""
    for solver in SOLVERS:
        for precision in SCALARS:
            count = sum(t.qps for (_, s, p), t in tallies.items() if (s, p) == (solver, precision))
            report.add("qps", count, case=f"{solver}, {precision}", limit=math.ceil(QPS * scale), at_least=True)
    for precision in SCALARS:
        chosen = {(kind, solver): t for (kind, solver, p), t in tallies.items() if p == precision}
        total = sum(t.qps for t in chosen.values())
        wrong = sum(t.false_ok for t in chosen.values())
        report.add(f"false_ok_{precision}", wrong, case="all classes and solvers", n=total, limit=0)
        for (kind, solver), t in chosen.items():
            report.add(f"false_ok_{precision}", t.false_ok, case=f"{kind}, {solver}", n=t.qps, limit=0)
        for (kind, solver), t in chosen.items():
            _report_unsolved(report, precision, kind, solver, t)
    for (kind, solver, precision), t in tallies.items():
        for number, what in t.examples[:SHOWN]:
            print(f'--replay "{kind}/{number}/{solver}/{precision}": {what}')


def _report_unsolved(report: Report, precision: str, kind: str, solver: str, t: Tally) -> None:
    case, infeasible = f"{kind}, {solver}", t.status["INFEASIBLE"]
    if t.feasible == 0:
        report.add(f"qp_infeasible_unproven_{precision}", (t.qps - infeasible) / t.qps, case=case, n=t.qps)
        return
    others = {name: n for name, n in t.status.items() if name != "OK"}
    text = ", ".join(f"{n} {name}" for name, n in sorted(others.items()))
    watched = precision == "single" and kind in BEYOND_SINGLE
    limit = None if watched else UNSOLVED_LIMITS[precision]
    key = f"qp_unsolved_{precision}{'_watched' if watched else ''}"
    report.add(key, t.unsolved / t.feasible, case=case + (f": {text}" if text else ""), n=t.feasible, limit=limit)
