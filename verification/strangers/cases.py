"""One QP per sample easily loses these loops: a drone at a pillar, a car that passes another, a tilting drone."""

from __future__ import annotations

import casadi as ca
import numpy as np

from verification.strangers.statement import Limit, Stranger

M, G, ARM, INERTIA = 0.5, 9.81, 0.2, 0.01

DRONE = Stranger(
    "drone",
    "cases",
    *(2.0, 20, ("x", "z", "th", "vx", "vz", "w"), {"f1": (0.0, 6.0), "f2": (0.0, 6.0)}),
    model=lambda x, u: ca.vertcat(
        x[3:], -(u[0] + u[1]) / M * ca.sin(x[2]), (u[0] + u[1]) / M * ca.cos(x[2]) - G, (u[0] - u[1]) * ARM / INERTIA
    ),
    start=((-2.3, 0.7, -0.1, -0.2, -0.2, -0.1), (-1.7, 1.3, 0.1, 0.2, 0.2, 0.1)),
    samples=60,
    kick=(10, (0.05, 0.05, 0.05, 0.1, -0.1, 0.0)),
    residual=lambda x, u: ca.vertcat(x[0] - 2, x[1] - 1, x[2:], u - M * G / 2),
    weight=(10, 10, 1, 1, 1, 0.1, 0.1, 0.1),
    limits=(Limit("pillar", lambda x, _: x[0] ** 2 + (x[1] - 1.2) ** 2, 0.25, scale=0.25),),
    distance=lambda x: float(np.hypot(x[0] - 2, x[1] - 1)),
    reach=0.1,
)

CAR = Stranger(
    "car",
    "cases",
    *(3.0, 30, ("x", "y", "psi", "v"), {"a": (-4.0, 3.0), "delta": (-0.5, 0.5)}),
    model=lambda x, u: ca.vertcat(x[3] * ca.cos(x[2]), x[3] * ca.sin(x[2]), x[3] * ca.tan(u[1]) / 2.7, u[0]),
    start=((-1.0, -0.3, -0.05, 7.0), (1.0, 0.3, 0.05, 9.0)),
    samples=60,
    kick=(10, (0.0, 0.1, 0.03, 0.0)),
    residual=lambda x, u: ca.vertcat(x[1], x[2], x[3] - 8, u),
    weight=(1, 10, 1, 0.1, 10),
    limits=(
        Limit("parked", lambda x, _: ((x[0] - 20) / 4) ** 2 + ((x[1] + 0.4) / 2) ** 2, 1.0),
        Limit("road", lambda x, _: x[1], -2.0, 4.0, 2.0),
    ),
    distance=lambda x: float(max(0.0, 30 - x[0]) + abs(x[1])),
    reach=0.5,
)


def _tilted(x: ca.SX, u: ca.SX) -> ca.SX:
    thrust, w, i, j, k = (u[n] for n in range(5))
    push = ca.vertcat(2 * (i * k + w * j), 2 * (j * k - w * i), 1 - 2 * i * i - 2 * j * j) * thrust
    return ca.vertcat(x[3:], push - ca.DM([0, 0, G]))


QUATERNION = Stranger(
    "quaternion",
    "cases",
    *(2.0, 20, ("px", "py", "pz", "vx", "vy", "vz")),
    {"thrust": (2.0, 20.0), "qw": (-1.0, 1.0), "qx": (-1.0, 1.0), "qy": (-1.0, 1.0), "qz": (-1.0, 1.0)},
    model=_tilted,
    start=((-0.3,) * 6, (0.3,) * 6),
    samples=60,
    kick=(20, (0.1, -0.1, 0.1, 0.2, 0.2, -0.2)),
    residual=lambda x, u: ca.vertcat(x[:3] - ca.DM([2, 1, 1]), x[3:], u - ca.DM([G, 1, 0, 0, 0])),
    weight=(5, 5, 5, 1, 1, 1, 0.01, 0.1, 0.1, 0.1, 0.1),
    end_residual=lambda x: ca.vertcat(x[:3] - ca.DM([2, 1, 1]), x[3:]),
    end_weight=(50, 50, 50, 10, 10, 10),
    limits=(Limit("unit", lambda _, u: ca.sumsqr(u[1:]), 1.0, 1.0),),
    distance=lambda x: float(np.linalg.norm(x[:3] - np.array([2, 1, 1]))),
    reach=0.1,
)
