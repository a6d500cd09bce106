"""Overhead crane: bring the load to rest at the origin in 3 s, |a| <= 1 m/s^2.

What it shows: states, a control, dynamics, least squares, a bound and a terminal equality; the C package, the same code
in Python, a closed loop and its plot.

Houska, Ferreau and Diehl, "An auto-generated real-time iteration algorithm for nonlinear MPC in the microsecond range",
Automatica 47 (2011), section 4.1.
"""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, Options, RealTimeIteration, build, export, simulate


def build_ocp(terminal_constraint: bool = True) -> OCP:
    """The problem with x_N = 0 or, without the terminal constraint, with unit terminal weights instead.

    x0 = (2, 0, 0, 0) is feasible; (1, 0, 0.5, 0) and (0, 0, 1, 0) are not.
    """
    ocp = OCP("crane", T=3.0, N=10)
    p = ocp.state("p", unit="m", initial=2.0)
    v = ocp.state("v", unit="m/s")
    phi = ocp.state("phi", unit="rad")
    omega = ocp.state("omega", unit="rad/s")
    a = ocp.control("a", unit="m/s^2")

    ocp.dynamics({p: v, v: a, phi: omega, omega: -9.81 * ca.sin(phi) - a * ca.cos(phi) - 0.2 * omega})
    ocp.least_squares(ca.vertcat(ocp.x, a), weight=np.eye(5))
    ocp.subject_to(-1, a, 1)
    if terminal_constraint:
        ocp.subject_to(0, ocp.x, 0, at="end")
    else:
        ocp.terminal_least_squares(ocp.x, weight=np.eye(4))
    return ocp


def main(folder: str = "out/crane", picture: str = "out/crane.png") -> None:
    """Write the C package, simulate 15 s of the closed loop, and plot them."""
    ocp, options = build_ocp(), Options(algorithm=RealTimeIteration(sampling_time=0.3))
    package = export(ocp, options, folder, name="crane")
    print(f"{package.directory}: {package.report['ram_bytes']:,} bytes of memory")
    controller = build(ocp, options)
    log = simulate(controller, np.array([2.0, 0.0, 0.0, 0.0]), steps=50)
    print(log.summary())
    log.plot(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
