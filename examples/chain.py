"""Chain of balls on springs between a wall and a hand: the hand, whose velocity is controlled, brings it to rest.

What it shows: one function that states problems of any size, here n = 3, 5, 7 balls with nx = 9, 21, 33 states;
expressions that are built in loops, and used again to find the shape at rest by CasADi's Newton method; integrate(),
which calls the integrator of the package alone.

Of the n balls the first is fixed, the last is in the hand, and M = n - 2 are free: nx = 6 M + 3, nu = 3.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, build, simulate
from nmpc_codegen.runtime.loops.simulate import Log

MASS, STIFFNESS, GRAVITY = 0.033, 1.0, 9.81
HAND = (1.0, 0.0, 0.0)
SAMPLING = 0.2
PUSH = np.array([-1.0, 1.0, 1.0])  # m/s, for five samples


def accelerations(free: Any, hand: Any) -> Any:
    """Accelerations (3 M,) of the free balls at the positions ``free`` (3 M,), between the wall at 0 and the hand."""
    M = free.numel() // 3
    rest, stiffness = 0.033 * 6 / (M + 1), STIFFNESS * (M + 1)
    balls = [ca.SX(3, 1), *ca.vertsplit(free, 3), hand]
    pulls = []
    for a, b in pairwise(balls):
        d = b - a
        pulls.append(stiffness / MASS * (1 - rest / ca.norm_2(d)) * d)
    return ca.vertcat(*(after - before - ca.vertcat(0, 0, GRAVITY) for before, after in pairwise(pulls)))


def rest_shape(n: int) -> np.ndarray:
    """Positions of the free balls at rest with the hand at HAND, shape (3 (n - 2),)."""
    M = n - 2
    free = ca.SX.sym("free", 3 * M)
    newton = ca.rootfinder("rest", "newton", {"x": free, "g": accelerations(free, ca.SX(HAND))}, {"abstol": 1e-13})
    guess = [[s, 0.0, -4 * s * (1 - s)] for s in np.arange(1, M + 1) / (M + 1)]
    return newton(x0=np.ravel(guess))["x"].full().ravel()


def build_ocp(n: int = 5, N: int = 40) -> OCP:
    """A chain of n balls over N intervals of 0.2 s, initially at rest."""
    M = n - 2
    shape = rest_shape(n)
    ocp = OCP(f"chain{n}", T=SAMPLING * N, N=N)
    ball = ocp.state("ball", size=3 * M, unit="m", initial=shape)
    hand = ocp.state("hand", size=3, unit="m", initial=HAND)
    speed = ocp.state("speed", size=3 * M, unit="m/s")
    u = ocp.control("u", size=3, unit="m/s")
    ocp.dynamics({"ball": speed, "hand": u, "speed": accelerations(ball, hand)})

    Q = np.array([2.5] * (3 * M) + [25.0] * 3 + [25.0] * (3 * M))
    reference = np.concatenate([shape, HAND, np.zeros(3 * M)])
    ocp.least_squares(ca.vertcat(ocp.x, u), weight=[*Q, *[0.1] * 3], reference=[*reference, *[0.0] * 3])
    ocp.terminal_least_squares(ocp.x, weight=10 * Q, reference=reference)
    ocp.subject_to(-1, u, 1)
    return ocp


def still(n: int, samples: int = 60) -> Log:
    """Push the chain for five samples with the hand, then run the controller in closed loop."""
    controller = build(build_ocp(n))
    x = controller.x[0].copy()
    for _ in range(5):
        x = controller.integrate(x, PUSH, SAMPLING)
    return simulate(controller, x, steps=samples)


def draw(sizes: Sequence[int], logs: Sequence[Log], picture: str) -> None:
    """Plot every chain in space, from black to blue over time, with the path of its hand; below, speed and control."""
    figure = Figure(figsize=(3.8 * len(sizes), 7.0), layout="constrained")
    space, curves = figure.subfigures(2, 1, height_ratios=(1.6, 1))
    lower = curves.subplots(2, len(sizes), sharex=True, sharey="row", squeeze=False)
    for i, (n, log) in enumerate(zip(sizes, logs, strict=True)):
        M = n - 2
        axis = space.add_subplot(1, len(sizes), i + 1, projection="3d")
        balls = np.hstack([np.zeros((len(log.t), 3)), log.x[:, : 3 * M + 3]]).reshape(-1, n, 3)
        for k in (0, 2, 4, 8, 16, len(log.t) - 1):
            last = k == len(log.t) - 1
            shade = "#1f5fa8" if last else str(0.1 + 0.04 * k)
            axis.plot(*balls[k].T, "o-", color=shade, markersize=5, linewidth=1.8 if last else 1.0)
        axis.plot(*balls[:, -1].T, color="#c2571a", linewidth=1.2)
        axis.set_title(f"{n} balls, {log.x.shape[1]} states")
        axis.set_aspect("equal")
        axis.set_box_aspect(None, zoom=1.0)
        axis.locator_params(nbins=3)
        for name in "xyz":
            getattr(axis, f"set_{name}label")(f"{name} [m]", labelpad=-8, fontsize=8)
            axis.tick_params(axis=name, pad=-1)
        axis.view_init(elev=14, azim=-68)
        axis.tick_params(labelsize=7)
        speed = np.linalg.norm(log.x[:, 3 * M + 3 :].reshape(-1, M, 3), axis=2).max(axis=1)
        lower[0, i].semilogy(log.t, speed, color="#1f5fa8")
        lower[1, i].step(log.t[:-1], log.u, where="post", linewidth=1.0, label=["x", "y", "z"])
        lower[1, i].set(xlabel="time [s]", xlim=(0, log.t[-1]))
        for bound in (-1, 1):
            lower[1, i].axhline(bound, color="0.45", linewidth=1.0, linestyle="--")
    lower[0, 0].set_ylabel("fastest ball [m/s]")
    lower[1, 0].set_ylabel("hand [m/s]")
    lower[1, -1].legend(frameon=False, ncols=3, fontsize=8)
    for axis in lower.flat:
        axis.grid(alpha=0.25)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=80)


def main(picture: str = "out/chain.png", sizes: Sequence[int] = (3, 5, 7)) -> list[Log]:
    """Push chains of several sizes, and bring them to rest."""
    logs = [still(n) for n in sizes]
    for log in logs:
        print(log.summary())
    draw(sizes, logs, picture)
    return logs


if __name__ == "__main__":
    main(*sys.argv[1:2])
