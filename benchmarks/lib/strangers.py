"""Closed loops of strangers with default options, against loops with IPOPT in every sample."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import RealTimeIteration
from verification.built import build_all
from verification.routes import PURE
from verification.strangers.loops import Judge, Verdict, run
from verification.strangers.problems import CASES, STRANGERS
from verification.strangers.statement import Stranger
from verification.strangers.twin import STARTS, Twin

LEAST = 3
LOST, NOT_OK = 0.02, 0.02

#: The defaults and what they are compared with in the table.
SCHEMES: Mapping[str, RealTimeIteration] = {
    "default": RealTimeIteration(),
    "relaxation=None": RealTimeIteration(relaxation=None),
    "repair=0": RealTimeIteration(repair=0),
    "pure": replace(PURE, tolerance=RealTimeIteration().tolerance),
}


def loops(strangers: Sequence[Stranger], numbers: Sequence[int], scheme: str) -> dict[str, list[Verdict]]:
    """The loops with these numbers of every stranger."""
    algorithm = SCHEMES[scheme]
    built = build_all((s.ocp(), replace(s.options(), algorithm=algorithm)) for s in strangers)
    found = {}
    for stranger, controller in zip(strangers, built, strict=True):
        twin = Twin(stranger)
        judge = Judge(twin)
        found[stranger.name] = [run(twin, judge, controller, number) for number in numbers]
    return found


def measure(report: Report, asked: Run) -> None:
    """A line per problem, and the figures of all."""
    numbers = [i for i, _ in asked.some(range(STARTS), LEAST)]
    found = loops(STRANGERS, numbers, "default")
    for stranger in STRANGERS:
        _report(report, stranger.name, found[stranger.name])
    judged = [v for s in STRANGERS if s not in CASES for v in found[s.name]]
    every = [v for verdicts in found.values() for v in verdicts]
    samples = sum(v.samples for v in every)
    totals = {
        "loops_lost": (sum(bool(v.lost) for v in judged) / len(judged), LOST, len(judged)),
        "not_ok_share": (sum(v.bad for v in every) / samples, NOT_OK, samples),
        "ok_while_far": (sum(v.far for v in every), 0, samples),
        "drone_lost": (sum(bool(v.lost) for v in found["drone"]), 0, len(numbers)),
        "quaternion_drone_ok_while_far": (sum(v.far for v in found["quaternion"]), 0, len(numbers)),
    }
    for key, (value, limit, n) in totals.items():
        report.add(key, value, case="all", n=n, limit=limit)
    for line in lost(found, numbers):
        print(line)


def lost(found: Mapping[str, list[Verdict]], numbers: Sequence[int]) -> Iterable[str]:
    """A line per loop that is lost."""
    for name, verdicts in found.items():
        for number, verdict in zip(numbers, verdicts, strict=True):
            if verdict.lost:
                yield f"lost: {name}/{number}: {verdict.lost}"


def _report(report: Report, name: str, verdicts: list[Verdict]) -> None:
    samples, n = sum(v.samples for v in verdicts), len(verdicts)
    report.add("lost", sum(bool(v.lost) for v in verdicts), "loops", case=name, n=n)
    report.add("not OK", sum(v.bad for v in verdicts) / samples, "share", case=name, n=samples)
    report.add("relaxed", sum(v.statuses["RELAXED"] for v in verdicts) / samples, "share", case=name, n=samples)
    report.add("OK while far", sum(v.far for v in verdicts), "samples", case=name, n=samples, limit=0)
    report.add("repairs", sum(v.repairs for v in verdicts) / samples, "per sample", case=name, n=samples)


def table() -> str:
    """The loops of all strangers with every scheme, in Markdown."""
    head = "| problem | family | nx, nu, N | " + " | ".join(SCHEMES) + " |"
    lines = [head, "|---" * (3 + len(SCHEMES)) + "|"]
    found = {scheme: loops(STRANGERS, range(STARTS), scheme) for scheme in SCHEMES}
    for s in STRANGERS:
        sizes = f"{len(s.states)}, {len(s.controls)}, {s.N}"
        cells = " | ".join(_cell(found[scheme][s.name]) for scheme in SCHEMES)
        lines.append(f"| {s.name} | {s.family} | {sizes} | {cells} |")
    return "\n".join(lines) + "\n"


def _cell(verdicts: list[Verdict]) -> str:
    """Lost loops; samples that are neither OK nor RELAXED, and RELAXED ones, in percent."""
    statuses: Counter[str] = sum((v.statuses for v in verdicts), Counter())
    samples = sum(v.samples for v in verdicts)
    bad, relaxed = (100 * count / samples for count in (sum(v.bad for v in verdicts), statuses["RELAXED"]))
    return f"{sum(bool(v.lost) for v in verdicts)} lost, {bad:.1f} % not OK, {relaxed:.1f} % relaxed"
