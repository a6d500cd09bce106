"""Quadrotor: fly along an inclined figure of eight, which the controller previews over its whole horizon.

What it shows: states and controls that are vectors, options (one RK4 step per interval is enough here), and a
reference for every node of the horizon, updated at every sample. Twelve states, four rotor thrusts of 0 to 2.5 N.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, Options, RealTimeIteration, build, simulate
from nmpc_codegen.runtime.loops.simulate import Log

MASS, ARM, DRAG, GRAVITY = 0.5, 0.17, 0.016, 9.81
INERTIA = (0.0023, 0.0023, 0.004)
HOVER = MASS * GRAVITY / 4
SAMPLING = 0.05
PERIOD = 5.0  # s, of the figure of eight


def build_ocp(start: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> OCP:
    """20 intervals over 1 s, initially at rest at ``start`` (m); the default reference is to hover at the origin."""
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
    Q = [10.0] * 3 + [1.0] * 6 + [0.1] * 3
    hover = np.concatenate([np.zeros(12), np.full(4, HOVER)])
    ocp.least_squares(ca.vertcat(ocp.x, u), weight=[*Q, *[0.1] * 4], reference=hover)
    ocp.terminal_least_squares(ocp.x, weight=10 * np.array(Q))
    ocp.subject_to(0, u, 2.5)
    return ocp


def options(shift: str | None = None) -> Options:
    """One RK4 step per interval; with shift="repeat" the plan moves by one interval per sample."""
    return Options(
        integrator=ExplicitRungeKutta(RK4, steps=1), algorithm=RealTimeIteration(shift=shift, sampling_time=SAMPLING)
    )


def path(t: np.ndarray) -> np.ndarray:
    """Reference of the states at times t: position and velocity on the figure of eight, shape (len(t), 12)."""
    w = 2 * np.pi / PERIOD
    s, c, s2, c2 = np.sin(w * t), np.cos(w * t), np.sin(2 * w * t), np.cos(2 * w * t)
    position = np.stack([1.5 * s, 0.75 * s2, 1.0 + 0.4 * s], axis=1)
    velocity = np.stack([1.5 * w * c, 1.5 * w * c2, 0.4 * w * c], axis=1)
    return np.hstack([position, velocity, np.zeros((len(t), 6))])


def draw(log: Log, picture: str) -> None:
    """Plot the flight in space, with the arms of the quadrotor every 0.25 s, the distance to the path, and thrusts."""
    wanted = path(log.t)
    figure = Figure(figsize=(9, 7.6), layout="constrained")
    space, curves = figure.subfigures(2, 1, height_ratios=(2.6, 1))
    axis = space.add_subplot(projection="3d")
    axis.plot(*wanted[:, :3].T, color="0.35", linestyle=":", linewidth=1.2, label="reference")
    axis.plot(*log.x[:, :3].T, color="#1f5fa8", linewidth=1.6, label="flight")
    for k in range(0, len(log.t), 5):
        position, (phi, theta, psi) = log.x[k, :3], log.x[k, 6:9]
        rotation = _turn(2, psi) @ _turn(1, theta) @ _turn(0, phi)
        for arm in rotation.T[:2]:
            ends = np.stack([position - ARM * arm, position + ARM * arm])
            axis.plot(*ends.T, color="#c2571a", linewidth=1.5)
    axis.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axis.locator_params(nbins=5)
    axis.set_aspect("equal")
    axis.set_box_aspect(None, zoom=1.0)
    axis.view_init(elev=38, azim=-72)
    axis.legend(frameon=False, loc="upper right")
    left, right = curves.subplots(1, 2, sharex=True)
    left.semilogy(log.t, 100 * np.linalg.norm(log.x[:, :3] - wanted[:, :3], axis=1), color="#1f5fa8")
    left.set(ylabel="distance to reference [cm]", xlabel="time [s]", xlim=(0, log.t[-1]))
    right.step(log.t[:-1], log.u, where="post", linewidth=1.0, label=["1", "2", "3", "4"])
    right.legend(title="rotor", title_fontsize=8, fontsize=8, frameon=False, ncols=4, loc="lower right")
    for bound in (0, 2.5):
        right.axhline(bound, color="0.45", linewidth=1.0, linestyle="--")
    right.set(ylabel="thrusts [N]", xlabel="time [s]")
    for curve in (left, right):
        curve.grid(alpha=0.25)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=85)


def _turn(axis: int, angle: float) -> np.ndarray:
    """Matrix of the rotation about a coordinate axis, shape (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def main(picture: str = "out/quadrotor.png") -> Log:
    """Fly the figure twice, from rest at a point beside the path."""
    start = (-0.5, 0.8, 0.2)
    controller = build(build_ocp(start), options(shift="repeat"))
    steps = round(2 * PERIOD / SAMPLING)
    ahead = path(SAMPLING * np.arange(steps + controller.dims.N + 1))
    wanted = np.hstack([ahead, np.full((len(ahead), 4), HOVER)])  # node j of sample k has row k + j
    log = simulate(controller, controller.x[0], steps, dt=SAMPLING, references=wanted, warm_start=True)
    print(log.summary())
    draw(log, picture)
    return log


if __name__ == "__main__":
    main(*sys.argv[1:])
