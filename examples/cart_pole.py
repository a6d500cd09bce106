"""Cart and pole: swing the pole up within 1 s and keep it up, with a force of at most 80 N.

What it shows: solve(), SQP to convergence with a line search, for a plan that one step per sample would not find
without an initial guess; real-time iterations from this plan, with shift="repeat" since the sampling time is one
interval; a parameter, the length of the pole, that is changed in the compiled controller; disturbances.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, Options, RealTimeIteration, build, simulate
from nmpc_codegen.runtime.loops.simulate import Log

CART, POLE, GRAVITY = 1.0, 0.1, 9.81
HANGING = np.array([0.0, np.pi, 0.0, 0.0])
LENGTHS = (0.8, 1.2)
SWING_UP = 20  # samples


def build_ocp(any_length: bool = False) -> OCP:
    """20 intervals of 0.05 s from hanging to upright, th = 0; the length of the pole is 0.8 m or a parameter."""
    ocp = OCP("cart_pole", T=1.0, N=20)
    p = ocp.state("p", unit="m")
    th = ocp.state("th", unit="rad", initial=np.pi)
    v = ocp.state("v", unit="m/s")
    w = ocp.state("w", unit="rad/s")
    F = ocp.control("F", unit="N")
    length = ocp.parameter("length", value=0.8, unit="m") if any_length else 0.8

    s, c = ca.sin(th), ca.cos(th)
    D = CART + POLE - POLE * c**2
    ocp.dynamics(
        {
            p: v,
            th: w,
            v: (-POLE * length * s * w**2 + POLE * GRAVITY * c * s + F) / D,
            w: (-POLE * length * c * s * w**2 + F * c + (CART + POLE) * GRAVITY * s) / (length * D),
        }
    )
    Q = [1e3, 1e3, 0.01, 0.01]
    ocp.least_squares(ca.vertcat(ocp.x, F), weight=[*Q, 0.01])
    ocp.terminal_least_squares(ocp.x, weight=Q)
    ocp.subject_to(-80, F, 80)
    return ocp


def options() -> Options:
    """A sample every interval, so that the plan moves by one interval."""
    return Options(algorithm=RealTimeIteration(sampling_time=0.05))


def push(k: int, x: np.ndarray) -> np.ndarray:
    """The disturbance that simulate() adds after sample k: a blow at the pole after 2 s."""
    return np.array([0.0, 0.0, 0.0, -4.0 if k == 39 else 0.0])


def draw(logs: list[Log], picture: str) -> None:
    """Plot the swing for each length as a stroboscopic picture, and angle and force over time."""
    figure = Figure(figsize=(9, 6.8), layout="constrained")
    poses, curves = figure.subfigures(2, 1, height_ratios=(1.2, 1))
    axes = curves.subplots(2, 1, sharex=True)
    for axis, length, log, color in zip(
        poses.subplots(1, 2, sharex=True, sharey=True), LENGTHS, logs, ("#1f5fa8", "#c2571a"), strict=True
    ):
        for k in range(SWING_UP + 1):
            p, th = log.x[k, :2]
            tip = (p - length * np.sin(th), length * np.cos(th))
            shade = 0.12 + 0.88 * k / SWING_UP
            axis.plot([p, tip[0]], [0, tip[1]], color=color, alpha=shade, linewidth=1.8)
            axis.plot(*tip, "o", color=color, alpha=shade, markersize=5)
            axis.plot(p, 0, "s", color="0.25", alpha=shade, markersize=7)
        axis.axhline(0, color="0.6", linewidth=0.8, zorder=0)
        axis.set(aspect="equal", xlabel="m", title=f"pole of {length} m, first {SWING_UP * 0.05:g} s")
        axes[0].plot(log.t, log.x[:, 1], color=color, label=f"{length} m")
        axes[1].step(log.t[:-1], log.u[:, 0], where="post", color=color)
    for bound in (-80, 80):
        axes[1].axhline(bound, color="#b3202c", linewidth=1.0)
    axes[0].annotate("blow", (2.0, 0.05), (2.0, 1.4), ha="center", arrowprops={"arrowstyle": "->"})
    axes[0].legend(frameon=False)
    axes[0].set(ylabel="angle [rad]", xlim=(0, logs[0].t[-1]))
    axes[1].set(ylabel="force [N]", xlabel="time [s]")
    for axis in axes:
        axis.grid(alpha=0.25)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/cart_pole.png") -> list[Log]:
    """Find the swing-up by SQP, follow it and keep the pole up by real-time iterations, for two poles."""
    controller = build(build_ocp(any_length=True), options())
    logs = []
    for length in LENGTHS:
        controller.reset()
        controller.set_parameter("length", length)
        solution = controller.solve(HANGING)
        print(f"{length} m: {solution.status.name}, {solution.iterations} iterations, cost {solution.cost:.4f}")
        logs.append(simulate(controller, HANGING, steps=80, disturbance=push, warm_start=True))
        print(logs[-1].summary())
    draw(logs, picture)
    return logs


if __name__ == "__main__":
    main(*sys.argv[1:])
