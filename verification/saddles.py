"""The plans of these problems may be at a saddle, where the slope of a control vanishes."""

from __future__ import annotations

import casadi as ca

from nmpc_codegen import OCP


def heater(delay: bool = False) -> OCP:
    """Return the OCP of a power that is the square of a voltage, which may act a sample later."""
    ocp = OCP("delayed" if delay else "heater", T=600, N=20)
    T, V = ocp.state("T", initial=20.0), ocp.control("V")
    ocp.dynamics({T: -(T - 20) / 300 + 2e-5 * (ocp.previous(V) if delay else V) ** 2})
    ocp.least_squares(T, weight=1.0, names=["to_T"])
    ocp.least_squares(V, weight=1e-4)
    ocp.subject_to(0, V, 230)
    return ocp


def delayed() -> OCP:
    """Return the OCP of the heater whose voltage acts a sample later."""
    return heater(delay=True)


def vehicle() -> OCP:
    """Return the OCP of a thrust n |n| against drag."""
    ocp = OCP("vehicle", T=4, N=20)
    p, v, n = ocp.state("p"), ocp.state("v"), ocp.control("n")
    ocp.dynamics({p: v, v: 0.002 * n * ca.fabs(n) - 0.3 * v * ca.fabs(v)})
    ocp.least_squares(ca.vertcat(p, v), weight=[1, 0.1], names=["to_p", "to_v"])
    ocp.least_squares(n, weight=1e-5)
    ocp.subject_to(-50, n, 50)
    return ocp


def lagging() -> OCP:
    """Return the OCP of the vehicle with a rotor speed that follows its command with a lag."""
    ocp = OCP("lagging", T=4, N=20)
    p, v, n, command = ocp.state("p"), ocp.state("v"), ocp.state("n"), ocp.control("command")
    ocp.dynamics({p: v, v: 0.002 * n * ca.fabs(n) - 0.3 * v * ca.fabs(v), n: (command - n) / 0.3})
    ocp.least_squares(ca.vertcat(p, v), weight=[1, 0.1], names=["to_p", "to_v"])
    ocp.least_squares(command, weight=1e-5)
    ocp.terminal_least_squares(p, weight=20, names=["end_p"])
    ocp.subject_to(-50, command, 50)
    return ocp


def motor() -> OCP:
    """Return the OCP of a torque that is the product of two currents, both 0 at rest."""
    ocp = OCP("motor", T=4, N=20)
    w, a, b = ocp.state("w"), ocp.control("a"), ocp.control("b")
    ocp.dynamics({w: 2 * a * b - 0.3 * w})
    ocp.least_squares(w, weight=1, names=["to_w"])
    ocp.least_squares(ca.vertcat(a, b), weight=1e-2)
    ocp.subject_to(-1, a, 1)
    ocp.subject_to(-1, b, 1)
    return ocp


def drone() -> OCP:
    """Return the OCP of a drone whose rotors lift with the squares of their speeds; either one alone overturns it."""
    ocp = OCP("drone", T=1.5, N=20)
    x, z, angle, vx, vz, w = (ocp.state(name) for name in ("x", "z", "angle", "vx", "vz", "w"))
    n, m = ocp.control("n"), ocp.control("m")
    left, right = 6e-6 * n**2, 6e-6 * m**2
    lift = left + right
    ocp.dynamics({x: vx, z: vz, angle: w, vx: -lift * ca.sin(angle), vz: lift * ca.cos(angle) - 9.81})
    ocp.dynamics({w: 10 * (left - right)})
    names = [f"to_{name}" for name in ("x", "z", "angle", "vx", "vz", "w")]
    ocp.least_squares(ca.vertcat(x, z, angle, vx, vz, w), weight=[2, 2, 0.5, 0.2, 0.2, 0.05], names=names)
    ocp.least_squares(ca.vertcat(n, m), weight=1e-7)
    ocp.terminal_least_squares(ca.vertcat(x, z), weight=20, names=["end_x", "end_z"])
    ocp.subject_to(0, n, 1500)
    ocp.subject_to(0, m, 1500)
    return ocp


def warm() -> OCP:
    """Return the OCP of a heater that has to heat only because of a hard row."""
    ocp = OCP("warm", T=600, N=20)
    T, V = ocp.state("T", initial=25.0), ocp.control("V")
    ocp.dynamics({T: -(T - 20) / 300 + 2e-5 * V**2})
    ocp.least_squares(V, weight=1e-4)
    ocp.subject_to(0, V, 230)
    ocp.subject_to(30, T, 100, name="warm")
    return ocp


def rated_heater(hard: bool = False) -> OCP:
    """Return the OCP of a heater with power V^2, a parameter as first voltage, and a cost of changes of the voltage."""
    ocp = OCP("heater", T=2.0, N=4)
    T, V, rated = ocp.state("T"), ocp.control("V"), ocp.parameter("rated")
    ocp.dynamics({T: V**2 - T})
    ocp.least_squares(ca.vertcat(T, V - rated, V - ocp.previous(V)), weight=[1, 0.1, 0.1])
    ocp.subject_to(-1, V, 1)
    if hard:
        ocp.subject_to(-0.2, V - ocp.previous(V), 0.2)
    return ocp


def rated_heater_in_steps() -> OCP:
    """Return the OCP of the heater with a limit of changes."""
    return rated_heater(hard=True)


def rated_heater_at_the_end() -> OCP:
    """Return the OCP of a heater whose cost depends on the last temperature only."""
    ocp = OCP("heater", T=2.0, N=4)
    T, V = ocp.state("T"), ocp.control("V")
    ocp.dynamics({T: V**2 - T})
    ocp.terminal_least_squares(T, weight=1)
    ocp.subject_to(-1, V, 1)
    return ocp
