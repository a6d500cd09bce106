"""Evaporation process: an economic cost that is not convex, and a constant Hessian as cheap as that of tracking.

What it shows: stage_cost() in money per minute; the best steady state, which lies on the bound X2 >= 25; tune(), which
finds a positive definite Hessian M for it once and off line; why that needs the strictly active bound (eta = 1); a
controller with M, whose code contains no second derivatives.

A liquor is concentrated from 5 % to X2 by evaporation at the pressure P2. Steam of the pressure P100 heats it, cooling
water at the rate F200 condenses the vapour. Steam is dear, so the product is not concentrated beyond its limit.

Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020), section V.A; the model is that of Newell
and Lee in the form of Amrit, Rawlings and Biegler, Computers and Chemical Engineering 58 (2013). Time in minutes.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, RK4, ExactHessian, ExplicitRungeKutta, Options, ProblemError, Project, build, simulate
from nmpc_codegen.economic import SteadyState, Tuning, steady_state, tune
from nmpc_codegen.runtime.loops.simulate import Log

A, B, C, D, E, F, G, H = 0.5616, 0.3126, 48.43, 0.507, 55.0, 0.1538, 90.0, 0.16
M, CAPACITY, UA2, CP, LATENT, LATENT_STEAM = 20.0, 4.0, 6.84, 0.07, 38.5, 36.6
F1, X1, F3, T1, T200 = 10.0, 5.0, 50.0, 40.0, 25.0

#: Best steady state (X2, P2), (P100, F200), and its cost per minute, as printed in the paper.
STEADY = np.array([25.0, 49.743])
STEADY_CONTROL = np.array([191.713, 215.888])
STEADY_COST = 6210.38


def build_ocp(N: int = 200) -> OCP:
    """N intervals of one minute; the plan ends in the best steady state."""
    ocp = process(N)
    end = steady_state(ocp, options()).x
    ocp.subject_to(end, ocp.x, end, at="end")
    return ocp


def process(N: int, *, economic: bool = True) -> OCP:
    """Model, bounds and, with ``economic``, the cost.

    The end is stated by build_ocp(), to all digits: a rounded steady state is no fixed point of the discrete map.
    """
    ocp = OCP("evaporation", T=float(N), N=N, time_unit="min")
    X2 = ocp.state("X2", unit="%", initial=STEADY[0])
    P2 = ocp.state("P2", unit="kPa", initial=STEADY[1] + 5.0)
    P100 = ocp.control("P100", unit="kPa")
    F200 = ocp.control("F200", unit="kg/min")

    T2, T3, T100 = A * P2 + B * X2 + C, D * P2 + E, F * P100 + G
    Q100 = H * (F1 + F3) * (T100 - T2)
    F4 = (Q100 - F1 * CP * (T2 - T1)) / LATENT
    flow = 2 * CP * F200
    Q200 = UA2 * (T3 - T200) * flow / (flow + UA2)  # as in the paper, but finite without cooling water
    F2, F100, F5 = F1 - F4, Q100 / LATENT_STEAM, Q200 / LATENT
    ocp.dynamics({X2: (F1 * X1 - F2 * X2) / M, P2: (F4 - F5) / CAPACITY})

    if economic:
        ocp.stage_cost(10.09 * (F2 + F3) + 600 * F100 + 0.6 * F200)
    ocp.subject_to(25, X2, np.inf)
    ocp.subject_to(40, P2, 80)
    ocp.subject_to(0, P100, 400)
    ocp.subject_to(0, F200, 400)
    return ocp


def options(hessian: Any = None) -> Options:
    """One RK4 step per minute; without a Hessian the exact one, so that an export needs no semidefinite program."""
    return Options(integrator=ExplicitRungeKutta(RK4, steps=1), hessian=hessian or ExactHessian(Project()))


def tuned(N: int = 200, eta: int = 1) -> Tuning:
    """The tuning, in the units of the problem; eta=0, without the bound on X2, raises ProblemError."""
    return tune(build_ocp(N), options(), eta=eta)


def closed_loop(dP: float = 10.0, samples: int = 200, hessian: Any = None, N: int = 200) -> Log:
    """Start ``dP`` kPa above the best pressure, with the steady state as first plan."""
    ocp = build_ocp(N)
    best = steady_state(ocp, options())
    controller = build(ocp, options(hessian))
    controller.x[...], controller.u[...] = best.x, best.u
    return simulate(controller, best.x + np.array([0.0, dP]), steps=samples, dt=1.0)


def draw(log: Log, best: SteadyState, picture: str) -> None:
    """Plot states and controls with the best steady state, dotted."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for axis, trace, value, goal in zip(
        axes.flat, (*log.states, *log.controls), (*log.x.T, *log.u.T), best.w, strict=True
    ):
        axis.axhline(goal, color="0.35", linewidth=1.2, linestyle=":")
        axis.plot(log.t[: len(value)], value, color="#c2571a" if trace in log.controls else "#1f5fa8", linewidth=1.6)
        axis.set_ylabel(trace.label)
        axis.margins(x=0)
        if np.ptp(value) < 1e-2 * abs(goal):
            axis.set_ylim(0.95 * goal, 1.05 * goal)
        axis.grid(alpha=0.25)
    for axis in axes[-1]:
        axis.set_xlabel("time [min]")
    figure.suptitle("Evaporation process: back to the most economic steady state", fontsize=11)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=100)


def main(picture: str = "out/evaporation.png") -> tuple[Tuning, Log]:
    """Print the tuning and why eta = 0 has none; simulate M from 10 kPa above the best pressure."""
    tuning = tuned()
    print(tuning)
    try:
        tuned(eta=0)
    except ProblemError as error:
        print(f"without the bound: {error}")
    log = closed_loop(hessian=tuning.hessian())
    print(log.summary())
    draw(log, steady_state(build_ocp(), options()), picture)
    return tuning, log


if __name__ == "__main__":
    main(*sys.argv[1:])
