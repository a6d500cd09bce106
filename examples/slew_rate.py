"""Crane whose drive takes time: a limit of the slew rate of its force, and few values of the force over a long horizon.

What it shows: `ocp.rate(u)` in a row and in the cost; `control(hold=...)`; `set_previous()`, where the drive does
something else than what it was told. The plan of a sample then starts from the force that acts.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from nmpc_codegen import OCP, build

Array = NDArray[np.float64]

DT, N, SAMPLES = 0.1, 30, 80
LIMIT, FASTEST = 4.0, 6.0  # m/s^2 and m/s^3
#: Lengths of the blocks of intervals with one value each: ten values over three seconds.
BLOCKS = (1, 1, 1, 1, 2, 2, 4, 4, 6, 8)
#: Samples in which the drive is stuck.
STUCK = range(22, 30)


def build_ocp(limited: bool = True) -> OCP:
    """Trolley p and load at the angle q; ``limited``: |a'| <= 6 m/s^3, at a small cost, and blocks of intervals."""
    ocp = OCP("slew_rate", T=N * DT, N=N)
    p, v = ocp.state("p", unit="m"), ocp.state("v", unit="m/s")
    q, w = ocp.state("q", unit="rad"), ocp.state("w", unit="rad/s")
    a = ocp.control("a", unit="m/s^2", hold=BLOCKS if limited else None)
    ocp.dynamics({p: v, v: a, q: w, w: -9.81 * ca.sin(q) - a * ca.cos(q)})
    ocp.least_squares(ca.vertcat(p, v, q, w, a), weight=[5, 0.5, 5, 0.5, 0.02], reference=[1, 0, 0, 0, 0])
    ocp.terminal_least_squares(ca.vertcat(p, v, q, w), weight=[100, 20, 100, 10], reference=[1, 0, 0, 0])
    ocp.subject_to(-LIMIT, a, LIMIT)
    if limited:
        ocp.least_squares(ocp.rate(a), weight=2e-3, names="slew")
        ocp.subject_to(-FASTEST, ocp.rate(a), FASTEST, name="slew")
    return ocp


def run(limited: bool, told: bool = True) -> dict[str, Array]:
    """8 s of the loop. The drive cannot do more than FASTEST and is stuck for a while; ``told``: set_previous()."""
    controller = build(build_ocp(limited))
    x, applied = np.zeros(4), 0.0
    log: dict[str, list[Array]] = {name: [] for name in ("x", "told", "applied", "status")}
    for k in range(SAMPLES):
        a = float(controller.step(x)[0])
        acts = applied if k in STUCK else float(np.clip(a, applied - FASTEST * DT, applied + FASTEST * DT))
        if limited and told:
            controller.set_previous([acts])
        for name, value in zip(log, (x, a, acts, controller.status), strict=True):
            log[name].append(np.asarray(value, dtype=float))
        x, applied = controller.integrate(x, [acts], DT), acts
    return {name: np.array(values) for name, values in log.items()}


def draw(logs: dict[str, dict[str, Array]], picture: str) -> None:
    """Position, angle and acceleration; what was asked for is dashed."""
    t = DT * np.arange(SAMPLES)
    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    for (label, log), color in zip(logs.items(), ("#c2571a", "#1f5fa8"), strict=True):
        for axis, values in zip(axes, (log["x"][:, 0], log["x"][:, 2], log["applied"]), strict=True):
            axis.step(t, values, where="post", color=color, label=label)
        axes[2].step(t, log["told"], where="post", color=color, linewidth=0.8, linestyle="--")
    for axis, name in zip(axes, ("p [m]", "q [rad]", "a [m/s²]"), strict=True):
        axis.set_ylabel(name)
        axis.grid(alpha=0.25)
        axis.axvspan(DT * STUCK[0], DT * (STUCK[-1] + 1), color="0.5", alpha=0.15, linewidth=0)
    axes[0].legend(frameon=False)
    axes[2].set_xlabel("time [s]")
    axes[2].margins(x=0)
    figure.suptitle("Crane with a slow drive, which is stuck for a while; dashed: what it is told", fontsize=11)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/slew_rate.png") -> dict[str, dict[str, Array]]:
    """Run the loop with a controller that knows nothing of the drive, and with one that does, and draw them."""
    logs = {"slew rate unknown": run(limited=False), "slew rate in the problem": run(limited=True)}
    for label, log in logs.items():
        error = np.abs(log["told"] - log["applied"])
        free = np.setdiff1d(np.arange(SAMPLES), STUCK)
        swing = np.abs(log["x"][:, 2]).max()
        print(f"{label}: largest angle {swing:.3f} rad, the drive misses up to {error[free].max():.2f} m/s^2")
    draw(logs, picture)
    return logs


if __name__ == "__main__":
    main(*sys.argv[1:])
