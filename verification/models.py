"""CasADi states the models of oracles/runge_kutta.py, a discrete map, and a pendulum with all features."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import OCP

#: N, interval length, and a nonuniform grid.
LENGTH = 0.3
GRID = [0.2, 0.3, 0.45]


def pendulum_of_everything(name: str, intervals: list[float]) -> OCP:
    """Return the OCP of a nonlinear pendulum with costs, rows and data of every kind."""
    ocp = OCP(name, intervals=intervals)
    q, w, u = ocp.state("q", initial=0.7), ocp.state("w", initial=-0.2), ocp.control("u")
    m = ocp.parameter("m", value=1.3)
    ocp.dynamics({q: w, w: -ca.sin(q) - 0.1 * w * ca.sqrt(1 + w**2) + u / m})
    ocp.least_squares(ca.vertcat(q * w, u), weight=[2.0, 0.3], reference=[0.4, 0.1])
    ocp.stage_cost(ca.exp(q) * w**2 + m * u * q, integrate=True)
    ocp.stage_cost(ca.cos(w) * u)
    ocp.terminal_cost(q**4 + m * w**2)
    ocp.subject_to(-2, q * u, 2, name="power")
    ocp.subject_to(-9, q**3 + w, 9, at="end", name="gate")
    return ocp


def couple(ocp: OCP) -> None:
    """Add a nonlinear coupled row to the pendulum."""
    ocp.boundary(-5, ocp.at_start(ocp.x[1]) ** 3 + ocp.at_end(ocp.x[0]) ** 2, 5, name="loop")


def problem_of(model: str, uniform: bool = True) -> OCP:
    """Return the OCP of an OCP with the dynamics of the model and a simple cost."""
    grid: dict[str, Any] = {"T": 3 * LENGTH, "N": 3} if uniform else {"intervals": GRID}
    ocp = OCP(model, **grid)
    {"crane": _crane, "reactor": _reactor, "tanks": _tanks}[model](ocp)
    n = int(ocp.x.numel() + ocp.u.numel())
    ocp.least_squares(ca.vertcat(ocp.x, ocp.u), weight=np.ones(n))
    return ocp


def _crane(ocp: OCP) -> None:
    p, v, phi, omega = (ocp.state(name) for name in ("p", "v", "phi", "omega"))
    a = ocp.control("a")
    ocp.dynamics({p: v, v: a, phi: omega, omega: -9.81 * ca.sin(phi) - a * ca.cos(phi) - 0.2 * omega})


def _reactor(ocp: OCP) -> None:
    c, T = ocp.state("c"), ocp.state("T", initial=1.0)
    q, w = ocp.control("q"), ocp.control("w")
    k, E = ocp.parameter("k", value=3.0), ocp.parameter("E", value=1.3)
    rate = k * c * ca.exp(-E / T)
    ocp.dynamics({c: q * (1 - c) - rate, T: q * (1 - T) + 2 * rate - w * (T - 0.5) / (1 + w)})


def _tanks(ocp: OCP) -> None:
    h, v = ocp.state("h", size=2, initial=[1.0, 1.0]), ocp.state("v")
    q, f, d = ocp.control("q"), ocp.control("f"), ocp.parameter("d", value=0.7)
    flow = d * ca.sqrt(h)
    ocp.dynamics(ca.vertcat(q - flow[0], flow[0] - flow[1], f / h[0] - d * v * ca.sqrt(1 + v * v)))


def discrete_map() -> OCP:
    """Return the OCP x+ = (x_0 + 0.5 x_1^2 + p u_0, 0.84 x_1 - x_0 exp(u_1))."""
    ocp = OCP("map", N=4)
    x, u, p = ocp.state("x", size=2), ocp.control("u", size=2), ocp.parameter("p", value=0.8)
    ocp.dynamics(ca.vertcat(x[0] + 0.5 * x[1] ** 2 + p * u[0], 0.84 * x[1] - x[0] * ca.exp(u[1])), discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(4))
    return ocp
