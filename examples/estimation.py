"""Cart whose position alone is measured: a moving horizon estimator beside the controller that uses its estimates.

What it shows: an estimator as a problem with a free initial state, whose references are the last measurements and whose
parameters are the last controls; a slope that neither of both knows, estimated as a constant state.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from nmpc_codegen import OCP, Controller, Options, RealTimeIteration, build

Array = NDArray[np.float64]

DT, BACK, AHEAD = 0.05, 20, 20  # s; intervals of the estimator and of the controller
NOISE = 0.004  # m, standard deviation of a measurement
SAMPLES = 240
MASS, DRAG = 0.5, 0.4  # kg, N s/m


def acceleration(v: ca.SX, F: ca.SX, slope: ca.SX) -> ca.SX:
    """v' of the cart; ``slope`` (m/s^2) is what the force does not explain."""
    return (F - DRAG * v) / MASS + slope


def build_estimator() -> OCP:
    """The last 20 intervals: 1/2 |p - measured|^2 / NOISE^2, and small changes of the slope."""
    ocp = OCP("estimator", T=BACK * DT, N=BACK)
    p, v = ocp.state("p", unit="m"), ocp.state("v", unit="m/s")
    slope = ocp.state("slope", unit="m/s^2")
    change = ocp.control("change", unit="m/s^3")
    F = ocp.parameter("F", unit="N")
    ocp.dynamics({p: v, v: acceleration(v, F, slope), slope: change})
    ocp.free_initial(p, v, slope)
    ocp.least_squares(ca.vertcat(p, change), weight=[NOISE**-2, 1.0], names=["measured", "change"])
    ocp.terminal_least_squares(p, weight=NOISE**-2, names=["measured"])
    ocp.subject_to(-1, slope, 1)
    return ocp


def build_ocp() -> OCP:
    """The next 20 intervals: go to the reference, on a slope that is a parameter; at most 1.5 N and 0.6 m/s."""
    ocp = OCP("cart", T=AHEAD * DT, N=AHEAD)
    p, v = ocp.state("p", unit="m"), ocp.state("v", unit="m/s")
    F = ocp.control("F", unit="N")
    slope = ocp.parameter("slope", unit="m/s^2")
    ocp.dynamics({p: v, v: acceleration(v, F, slope)})
    ocp.least_squares(ca.vertcat(p, v, F + MASS * slope), weight=[20, 1, 0.2], names=["p", "v", "push"])
    ocp.terminal_least_squares(ca.vertcat(p, v), weight=[200, 20])
    ocp.subject_to(-1.5, F, 1.5)
    ocp.subject_to(-0.6, v, 0.6, soft=(50, 50))
    return ocp


def estimate(estimator: Controller, measured: list[float], applied: list[float]) -> Array:
    """Present state and slope from the last measurements and the forces between them."""
    estimator.set_reference(np.column_stack([measured[-BACK - 1 : -1], np.zeros(BACK)]))
    estimator.set_terminal_reference(measured[-1:])
    estimator.set_parameter("F", [*applied[-BACK:], 0.0])
    estimator.step(np.zeros(3))  # x_0 is free: what is given is ignored
    return np.array(estimator.x[-1])


def run(seed: int = 1) -> dict[str, Array]:
    """12 s of the loop: the reference jumps at 4 s, the slope at 8 s."""
    random = np.random.default_rng(seed)
    estimator = build(build_estimator(), Options(algorithm=RealTimeIteration(shift="repeat")))
    controller = build(build_ocp())
    x, measured, applied = np.zeros(2), [0.0] * (BACK + 1), [0.0] * BACK
    log: dict[str, list[Array]] = {name: [] for name in ("x", "measured", "estimate", "slope", "F", "wanted", "time")}
    for k in range(SAMPLES):
        slope, wanted = (-0.3 if k < 160 else 0.4), (0.5 if k < 80 else -0.2)
        measured.append(x[0] + NOISE * random.standard_normal())
        found = estimate(estimator, measured, applied)
        controller.set_parameter("slope", found[2])
        controller.set_reference({"p": wanted})
        controller.set_terminal_reference({"p": wanted})
        F = controller.step(found[:2])
        applied.append(F[0])
        values = (x, measured[-1], found, slope, F[0], wanted, [estimator.time_ns, controller.time_ns])
        for name, value in zip(log, values, strict=True):
            log[name].append(np.array(value))
        for _ in range(10):
            x = x + DT / 10 * np.array([x[1], float(acceleration(x[1], F[0], slope))])
    return {name: np.array(values) for name, values in log.items()}


def draw(log: dict[str, Array], picture: str) -> None:
    """Position, speed, slope and force; what the estimator finds is orange."""
    t = DT * np.arange(SAMPLES)
    figure = Figure(figsize=(8, 7), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    axes[0].plot(t, log["measured"], ".", color="0.7", markersize=3, label="measured")
    axes[0].step(t, log["wanted"], where="post", color="0.2", linewidth=0.8, label="reference")
    truth = (log["x"][:, 0], log["x"][:, 1], log["slope"])
    for i, (axis, name) in enumerate(zip(axes, ("p [m]", "v [m/s]", "slope [m/s²]", "F [N]"), strict=True)):
        axis.set_ylabel(name)
        axis.grid(alpha=0.25)
        if i < 3:
            axis.plot(t, truth[i], color="#1f5fa8", linewidth=1.6, label="true")
            axis.plot(t, log["estimate"][:, i], color="#c2571a", linewidth=1.0, label="estimated")
    axes[3].step(t, log["F"], where="post", color="#3f7d4e")
    for axis, bound in ((axes[1], 0.6), (axes[3], 1.5)):
        for side in (-bound, bound):
            axis.axhline(side, color="0.45", linewidth=1.0, linestyle="--")
    axes[0].legend(frameon=False, ncols=4, fontsize=8)
    axes[3].set_xlabel("time [s]")
    axes[3].margins(x=0)
    median = np.median(log["time"], axis=0) / 1e3
    figure.suptitle(f"Estimator and controller: {median[0]:.1f} and {median[1]:.1f} us per sample", fontsize=11)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/estimation.png") -> dict[str, Array]:
    """Run the loop and draw it."""
    log = run()
    error = np.abs(log["estimate"] - np.column_stack([log["x"], log["slope"]]))
    settled = np.r_[60:80, 140:160, 220:240]
    print(f"largest errors of the settled estimates: {error[settled].max(axis=0)}")
    print(f"largest distance from the reference: {np.abs(log['x'][settled, 0] - log['wanted'][settled]).max():.4f} m")
    draw(log, picture)
    return log


if __name__ == "__main__":
    main(*sys.argv[1:])
