"""Random QPs of 13 classes are solved by every QP solver of ours, in both precisions."""

from __future__ import annotations

import math
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from itertools import count, islice

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from verification.oracles.stage_qp import Shape
from verification.qp.draw import CLASSES, CROWDED, SHAPES, shapes_of
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

#: Least number of QPs of a class for which its share is significant.
ENOUGH = 1000


def measure(report: Report, asked: Run) -> None:
    """Measure the same number of QPs of every class; at a small scale they have some of the shapes, which are drawn."""
    per_class = max(1, math.ceil(QPS * asked.scale / len(CLASSES)))
    others = [shape for shape in SHAPES if shape not in CROWDED]
    shapes = [shape for group in (CROWDED, others) for _, shape in asked.some(group, 1)]
    jobs = [
        (kind, numbers[first : first + CHUNK])
        for kind in CLASSES
        for numbers in [numbers_of(kind, shapes, per_class, asked)]
        for first in range(0, per_class, CHUNK)
    ]
    tallies: Tallies = {}
    spawn = multiprocessing.get_context("spawn")  # no copies of the compiling threads
    with ProcessPoolExecutor(2, spawn, initializer=take_packages, initargs=(controllers(shapes),)) as pool:
        for found in pool.map(run_chunk, jobs):
            for key, tally in found.items():
                tallies.setdefault(key, Tally()).merge(tally)
    report_tallies(report, tallies)


def numbers_of(kind: str, shapes: list[Shape], size: int, asked: Run) -> list[int]:
    """Return the first numbers of a class that have these shapes, from a start that depends on the seed."""
    known = shapes_of(kind)
    first = 0 if asked.scale >= 1 else 100_000 * asked.seed
    return list(islice((n for n in count(first) if known[n % len(known)] in shapes), size))


def report_tallies(report: Report, tallies: Tallies) -> None:
    """Report a line per solver and precision, and one per class whose share of unsolved QPs is beyond its limit."""
    for solver in SOLVERS:
        for precision in SCALARS:
            chosen = {kind: t for (kind, s, p), t in tallies.items() if (s, p) == (solver, precision)}
            asked = {kind: t for kind, t in chosen.items() if t.feasible and not _watched(kind, precision)}
            case, total = f"{solver}, {precision}", sum(t.qps for t in chosen.values())
            report.add("QPs", total, case=case)
            report.add("false OK", sum(t.false_ok for t in chosen.values()), case=case, n=total, limit=0)
            feasible = sum(t.feasible for t in asked.values())
            share = sum(t.unsolved for t in asked.values()) / feasible
            report.add("unsolved", share, "share", case=case, n=feasible, limit=UNSOLVED_LIMITS[precision])
            worst = max(asked, key=lambda kind: asked[kind].unsolved / asked[kind].feasible)
            share, n = asked[worst].unsolved / asked[worst].feasible, asked[worst].feasible
            limit = UNSOLVED_LIMITS[precision] if n >= ENOUGH else None
            report.add("of the worst class", share, "share", case=case, n=n, limit=limit)
            watched = [t for kind, t in chosen.items() if t.feasible and _watched(kind, precision)]
            if watched:
                share = sum(t.unsolved for t in watched) / sum(t.feasible for t in watched)
                report.add("beyond single", share, case=case, n=sum(t.feasible for t in watched))
            unproven = [t for t in chosen.values() if not t.feasible]
            missed = sum(t.qps - t.status["INFEASIBLE"] for t in unproven)
            report.add("infeasible, unproven", missed / sum(t.qps for t in unproven), case=case)
    _print_examples(tallies)


def _watched(kind: str, precision: str) -> bool:
    return precision == "single" and kind in BEYOND_SINGLE


def _print_examples(tallies: Tallies) -> None:
    """Print how to replay answers: all wrong ones, then the most frequent failures."""
    ranked = sorted(tallies, key=lambda key: (tallies[key].false_ok, tallies[key].unsolved), reverse=True)
    wrong = sum(tallies[key].false_ok > 0 for key in ranked)
    for kind, solver, precision in ranked[: max(wrong, 3)]:
        for number, what in tallies[kind, solver, precision].examples[:SHOWN]:
            print(f'--replay "{kind}/{number}/{solver}/{precision}": {what}')
