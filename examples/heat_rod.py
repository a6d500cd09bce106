"""Heat rod: 100 states and two controls, a temperature at either end.

What it shows: many states and few controls, where single shooting with adjoints needs neither the memory nor the
operations of transition matrices of 100 x 102; a vector of states; fixed steps of an explicit scheme at its limit of
stability.

    psi_i' = c (psi_{i-1} - 2 psi_i + psi_{i+1}),   psi_0 = u_1,   psi_{n+1} = u_2,   c = kappa (n + 1)^2

With c instead of kappa fixed the number of integration steps does not depend on n: RK4 is stable for h < 2.78 / (4 c).
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, RK4, AdjointShooting, ExplicitRungeKutta, Online, Options, build, simulate
from nmpc_codegen.runtime.loops.simulate import Log

STATES, N, INTERVAL, STEPS = 100, 20, 5.0, 5
C = 0.5  # 1/s
START, ENDS = 20.0, (80.0, 40.0)  # degC: at first, and wanted at the ends of a linear profile
HOTTEST = 90.0  # degC, of a control


def profile(states: int = STATES) -> np.ndarray:
    """The wanted temperatures (states,), those of a steady state."""
    return np.interp(np.arange(1, states + 1), [0, states + 1], ENDS)


def build_ocp(states: int = STATES, intervals: int = N) -> OCP:
    """Bring the rod to the profile; temperatures at its ends between 0 and 90 degC."""
    ocp = OCP("heat_rod", T=INTERVAL * intervals, N=intervals)
    psi = ocp.state("psi", size=states, unit="degC", initial=START)
    left, right = ocp.control("left", unit="degC"), ocp.control("right", unit="degC")
    ends = ca.vertcat(left, psi, right)
    ocp.dynamics({psi: C * (ends[:-2] - 2 * psi + ends[2:])})
    reference = np.concatenate([profile(states), ENDS])
    weight = np.concatenate([np.ones(states), [0.1, 0.1]])
    ocp.least_squares(ca.vertcat(psi, left, right), weight=weight, reference=reference)
    ocp.terminal_least_squares(psi, weight=10 * np.ones(states), reference=reference[:-2])
    ocp.subject_to(0, left, HOTTEST)
    ocp.subject_to(0, right, HOTTEST)
    return ocp


def options() -> Options:
    """One reference for all nodes, as memory is the point."""
    return Options(
        integrator=ExplicitRungeKutta(RK4, steps=STEPS),
        algorithm=AdjointShooting(sampling_time=INTERVAL),
        online=Online(reference="shared", weight="fixed"),
        solve=False,
    )


def draw(log: Log, picture: str) -> None:
    """The temperature over time and place, and the controls."""
    minutes = log.t / 60
    figure = Figure(figsize=(9, 5), layout="constrained")
    field, controls = figure.subplots(1, 2, width_ratios=(1.3, 1))
    image = field.imshow(
        log.x.T, aspect="auto", origin="lower", cmap="inferno", extent=(0, minutes[-1], 1, log.x.shape[1])
    )
    figure.colorbar(image, ax=field, label="temperature [°C]")
    field.set(xlabel="time [min]", ylabel="element of the rod")
    for j, (name, color) in enumerate((("left end", "#c2571a"), ("right end", "#1f5fa8"))):
        controls.step(minutes[:-1], log.u[:, j], where="post", color=color, linewidth=1.5, label=name)
        controls.axhline(ENDS[j], color=color, linewidth=1.0, linestyle=":")
    controls.axhline(HOTTEST, color="#b3202c", linewidth=1.0)
    controls.set(xlabel="time [min]", ylabel="control [°C]", ylim=(30, 95))
    controls.legend(frameon=False)
    controls.grid(alpha=0.25)
    figure.suptitle("Heat rod with 100 states, brought to a linear profile from its ends", fontsize=11)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/heat_rod.png") -> Log:
    """Simulate an hour of the closed loop."""
    controller = build(build_ocp(), options())
    log = simulate(controller, np.full(STATES, START), steps=720, dt=INTERVAL)
    off = np.abs(log.x[-1] - profile()).max()
    print(f"{log.summary()}\n{controller.nbytes:,} bytes; at the end {off:.2g} degC off the profile")
    draw(log, picture)
    return log


if __name__ == "__main__":
    main(*sys.argv[1:])
