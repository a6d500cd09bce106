"""Times of a sample with exact Hessians and with a constant one: energy-optimal driving, and the evaporation process.

The loops of closed_loop.c with the controllers of the examples: the car, N = 100, gets half a second of steering at
0.3 rad/s every 5 s; the evaporation process, N = 200, gets five minutes of more steam every 50 minutes. One lane, one
core, the profile "fast"; the figure is the median of prepare() and feedback(), the least of the runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.lib.report import Report
from examples import driving, evaporation
from nmpc_codegen import OCP, Options, generate
from nmpc_codegen.economic import Tuning
from verification.closed_loop import Scenario, Timing, closed_loop

RUNS, STEPS = 9, 400


@dataclass(frozen=True)
class Loop:
    """An example, its push (added to the controls of the steady state for five samples), and limits in us."""

    key: str
    make: Callable[[], OCP]
    options: Callable[[Any], Options]
    tuned: Callable[[], Tuning]
    dt: float
    push: tuple[float, ...]
    limits: tuple[float | None, float | None] = (None, None)  # exact, constant

    def scenario(self, tuning: Tuning) -> Scenario:
        """From the steady state, with a push every 50 samples."""
        push = tuple(map(float, tuning.u_s + np.array(self.push)))
        return Scenario(tuple(map(float, tuning.x_s)), self.dt, 50, push=push, pushes=5)


LOOPS = (
    Loop(
        *("driving", driving.build_ocp, driving.options, driving.tuned, driving.SAMPLING, (0.0, 0.0, 0.3)),
        limits=(300.0, 150.0),
    ),
    Loop("evaporation", evaporation.build_ocp, evaporation.options, evaporation.tuned, 1.0, (20.0, 0.0)),
)


def timed(loop: Loop, tuning: Tuning, *, exact: bool, runs: int = RUNS, steps: int = STEPS) -> Timing:
    """Times of one package."""
    ocp = loop.make()
    sources = generate(ocp, loop.options(None if exact else tuning.hessian()))
    return closed_loop(sources, ocp.name, loop.scenario(tuning), runs=runs, steps=steps)


def measure(report: Report) -> None:
    """<loop>_exact_us, <loop>_m_us: median of a sample; also the feedback phase, the worst sample, failures."""
    for loop in LOOPS:
        tuning = loop.tuned()
        for word, exact, limit in zip(("exact", "m"), (True, False), loop.limits, strict=True):
            t, key = timed(loop, tuning, exact=exact), f"{loop.key}_{word}"
            report.add(f"{key}_us", t.total, "us", n=t.samples, limit=limit)
            report.add(f"{key}_feedback_us", t.feedback, "us", n=t.samples)
            report.add(f"{key}_worst_us", t.worst, "us", n=t.samples)
            report.add(f"{key}_failed", t.failed, n=t.samples, limit=0)
            report.add(f"{key}_qp_iterations", t.qp_iterations, n=t.samples)
