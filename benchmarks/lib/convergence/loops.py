"""Closed loops that start cold, with hard rows: no call of solve() comes first.

The problems and their initial states were written down before the first run, except the third start of the landing:
the one before was too high to reach the ground within the horizon, by free fall.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import OCP, build, simulate
from verification.convergence.problems import swing_up
from verification.convergence.starts import is_explained

SAMPLES, LEAST = 200, 50


def vehicle() -> OCP:
    """Kinematic vehicle between two walls along a road with a bend, for which it has to brake. n is the distance from
    the middle of the road; the lateral acceleration is limited."""
    ocp = OCP("vehicle", T=4.0, N=40)
    s, n = ocp.state("s", unit="m"), ocp.state("n", unit="m")
    alpha, v = ocp.state("alpha", unit="rad"), ocp.state("v", unit="m/s", initial=15.0)
    a, curvature = ocp.control("a", unit="m/s^2"), ocp.control("curvature", unit="1/m")
    bend = 0.05 / (1 + ca.exp(-(s - 60) / 3)) - 0.05 / (1 + ca.exp(-(s - 100) / 3))
    along = v * ca.cos(alpha) / (1 - n * bend)
    ocp.dynamics({s: along, n: v * ca.sin(alpha), alpha: v * curvature - along * bend, v: a})
    ocp.least_squares(ca.vertcat(n, alpha, v, a, curvature), weight=[0.1, 0.1, 1, 0.1, 10], reference=[0, 0, 15, 0, 0])
    ocp.terminal_least_squares(ca.vertcat(n, alpha), weight=[1, 1])
    ocp.subject_to(-8, a, 4)
    ocp.subject_to(-0.15, curvature, 0.15)
    ocp.subject_to(-1.5, n, 1.5, name="walls")
    ocp.subject_to(-4, v**2 * curvature, 4, name="grip")
    return ocp


def landing() -> OCP:
    """Vertical landing within the horizon at rest on the ground, never below it, with a minimum thrust and the least
    fuel."""
    ocp = OCP("landing", T=12.0, N=30)
    h, v = ocp.state("h", unit="m", initial=200.0), ocp.state("v", unit="m/s", initial=-20.0)
    m, thrust = ocp.state("m", unit="t", initial=2.0), ocp.control("thrust", unit="kN")
    ocp.dynamics({h: v, v: thrust / m - 1.62, m: -thrust / 3000.0})
    ocp.least_squares(thrust, weight=[0.01], reference=[3.24])
    ocp.terminal_least_squares(m, weight=[1.0], reference=[2.0])
    ocp.subject_to(1.0, thrust, 12.0)
    ocp.subject_to(0.0, h, np.inf, name="ground")
    ocp.subject_to(0.0, h, 0.0, at="end", name="landed")
    ocp.subject_to(0.0, v, 0.0, at="end", name="at_rest")
    return ocp


#: Name -> problem, initial states of the plant.
LOOPS: dict[str, tuple[Callable[[], OCP], tuple[tuple[float, ...], ...]]] = {
    "vehicle": (vehicle, ((0, 0, 0, 15), (20, 1.2, -0.1, 14), (30, -1.2, 0.1, 12))),
    "swing_up": (swing_up, ((np.pi, 0), (np.pi - 0.3, 0.4), (np.pi + 0.3, -0.2))),
    "landing": (landing, ((200, -20, 2), (150, -10, 1.8), (100, -15, 1.9))),
}


def measure(report: Report, asked: Run) -> None:
    """Share of the samples that are OK, default options."""
    unexplained = 0
    for name, (make, starts) in asked.cases(LOOPS.items()):
        ctrl = build(make(), profile="fast")
        for start in asked.cases(starts):
            ctrl.reset()
            log = simulate(ctrl, np.array(start, dtype=float), steps=asked.share(SAMPLES, LEAST if asked.scale else 5))
            good = float(np.mean(log.status == 0))
            unexplained += not log.ok and not is_explained(log.failure, ctrl.names)
            why = "" if log.ok else log.failure.splitlines()[-1][:60]
            report.add(
                "cold_loop_ok", good, case=f"{name} from {start}; {why}", n=len(log.u), limit=0.98, at_least=True
            )
    report.add("unexplained_failures", unexplained, case="cold loops", limit=0)
