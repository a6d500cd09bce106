"""Strangers run with default options: closed loops against IPOPT in every sample, and cold starts of solve()."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import AugmentedLagrangian, Options, RealTimeIteration
from verification.built import build_all
from verification.convergence.starts import Attempt
from verification.routes import PURE
from verification.strangers import house, linear, solves
from verification.strangers.loops import Verdict, run
from verification.strangers.problems import CASES, ONCE, OPEN, STRANGERS
from verification.strangers.statement import Stranger
from verification.strangers.twin import NOMINAL, STARTS

LEAST = 3
LOST, NOT_OK, UNSOLVED = 0.0067, 0.0125, 0.02
#: Number of lost loops that is allowed in a sample of all.
FEW = 2
#: Longest allowed run of RELAXED samples; largest allowed excess cost of the house example over its optimum.
STAYS, DEARER = 50, 0.01

#: The schemes of the table: the defaults, and others for comparison.
SCHEMES: Mapping[str, RealTimeIteration | AugmentedLagrangian] = {
    "default": RealTimeIteration(),
    "relaxation=None": RealTimeIteration(relaxation=None),
    "iterations=1": RealTimeIteration(iterations=1),
    "pure": replace(PURE, tolerance=RealTimeIteration().tolerance),
    "augmented Lagrangian": AugmentedLagrangian(),
}


def loops(
    strangers: Sequence[Stranger], numbers: Sequence[int], scheme: str, nominal: bool = False
) -> dict[str, list[Verdict]]:
    """Run the loops with these numbers of every stranger, without their kicks if ``nominal``."""
    stated = [(s, replace(s.options(), algorithm=SCHEMES[scheme])) for s in strangers]
    build_all((s.ocp(), options) for s, options in stated)  # two at a time; campaigns find them in the cache
    return {s.name: run(s, numbers, options, nominal) for s, options in stated}


def measure(report: Report, asked: Run) -> None:
    """Report a line per problem, and the figures of all."""
    numbers, strangers = [i for i, _ in asked.some(range(STARTS), LEAST)], asked.cases(STRANGERS)
    found = loops(strangers, numbers, "default")
    for stranger in strangers:
        _report(report, stranger.name, found[stranger.name])
    judged = [v for s in strangers if s not in CASES for v in found[s.name]]
    every = [v for verdicts in found.values() for v in verdicts]
    undisturbed = [v for vs in loops(strangers, range(NOMINAL), "default", nominal=True).values() for v in vs]
    samples = sum(v.samples for v in every)
    few = LOST if len(numbers) == STARTS else FEW / len(judged)  # the two loops that are lost may be among few
    totals = {
        "loops_lost": (sum(bool(v.lost) for v in judged) / len(judged), few, len(judged)),
        "not_ok_share": (sum(v.bad for v in every) / samples, NOT_OK, samples),
        "ok_while_far": (sum(v.far for v in every), 0, samples),
        "nominal_limits_exceeded": (sum("row" in v.lost for v in undisturbed), 0, len(undisturbed)),
        "nominal_lost": (sum(bool(v.lost) for v in undisturbed), 0, len(undisturbed)),
        "stays_relaxed": (sum(v.relaxed > STAYS for v in every), 0, len(every)),
        "drone_lost": (sum(bool(v.lost) for v in found.get("drone", ())), 0, len(numbers)),
        "quaternion_drone_ok_while_far": (sum(v.far for v in found.get("quaternion", ())), 0, len(numbers)),
    }
    for key, (value, limit, n) in totals.items():
        report.add(key, value, case="all", n=n, limit=limit)
    _measure_house(report)
    for line in lost(found, numbers):
        print(line)


def _measure_house(report: Report) -> None:
    """Report a loop without curvature in any control."""
    (controller,) = build_all([(house.ocp(), house.options())])
    statuses, cost = house.run(controller)
    bad = house.SAMPLES - statuses["OK"]
    report.add("house_not_ok", bad, "samples", case="all", n=house.SAMPLES, limit=0)
    report.add("house_dearer", cost / house.OPTIMUM - 1, case="all", n=house.SAMPLES, limit=DEARER)


def measure_solve(report: Report, asked: Run) -> None:
    """Report cold starts of solve() that IPOPT solves: a line per problem, and the figures of all."""
    numbers = [i for i, _ in asked.some(range(solves.STARTS), LEAST)]
    once = asked.cases(ONCE)
    built = build_all((s.ocp(), s.options()) for s in once)
    every: list[tuple[Attempt, Attempt]] = []
    failed: set[str] = set()
    for stranger, controller in zip(once, built, strict=True):
        theirs, mine = solves.by_ipopt()[stranger.name], solves.solves(stranger, controller, numbers)
        pairs = [(m, theirs[i]) for i, m in zip(numbers, mine, strict=True) if theirs[i].solved]
        every += pairs
        _report_solves(report, stranger.name, pairs)
        for i, m in zip(numbers, mine, strict=True):
            if not m.solved:
                failed.add(stranger.name)
                print(f"not solved: {stranger.name}/{i}: {m.status} after {m.iterations}")
        if stranger.name == "free_time":
            error = max(abs(m.cost - t.cost) / t.cost for m, t in pairs)
            report.add("free_time_error", error, case="all", n=len(pairs), limit=1e-4)
    share = sum(m.solved for m, _ in every) / len(every)
    report.add("not solved", 1 - share, "share", case="all", n=len(every), limit=UNSOLVED)
    report.add("false_infeasible", sum(m.status == "INFEASIBLE" for m, _ in every), case="all", n=len(every), limit=0)
    good = [pair for pair in every if pair[0].solved]
    report.add(
        "worse optimum", sum(solves.is_worse(m, t) for m, t in good) / len(good), "share", case="all", n=len(good)
    )
    report.add("iterations", float(np.median([m.iterations for m, _ in good])), "median", case="all", n=len(good))
    report.add("of IPOPT", float(np.median([t.iterations for _, t in good])), "median", case="all", n=len(good))
    report.add("open_not_solved", len(set(OPEN) & failed), case="all", n=len(OPEN), limit=1)
    _measure_linear(report, asked)


def _measure_linear(report: Report, asked: Run) -> None:
    """Report loops whose samples are linear programs."""
    cases = asked.cases(linear.CASES)
    for case, controller in zip(cases, build_all((c.ocp(), Options()) for c in cases), strict=True):
        bad, worst = case.run(controller)
        report.add(f"{case.name}_not_ok", bad, "samples", case="all", n=case.samples, limit=0)
        report.add(f"{case.name}_error", worst, "cost", case="all", n=case.samples, limit=linear.SAME)


def _report_solves(report: Report, name: str, pairs: Sequence[tuple[Attempt, Attempt]]) -> None:
    good = [pair for pair in pairs if pair[0].solved]
    report.add("not solved", len(pairs) - len(good), "starts", case=name, n=len(pairs))
    report.add("worse optimum", sum(solves.is_worse(m, t) for m, t in good), "starts", case=name, n=len(good))
    for key, values in (("iterations", [m.iterations for m, _ in good]), ("of IPOPT", [t.iterations for _, t in good])):
        report.add(key, float(np.median(values)) if values else float("nan"), "median", case=name, n=len(good))


def lost(found: Mapping[str, list[Verdict]], numbers: Sequence[int]) -> Iterable[str]:
    """Yield a line per lost loop."""
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
    report.add("iterations", sum(v.iterations for v in verdicts) / samples, "per sample", case=name, n=samples)


def table() -> str:
    """Return the loops of all strangers with every scheme, in Markdown."""
    head = "| problem | family | nx, nu, N | " + " | ".join(SCHEMES) + " |"
    lines = [head, "|---" * (3 + len(SCHEMES)) + "|"]
    found = {scheme: loops(STRANGERS, range(STARTS), scheme) for scheme in SCHEMES}
    for s in STRANGERS:
        sizes = f"{len(s.states)}, {len(s.controls)}, {s.N}"
        cells = " | ".join(_cell(found[scheme][s.name]) for scheme in SCHEMES)
        lines.append(f"| {s.name} | {s.family} | {sizes} | {cells} |")
    return "\n".join(lines) + "\n"


def _cell(verdicts: list[Verdict]) -> str:
    """Return lost loops, and the percentages of samples that are neither OK nor RELAXED, and of RELAXED ones."""
    statuses: Counter[str] = sum((v.statuses for v in verdicts), Counter())
    samples = sum(v.samples for v in verdicts)
    bad, relaxed = (100 * count / samples for count in (sum(v.bad for v in verdicts), statuses["RELAXED"]))
    return f"{sum(bool(v.lost) for v in verdicts)} lost, {bad:.1f} % not OK, {relaxed:.1f} % relaxed"
