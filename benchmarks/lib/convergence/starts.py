"""solve() starts cold with default options, and is compared with IPOPT from the same first guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import OptionError, build
from verification.built import build_all
from verification.convergence.problems import problems
from verification.convergence.starts import STARTS, WORSE, Attempt, attempts, by_ipopt
from verification.routes import ROUTES

PROBLEMS, LEAST = 12, 6


def measure(report: Report, asked: Run) -> None:
    """Measure all problems; at a small scale some problems and some starts, which are drawn."""
    chosen = [problem for _, problem in asked.some(problems(), PROBLEMS)]
    built = build_all((problem.make(), problem.options()) for problem in chosen)
    for problem, controller in zip(chosen, built, strict=True):
        numbers = [i for i, _ in asked.some(range(STARTS), LEAST)]
        theirs = by_ipopt()[problem.name]
        report_problem(report, problem.name, [theirs[i] for i in numbers], attempts(problem.name, controller, numbers))


def routes(report: Report, asked: Run) -> None:
    """Measure all problems by each of the two QP solvers among which qp=None chooses."""
    for problem in asked.cases(problems()):
        numbers = [i for i, _ in asked.some(range(STARTS), LEAST)]
        theirs = by_ipopt()[problem.name]
        for route in ("dense", "riccati"):
            condensing, qp = ROUTES[route]
            try:
                ctrl = build(problem.make(), replace(problem.options(), condensing=condensing, qp=qp))
            except OptionError:  # refused, so it is not chosen, either
                continue
            ours = attempts(problem.name, ctrl, numbers)
            report_problem(report, f"{problem.name}, {route}", [theirs[i] for i in numbers], ours)


def report_problem(report: Report, name: str, theirs: list[Attempt], ours: list[Attempt]) -> None:
    """Report the figures of a problem."""
    pairs = [(h, m) for h, m in zip(theirs, ours, strict=True) if h.solved]
    both = [(h, m) for h, m in pairs if m.solved]
    report.add("IPOPT solves", len(pairs), "starts", case=name, n=len(theirs))
    least = min(0.98 * len(pairs), len(pairs) - 1)
    report.add("ours of them", len(both), "starts", case=name, n=len(pairs), limit=least, at_least=True)
    if both:
        h, m = [float(np.median([a.iterations for a in side])) for side in zip(*both, strict=True)]
        report.add("iterations", m, case=name, n=len(both))
        limit = 1.5 if len(theirs) == STARTS else None  # few starts say little about a median
        report.add("to IPOPT's", m / max(1.0, h), case=name, n=len(both), limit=limit)
        worse = [(m.cost - h.cost) / max(1e-6, abs(h.cost)) > WORSE for h, m in both]
        report.add("worse optimum", sum(worse), "starts", case=name, n=len(both))
    silent = sum(not attempt.explained for attempt in ours)
    report.add("unexplained", silent, "starts", case=name, n=len(ours), limit=0)
