"""Counted operations of samples of the augmented Lagrangian against the worst case that worst_case() finds."""

from __future__ import annotations

from benchmarks.lib.augmented.loop import AUGMENTED
from benchmarks.lib.report import Report
from benchmarks.lib.robustness.worst import worst_case
from nmpc_codegen import AugmentedLagrangian, Options
from verification.robustness.work import Loop, closed_loops


def loops() -> list[Loop]:
    """Those of the other benchmarks that are small enough to be counted in a minute."""
    known = {loop.name: loop for loop in closed_loops()}
    found = [known[name] for name in ("crane", "cstr", "cart_pole", "quadrotor")]
    chosen = [Loop(k.name, k.make, _augmented(k.options), k.scenario, k.steps) for k in found]
    fermenter = known["bioreactor"]
    return [*chosen, Loop("bioreactor", fermenter.make, AUGMENTED, fermenter.scenario, fermenter.steps)]


def _augmented(options: Options) -> Options:
    return Options(integrator=options.integrator, algorithm=AugmentedLagrangian())


def measure(report: Report, scale: float) -> None:
    """worst_case_exceeded, and how far the statement is above what was seen."""
    for loop in loops():
        worst_case(report, loop, scale)
