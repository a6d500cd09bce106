"""These strangers are solved once: swing-ups, minimum time, a linear tariff, a gate."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from verification.strangers.statement import Limit, Stranger

G = 9.81


def _at_end(name: str, value: Any, target: float, scale: float = 1.0) -> Limit:
    return Limit(name, lambda x, _: value(x), target, target, scale, at="end")


def _states(targets: dict[int, float], scale: float = 1.0) -> tuple[Limit, ...]:
    """Return end conditions on states."""
    return tuple(_at_end(f"end_{i}", lambda x, i=i: x[i], target, scale) for i, target in targets.items())


# ---- swing-ups


def _cart_pole(x: Any, u: Any) -> Any:
    """Return the slopes of a cart of 1 kg with a bob of 0.3 kg on 0.5 m, hanging at angle 0."""
    s, c, big, small, length = ca.sin(x[1]), ca.cos(x[1]), 1.0, 0.3, 0.5
    inertia = big + small * s**2
    along = (length * small * s * x[3] ** 2 + u[0] + small * G * c * s) / inertia
    around = -(length * small * c * s * x[3] ** 2 + u[0] * c + (big + small) * G * s) / (length * inertia)
    return ca.vertcat(x[2:], along, around)


CART_POLE = Stranger(
    "cart_pole",
    "swing-ups",
    *(2.0, 40, ("q1", "q2", "v1", "v2"), {"force": (-20.0, 20.0)}),
    model=_cart_pole,
    start=((-0.2, -0.2, -0.1, -0.2), (0.2, 0.2, 0.1, 0.2)),
    residual=lambda _, u: u,
    weight=(0.1,),
    limits=(Limit("track", lambda x, _: x[0], -2.0, 2.0), *_states({0: 1.0, 1: np.pi, 2: 0.0, 3: 0.0})),
)


def _acrobot(x: Any, u: Any) -> Any:
    """Return the slopes of two rods of 1 kg and 1 m, driven in their joint.

    Angles from hanging, the second relative.
    """
    c2, s2, I = ca.cos(x[1]), ca.sin(x[1]), 1 / 12  # noqa: E741
    far = I + 0.25
    mixed = far + 0.5 * c2
    near = I + 0.25 + I + 1 + 0.25 + c2
    twist = 0.5 * s2
    whirl = ca.vertcat(-2 * twist * x[2] * x[3] - twist * x[3] ** 2, twist * x[2] ** 2)
    low = 0.5 * G * ca.sin(x[0] + x[1])
    weight = ca.vertcat(1.5 * G * ca.sin(x[0]) + low, low)
    mass = ca.vertcat(ca.horzcat(near, mixed), ca.horzcat(mixed, far))
    return ca.vertcat(x[2:], ca.solve(mass, ca.vertcat(0, u[0]) - whirl - weight))


ACROBOT = Stranger(
    "acrobot",
    "swing-ups",
    *(4.0, 60, ("q1", "q2", "w1", "w2"), {"torque": (-15.0, 15.0)}),
    model=_acrobot,
    start=((-0.05, -0.05, -0.1, -0.1), (0.05, 0.05, 0.1, 0.1)),
    residual=lambda x, u: ca.vertcat(x[0] - np.pi, x[1:], u) * np.sqrt(4.0 / 60),
    weight=(0.1, 0.1, 0.01, 0.01, 0.1),
    limits=_states({0: np.pi, 1: 0.0, 2: 0.0, 3: 0.0}),
)

M_CART, M_ROD, L_ROD, G_DOUBLE = 0.6, 0.2, 0.5, 9.80665
HALF, J_ROD = L_ROD / 2, M_ROD * (L_ROD / 2) ** 2 / 3


def _double_pendulum(x: Any, u: Any) -> Any:
    """Return the slopes of a cart with two rods in a row, angles from upright."""
    c1, c2, s1, s2 = ca.cos(x[1]), ca.cos(x[2]), ca.sin(x[1]), ca.sin(x[2])
    c12, s12 = ca.cos(x[1] - x[2]), ca.sin(x[1] - x[2])
    first, second, cross = M_ROD * (HALF + L_ROD), M_ROD * HALF, M_ROD * HALF * L_ROD
    inner, outer = M_ROD * (HALF**2 + L_ROD**2) + J_ROD, M_ROD * HALF**2 + J_ROD
    mass = ca.vertcat(
        ca.horzcat(M_CART + 2 * M_ROD, first * c1, second * c2),
        ca.horzcat(first * c1, inner, cross * c12),
        ca.horzcat(second * c2, cross * c12, outer),
    )
    right = ca.vertcat(
        first * x[4] ** 2 * s1 + second * x[5] ** 2 * s2 + u[0],
        first * G_DOUBLE * s1 - cross * x[5] ** 2 * s12,
        cross * x[4] ** 2 * s12 + second * G_DOUBLE * s2,
    )
    return ca.vertcat(x[3:], ca.solve(mass, right))


def _potential(x: Any) -> Any:
    return M_ROD * G_DOUBLE * ((HALF + L_ROD) * ca.cos(x[1]) + HALF * ca.cos(x[2]))


def _kinetic(x: Any) -> Any:
    c1, c2, s1, s2 = ca.cos(x[1]), ca.cos(x[2]), ca.sin(x[1]), ca.sin(x[2])
    first = (x[3] + HALF * x[4] * c1) ** 2 + (HALF * x[4] * s1) ** 2
    second = (x[3] + L_ROD * x[4] * c1 + HALF * x[5] * c2) ** 2 + (L_ROD * x[4] * s1 + HALF * x[5] * s2) ** 2
    return 0.5 * (M_CART * x[3] ** 2 + M_ROD * (first + second) + J_ROD * (x[4] ** 2 + x[5] ** 2))


DOUBLE_PENDULUM = Stranger(
    "double_pendulum",
    "swing-ups",
    *(3.2, 80, ("pos", "theta1", "theta2", "dpos", "dtheta1", "dtheta2"), {"force": (-4.0, 4.0)}),
    model=_double_pendulum,
    start=((0.6, np.pi - 0.1, np.pi - 0.1, -0.1, -0.1, -0.1), (1.0, np.pi + 0.1, np.pi + 0.1, 0.1, 0.1, 0.1)),
    rate=lambda x, u: (-_potential(x) + 10 * x[0] ** 2 + 0.1 * u[0] ** 2) * 80 / 3.2,
    end_cost=lambda x: _kinetic(x) - _potential(x),
)

# ---- a gate


GATE = Stranger(
    "gate",
    "obstacles",
    *(2.0, 40, ("x", "z", "th", "vx", "vz", "w"), {"f1": (0.0, 5.0), "f2": (0.0, 5.0)}),
    model=lambda x, u: ca.vertcat(
        x[3:],
        -(u[0] + u[1]) * ca.sin(x[2]) / 0.5,
        (u[0] + u[1]) * ca.cos(x[2]) / 0.5 - G,
        0.17 * (u[1] - u[0]) / 4e-3,
    ),
    start=((-0.2, -0.2, -0.1, -0.2, -0.2, -0.2), (0.2, 0.2, 0.1, 0.2, 0.2, 0.2)),
    residual=lambda x, u: ca.vertcat(x[0] - 3, x[1] - 1, x[2:], u - 0.25 * G),
    weight=(1, 1, 0.1, 0.1, 0.1, 0.01, 0.02, 0.02),
    end_residual=lambda x: ca.vertcat(x[0] - 3, x[1] - 1, x[2:]),
    end_weight=(100, 100, 20, 20, 20, 2),
    limits=(Limit("opening", lambda x, _: x[1] + 0.15 - 2 * (x[0] - 1.5) ** 2, upper=0.0, soft=(50.0, 100.0)),),
)

# ---- minimum time: the last state is the duration, and time runs from 0 to 1


def _timed(model: Any) -> Any:
    """Return the model in scaled time with the duration as its last state."""
    return lambda x, u: ca.vertcat(x[-1] * model(x, u), 0)


STEERING = Stranger(
    "steering",
    "minimum time",
    *(1.0, 50, ("y1", "y2", "v1", "v2", "duration"), {"angle": (-np.pi / 2, np.pi / 2)}),
    model=_timed(lambda x, u: ca.vertcat(x[2], x[3], 100 * ca.cos(u[0]), 100 * ca.sin(u[0]))),
    start=((-0.5, -0.5, -2.0, -2.0, 0.5), (0.5, 0.5, 2.0, 2.0, 1.5)),
    free=(4,),
    end_cost=lambda x: x[4],
    limits=(Limit("time", lambda x, _: x[4], 0.05, 5.0), *_states({1: 5.0, 2: 45.0, 3: 0.0}, 10.0)),
)


def _robot(x: Any, u: Any) -> Any:
    """Return the slopes of an arm of 5 m that reaches, turns and rises."""
    phi = ((5 - x[0]) ** 3 + x[0] ** 3) / 3
    theta = phi * ca.sin(x[4]) ** 2
    return ca.vertcat(x[1], u[0] / 5, x[3], u[1] / theta, x[5], u[2] / phi)


ROBOT_ARM = Stranger(
    "robot_arm",
    "minimum time",
    *(1.0, 50, ("rho", "drho", "theta", "dtheta", "phi", "dphi", "duration")),
    {"reach": (-1.0, 1.0), "turn": (-1.0, 1.0), "rise": (-1.0, 1.0)},
    model=_timed(_robot),
    start=((4.2, -0.02, -0.2, -0.02, 0.6, -0.02, 6.0), (4.7, 0.02, 0.2, 0.02, 0.9, 0.02, 12.0)),
    free=(6,),
    end_cost=lambda x: x[6],
    limits=(
        Limit("length", lambda x, _: x[0], 0.0, 5.0),
        Limit("turned", lambda x, _: x[2], -np.pi, np.pi),
        Limit("risen", lambda x, _: x[4], 0.0, np.pi),
        Limit("time", lambda x, _: x[6], 0.1, 30.0),
        *_states({0: 4.5, 1: 0.0, 2: 2 * np.pi / 3, 3: 0.0, 4: np.pi / 4, 5: 0.0}),
    ),
)

VAN_DER_POL = Stranger(
    "van_der_pol",
    "minimum time",
    *(1.0, 50, ("x1", "x2", "duration"), {"push": (-1.0, 1.0)}),
    model=_timed(lambda x, u: ca.vertcat(x[1], -x[0] + x[1] * (1 - x[0] ** 2) + u[0])),
    start=((0.7, 0.7, 1.0), (1.3, 1.3, 3.0)),
    free=(2,),
    end_cost=lambda x: x[2],
    limits=(
        Limit("time", lambda x, _: x[2], 0.1, 10.0),
        _at_end("circle", lambda x: x[0] ** 2 + x[1] ** 2, 0.04, 0.04),
    ),
)

FREE_TIME = Stranger(
    "free_time",
    "minimum time",
    *(1.0, 50, ("x", "v", "duration"), {"acceleration": (-2.0, 2.0)}),
    model=_timed(lambda x, u: ca.vertcat(x[1], u[0])),
    start=((0.0, 0.0, 0.1), (0.0, 0.0, 3.0)),
    free=(2,),
    rate=lambda x, u: x[2] ** 2 + u[0] ** 2,
    end_cost=lambda x: x[2] ** 2,
    limits=(Limit("time", lambda x, _: x[2], 0.1, 50.0), *_states({0: 10.0, 1: 0.0}, 10.0)),
)

ZERMELO = Stranger(
    "zermelo",
    "minimum time",
    *(1.0, 40, ("x", "y", "duration"), {"heading": (-2 * np.pi, 2 * np.pi)}),
    model=_timed(lambda x, u: ca.vertcat(ca.cos(u[0]) + 0.5 * ca.sin(np.pi * x[1]), ca.sin(u[0]) - 0.3 * x[0])),
    start=((-0.3, -0.3, 2.0), (0.3, 0.3, 6.0)),
    free=(2,),
    end_cost=lambda x: x[2],
    limits=(Limit("time", lambda x, _: x[2], 0.1, 30.0), *_states({0: 3.0, 1: 1.0})),
)

# ---- a tariff without any curvature

ARBITRAGE = Stranger(
    "arbitrage",
    "tariffs",
    *(24.0, 24, ("energy", "clock"), {"charge": (0.0, 0.25), "discharge": (0.0, 0.25)}),
    model=lambda x, u: ca.vertcat(0.95 * u[0] - u[1] / 0.95, 2 * np.pi / 24),
    start=((0.1, 0.0), (0.9, 6.0)),
    rate=lambda x, u: (0.12 + 0.08 * ca.sin(x[1]) + 0.03 * ca.cos(3 * x[1])) * (u[0] - u[1]),
    end_cost=lambda x: -0.11 * x[0],
    limits=(Limit("capacity", lambda x, _: x[0], 0.0, 1.0),),
)
