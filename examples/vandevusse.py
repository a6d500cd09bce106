"""Van de Vusse reactor: output constraints as exact penalties in single shooting, resolved with a growing weight.

What it shows: `AdjointShooting`, which stores no derivative of the dynamics; soft rows whose weight is increased until
they hold, one plan after the other; a reference per node; a plan of 100 intervals by `solve()`; a cost that is
integrated over time, and rows that are penalised along the intervals.

The controlled outputs are the concentration cB and the temperature T. Their references move on a ramp from one steady
state to another one, which violates cB <= 800 and T <= 100. With the penalty mu (|cB - 800|_+ + 5 |T - 100|_+) per node
the rows are violated for mu = 10 and hold for mu = 20, because 20 exceeds all of their multipliers in these units.

The objective (7.16) of the thesis is the integral of the same terms over time, by the points of the integrator. As the
integral of a short excess is small, its penalties need more weight than those of the nodes.

"Adjoint-based derivative evaluation methods for nonlinear model predictive control", thesis, 2009, sections 6.6, 7.4.
Time in hours.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import (
    OCP,
    RK4,
    AdjointShooting,
    Controller,
    ExplicitRungeKutta,
    Online,
    Options,
    build,
    smooth_excess,
)
from nmpc_codegen.runtime.controller import Solution

ALPHA, BETA, GAMMA, DELTA, CIN, TIN = 30.8285, 86.668, 100.0, 3.556e-4, 5100.0, 104.9
SAMPLING = 0.02  # h
N = 100
HIGHEST = {"cB": 800.0, "T": 100.0}
WEIGHTS = {"cB": 1.0, "T": 5.0}  # of the penalties
WEIGHT = np.array([0.1, 10.0, 10.0, 10.0])  # of (cB, T, u1, u2)
WIDTH = 0.01  # over which the penalties of the integral are rounded off
#: Controls of the steady states at both ends of the ramp.
ENDS = (np.array([8.256, -6.239]), np.array([18.037, -4.556]))
RAMP = (20, 60)  # its first and last step
PENALTIES = (0.0, 10.0, 20.0)
INTEGRAL_PENALTIES = (20.0, 80.0)
#: Weight of the rows of the augmented Lagrangian in their scales, about 100 degC and 800 mol/m^3: the curvature 10 of
#: the cost along T, times 100^2.
PENALTY = 1e5


def rates(x: ca.SX, u: ca.SX) -> ca.SX:
    """d (cA, cB, T, Tc) / dt."""
    cA, cB, T, Tc = ca.vertsplit(x)
    u1, u2 = ca.vertsplit(u)
    k1 = 1.287e12 * ca.exp(-9758.3 / (T + 273.15))
    k2 = 9.042e6 * ca.exp(-8560 / (T + 273.15))
    heat = -DELTA * (k1 * (4.2 * cA - 11 * cB) - 41.85 * k2 * cA**2)
    return ca.vertcat(
        -k1 * cA - k2 * cA**2 + (CIN - cA) * u1,
        k1 * (cA - cB) - cB * u1,
        heat + ALPHA * (Tc - T) + (TIN - T) * u1,
        BETA * (T - Tc) + GAMMA * u2,
    )


def steady_state(u: np.ndarray) -> np.ndarray:
    """The state (4,) in which the reactor stays under the controls u (2,)."""
    x = ca.SX.sym("x", 4)
    find = ca.rootfinder("steady", "newton", {"x": x, "g": rates(x, ca.SX(u))})
    return np.asarray(find([2500.0, 900.0, 100.0, 95.0], []), dtype=float).ravel()


def reactor(name: str, intervals: int = N) -> tuple[OCP, ca.SX]:
    """The reactor in its first steady state, and what follows references: (cB, T, u1, u2)."""
    ocp = OCP(name, T=SAMPLING * intervals, N=intervals, time_unit="h")
    first = steady_state(ENDS[0])
    cA = ocp.state("cA", unit="mol/m^3", initial=first[0])
    cB = ocp.state("cB", unit="mol/m^3", initial=first[1])
    T = ocp.state("T", unit="degC", initial=first[2])
    Tc = ocp.state("Tc", unit="degC", initial=first[3])
    u1 = ocp.control("u1", unit="1/h")
    u2 = ocp.control("u2", unit="K/h")
    ocp.dynamics(rates(ca.vertcat(cA, cB, T, Tc), ca.vertcat(u1, u2)))
    return ocp, ca.vertcat(cB, T, u1, u2)


def build_ocp(penalty: float | None = None, intervals: int = N) -> OCP:
    """A sum over the nodes. penalty: of the rows; 0: no rows, None: hard ones."""
    ocp, outputs = reactor("vandevusse", intervals)
    ocp.least_squares(outputs, weight=WEIGHT, reference=ramp()[0])
    for row in ca.vertsplit(outputs[:2]) if penalty != 0 else ():
        soft = None if penalty is None else (penalty * WEIGHTS[row.name()], 0.0)
        ocp.subject_to(-np.inf, row, HIGHEST[row.name()], soft=soft)
    return ocp


def build_integral_ocp(penalty: float, width: float = WIDTH) -> OCP:
    """(7.16): the integral over time of the same cost and of the penalties, rounded off over ``width``."""
    ocp, outputs = reactor("vandevusse_integral")
    off = outputs - ocp.parameter("reference", size=4, value=ramp()[0])
    excess = smooth_excess(-np.inf, outputs[:2], list(HIGHEST.values()), width)
    rate = ca.dot(WEIGHT * off, off) / 2 + penalty * ca.dot(ca.DM(list(WEIGHTS.values())), excess)
    ocp.stage_cost(rate, integrate=True)
    return ocp


def options() -> Options:
    """Single shooting; 4 RK4 steps per interval have an error of 6e-4 in cB, one step 0.3."""
    return Options(
        integrator=ExplicitRungeKutta(RK4, steps=4),
        algorithm=AdjointShooting(penalty=PENALTY),
        online=Online(bounds="fixed"),
    )


def ramp(first: int = RAMP[0], last: int = RAMP[1], nodes: int = N + 1) -> np.ndarray:
    """References (nodes, 4) of (cB, T, u1, u2)."""
    ends = [np.concatenate([steady_state(u)[1:3], u]) for u in ENDS]
    part = np.clip((np.arange(nodes) - first) / (last - first), 0.0, 1.0)[:, None]
    return np.asarray(ends[0] + part * (ends[1] - ends[0]))


def plan(controller: Controller, reference: np.ndarray, tol: float = 1e-7, most: int = 500) -> Solution:
    """Solve from the controls of the references, in ``most`` iterations at most."""
    if controller.dims.ny:
        controller.set_reference(reference[:-1])
    else:
        controller.set_parameter("reference", reference)
    controller.u = reference[:-1, 2:]
    return controller.solve(steady_state(ENDS[0]), tol=tol, max_iterations=most)


def excess(controller: Controller, found: Solution, points: int = 10) -> np.ndarray:
    """What the plan exceeds the bounds of cB and T by, (N * points + 1, 2): at ``points`` times of every interval."""
    x = [found.x[0]]
    for u in found.u:
        for _ in range(points):
            x.append(controller.integrate(x[-1], u, SAMPLING / points))
    return np.array(x)[:, 1:3] - list(HIGHEST.values())


def draw(plans: Mapping[str, Solution], reference: np.ndarray, picture: str) -> None:
    """Outputs and controls of the plans, with their references and bounds."""
    time = 60 * SAMPLING * np.arange(N + 1)
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    names = ("cB [mol/m³]", "T [°C]", "u1 [1/h]", "u2 [K/h]")
    colors = ("0.55", "#c2571a", "#1f5fa8", "#6fb1e0", "#2f8f5b")
    for i, (axis, name) in enumerate(zip(axes.flat, names, strict=True)):
        axis.plot(time, reference[:, i], color="0.2", linewidth=1.0, linestyle=":", label="reference")
        for (label, found), color in zip(plans.items(), colors, strict=True):
            style = {"color": color, "linewidth": 1.5, "linestyle": "--" if "integral" in label else "-"}
            if i < 2:
                axis.plot(time, found.x[:, 1 + i], label=label, **style)
            else:
                axis.step(time[:-1], found.u[:, i - 2], where="post", **style)
        if i < 2:
            bound = tuple(HIGHEST.values())[i]
            top = axis.get_ylim()[1]
            axis.axhspan(bound, top, color="#b3202c", alpha=0.12, linewidth=0)
            axis.axhline(bound, color="#b3202c", linewidth=1.0)
            axis.set_ylim(top=top)
        axis.set_ylabel(name)
        axis.margins(x=0)
        axis.grid(alpha=0.25)
    axes[0, 0].legend(frameon=False, fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time [min]")
    figure.suptitle(
        "Van de Vusse reactor ([T09], Fig. 7.3): the penalty is exact as soon as it exceeds the multipliers",
        fontsize=11,
    )
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/vandevusse.png") -> dict[str, Solution]:
    """Plans with growing weights, and what they violate."""
    reference, plans = ramp(), {}
    problems = {f"penalty {p:g}": build_ocp(p) for p in PENALTIES}
    problems |= {f"integral, penalty {p:g}": build_integral_ocp(p) for p in INTEGRAL_PENALTIES}
    for label, ocp in problems.items():
        controller = build(ocp, options())
        found = plans[label] = plan(controller, reference)
        nodes, worst = (e.max(axis=0) for e in (excess(controller, found, 1), excess(controller, found)))
        print(
            f"{label:21}: {found.status.name}, {found.iterations} iterations, {controller.nbytes:,} bytes; "
            f"cB - 800 <= {nodes[0]:.2g} at the nodes, {worst[0]:.2g} between them, "
            f"T - 100 <= {nodes[1]:.2g}, {worst[1]:.2g}"
        )
    draw(plans, reference, picture)
    return plans


if __name__ == "__main__":
    main(*sys.argv[1:])
