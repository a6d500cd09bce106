"""Energy-optimal driving: an economic cost with a state that grows for ever, and a terminal cost from its regulator.

What it shows: cyclic() for the position along the road, which has no steady state; lqr_terminal_cost(economic=True),
whose matrix P is indefinite; a cost integrated with the dynamics, without which the controller has no stable regulator;
the constant Hessian M of tune(), which has no rows for the position; an obstacle that disappears, by bounds that change
at every sample: those of the position do not concern M.

An electric car keeps 50 km/h with the least energy: the gain of speed makes 50 km/h the best steady one. At
8 s the lane moves sideways. The state ``py`` is the distance from the middle of the lane, so the car, which does not
foresee the move, measures a jump. Until 6 s something blocks the road at 80 m.

Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020), section V.B. Powers are divided by 14341 W,
so that energy and lateral deviations have comparable weights. Time in seconds.
"""

from __future__ import annotations

import sys
from itertools import count
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import (
    OCP,
    RK4,
    Controller,
    ExactHessian,
    ExplicitRungeKutta,
    Online,
    Options,
    Project,
    RealTimeIteration,
    build,
    simulate,
)
from nmpc_codegen.economic import Tuning, steady_state, tune
from nmpc_codegen.runtime.loops.simulate import Log

LENGTH, MASS, RADIUS, GRAVITY, GEAR = 4.8, 1700.0, 0.35, 9.81, 7.94
DRAG, ROLLING = 0.45, 0.015
T_MAX, P_MAX, OMEGA_MAX, BRAKE_MAX = 280.0, 80e3, 1047.2, 10e3
POWER = 14341.0  # W
SPEED = 50 / 3.6
SAMPLING, N, STEPS = 0.1, 100, 5
OBSTACLE, CLEARED, MOVE = 80.0, 6.0, 8.0  # m, s, s
TARGET: dict[str, Any] = {"color": "0.15", "linewidth": 0.8}
BOUND: dict[str, Any] = {"color": "0.45", "linewidth": 1.0, "linestyle": "--"}


def build_ocp(newton: float = 1000.0, intervals: int = N, *, economic: bool = True) -> OCP:
    """Intervals of 0.1 s; the terminal cost is the cost-to-go of the regulator at 50 km/h. No cost if not ``economic``.

    Torque and brake are measured in ``newton`` N m and N: in kilo, as their effect on the cost is then of size 1.
    """
    ocp = OCP("driving", T=SAMPLING * intervals, N=intervals)
    px, py = ocp.state("px", unit="m"), ocp.state("py", unit="m")
    v = ocp.state("v", unit="m/s", initial=SPEED)
    theta, delta = ocp.state("theta", unit="rad"), ocp.state("delta", unit="rad")
    T = ocp.control("T", unit="kN m" if newton == 1000.0 else "")
    Fb = ocp.control("Fb", unit="kN" if newton == 1000.0 else "")
    steering = ocp.control("steering", unit="rad/s")

    drag = DRAG * v**2 + MASS * GRAVITY * ROLLING
    ocp.dynamics(
        {
            px: v * ca.cos(theta),
            py: v * ca.sin(theta),
            v: (newton * (GEAR * T / RADIUS - Fb) - drag) / MASS,
            theta: v * ca.tan(delta) / LENGTH,
            delta: steering,
        }
    )
    ocp.cyclic(px)

    if economic:
        ocp.stage_cost(cost_rate(ocp.x, ocp.u, newton), integrate=True)
        ocp.lqr_terminal_cost(economic=True)

    ocp.subject_to(0, T, T_MAX / newton)
    ocp.subject_to(0, Fb, BRAKE_MAX / newton)
    ocp.subject_to(-np.inf, T * GEAR * v / RADIUS, P_MAX / newton, name="power")
    ocp.subject_to(0, v, OMEGA_MAX * RADIUS / GEAR)
    ocp.subject_to(-np.inf, px, np.inf, name="obstacle")
    return ocp


def power(v: Any, torque: Any) -> Any:
    """Electric power (W) of the motor at the speed v (m/s) and torque (N m)."""
    omega = GEAR * v / RADIUS
    return omega * torque + 0.0323 * omega * torque + 0.0183 * omega**2 + 0.0043 * torque**2


def steady_power(v: Any) -> Any:
    """Electric power (W) that it takes to keep the speed v (m/s)."""
    return power(v, (DRAG * v**2 + MASS * GRAVITY * ROLLING) * RADIUS / GEAR)


def gain(speed: float) -> float:
    """Cost of a metre (W s) for which this speed (m/s) is the best steady one: minus the slope of its power."""
    v = ca.SX.sym("v")
    return -float(ca.Function("slope", [v], [ca.gradient(steady_power(v), v)])(speed))


