"""Iterations in random units over those in the units of the example."""

from __future__ import annotations

import numpy as np

from benchmarks.lib.report import Report
from nmpc_codegen import build
from nmpc_codegen.frontend.classify import classify
from verification.convergence.problems import StartProblem, problems
from verification.convergence.units import EXAMPLES, SEEDS, Units, in_units


def measure(report: Report, scale: float = 1.0) -> None:
    """Iterations of solve() in random units over those in the units of the example, from the first cold start."""
    for problem in problems():
        if problem.name in EXAMPLES:
            _measure(report, problem, max(1, round(scale * SEEDS)))


def _measure(report: Report, problem: StartProblem, seeds: int) -> None:
    ocp = problem.make()
    start = problem.start(0)
    plain = build(ocp, problem.options(), profile="fast").solve(start)
    for seed in range(seeds):
        units = Units.of(ocp, seed)
        other = in_units(ocp, units)
        assert classify(other).nx == start.size
        found = build(other, problem.options(), profile="fast").solve(start / units.x)
        solved = found.status.name == plain.status.name == "OK"
        ratio = max(1, found.iterations) / max(1, plain.iterations) if solved else np.inf
        case = f"{problem.name}, {found.status.name} {found.iterations}, {plain.status.name} {plain.iterations}"
        report.add("unit_sensitivity", ratio, case=case, limit=2)
