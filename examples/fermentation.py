"""Fermentation: the augmented Lagrangian finds the most productive feed, without a QP.

What it shows: AugmentedLagrangian, whose samples have a bounded number of Newton iterations and no QP that may fail; a
simulated guess of the first plan; stats.residual, which says how far a plan is from the model; a loop whose plan is
periodic, with a measured x_0 and soft rows that close the period.

The statement is that of bioreactor.py with a mean feed of 32.9 g/L. The algorithm is that of Hours, Shukla and Jones,
"A parametric augmented Lagrangian algorithm for real-time economic NMPC", ECC 2016, with M = 3 iterations. Their
penalty, rho = 100 for gaps in g/L, is 3,400 to 42,000 for gaps relative to the declared states, as they are here.
Without a penalty the compiler chooses one for the cost. Time in hours, concentrations in g/L.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import (
    OCP,
    RK4,
    AugmentedLagrangian,
    Controller,
    ExplicitRungeKutta,
    Options,
    ProblemWarning,
    Status,
    build,
)

PERIOD, N = 48.0, 20
SAMPLING = PERIOD / N
#: A lean start, and what multiplies biomass, substrate and product before sample 100.
START, JUMP = np.array([4.5, 12.0, 15.0, 0.0, 0.0]), np.array([1.0, 1.2, 1.0, 1.0, 1.0])


def build_ocp() -> OCP:
    """One period in 20 intervals: the most product at a mean feed of 32.9 g/L and a mean biomass of at most 5.8 g/L."""
    ocp = OCP("fermentation", T=PERIOD, N=N, time_unit="h")
    grown = {"X": 5.8, "S": 18.0, "P": 20.5}
    X, S, P = (ocp.state(name, unit="g/L", initial=value) for name, value in grown.items())
    mean_feed, mean_X = ocp.state("mean_feed", unit="g/L"), ocp.state("mean_X", unit="g/L")
    feed = ocp.control("feed", unit="g/L")
    dilution, growth = 0.15, 0.48 * (1 - P / 50) * S / (1.2 + S + S**2 / 22)
    ocp.dynamics(
        {
            X: (growth - dilution) * X,
            S: dilution * (feed - S) - growth * X / 0.4,
            P: (2.2 * growth + 0.2) * X - dilution * P,
            mean_feed: feed / PERIOD,
            mean_X: X / PERIOD,
        }
    )
    ocp.accumulator(mean_feed, mean_X)
    ocp.stage_cost(-dilution * P / PERIOD, integrate=True)
    ocp.subject_to(28.7, feed, 40.0)
    ocp.subject_to(32.9, mean_feed, 32.9, at="end", name="mean_feed")
    ocp.subject_to(-np.inf, mean_X, 5.8, at="end", name="mean_biomass")
    for x in (X, S, P):
        ocp.boundary(0, ocp.at_end(x) - ocp.at_start(x), 0, name=f"period_{x.name()}", soft=(1.0, 0.0))
    return ocp


def options() -> Options:
    """Three Newton iterations per sample; the rows that close the period make the plan move periodically."""
    algorithm = AugmentedLagrangian(iterations=3, penalty=2e4)
    return Options(ExplicitRungeKutta(RK4, steps=3), algorithm=algorithm)


@dataclass(frozen=True, eq=False)
class Loop:
    """States (samples, 5), feeds and residuals of the plans (samples,), samples that were not OK."""

    x: np.ndarray
    feed: np.ndarray
    residual: np.ndarray
    not_ok: int

    def productivity(self, first: int) -> float:
        """Mean of D P at the samples of a period, g/(L h)."""
        return float(0.15 * np.mean(self.x[first : first + N, 2]))


def guess(controller: Controller) -> None:
    """Write a first plan: a rich feed for seven intervals, then a lean one, simulated. A constant feed is a local
    optimum of 3.016 g/(L h), near which a loop would begin."""
    controller.u[:, 0] = np.where(np.arange(N) < 7, 40.0, 28.7)
    controller.x[0] = START
    for k in range(N):
        controller.x[k + 1] = controller.integrate(controller.x[k], controller.u[k], SAMPLING)


def closed_loop(samples: int = 200, at: int = 100) -> Loop:
    """Simulate from START; the state jumps before sample ``at``."""
    controller = build(build_ocp(), options())
    guess(controller)
    x, states, feeds, residuals, not_ok = START.copy(), [], [], [], 0
    for n in range(samples):
        x = x * JUMP if n == at else x
        u = controller.step(x)
        states.append(x)
        feeds.append(float(u[0]))
        residuals.append(controller.stats.residual)
        not_ok += controller.status is not Status.OK
        x = np.asarray(controller.integrate(x, u, SAMPLING))
        x[3:] = 0.0
    return Loop(np.array(states), np.array(feeds), np.array(residuals), not_ok)


def orbit() -> np.ndarray:
    """The best period, (N+1, 5): the same problem, whose first state the solver chooses."""
    ocp = build_ocp()
    ocp.free_initial("X", "S", "P")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)  # the cost has no curvature in the feed
        controller = build(ocp)
    guess(controller)
    return np.array(controller.solve(START).x)


def draw(loop: Loop, best: np.ndarray, picture: str) -> None:
    """Plot concentrations, the feed, and the residual of every plan; beside them the path and the best period."""
    t = SAMPLING * np.arange(len(loop.feed))
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    curves, plane = figure.subfigures(1, 2, width_ratios=(1.7, 1))
    top, middle, bottom = curves.subplots(3, 1, sharex=True)
    path = plane.subplots()
    path.plot(*loop.x[:, [1, 2]].T, color="#1f5fa8", linewidth=0.8, label="loop")
    path.plot(*loop.x[-N:, [1, 2]].T, color="#c2571a", linewidth=1.6, label="its last period")
    path.plot(*best[:, [1, 2]].T, color="0.1", linestyle="--", linewidth=1.2, label="best period")
    path.plot(*START[[1, 2]], color="#1f5fa8", marker="o")
    path.set(xlabel="S [g/L]", ylabel="P [g/L]")
    path.grid(alpha=0.25)
    plane.legend(frameon=False, ncols=3, fontsize=8, loc="outside lower center")
    for i, (name, colour) in enumerate((("X", "#3a7d44"), ("S", "#c2571a"), ("P", "#1f5fa8"))):
        top.plot(t, loop.x[:, i], color=colour, label=name)
    top.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.98))
    top.set(ylabel="concentrations [g/L]", ylim=(0, 30))
    middle.step(t, loop.feed, where="post", color="#1f5fa8")
    middle.set(ylabel="feed [g/L]")
    for bound in (28.7, 40.0):
        middle.axhline(bound, color="0.45", linewidth=1.0, linestyle="--")
    bottom.semilogy(t, loop.residual, color="0.3", marker=".", markersize=4, linewidth=0.8)
    bottom.axhline(0.1, color="#b3202c", linewidth=1.0)
    bottom.annotate("NOT_CONVERGED above", (t[-1], 0.1), ha="right", va="bottom", fontsize=8, color="#b3202c")
    bottom.set(ylabel="residual of the plan", xlabel="time [h]", xlim=(0, t[-1]), ylim=(1e-5, 1))
    for axis in (top, middle, bottom):
        axis.grid(alpha=0.25)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=85)


def main(picture: str = "out/fermentation.png") -> Loop:
    """Simulate 480 h, with S + 20 % at 240 h."""
    loop = closed_loop()
    for first in (0, 80, 180):
        print(f"samples {first} to {first + N}: {loop.productivity(first):.4f} g/(L h)")
    print(f"{loop.not_ok} of {len(loop.feed)} samples were not OK")
    draw(loop, orbit(), picture)
    return loop


if __name__ == "__main__":
    main(*sys.argv[1:])
