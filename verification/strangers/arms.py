"""These strangers are swing-ups, arms, and a suspended ball."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from verification.strangers.statement import Limit, Stranger


def _angle(x: float) -> float:
    """Return the distance of an angle from the upright one."""
    return float(abs(np.angle(np.exp(1j * (x - np.pi)))))


# Pendulum whose motor cannot lift it at once.
PENDULUM = Stranger(
    "pendulum",
    "swing-ups",
    *(3.0, 60, ("angle", "rate"), {"torque": (-5.0, 5.0)}),
    model=lambda x, u: ca.vertcat(x[1], -9.81 * ca.sin(x[0]) - 0.1 * x[1] + u[0]),
    start=((-0.3, -0.5), (0.3, 0.5)),
    samples=120,
    kick=(90, (0.05, -0.2)),
    residual=lambda x, u: ca.vertcat(x[0] - np.pi, x[1], u),
    weight=(1, 0.05, 0.02),
    end_residual=lambda x: ca.vertcat(x[0] - np.pi, x[1]),
    end_weight=(50, 5),
    limits=(Limit("rate", lambda x, _: x[1], -10, 10, 10),),
    distance=lambda x: _angle(x[0]) + 0.2 * abs(x[1]),
    reach=0.3,
)


def _arm(x: Any, u: Any) -> Any:
    """Return the slopes of two links of 1 kg and 0.5 m in a plane without gravity, driven in both joints."""
    c, s = ca.cos(x[1]), ca.sin(x[1])
    a, b, d = 0.42 + 0.25 * c, 0.083 + 0.125 * c, 0.083
    h = 0.125 * s
    first = u[0] + h * (2 * x[2] + x[3]) * x[3] - 0.2 * x[2]
    second = u[1] - h * x[2] ** 2 - 0.2 * x[3]
    det = a * d - b * b
    return ca.vertcat(x[2], x[3], (d * first - b * second) / det, (a * second - b * first) / det)


def _hand(x: Any) -> Any:
    return ca.vertcat(0.5 * ca.cos(x[0]) + 0.5 * ca.cos(x[0] + x[1]), 0.5 * ca.sin(x[0]) + 0.5 * ca.sin(x[0] + x[1]))


# Arm whose hand moves round a disc in its workspace.
ARM = Stranger(
    "arm",
    "arms",
    *(1.5, 30, ("q1", "q2", "w1", "w2"), {"t1": (-6.0, 6.0), "t2": (-4.0, 4.0)}),
    model=_arm,
    start=((-0.6, 0.8, -0.2, -0.2), (-0.2, 1.2, 0.2, 0.2)),
    samples=60,
    kick=(15, (0.02, 0.02, 0.1, -0.1)),
    residual=lambda x, u: ca.vertcat(_hand(x) - ca.DM([-0.3, 0.7]), x[2:], u),
    weight=(20, 20, 0.1, 0.1, 0.01, 0.01),
    end_residual=lambda x: ca.vertcat(_hand(x) - ca.DM([-0.3, 0.7]), x[2:]),
    end_weight=(200, 200, 2, 2),
    limits=(
        Limit("post", lambda x, _: ca.sumsqr(_hand(x) - ca.DM([0.55, 0.6])), 0.01, scale=0.01),
        Limit("elbow", lambda x, _: x[1], 0.1, 2.8, 1.0),
    ),
    distance=lambda x: float(np.linalg.norm(np.asarray(_hand(x)).ravel() - [-0.3, 0.7])),
    reach=0.1,
)

# Steel ball under a magnet, in metres, amperes and volts: unstable and fast.
MAGLEV = Stranger(
    "maglev",
    "unstable plants",
    *(0.06, 30, ("gap", "speed", "current"), {"voltage": (0.0, 50.0)}),
    model=lambda x, u: ca.vertcat(x[1], 9.81 - 5e-4 * (x[2] / (x[0] + 1e-3)) ** 2, (u[0] - 10 * x[2]) / 0.1),
    start=((0.009, -0.03, 1.4), (0.011, 0.03, 1.7)),
    samples=80,
    kick=(40, (0.0002, 0.02, 0.0)),
    residual=lambda x, u: ca.vertcat(x[0] - 0.01, x[1], 1e-2 * (u[0] - 15.4)),
    weight=(1e5, 1e2, 1),
    end_residual=lambda x: ca.vertcat(x[0] - 0.01, x[1], x[2] - 1.54),
    end_weight=(1e6, 1e4, 10),
    limits=(
        Limit("gap", lambda x, _: x[0], 0.003, 0.02, 0.01),
        Limit("current", lambda x, _: x[2], 0, 4, 4),
    ),
    distance=lambda x: float(abs(x[0] - 0.01)),
    reach=0.001,
)
