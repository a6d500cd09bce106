"""Chain of masses on springs: bring a hanging chain to rest with its last ball, whose velocity is controlled.

n balls, the first fixed, M = n - 2 free: nx = 6 M + 3, nu = 3; N = 40 intervals of 0.2 s, two RK4 steps each.
"""

from __future__ import annotations

import sys
from itertools import pairwise

import casadi as ca
import numpy as np
from scipy.optimize import fsolve

from nmpc_codegen import OCP, Options, build, simulate

MASS, STIFFNESS, GRAVITY = 0.033, 1.0, 9.81
END = (1.0, 0.0, 0.0)


def accelerations(free: list, end: ca.SX) -> list:
    """Accelerations of the free balls at positions ``free`` between the origin and ``end``."""
    M = len(free)
    rest, stiffness = 0.033 * 6 / (M + 1), STIFFNESS * (M + 1)
    points = [ca.SX(3, 1), *free, end]
    pulls = []
    for a, b in pairwise(points):
        d = b - a
        pulls.append(stiffness / MASS * (1 - rest / ca.sqrt(ca.dot(d, d))) * d)
    return [pulls[i + 1] - pulls[i] - ca.vertcat(0, 0, GRAVITY) for i in range(M)]


def rest_shape(n: int) -> np.ndarray:
    """Positions of the free balls at rest with the end ball at END, shape (3 (n - 2),)."""
    M = n - 2
    x = ca.SX.sym("x", 3 * M)
    f = ca.Function("f", [x], [ca.vertcat(*accelerations([x[3 * i : 3 * i + 3] for i in range(M)], ca.SX(ca.DM(END))))])
    guess = np.concatenate([[(i + 1) / (M + 1), 0.0, -0.3] for i in range(M)])
    return np.asarray(fsolve(lambda v: np.array(f(v)).ravel(), guess, xtol=1e-12))


def build_ocp(n: int = 5, N: int = 40) -> OCP:
    """Chain of n balls; it starts at rest, disturbed by a push of the end ball (initial state: the rest shape)."""
    M = n - 2
    shape = rest_shape(n)
    ocp = OCP(f"chain{n}", T=0.2 * N, N=N)
    ball = ocp.state("ball", size=3 * M, unit="m", initial=shape)
    end = ocp.state("tip", size=3, unit="m", initial=END)
    speed = ocp.state("speed", size=3 * M, unit="m/s")
    u = ocp.control("u", size=3, unit="m/s")
    ocp.dynamics(
        {
            "ball": speed,
            "tip": u,
            "speed": ca.vertcat(*accelerations([ball[3 * i : 3 * i + 3] for i in range(M)], end)),
        }
    )
    weights = [2.5] * (3 * M) + [25.0] * 3 + [25.0] * (3 * M)
    reference = np.concatenate([shape, END, np.zeros(3 * M)])
    ocp.least_squares(
        ca.vertcat(ocp.x, u),
        weight=np.array([*weights, *[0.1] * 3]),
        reference=np.concatenate([reference, np.zeros(3)]),
    )
    ocp.terminal_least_squares(ocp.x, weight=10 * np.array(weights), reference=reference)
    ocp.subject_to(-1, u, 1)
    return ocp


def main(picture: str = "out/chain.png") -> None:
    """Five pushes with u = (-1, 1, 1), then the controller brings the chain of 5 to rest."""
    ocp = build_ocp(5)
    controller = build(ocp, Options())
    x = np.array(controller.x[0])
    for _ in range(5):
        x = controller.integrate(x, np.array([-1.0, 1.0, 1.0]), 0.2)
    log = simulate(controller, x, steps=50, dt=0.2)
    print(log.summary())
    log.plot(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
