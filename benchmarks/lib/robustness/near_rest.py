"""Displacements along single axes, and loops that settle: samples that a solver gives up."""

from __future__ import annotations

from benchmarks.lib.report import Report
from verification.robustness.near_rest import SETTLING, candidates_of, run
from verification.robustness.subjects import in_processes, subjects


def measure(report: Report, scale: float = 1.0) -> None:
    """The automatic choice has a limit; solvers that are named are reported."""
    chosen = [candidate for subject in subjects() for candidate in candidates_of(subject)]
    outcomes = in_processes(run, list(enumerate(chosen)), max(20, round(scale * SETTLING)))
    for candidate, out in zip(chosen, outcomes, strict=True):
        automatic = candidate.label.startswith("chosen")
        counts = ", ".join(f"{n} {status}" for status, n in sorted(out.given_up.items()))
        case = f"{candidate}: {counts}, first at {out.example}" if counts else str(candidate)
        key, limit = ("given_up_near_rest", 0) if automatic else ("given_up_near_rest_named", None)
        report.add(key, sum(out.given_up.values()), case=case, n=out.samples, limit=limit)
