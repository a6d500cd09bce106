"""Bioreactor: economic NMPC with exact Hessians finds and tracks the most productive periodic feed of a fermentation.

What it shows: an economic cost, which is not a distance, integrated with the dynamics; averages as states that are
reset at every sample; a free initial state and coupled rows that close the orbit; a closed loop after jumps.

The averages of feed and biomass over the horizon of 48 h are limited. The classical problem fixes the average feed,
Sf_avg(T) = 32.9; as printed in the paper it is only bounded above. In that case every orbit with X_avg = 5.8 is
optimal, with the productivity (2.2 D + 0.2) X_avg = 3.074 g/(L h), as averaging the balances over a period shows.

Quirynen, Houska, Vallerio, Telen, Logist, Van Impe and Diehl, "Symmetric algorithmic differentiation based exact
Hessian SQP method and software for economic MPC", CDC 2014, section VI. Time in hours, concentrations in g/L.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import (
    OCP,
    RK4,
    Controller,
    ExactHessian,
    ExplicitRungeKutta,
    Mirror,
    Options,
    RealTimeIteration,
    build,
    simulate,
)
from nmpc_codegen.runtime.controller import Solution
from nmpc_codegen.runtime.loops.simulate import Log

D, KI, KM, PM, YIELD, ALPHA, BETA, MU_MAX = 0.15, 22.0, 1.2, 50.0, 0.4, 2.2, 0.2, 0.48
HORIZON, N, STEPS = 48.0, 20, 3
SAMPLING = HORIZON / N
FEED, X_MAX = 32.9, 5.8
LOWEST, HIGHEST = 28.7, 40.0

# Initial state of the plans, and x0 of the variant without periodicity.
START = np.array([5.8, 18.0, 20.5, 0.0, 0.0])


def build_ocp(reading: str = "b", periodic: bool = True, soft: bool = False, averages: bool = True) -> OCP:
    """One period of 48 h in 20 intervals.

    reading: "b", the average feed is equal to 32.9; "a", it is at most 32.9. periodic: x(0) = x(T) for X, S, P with
    free x(0); ``soft``: with an l1 penalty of 1 and measured x(0). averages=False leaves out the limits on averages.
    """
    if reading not in ("a", "b"):
        raise ValueError(f"reading: {reading!r}; expected 'a' or 'b'")
    ocp = OCP("bioreactor", T=HORIZON, N=N, time_unit="h")
    X = ocp.state("X", unit="g/L", initial=START[0])
    S = ocp.state("S", unit="g/L", initial=START[1])
    P = ocp.state("P", unit="g/L", initial=START[2])
    Sf_avg, X_avg = ocp.state("Sf_avg", unit="g/L"), ocp.state("X_avg", unit="g/L")
    Sf = ocp.control("Sf", unit="g/L")
    mu = MU_MAX * (1 - P / PM) * S / (KM + S + S**2 / KI)
    ocp.dynamics(
        {
            X: -D * X + mu * X,
            S: D * (Sf - S) - mu * X / YIELD,
            P: -D * P + (ALPHA * mu + BETA) * X,
            Sf_avg: Sf / HORIZON,
            X_avg: X / HORIZON,
        }
    )
    ocp.accumulator(Sf_avg, X_avg)
    ocp.stage_cost(-D * P / HORIZON, integrate=True)
    ocp.subject_to(LOWEST, Sf, HIGHEST)
    if averages:
        ocp.subject_to(FEED if reading == "b" else -np.inf, Sf_avg, FEED, at="end", name="feed")
        ocp.subject_to(-np.inf, X_avg, X_MAX, at="end", name="biomass")
    if periodic:
        closed = ca.vertcat(X, S, P)
        if not soft:
            ocp.free_initial(X, S, P)
        ocp.boundary(0, ocp.at_end(closed) - ocp.at_start(closed), 0, name="period", soft=(1.0, 0.0) if soft else None)
    return ocp


def options(hessian: Any = None, shift: str | None = "periodic") -> Options:
    """Three RK4 steps per interval and mirrored Hessian blocks; with one sample per interval the plan moves by one."""
    return Options(
        integrator=ExplicitRungeKutta(RK4, steps=STEPS),
        hessian=hessian or ExactHessian(Mirror(level="stage")),
        algorithm=RealTimeIteration(shift=shift, sampling_time=SAMPLING),
    )


def guess(controller: Controller, periods: int = 6) -> None:
    """Write an initial plan: feed 40 for seven intervals and 28.7 for the others, after some periods of this feed."""
    feed = np.where(np.arange(N) < 7, HIGHEST, LOWEST)
    x = START.copy()
    for _ in range(periods):
        x[3:] = 0.0
        for k in range(N):
            controller.x[k], controller.u[k] = x, feed[k]
            x = np.asarray(controller.integrate(x, [feed[k]], SAMPLING))
    controller.x[N] = x


def orbit(reading: str = "b", hessian: Any = None) -> tuple[Controller, Solution]:
    """Compute the optimal orbit; its productivity is minus the cost of the solution."""
    controller = build(build_ocp(reading), options(hessian, shift=None))
    guess(controller)
    return controller, controller.solve(np.append(controller.x[0, :3], [0.0, 0.0]), tol=1e-9)


def closed_loop(jump: Sequence[float], samples: int = 120, at: int = 60) -> Log:
    """Simulate 288 h from the orbit with soft periodicity; the state is multiplied by ``jump`` before sample ``at``."""
    _, best = orbit()
    controller = build(build_ocp(soft=True), options())
    controller.x[...], controller.u[...], controller.lam[...] = best.x, best.u, best.lam
    samples_done = count(1)
    factor = np.append(np.asarray(jump, dtype=float), [1.0, 1.0])

    def plant(x: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        x_next = np.asarray(controller.integrate(x, u, dt), dtype=float)
        return x_next * factor if next(samples_done) == at else x_next

    return simulate(controller, best.x[0], steps=samples, dt=SAMPLING, plant=plant)


def productivity(log: Log, first: int, last: int, parts: int = 48) -> float:
    """Mean of D P over the samples first .. last - 1 in g/(L h), by the trapezoidal rule on a fine grid."""
    controller = build(build_ocp(soft=True), options())
    total = 0.0
    for k in range(first, last):
        x = log.x[k].copy()
        for _ in range(parts):
            x_next = np.asarray(controller.integrate(x, log.u[k], SAMPLING / parts))
            total += D * (x[2] + x_next[2]) / 2
            x = x_next
    return total / (parts * (last - first))


def draw(best: Solution, loops: dict[str, Log], picture: str) -> None:
    """Plot the closed loops over 288 h and, dashed, the optimal orbit that they should follow."""
    names = ("X [g/L]", "S [g/L]", "P [g/L]", "feed Sf [g/L]")
    figure = Figure(figsize=(9, 7), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    for (title, log), color in zip(loops.items(), ("#1f5fa8", "#c2571a"), strict=False):
        for i, axis in enumerate(axes[:3]):
            axis.plot(log.t, log.x[:, i], color=color, linewidth=1.5, label=title)
        axes[3].step(log.t, np.append(log.u[:, 0], log.u[-1, 0]), where="post", color=color, linewidth=1.5)
    t = np.arange(len(next(iter(loops.values())).u) + 1) * SAMPLING
    for i, axis in enumerate(axes[:3]):
        axis.plot(
            t, best.x[np.arange(len(t)) % N, i], color="0.4", linewidth=0.8, linestyle="--", label="optimal orbit"
        )
    axes[3].step(t, best.u[np.arange(len(t)) % N, 0], where="post", color="0.4", linewidth=0.8, linestyle="--")
    for axis, name in zip(axes, names, strict=True):
        axis.set_ylabel(name)
        axis.grid(alpha=0.25)
        axis.margins(x=0)
        axis.axvline(t[-1] / 2, color="0.6", linewidth=0.8)
    axes[0].set_ylim(top=8.0)
    axes[0].legend(frameon=False, ncols=3, loc="upper left")
    axes[3].set_xlabel("time [h]")
    figure.suptitle(
        "Bioreactor ([Q14], Fig. 1): economic NMPC finds its orbit again after a jump at 144 h", fontsize=11
    )
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=85)


def main(picture: str = "out/bioreactor.png") -> dict[str, Log]:
    """Solve both readings of the average feed, and simulate two closed loops with a jump."""
    for reading in ("a", "b"):
        solution = orbit(reading)[1]
        print(f"reading ({reading}): {-solution.cost:.6f} g/(L h) in {solution.iterations} iterations")
    loops = {"S jumps by 20 %": closed_loop([1.0, 1.2, 1.0]), "X jumps by 10 %": closed_loop([1.1, 1.0, 1.0])}
    for title, log in loops.items():
        end = len(log.u)
        failed = int(np.count_nonzero(log.status))
        print(f"{title}: {productivity(log, end - N, end):.5f} g/(L h) in the last 48 h, {failed} failed QPs")
    draw(orbit("b")[1], loops, picture)
    return loops


if __name__ == "__main__":
    main(*sys.argv[1:])
