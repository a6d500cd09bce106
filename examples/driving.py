"""Energy-optimal driving: an economic cost with a state that grows for ever, and a terminal cost from its regulator.

What it shows: cyclic() for the position along the road, which has no steady state; lqr_terminal_cost(economic=True),
whose matrix P is indefinite; a cost integrated with the dynamics, without which the controller has no stable regulator;
an obstacle that disappears, by bounds that change at every sample.

An electric car keeps 50 km/h with the least energy: the gain ALPHA per metre makes 50 km/h the best steady speed. At
8 s the lane moves sideways. The state ``py`` is the distance from the middle of the lane, so the car, which does not
foresee the move, measures a jump. Until 6 s something blocks the road at 80 m.

Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020), section V.B. Powers are divided by 14341 W,
so that energy and lateral deviations have comparable weights. Time in seconds.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import (
    OCP,
    RK4,
    ExactHessian,
    ExplicitRungeKutta,
    Online,
    Options,
    Project,
)
from nmpc_codegen.economic import Tuning, tune

LENGTH, MASS, RADIUS, GRAVITY, GEAR = 4.8, 1700.0, 0.35, 9.81, 7.94
DRAG, ROLLING = 0.45, 0.015
T_MAX, P_MAX, OMEGA_MAX, BRAKE_MAX = 280.0, 80e3, 1047.2, 10e3
ALPHA, POWER = -788.743, 14341.0  # W s/m, W
SPEED = 50 / 3.6
SAMPLING, N, STEPS = 0.1, 100, 5
OBSTACLE, CLEARED, MOVE = 80.0, 6.0, 8.0  # m, s, s


def build_ocp() -> OCP:
    """10 s in 100 intervals; the terminal cost is the cost-to-go of the regulator at 50 km/h."""
    ocp = OCP("driving", T=SAMPLING * N, N=N)
    px, py = ocp.state("px", unit="m"), ocp.state("py", unit="m")
    v = ocp.state("v", unit="m/s", initial=SPEED)
    theta, delta = ocp.state("theta", unit="rad"), ocp.state("delta", unit="rad")
    T = ocp.control("T", unit="N m")
    Fb = ocp.control("Fb", unit="N")
    steering = ocp.control("steering", unit="rad/s")

    drag = DRAG * v**2 + MASS * GRAVITY * ROLLING
    ocp.dynamics(
        {
            px: v * ca.cos(theta),
            py: v * ca.sin(theta),
            v: (GEAR * T / RADIUS - Fb - drag) / MASS,
            theta: v * ca.tan(delta) / LENGTH,
            delta: steering,
        }
    )
    ocp.cyclic(px)

    omega = GEAR * v / RADIUS
    power = omega * T + 0.0323 * omega * T + 0.0183 * omega**2 + 0.0043 * T**2
    ocp.stage_cost((power + ALPHA * v) / POWER + py**2 + theta**2 + delta**2 + steering**2, integrate=True)
    ocp.lqr_terminal_cost(economic=True)

    ocp.subject_to(0, T, T_MAX)
    ocp.subject_to(0, Fb, BRAKE_MAX)
    ocp.subject_to(-np.inf, T * omega, P_MAX, name="power")
    ocp.subject_to(0, v, OMEGA_MAX * RADIUS / GEAR)
    ocp.subject_to(-np.inf, px, np.inf, name="obstacle")
    return ocp


def options(hessian: Any = None) -> Options:
    """Five RK4 steps per interval; the bounds differ between nodes, because the obstacle disappears within the plan."""
    return Options(
        integrator=ExplicitRungeKutta(RK4, steps=STEPS),
        hessian=hessian or ExactHessian(Project(1e-8, level="reduced")),
        online=Online(bounds="node"),
    )


def tuned() -> Tuning:
    """The tuning; the position has zero rows in M."""
    return tune(build_ocp(), options())
