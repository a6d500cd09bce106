"""Problems of the tests of campaigns."""

from __future__ import annotations

import casadi as ca

from nmpc_codegen import OCP


def cart(rate: bool = False) -> OCP:
    """A cart of unknown mass that goes to 0 with a known wind and a hard limit of its speed; ``rate``: it knows the
    control before."""
    ocp = OCP("cart", T=2.0, N=8)
    p = ocp.state("p", unit="m", initial=1.0, initial_range=(0.5, 1.5))
    v = ocp.state("v", unit="m/s")
    F = ocp.control("F", unit="N")
    m = ocp.parameter("m", value=1.0, unit="kg", bounds=(0.5, 2.0))
    goal = ocp.parameter("goal", value=0.0, unit="m", bounds=(-0.2, 0.2))
    wind = ocp.parameter("wind", value=0.0, unit="N")
    ocp.dynamics({p: v, v: (F + wind - 0.1 * v * ca.sqrt(v * v + 0.01)) / m})
    ocp.least_squares(ca.vertcat(p - goal, v, F), weight=[1, 0.1, 0.01], names=["p_to_goal", "v", "F"])
    ocp.terminal_least_squares(ca.vertcat(p - goal, v), weight=[5, 1])
    ocp.subject_to(-2, F, 2)
    ocp.subject_to(-0.6, v, 0.6, soft=(50, 10))
    ocp.subject_to(-1, p + 0.3 * v, 2, name="wall")
    if rate:
        ocp.subject_to(-6, ocp.rate(F), 6, name="rate")
    return ocp


def point() -> OCP:
    """An integrator with a set point."""
    ocp = OCP("point", T=1.0, N=4)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), [1.0, 0.1], names=["x", "u"])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-2, x, 2)
    return ocp
