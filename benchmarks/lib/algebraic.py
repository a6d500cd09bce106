"""Models with algebraic equations are measured against IPOPT, in closed loops, and against elimination by hand."""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.stiff import LOOPS, code_bytes, loops, optimum
from examples import rope_crane
from examples.rope_crane import CART, DAMPING, GRAVITY, LENGTH, STRONGEST
from nmpc_codegen import (
    OCP,
    SDIRK3,
    ImplicitRungeKutta,
    Options,
    build,
    generate,
    simulate,
)
from nmpc_codegen.frontend.classify import classify
from verification import algebraic

#: Residual of an equation, relative to the terms in it that contain z; samples of the long loops.
RESIDUAL, SAMPLES = 1e-12, 10_000


def measure(report: Report, asked: Run) -> None:
    """Measure all figures, with a line per problem."""
    for name in asked.cases(algebraic.PROBLEMS):
        case = algebraic.PROBLEMS[name]
        for route, options in algebraic.ROUTES.items():
            optimum(report, name, case, options, f"optimum, {route}")
        loops(report, name, case, algebraic.Plant(case.make()), asked.share(LOOPS, 3))
    _long_loop(report, asked.share(SAMPLES, 200))
    _drift(report, asked.share(SAMPLES, 200))
    _beside(report, "battery", {"stated": algebraic.battery(), "by hand": battery_by_hand()})
    _beside(report, "crane", {"stated": rope_crane.build_ocp(), "by hand": crane_by_hand()})


# -- long loops -------------------------------------------------------------------------------------------------------


def _long_loop(report: Report, samples: int) -> None:
    """Measure the residual of the charge balance in a loop with changing references."""
    ocp, reference = algebraic.neutralisation(), 7 + np.sin(np.arange(samples) / 7.0)
    log = simulate(build(ocp, profile="fast"), classify(ocp).x_initial[:3], samples, references={"pH": reference})
    left = algebraic.residual(ocp, log.x[:-1], log.z, log.u)
    report.add("residual of g", left, case="neutralisation", n=samples, limit=RESIDUAL)
    report.add("samples not OK", int(np.sum(log.status != 0)), case="neutralisation", n=samples)


def _drift(report: Report, samples: int) -> None:
    """Measure the constraint error of the rope length while the crane moves to and fro."""
    goal = np.where(np.arange(samples) // 60 % 2, 1.0, 0.0)
    ctrl, start = build(rope_crane.build_ocp(), profile="fast"), [1.0, 0.0, 1.0, -LENGTH, 0.0, 0.0]
    log = simulate(ctrl, start, samples, references={"s": goal, "p[0]": goal})
    stretch = np.abs(rope_crane.stretch(log))
    report.add("drift of the length", float(np.max(stretch)), "m", case="crane", n=samples)
    report.add("drift at the end", float(np.max(stretch[-60:])), "m", case="crane", n=samples)


# -- beside elimination by hand ---------------------------------------------------------------------------------------


def battery_by_hand() -> OCP:
    """Return the OCP of the battery, whose current is the smaller solution of a quadratic equation."""
    ocp = OCP("battery", T=20.0, N=20, time_unit="min")
    q, vp = ocp.state("q", initial=0.8), ocp.state("vp", unit="V")
    T, P = ocp.state("T", initial=30.0, unit="degC"), ocp.control("P", unit="kW")
    demand = ocp.parameter("demand", value=60.0, unit="kW")
    U = 350 + 60 * q - 10 * ca.exp(-20 * q) - vp
    R = 0.12 * ca.exp(0.02 * (30 - T))
    current = (U - ca.sqrt(U**2 - 4e3 * R * P)) / (2 * R)
    heat = 60 * (R * current**2 / 1e5 - 12 * (T - 25) / 1e5)
    ocp.dynamics({q: -current / (60 * 250.0), vp: 60 * (current / 3000 - vp / 120), T: heat})
    ocp.least_squares(P - demand, weight=1.0)
    ocp.subject_to(0, P, 100)
    ocp.subject_to(-np.inf, current, 180.0)
    ocp.subject_to(-np.inf, T, 45.0, soft=(1e3, 1e3))
    return ocp


def crane_by_hand() -> OCP:
    """Return the OCP of the crane with its tension eliminated.

    (r'r / load + r_x^2 / cart) tension equals the other terms of the length equation.
    """
    ocp = OCP("rope_crane", T=3.0, N=30)
    s, vs = ocp.state("s", initial=1.0, unit="m"), ocp.state("vs", unit="m/s")
    p, v = ocp.state("p", size=2, initial=[1.0, -LENGTH], unit="m"), ocp.state("v", size=2, unit="m/s")
    F, load = ocp.control("F", unit="N"), ocp.parameter("load", value=1.0, unit="kg")
    rope, turning = ca.vertcat(p[0] - s, p[1]), ca.vertcat(v[0] - vs, v[1])
    damped = 2 * DAMPING * ca.dot(rope, turning) + DAMPING**2 * (ca.sumsqr(rope) - LENGTH**2) / 2
    others = ca.sumsqr(turning) + damped - GRAVITY * rope[1] - rope[0] * F / CART
    tension = others / (ca.sumsqr(rope) / load + rope[0] ** 2 / CART)
    fall = -tension * rope / load - ca.vertcat(0, GRAVITY)
    ocp.dynamics({s: vs, p: v, vs: (F + tension * rope[0]) / CART, v: fall})
    ocp.least_squares(ca.vertcat(s, p[0], vs, v[0], F), weight=[10, 10, 1, 1, 0.05])
    ocp.terminal_least_squares(ca.vertcat(s, p[0], vs, v[0]), weight=20)
    ocp.subject_to(-10, F, 10)
    ocp.subject_to(-ca.inf, tension, STRONGEST, soft=(10, 10))
    return ocp


def _beside(report: Report, name: str, ocps: dict[str, OCP]) -> None:
    """Report operations of a linearisation, memory and code of both models."""
    for which, ocp in ocps.items():
        implicit = ImplicitRungeKutta(SDIRK3, 2, 2) if name == "battery" else None
        sources = generate(ocp, Options(integrator=implicit, solve=False))
        found = sources.description.report
        report.add(f"linearisation, {which}", found.linearization_operations, "operations", case=name)
        report.add(f"memory, {which}", found.ram_bytes, "B", case=name)
        report.add(f"code, {which}", code_bytes(sources), "B", case=name)
