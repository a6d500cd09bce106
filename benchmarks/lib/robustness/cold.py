"""Cold starts and recovery of the augmented Lagrangian are measured."""

from __future__ import annotations

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from verification.robustness import cold, episodes
from verification.robustness.subjects import augmented, candidates, in_processes

LEAST = 2
EPISODES, PART = 48, 0.95


def measure(report: Report, asked: Run) -> None:
    """Measure loops from cold plans, and episodes with one bad datum."""
    count = max(LEAST, round(asked.scale * cold.STARTS))
    every: list[bool] = []
    far = 0
    for case in asked.cases(cold.cases()):
        good, loops = cold.judge(case, count)
        report.add("al_converged", sum(good) / count, "share", case=case.name, n=count)
        report.add("al_not_ok", sum(o.bad for o in loops), "samples", case=case.name, n=count * cold.SAMPLES)
        every += good
        far += sum(o.far for o in loops)
    report.add("al_cold_converged", sum(every) / len(every), case="all", n=len(every), limit=PART, at_least=True)
    report.add("al_ok_while_far", far, "samples", case="all", n=len(every) * cold.SAMPLES, limit=0)
    _recover(report, max(1, round(asked.scale * EPISODES / len(augmented()) + 1)))


def _recover(report: Report, each: int) -> None:
    """Count episodes whose controller is OK within the limit of samples, and returns to its undisturbed control."""
    step = len(candidates()) // len(augmented())  # of every subject, one candidate knows the program of the oracle
    chosen = [(step * i, candidate) for i, candidate in enumerate(augmented())]
    outcomes = in_processes(episodes.run, chosen, each)
    total = sum(o.episodes for o in outcomes)
    lost = sum(o.lockups for o in outcomes)
    longest = max(most for o in outcomes for found in o.recovery.values() for most in found)
    report.add("al_recovered", (total - lost) / total, "share", case="all", n=total, limit=1.0, at_least=True)
    report.add("al_samples_to_recover", longest, "samples", case="all", n=total, limit=episodes.PATIENCE)
    for (_, candidate), out in zip(chosen, outcomes, strict=True):
        for example in out.examples:
            print(f"{candidate}: {example}")
