"""Cart-pole swing-up: from hanging down to upright in 1 s with |F| <= 80 N."""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, Options, build, simulate

CART, POLE, LENGTH, GRAVITY = 1.0, 0.1, 0.8, 9.81


def build_ocp() -> OCP:
    """N = 20 over 1 s, two RK4 steps per interval; the optimum costs 22417.4595."""
    ocp = OCP("cart_pole", T=1.0, N=20)
    p = ocp.state("p", unit="m")
    th = ocp.state("th", unit="rad", initial=np.pi)
    v = ocp.state("v", unit="m/s")
    w = ocp.state("w", unit="rad/s")
    F = ocp.control("F", unit="N")
    s, c = ca.sin(th), ca.cos(th)
    D = CART + POLE - POLE * c**2
    ocp.dynamics(
        {
            p: v,
            th: w,
            v: (-POLE * LENGTH * s * w**2 + POLE * GRAVITY * c * s + F) / D,
            w: (-POLE * LENGTH * c * s * w**2 + F * c + (CART + POLE) * GRAVITY * s) / (LENGTH * D),
        }
    )
    weights = [1e3, 1e3, 0.01, 0.01]
    ocp.least_squares(ca.vertcat(ocp.x, F), weight=[*weights, 0.01])
    ocp.terminal_least_squares(ocp.x, weight=weights)
    ocp.subject_to(-80, F, 80)
    return ocp


def main(picture: str = "out/cart_pole.png") -> None:
    """Find the swing-up once by SQP, then keep it up by real-time iterations for 3 s."""
    controller = build(build_ocp(), Options())
    start = np.array([0.0, np.pi, 0.0, 0.0])
    print(controller.solve(start).status)
    log = simulate(controller, start, steps=60, dt=0.05)
    print(log.summary())
    log.plot(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
