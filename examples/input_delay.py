"""Heated pipe whose control arrives two samples late.

What it shows: a dead time in a continuous model. `ocp.previous(u)` is the control of the node before; a discrete state
beside the continuous ones, `dynamics({...}, discrete={...})`, hands it on by another sample.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, Controller, build, simulate
from nmpc_codegen.runtime.records.log import Log

DT, N, SAMPLES = 2.0, 20, 60  # s
GOAL = 60.0  # degC
TIME = 8.0  # s, time constants of the pipe and of its wall


def build_ocp(delayed: bool = True) -> OCP:
    """Outlet T and wall W; ``delayed``: the power P acts two samples late."""
    ocp = OCP("input_delay", T=N * DT, N=N)
    T, W = ocp.state("T", initial=20.0, unit="degC"), ocp.state("W", initial=20.0, unit="degC")
    late = ocp.state("late", unit="kW") if delayed else None
    P = ocp.control("P", unit="kW")
    power = P if late is None else late
    rates = {T: (W - T) / TIME + (20 - T) / (4 * TIME), W: (T - W) / TIME + 2.5 * power}
    ocp.dynamics(rates, discrete={} if late is None else {late: ocp.previous(P)})
    ocp.least_squares(ca.vertcat(T, ocp.rate(P)), weight=[1, 20], reference=[GOAL, 0], names=["T", "slew"])
    ocp.terminal_least_squares(T, weight=10, reference=GOAL)
    ocp.subject_to(0, P, 6)
    return ocp


def loop(delayed: bool) -> Log:
    """A controller with or without the dead time in its model, in closed loop with the pipe that has it."""
    pipe: Controller = build(build_ocp(delayed=True))
    controller = pipe if delayed else build(build_ocp(delayed=False), name="no_delay")
    sent = [0.0, 0.0]

    def plant(x: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        """The pipe, which receives what was sent two samples ago."""
        sent.append(float(u[0]))
        after = pipe.integrate([x[0], x[1], sent[-3]], u, dt)
        return np.array([*after[:2], sent[-2]]) if delayed else np.array(after[:2])

    start = [20.0, 20.0, 0.0] if delayed else [20.0, 20.0]
    return simulate(controller, start, SAMPLES, plant=plant)


def draw(logs: dict[str, Log], picture: str) -> None:
    """Outlet temperature and power."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    for (label, log), color in zip(logs.items(), ("#c2571a", "#1f5fa8"), strict=True):
        axes[0].plot(log.t, log.x[:, 0], color=color, label=label)
        axes[1].step(log.t[:-1], log.u[:, 0], where="post", color=color)
    axes[0].axhline(GOAL, color="0.3", linewidth=0.8)
    axes[0].legend(frameon=False, loc="lower right")
    for axis, name in zip(axes, ("T [degC]", "P [kW]"), strict=True):
        axis.set_ylabel(name)
        axis.grid(alpha=0.25)
    axes[1].set_xlabel("time [s]")
    axes[1].margins(x=0)
    figure.suptitle("Heated pipe with a dead time of two samples", fontsize=11)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/input_delay.png") -> dict[str, Log]:
    """Run the loop without and with the dead time in the model, and draw both."""
    logs = {"dead time left out": loop(delayed=False), "dead time in the model": loop(delayed=True)}
    for label, log in logs.items():
        print(f"{label}: overshoot {max(0.0, log.x[:, 0].max() - GOAL):.2f} degC, last {log.x[-1, 0]:.3f} degC")
    draw(logs, picture)
    return logs


if __name__ == "__main__":
    main(*sys.argv[1:])
