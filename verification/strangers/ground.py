"""These strangers are vehicles among obstacles, ships, and trailers."""

from __future__ import annotations

import casadi as ca
import numpy as np

from verification.strangers.statement import Limit, Stranger


def _disc(name: str, x: float, y: float, radius: float) -> Limit:
    """Return the row outside of a disc; states 0 and 1 are the position."""
    return Limit(name, lambda s, _: (s[0] - x) ** 2 + (s[1] - y) ** 2, radius**2, scale=radius**2)


# Robot with wheels that drives past two discs to a pose.
UNICYCLE = Stranger(
    "unicycle",
    "obstacles",
    *(4.0, 40, ("x", "y", "theta"), {"v": (-0.5, 1.5), "omega": (-2.0, 2.0)}),
    model=lambda x, u: ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1]),
    start=((-0.2, -0.5, -0.8), (0.2, 0.5, 0.8)),
    samples=80,
    kick=(20, (0.05, -0.1, 0.2)),
    residual=lambda x, u: ca.vertcat(x[0] - 3, x[1] - 1, x[2], u),
    weight=(1, 1, 0.1, 0.05, 0.05),
    end_residual=lambda x: ca.vertcat(x[0] - 3, x[1] - 1, x[2]),
    end_weight=(20, 20, 2),
    limits=(_disc("first", 1.0, 0.1, 0.4), _disc("second", 2.2, 1.0, 0.3)),
    distance=lambda x: float(np.hypot(x[0] - 3, x[1] - 1)),
    reach=0.2,
)

# Hovercraft with drag: a mass that is pushed between three posts.
HOVERCRAFT = Stranger(
    "hovercraft",
    "obstacles",
    *(3.0, 30, ("x", "y", "vx", "vy"), {"Fx": (-2.0, 2.0), "Fy": (-2.0, 2.0)}),
    model=lambda x, u: ca.vertcat(x[2], x[3], u[0] - 0.3 * x[2], u[1] - 0.3 * x[3]),
    start=((-0.3, -0.3, -0.5, -0.5), (0.3, 0.3, 0.5, 0.5)),
    samples=60,
    kick=(12, (0.0, 0.1, 0.2, -0.2)),
    residual=lambda x, u: ca.vertcat(x[0] - 4, x[1], x[2:], u),
    weight=(1, 1, 0.2, 0.2, 0.05, 0.05),
    end_residual=lambda x: ca.vertcat(x[0] - 4, x[1], x[2:]),
    end_weight=(10, 10, 2, 2),
    limits=(_disc("left", 1.5, 0.6, 0.5), _disc("right", 1.5, -0.7, 0.5), _disc("far", 2.8, 0.1, 0.4)),
    distance=lambda x: float(np.hypot(x[0] - 4, x[1])),
    reach=0.2,
)

# Ship with a slow rudder (Norrbin's steering law) that changes its course and its track.
SHIP = Stranger(
    "ship",
    "ships and trailers",
    *(120.0, 40, ("y", "psi", "r", "delta"), {"rate": (-0.05, 0.05)}),
    model=lambda x, u: ca.vertcat(8 * ca.sin(x[1]), x[2], (-(x[2] + 300 * x[2] ** 3 * 100) + 0.1 * x[3]) / 20, u[0]),
    start=((-120.0, -0.4, -0.003, -0.1), (120.0, 0.4, 0.003, 0.1)),
    samples=80,
    kick=(25, (20.0, 0.1, 0.0, 0.0)),
    residual=lambda x, u: ca.vertcat(x, u),
    weight=(1e-4, 1, 10, 0.1, 10),
    end_residual=lambda x: x,
    end_weight=(1e-2, 50, 1000, 1),
    limits=(
        Limit("rudder", lambda x, _: x[3], -0.5, 0.5, 0.5),
        Limit("turn", lambda x, _: x[2], -0.02, 0.02, 0.02),
    ),
    distance=lambda x: float(abs(x[0]) / 20 + abs(x[1])),
    reach=0.2,
)

# Truck with a trailer that backs into a lane; the hitch must not fold.
TRAILER = Stranger(
    "trailer",
    "ships and trailers",
    *(6.0, 40, ("x", "y", "theta", "hitch"), {"v": (-1.0, 1.0), "steer": (-0.7, 0.7)}),
    model=lambda x, u: ca.vertcat(
        u[0] * ca.cos(x[2]),
        u[0] * ca.sin(x[2]),
        u[0] * ca.tan(u[1]) / 0.5,
        -u[0] * (ca.tan(u[1]) / 0.5 + ca.sin(x[3]) / 0.8),
    ),
    start=((1.5, 0.3, -0.3, -0.2), (2.5, 0.8, 0.3, 0.2)),
    samples=90,
    kick=(30, (0.0, 0.05, 0.05, 0.05)),
    residual=lambda x, u: ca.vertcat(x, u),
    weight=(1, 2, 0.5, 0.5, 0.05, 0.05),
    end_residual=lambda x: x,
    end_weight=(20, 60, 20, 10),
    limits=(Limit("fold", lambda x, _: x[3], -0.9, 0.9, 0.9),),
    distance=lambda x: float(np.hypot(x[0], x[1])),
    reach=0.3,
)

# Point mass on a floor: its acceleration has to stay inside the circle of friction, at which braking and turning meet.
PUCK = Stranger(
    "puck",
    "friction",
    *(2.0, 20, ("x", "y", "vx", "vy"), {"ax": (-4.0, 4.0), "ay": (-4.0, 4.0)}),
    model=lambda x, u: ca.vertcat(x[2:], u),
    start=((-5.0, -5.0, -2.0, -2.0), (5.0, 5.0, 2.0, 2.0)),
    samples=60,
    kick=(30, (0.5, -0.5, 1.0, 1.0)),
    residual=lambda x, u: ca.vertcat(x, u),
    weight=(1, 1, 0.1, 0.1, 0.02, 0.02),
    end_residual=lambda x: x,
    end_weight=(10, 10, 1, 1),
    limits=(Limit("friction", lambda _, u: ca.sumsqr(u), upper=16.0, scale=16.0),),
    distance=lambda x: float(np.linalg.norm(x)),
    reach=0.05,
)