def cost_rate(x: Any, u: Any, newton: float = 1000.0, lane: Any = 0.0) -> Any:
    """Electric power with the gain of speed, and deviations from the middle of the lane at ``lane`` m."""
    money = (power(x[2], newton * u[0]) + gain(SPEED) * x[2]) / POWER
    return money + (x[1] - lane) ** 2 + x[3] ** 2 + x[4] ** 2 + u[2] ** 2


def options(hessian: Any = None) -> Options:
    """Five RK4 steps per interval; the plan moves by one interval per sample.

    The bounds differ between nodes, because the obstacle disappears within the plan. Without a Hessian it is the exact
    one, so that an export needs no semidefinite program.
    """
    return Options(
        integrator=ExplicitRungeKutta(RK4, steps=STEPS),
        hessian=hessian or ExactHessian(Project()),
        algorithm=RealTimeIteration(sampling_time=SAMPLING),
        online=Online(bounds="node"),
    )


def tuned() -> Tuning:
    """The tuning; the position has zero rows in M."""
    return tune(build_ocp(), options())


def schedule(k: int, controller: Controller) -> None:
    """Bounds of the position at the nodes of sample k: OBSTACLE up to the time CLEARED, none after it."""
    for node in range(1, N + 1):
        blocked = (k + node) * SAMPLING <= CLEARED + 1e-9
        controller.set_bounds("obstacle", -np.inf, OBSTACLE if blocked else np.inf, node=node)


def closed_loop(side_step: float = 2.0, samples: int = 300, hessian: Any = None) -> Log:
    """Drive 30 s; from the best steady state as first plan. The lane moves by ``side_step`` m at the time MOVE."""
    ocp = build_ocp()
    best = steady_state(ocp, options())
    controller = build(ocp, options(hessian))
    controller.x[...] = controller.x[0]
    controller.x[:, 2] = SPEED
    controller.x[:, 0] = np.arange(N + 1) * SAMPLING * SPEED
    controller.u[...] = best.u
    moved = round(MOVE / SAMPLING)
    done = count(1)

    def plant(x: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        x_next = np.array(controller.integrate(x, u, dt))
        if next(done) == moved:
            x_next[1] -= side_step
        return x_next

    start = np.array([0.0, 0.0, SPEED, 0.0, 0.0])
    return simulate(controller, start, steps=samples, dt=SAMPLING, plant=plant, before=schedule)


def draw(log: Log, picture: str) -> None:
    """Plot speed, position with the obstacle, lateral distance, torque and brake, each with its bounds."""
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True)
    values = (log.x[:, 2] * 3.6, log.x[:, 0], log.x[:, 1])
    names = ("speed [km/h]", "position [m]", "distance from\nthe lane [m]")
    for axis, value, name in zip(axes, values, names, strict=False):
        axis.plot(log.t, value, color="#1f5fa8", linewidth=1.6)
        axis.set_ylabel(name)
    axes[0].axhline(3.6 * SPEED, **TARGET, label="best steady speed")
    axes[1].fill_between([0, CLEARED], OBSTACLE, log.x[:, 0].max(), color="#b3202c", alpha=0.12, linewidth=0)
    axes[1].annotate("obstacle", (0.5 * CLEARED, 0.5 * (OBSTACLE + log.x[:, 0].max())), ha="center", fontsize=8)
    axes[2].axhline(0.0, **TARGET, label="middle of the lane")
    most = np.minimum(T_MAX, P_MAX * RADIUS / (GEAR * log.x[:-1, 2])) / 1000.0
    for axis, j, name, bound in ((axes[3], 0, "torque [kN m]", most), (axes[4], 1, "brake [kN]", 0 * most + 10.0)):
        axis.step(log.t[:-1], log.u[:, j], where="post", color="#c2571a", linewidth=1.6)
        axis.plot(log.t[:-1], bound, **BOUND, label="bound")
        axis.axhline(0.0, **BOUND)
        axis.set_ylabel(name)
    axes[-1].set_xlabel("time [s]")
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.margins(x=0)
        if axis is not axes[1]:
            axis.legend(frameon=False, fontsize=8, loc="upper right" if axis is axes[0] else "right")
    figure.align_ylabels(axes)
    figure.suptitle("Energy-optimal driving: an obstacle until 6 s, a move of the lane at 8 s", fontsize=11)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=90)


def main(picture: str = "out/driving.png") -> tuple[Tuning, Log]:
    """Print the tuning, drive 30 s with M and draw the figure."""
    tuning = tuned()
    print(tuning)
    log = closed_loop(hessian=tuning.hessian())
    print(log.summary())
    print(f"at most {log.x[: round(CLEARED / SAMPLING) + 1, 0].max():.3f} m until {CLEARED:g} s")
    draw(log, picture)
    return tuning, log


if __name__ == "__main__":
    main(*sys.argv[1:])
