"""Stirred tank reactor with a cooling jacket: three set points in succession, one of them out of reach.

What it shows: bounds on states, references that change while the controller runs, and a sampling time (5 s) that is far
shorter than an interval of the plan (150 s), for which shift="resample" evaluates the old plan 5 s later.

The second set point violates the bounds th >= 98 and thK >= 92: the controller steers to the best admissible point.
Bounds hold at the nodes of the plan. With 150 s between nodes the reactor violates them in between by some 0.03 K. It
does not on a grid whose first interval is the sampling time, because the next sample is then a node.

Houska, Ferreau and Diehl, "An auto-generated real-time iteration algorithm for nonlinear MPC in the microsecond range",
Automatica 47 (2011), section 4.2 and figure 6; the model is that of Klatt and Engell. Time in seconds.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, Controller, Options, RealTimeIteration, build, simulate
from nmpc_codegen.runtime.loops.simulate import Log

K10, K20, K30 = 1.287e12, 1.287e12, 9.043e9
E1, E2, E3 = -9758.3, -9758.3, -8560.0
H1, H2, H3 = 4.2, -11.0, -41.85
RHO, CP, KW, AR, VR, MK, CPK, CA0, TH0 = 0.9342, 3.01, 4032.0, 0.215, 10.0, 5.0, 2.0, 5.1, 104.9
LOWEST = {"th": 98.0, "thK": 92.0}

# (cA, cB, th, thK, u1, u2)
SET_POINTS = (
    np.array([2.1402105, 1.0903044, 114.1910844, 112.9065929, 14.19, -1113.5]),
    np.array([3.51744722, 0.74003328, 87.00164887, 79.8045743, 8.256, -6239.0]),
    np.array([1.67416, 1.03579, 113.378, 112.094, 8.6133, -1113.5]),
)
REFINED = (5.0, 10.0, 20.0, 40.0, 75.0, *[150.0] * 9)  # s, 1500 in all
START = np.array([1.0, 0.5, 100.0, 100.0])
SAMPLING = 5.0
HOLD = 600  # samples per set point


def build_ocp(
    set_point: int = 0, N: int = 10, state_bounds: bool = True, intervals: Sequence[float] | None = None
) -> OCP:
    """1500 s in N equal intervals, or in the given ones, with one of the set points as reference."""
    ocp = OCP("cstr", intervals=intervals) if intervals else OCP("cstr", T=1500.0, N=N)
    cA = ocp.state("cA", unit="mol/l", initial=START[0])
    cB = ocp.state("cB", unit="mol/l", initial=START[1])
    th = ocp.state("th", unit="degC", initial=START[2])
    thK = ocp.state("thK", unit="degC", initial=START[3])
    u1 = ocp.control("u1", unit="1/h")
    u2 = ocp.control("u2", unit="kJ/h")

    # Rates are per hour.
    k1, k2, k3 = (k * ca.exp(E / (273.15 + th)) for k, E in ((K10, E1), (K20, E2), (K30, E3)))
    heat = (k1 * cA * H1 + k2 * cB * H2 + k3 * cA**2 * H3) / (RHO * CP)
    ocp.dynamics(
        {
            cA: (u1 * (CA0 - cA) - k1 * cA - k3 * cA**2) / 3600,
            cB: (-u1 * cB + k1 * cA - k2 * cB) / 3600,
            th: (u1 * (TH0 - th) + KW * AR / (RHO * CP * VR) * (thK - th) - heat) / 3600,
            thK: (u2 + KW * AR * (th - thK)) / (MK * CPK) / 3600,
        }
    )
    reference = SET_POINTS[set_point]
    Q = [0.2, 1.0, 0.5, 0.2]
    ocp.least_squares(ca.vertcat(ocp.x, u1, u2), weight=[*Q, 0.5, 5e-7], reference=reference)
    ocp.terminal_least_squares(ocp.x, weight=10 * np.array(Q), reference=reference[:4])
    ocp.subject_to(3, u1, 35)
    ocp.subject_to(-9000, u2, 0)
    if state_bounds:
        ocp.subject_to(LOWEST["th"], th, np.inf)
        ocp.subject_to(LOWEST["thK"], thK, np.inf)
    return ocp


def options() -> Options:
    """A sample is much shorter than an interval: the plan is evaluated one sample later, between its nodes."""
    return Options(algorithm=RealTimeIteration(sampling_time=SAMPLING))


def schedule(k: int, controller: Controller) -> None:
    """Set the next set point every HOLD samples; simulate() calls this before sample k."""
    if k % HOLD == 0:
        reference = SET_POINTS[k // HOLD]
        controller.set_reference(reference)
        controller.set_terminal_reference(reference[:4])


def draw(log: Log, coarse: Log, picture: str) -> None:
    """Plot states and controls with dotted set points and shaded forbidden regions; inset: both grids near th = 98."""
    traces = (*log.states, *log.controls)
    t = log.t / 60
    values = np.hstack([log.x, np.vstack([log.u, log.u[-1:]])]).T
    wanted = np.array([SET_POINTS[min(k // HOLD, len(SET_POINTS) - 1)] for k in range(len(t))]).T
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    for axis, trace, value, reference in zip(axes.flat, traces, values, wanted, strict=True):
        axis.step(t, reference, where="post", color="0.35", linewidth=1.2, linestyle=":", label="set point")
        axis.plot(t, value, color="#c2571a" if trace in log.controls else "#1f5fa8", linewidth=1.6)
        axis.set_ylabel(trace.label.replace("degC", "°C"))
        low, high = axis.get_ylim()
        lower, upper = (float(side[0]) for side in log.bounds(trace.name))
        for bound, far in ((lower, low), (upper, high)):
            if low <= bound <= high:
                axis.axhspan(bound, bound + 10 * (far - bound), color="#b3202c", alpha=0.12, linewidth=0)
                axis.axhline(bound, color="#b3202c", linewidth=1.0)
        axis.set_ylim(low, high)
        axis.margins(x=0)
        axis.grid(alpha=0.25)
    axes[0, 0].legend(frameon=False)
    axes[1, 0].set_ylim(bottom=80)
    inset = axes[1, 0].inset_axes((0.70, 0.11, 0.28, 0.36))
    inset.axhspan(97, LOWEST["th"], color="#b3202c", alpha=0.12, linewidth=0)
    inset.plot(t, coarse.x[:, 2], color="0.45", linewidth=1.2, linestyle="--")
    inset.plot(t, log.x[:, 2], color="#1f5fa8", linewidth=1.2)
    inset.text(69, 97.974, "150 s grid", fontsize=7, color="0.35")
    inset.text(70, 98.008, "refined grid", fontsize=7, color="#1f5fa8")
    inset.set(xlim=(55, 90), ylim=(97.96, 98.04), yticks=(98.0,), yticklabels=("98",))
    inset.tick_params(labelsize=7)
    for axis in axes[-1]:
        axis.set_xlabel("time [min]")
    figure.suptitle(
        "Stirred tank reactor ([H11], Fig. 6): the second set point is out of reach of th ≥ 98 and thK ≥ 92",
        fontsize=10,
    )
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/cstr.png") -> tuple[Log, Log]:
    """Simulate three set points for 3000 s each, sampled every 5 s, on the refined grid and on the uniform one."""
    logs = []
    for title, intervals in (("refined grid", REFINED), ("150 s grid", None)):
        controller = build(build_ocp(intervals=intervals), options())
        log = simulate(controller, START, steps=HOLD * len(SET_POINTS), dt=SAMPLING, before=schedule)
        th, thK = log.x[:, 2:].min(axis=0)
        print(f"{log.summary()}\n{title}: th down to {th:.6f}, thK down to {thK:.6f}\n")
        logs.append(log)
    draw(*logs, picture)
    return logs[0], logs[1]


if __name__ == "__main__":
    main(*sys.argv[1:])
