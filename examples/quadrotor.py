"""Quadrotor: fly to a point and hover there; four rotor thrusts, Euler angles.

Twelve states, N = 20 over 1 s with one RK4 step per interval, 0 <= thrust <= 2.5 N, sampling 0.05 s.
"""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, Options, build, simulate

MASS, ARM, DRAG, GRAVITY = 0.5, 0.17, 0.016, 9.81
INERTIA = (0.0023, 0.0023, 0.004)
HOVER = MASS * GRAVITY / 4


def build_ocp(start: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> OCP:
    """The quadrotor at rest at ``start`` (m), to be brought to the origin."""
    ocp = OCP("quadrotor", T=1.0, N=20)
    ocp.state("pos", size=3, unit="m", initial=start)
    vel = ocp.state("vel", size=3, unit="m/s")
    phi, theta, psi = (ocp.state(name, unit="rad") for name in ("phi", "theta", "psi"))
    p, q, r = (ocp.state(name, unit="rad/s") for name in ("p", "q", "r"))
    u = ocp.control("u", size=4, unit="N")

    s_phi, c_phi, s_th, c_th, s_psi, c_psi = (f(angle) for angle in (phi, theta, psi) for f in (ca.sin, ca.cos))
    up = ca.vertcat(c_phi * s_th * c_psi + s_phi * s_psi, c_phi * s_th * s_psi - s_phi * c_psi, c_phi * c_th)
    Jx, Jy, Jz = INERTIA
    ocp.dynamics(
        {
            "pos": vel,
            "vel": up * ca.sum1(u) / MASS - ca.vertcat(0, 0, GRAVITY),
            phi: p + (q * s_phi + r * c_phi) * ca.tan(theta),
            theta: q * c_phi - r * s_phi,
            psi: (q * s_phi + r * c_phi) / c_th,
            p: (ARM * (u[1] - u[3]) + (Jy - Jz) * q * r) / Jx,
            q: (ARM * (u[2] - u[0]) + (Jz - Jx) * p * r) / Jy,
            r: (DRAG * (u[0] - u[1] + u[2] - u[3]) + (Jx - Jy) * p * q) / Jz,
        }
    )
    weights = [10.0] * 3 + [1.0] * 6 + [0.1] * 3
    reference = np.concatenate([np.zeros(12), np.full(4, HOVER)])
    ocp.least_squares(ca.vertcat(ocp.x, u), weight=np.diag([*weights, *[0.1] * 4]), reference=reference)
    ocp.terminal_least_squares(ocp.x, weight=10 * np.diag(weights))
    ocp.subject_to(0, u, 2.5)
    return ocp


def options() -> Options:
    """One RK4 step per interval."""
    return Options(integrator=ExplicitRungeKutta(RK4, steps=1))


def main(picture: str = "out/quadrotor.png") -> None:
    """Four seconds of closed loop from (1, 1, 1), drawn."""
    controller = build(build_ocp(), options())
    log = simulate(controller, np.array([1.0, 1.0, 1.0, *[0.0] * 9]), steps=80, dt=0.05)
    print(log.summary())
    log.plot(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
