"""Level of a tank with a pump of unknown gain and an unknown leak: tracking without offset.

What it shows: integral action. The cost has the rate of the control, `ocp.rate(u)`, in the place of the control, so
that no value of the control is dearer than another; the error of the model is a parameter that an estimator finds from
the measured level. Both together leave no offset, whatever the model is wrong about. Either of them alone leaves one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from nmpc_codegen import OCP, Log, build, simulate

Array = NDArray[np.float64]

DT, N, SAMPLES = 5.0, 20, 120  # s
GAIN, REAL_GAIN = 0.020, 0.016  # m/s at full speed, as it is believed and as it is
OUTFLOW, LEAK = 0.012, 0.002  # m^0.5/s, m/s
LEAK_FROM = 60  # sample
NOISE, DRIFT = 0.001, 5e-4  # m of a measurement; m/s by which the error of the model may change from sample to sample


def build_ocp(integral: bool = True) -> OCP:
    """Level h of the tank, whose pump has the speed s; ``integral``: the cost has the rate of the speed."""
    ocp = OCP("offset_free", T=N * DT, N=N)
    h = ocp.state("h", initial=0.3, unit="m")
    s = ocp.control("s")
    error = ocp.parameter("error", unit="m/s")
    ocp.dynamics({h: GAIN * s - OUTFLOW * ca.sqrt(h + 1e-3) + error})
    ocp.least_squares(h, weight=200, reference=0.5)
    ocp.least_squares(ocp.rate(s) if integral else s, weight=50 if integral else 0.5, names="effort")
    ocp.terminal_least_squares(h, weight=1000, reference=0.5)
    ocp.subject_to(0, s, 1)
    return ocp


def move(x: Array, u: Array, dt: float) -> Array:
    """The tank as it is, without its leak."""
    h = x[0]
    for _ in range(20):
        h += dt / 20 * (REAL_GAIN * u[0] - OUTFLOW * np.sqrt(h + 1e-3))
    return np.array([h])


def run(integral: bool, corrected: bool, seed: int | None = None) -> Log:
    """10 min of the loop: the level goes to 0.5 m, and at 5 min the tank begins to leak; ``seed``: of noise."""
    ocp = build_ocp(integral)
    deviations = {
        "noise_std": {"h": NOISE},
        "process_std": {"error": DRIFT},
        "initial_std": {"h": NOISE, "error": 0.01},
    }
    estimator = ocp.estimator(N=10, measure={"h": ocp.x}, **deviations) if corrected else None

    def leak(k: int, x: Array) -> Array:
        return np.array([-DT * LEAK if k >= LEAK_FROM else 0.0])

    observer = None if estimator is None else build(estimator)
    return simulate(build(ocp), [0.3], SAMPLES, plant=move, disturbance=leak, estimator=observer, seed=seed)


#: Label -> the cost has the rate of the control; the error of the model is estimated.
LOOPS = {"neither": (False, False), "rate alone": (True, False), "rate and estimated error": (True, True)}


def draw(logs: dict[str, Log], picture: str) -> None:
    """Level and speed of the pump."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    for (label, log), color in zip(logs.items(), ("0.55", "#c2571a", "#1f5fa8"), strict=True):
        axes[0].plot(log.t / 60, log.x[:, 0], color=color, label=label)
        axes[1].step(log.t[:-1] / 60, log.u[:, 0], where="post", color=color)
    axes[0].axhline(0.5, color="0.3", linewidth=0.8)
    for axis, name in zip(axes, ("h [m]", "speed of the pump"), strict=True):
        axis.set_ylabel(name)
        axis.grid(alpha=0.25)
        axis.axvline(DT * LEAK_FROM / 60, color="#b3202c", linewidth=0.8, linestyle="--")
    axes[0].legend(frameon=False, loc="lower right", ncols=3, fontsize=9)
    axes[1].set_xlabel("time [min]")
    axes[1].margins(x=0)
    figure.suptitle("Tank with a pump of unknown gain; it leaks after the dashed line", fontsize=11)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/offset_free.png") -> dict[str, Log]:
    """Run the loops and draw them."""
    logs = {label: run(*which) for label, which in LOOPS.items()}
    for label, log in logs.items():
        before, after = log.x[LEAK_FROM, 0] - 0.5, log.x[-1, 0] - 0.5
        print(f"{label}: offset {1e3 * before:+.3f} mm before the leak, {1e3 * after:+.3f} mm with it")
    draw(logs, picture)
    return logs


if __name__ == "__main__":
    main(*sys.argv[1:])
