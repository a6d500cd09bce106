"""A load on a rope below a cart, in Cartesian coordinates: the rope is a constraint, its tension an unknown.

What it shows: equations of motion as they are written, M(x) x'' = forces + constraint forces, by
``implicit_dynamics()`` with ``der()``. The length of the rope, 0 = |r|^2 - 1, contains neither a derivative nor the
tension (index 3), so that it is stated twice differentiated; what would drift is damped (Baumgarte, Comput. Methods
Appl. Mech. Eng. 1 (1972), 1-16). All equations are linear in derivatives and tension: the compiler eliminates them, and
RK4 integrates what is left. A row limits the tension.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, build, simulate
from nmpc_codegen.runtime.loops.simulate import Log

CART, LENGTH, GRAVITY, DAMPING = 2.0, 1.0, 9.81, 5.0  # kg, m, m/s^2, 1/s
STRONGEST, SAMPLES = 11.0, 60  # N/m per kg


def build_ocp(N: int = 30) -> OCP:
    """3 s in N intervals."""
    ocp = OCP("rope_crane", T=3.0, N=N)
    s, vs = ocp.state("s", initial=1.0, unit="m"), ocp.state("vs", unit="m/s")
    p = ocp.state("p", size=2, initial=[1.0, -LENGTH], unit="m")
    v = ocp.state("v", size=2, unit="m/s")
    F, tension = ocp.control("F", unit="N"), ocp.algebraic("tension", unit="N/m")
    load = ocp.parameter("load", value=1.0, unit="kg")

    rope, turning = ca.vertcat(p[0] - s, p[1]), ca.vertcat(v[0] - vs, v[1])
    ocp.dynamics({s: vs, p: v})
    ocp.implicit_dynamics(CART * ocp.der(vs) - F - tension * rope[0], name="cart")
    ocp.implicit_dynamics(load * ocp.der(v) + tension * rope + load * ca.vertcat(0, GRAVITY), name="load")
    pull = ocp.der(v) - ca.vertcat(ocp.der(vs), 0)
    length, rate = (ca.sumsqr(rope) - LENGTH**2) / 2, ca.dot(rope, turning)
    second = ca.dot(rope, pull) + ca.sumsqr(turning)
    ocp.implicit_dynamics(second + 2 * DAMPING * rate + DAMPING**2 * length, name="length")

    ocp.least_squares(ca.vertcat(s, p[0], vs, v[0], F), weight=[10, 10, 1, 1, 0.05])
    ocp.terminal_least_squares(ca.vertcat(s, p[0], vs, v[0]), weight=20)
    ocp.subject_to(-10, F, 10)
    ocp.subject_to(-ca.inf, tension, STRONGEST, soft=(10, 10))
    return ocp


def stretch(log: Log) -> np.ndarray:
    """How far the length of the rope is from LENGTH at every sample, m."""
    found: np.ndarray = np.hypot(log.x[:, 2] - log.x[:, 0], log.x[:, 3]) - LENGTH
    return found


def draw(log: Log, path: Path) -> None:
    """Positions, force and tension, the way of the load, the length of the rope."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 2)
    for i, name in ((0, "cart"), (2, "load")):
        axes[0, 0].plot(log.t, log.x[:, i], label=name)
    axes[0, 0].set(ylabel="position (m)")
    axes[0, 0].legend(frameon=False)
    axes[1, 0].step(log.t[:-1], log.u[:, 0], where="post", label="force (N)")
    axes[1, 0].plot(log.t[:-1], log.z[:, 0], label="tension (N/m)")
    axes[1, 0].axhline(STRONGEST, color="0.5", linestyle=":")
    axes[1, 0].set(xlabel="time (s)")
    axes[1, 0].legend(frameon=False)
    for k in range(0, SAMPLES, 4):
        axes[0, 1].plot([log.x[k, 0], log.x[k, 2]], [0, log.x[k, 3]], ".-", color="0.6")
    axes[0, 1].plot(log.x[:, 2], log.x[:, 3])
    axes[0, 1].set(xlabel="horizontal (m)", ylabel="vertical (m)", aspect="equal")
    axes[1, 1].plot(log.t, 1e6 * stretch(log))
    axes[1, 1].set(xlabel="time (s)", ylabel="length of the rope - 1 m (um)")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main(picture: str = "out/rope_crane.png") -> Log:
    """Bring the load 1 m to the left."""
    controller = build(build_ocp())
    print(controller.description.report.choices[0])
    log = simulate(controller, [1.0, 0.0, 1.0, -LENGTH, 0.0, 0.0], SAMPLES)
    print(log.summary())
    draw(log, Path(picture))
    return log


if __name__ == "__main__":
    main(*sys.argv[1:])
