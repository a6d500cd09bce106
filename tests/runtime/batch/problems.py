"""A car with everything that a batch can be told, and a reactor with an algebraic variable."""

from __future__ import annotations

import casadi as ca
import numpy as np

from nmpc_codegen import OCP

N = 8


def car(rate: bool = False, time: bool = False, scaled: bool = False) -> OCP:
    """Two parameters, one of them a vector; a bound on a state, a soft row; on request a rate, a cost that changes with
    time, a residual whose weight is scaled."""
    ocp = OCP("car", T=2.0, N=N)
    p = ocp.state("p", unit="m", initial=1.0)
    v, r = ocp.state("v", unit="m/s"), ocp.state("r", size=2)
    a = ocp.control("a")
    m, k = ocp.parameter("m", value=1.0, bounds=(0.1, 10.0)), ocp.parameter("k", size=2, value=[0.5, 0.2])
    ocp.dynamics({p: v, v: a / m - 0.1 * v * ca.sqrt(v**2 + 0.01), r: ca.vertcat(-k[0] * r[0] + a, -k[1] * r[1] + p)})
    names = ["p", "v", "r0", "r1", "a"]
    ocp.least_squares(ca.vertcat(p, v, r, a), weight=np.diag([1, 1, 0.1, 0.1, 0.1]), names=names, scale_with_dt=scaled)
    ocp.terminal_least_squares(ca.vertcat(p, v), weight=10 * np.eye(2), names=["p", "v"])
    ocp.subject_to(-2, a, 2)
    ocp.subject_to(-1, v, 1)
    ocp.subject_to(-np.inf, p * p + v, 1.2, soft=(10, 1), name="curve")
    if rate:
        ocp.subject_to(-1.0, ocp.rate(a), 1.0, name="rate")
    if time:
        ocp.stage_cost(0.01 * ca.sin(ocp.time) * v)
    return ocp


def reactor() -> OCP:
    """x' = u - z x with the algebraic variable z + z^3 = x, and a row that contains it."""
    ocp = OCP("reactor", T=2.0, N=4)
    x, u, z = ocp.state("x", initial=1.0), ocp.control("u"), ocp.algebraic("z", initial=0.5)
    ocp.algebraic_equation(z + z**3 - x)
    ocp.dynamics({x: u - z * x})
    ocp.least_squares(ca.vertcat(x, u), np.diag([1.0, 0.01]), reference=[0.7, 0.0], names=["x", "u"])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-np.inf, z + 0.05 * u, 0.6, soft=(10, 1), name="warm")
    return ocp
