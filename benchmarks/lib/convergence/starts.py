"""Random cold starts: ours and IPOPT's from the same first guess."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from benchmarks.lib.report import Report
from verification.convergence.problems import problems
from verification.convergence.starts import STARTS, WORSE, Outcome, run


def measure(report: Report, scale: float = 1.0) -> None:
    """All problems, two at a time."""
    count = max(5, round(scale * STARTS))
    names = [p.name for p in problems()]
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        for outcome in pool.map(run, [(name, count) for name in names]):
            for route in outcome.ours:
                report_route(report, outcome, route)
            failed = [a for attempts in outcome.ours.values() for a in attempts if a.status != "OK"]
            silent = sum(not a.explained for a in failed)
            report.add("unexplained_failures", silent, case=f"{outcome.problem}: {len(failed)} failures", limit=0)


def report_route(report: Report, outcome: Outcome, route: str) -> None:
    """Of a problem."""
    pairs = [(h, m) for h, m in zip(outcome.ipopt, outcome.ours[route], strict=True) if h.solved]
    both = [(h, m) for h, m in pairs if m.solved]
    failed = [f"{n} {m.status}" for n, m in enumerate(outcome.ours[route]) if outcome.ipopt[n].solved and not m.solved]
    lost = sum(not h.solved for h in outcome.ipopt)
    case = f"{outcome.problem}, {route}; IPOPT fails {lost}; " + ", ".join(failed[:6])
    share = len(both) / max(1, len(pairs))
    report.add("solve_success_ratio", share, case=case, n=len(pairs), limit=0.98, at_least=True)
    if both:
        middle = [float(np.median([a.iterations for a in side])) for side in zip(*both, strict=True)]
        case = f"{outcome.problem}, {route}: {middle[1]:g}, IPOPT {middle[0]:g}"
        report.add("solve_iterations_ratio", middle[1] / max(1.0, middle[0]), case=case, n=len(both), limit=1.5)
        gaps = [(m.cost - h.cost) / max(1e-6, abs(h.cost)) for h, m in both]
        case = f"{outcome.problem}, {route}; better {sum(g < -WORSE for g in gaps)}"
        report.add("worse_optimum_share", float(np.mean([g > WORSE for g in gaps])), case=case, n=len(both), limit=0.05)
