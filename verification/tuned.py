"""Problems with the features of tuned controllers are stated twice: as an OCP, and by hand for IPOPT.

The features are previous controls, rates, move blocks, time and discrete states.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import OCP
from verification.oracles.transcribed import Transcription

#: The problem, its transcription by hand, x_0, and the previous control.
Tuned = tuple[OCP, Transcription, list[float], list[float]]


def _none(*_: Any) -> dict[int, Any]:
    return {}


def slewed_crane(N: int = 10, name: str = "slewed") -> Tuned:
    """Return the OCP of a crane whose trolley force has a rate penalty, a rate limit, and a terminal penalty."""
    ocp = OCP(name, T=0.3 * N, N=N)
    p, v, q, w = (ocp.state(n) for n in ("p", "v", "q", "w"))
    F = ocp.control("F", unit="N")
    x = ca.vertcat(p, v, q, w)
    ocp.dynamics({p: v, v: F, q: w, w: -9.81 * ca.sin(q) - F * ca.cos(q)})
    ocp.least_squares(x, [10, 1, 5, 1], reference=[1, 0, 0, 0])
    ocp.least_squares(ocp.rate(F), 0.05, names="slew")
    ocp.subject_to(-2, ocp.rate(F), 2.5, name="slew")
    ocp.terminal_least_squares(ca.vertcat(x, ocp.previous(F)), [50, 5, 25, 5, 2], reference=[1, 0, 0, 0, 0])
    ocp.subject_to(-5, F, 5)
    path, end = np.array([10, 1, 5, 1.0]), np.array([50, 5, 25, 5, 2.0])
    target = np.array([1.0, 0, 0, 0])

    def square(weight: Any, y: Any) -> Any:
        return ca.dot(weight * y, y) / 2

    by_hand = Transcription(
        4,
        1,
        (0.3,) * N,
        lambda x, u, v, t: ca.vertcat(x[1], u, x[3], -9.81 * ca.sin(x[2]) - u * ca.cos(x[2])),
        _none,
        lambda x, u, v, t, d: square(path, x - target) + 0.05 / 2 * ((u - v) / d) ** 2,
        lambda x, v, t: square(end, ca.vertcat(x - target, v)),
        rows=[(-2, lambda x, u, v, t, d: (u - v) / d, 2.5, range(N))],
        lower=[-5],
        upper=[5],
    )
    return ocp, by_hand, [0.0, 0.0, 0.1, 0.0], [0.4]


def graded_tank(name: str = "graded") -> Tuned:
    """Return the OCP of two tanks on a grid of growing intervals.

    They have general costs of rates, a row of the rates of both pumps, and a row of a level and the previous control.
    """
    dt = (0.5, 0.5, 1.0, 1.0, 2.0, 3.0)
    ocp = OCP(name, intervals=dt)
    h, g = ocp.state("h", initial=1.0), ocp.state("g", initial=0.5)
    u = ocp.control("u", size=2)
    before = ocp.previous(u)
    ocp.dynamics({h: u[0] - 0.5 * h * h + 0.1 * u[1], g: 0.3 * h - 0.4 * g + u[1]})
    ocp.stage_cost(
        (h - 1.5) ** 2 + (g - 1) ** 2 + 0.1 * ca.sumsqr(ocp.rate(u)) + 0.05 * h * before[1] + 0.02 * u[1] ** 4
    )
    ocp.terminal_cost(3 * (h - 1.5) ** 2 + (g - 1) ** 2 + 0.3 * before[0] ** 2)
    ocp.subject_to(-0.8, ocp.rate(u[0]) + ocp.rate(u[1]), 0.8, name="both")
    ocp.subject_to(-9, h + 0.5 * before[0], 2.2, name="mixed")
    ocp.subject_to(-2, u, 2)

    def stage(x: Any, u: Any, v: Any, t: Any, d: float) -> Any:
        value = (x[0] - 1.5) ** 2 + (x[1] - 1) ** 2 + 0.1 * ca.sumsqr((u - v) / d)
        return value + 0.05 * x[0] * v[1] + 0.02 * u[1] ** 4

    starts = np.concatenate([[0.0], np.cumsum(dt)])

    def scaled(x: Any, u: Any, v: Any, t: Any, d: float) -> Any:
        return dt[int(np.argmin(np.abs(starts - t)))] * stage(x, u, v, t, d)

    by_hand = Transcription(
        2,
        2,
        dt,
        lambda x, u, v, t: ca.vertcat(u[0] - 0.5 * x[0] ** 2 + 0.1 * u[1], 0.3 * x[0] - 0.4 * x[1] + u[1]),
        _none,
        scaled,
        lambda x, v, t: 3 * (x[0] - 1.5) ** 2 + (x[1] - 1) ** 2 + 0.3 * v[0] ** 2,
        rows=[
            (-0.8, lambda x, u, v, t, d: (u[0] - v[0] + u[1] - v[1]) / d, 0.8, range(6)),
            (-9, lambda x, u, v, t, d: x[0] + 0.5 * v[0], 2.2, range(1, 6)),
        ],
        end_rows=[(-9, lambda x, v, t: x[0] + 0.5 * v[0], 2.2)],
        lower=[-2, -2],
        upper=[2, 2],
    )
    return ocp, by_hand, [1.0, 0.5], [0.3, -0.1]


def dead_time(name: str = "dead") -> Tuned:
    """Return the OCP of a discrete map that the control reaches one sample late; its cost counts actuator changes."""
    N = 12
    ocp = OCP(name, N=N)
    x, y = ocp.state("x", initial=2.0), ocp.state("y")
    a, b = ocp.control("a"), ocp.control("b")
    ocp.dynamics({x: x + 0.2 * y, y: 0.9 * y - 0.1 * ca.sin(x) + ocp.previous(a) + 0.1 * b}, discrete=True)
    ocp.least_squares(ca.vertcat(x, y, a - ocp.previous(a), b), [1, 0.1, 0.5, 0.2])
    ocp.terminal_least_squares(ca.vertcat(x, y), [5, 1])
    ocp.subject_to(-0.3, a - ocp.previous("a"), 0.3, name="move")
    ocp.subject_to(-1, ca.vertcat(a, b), 1)
    by_hand = Transcription(
        2,
        2,
        (1.0,) * N,
        None,
        lambda x, u, v, t, dt: {0: x[0] + 0.2 * x[1], 1: 0.9 * x[1] - 0.1 * ca.sin(x[0]) + v[0] + 0.1 * u[1]},
        lambda x, u, v, t, d: (x[0] ** 2 + 0.1 * x[1] ** 2 + 0.5 * (u[0] - v[0]) ** 2 + 0.2 * u[1] ** 2) / 2,
        lambda x, v, t: (5 * x[0] ** 2 + x[1] ** 2) / 2,
        rows=[(-0.3, lambda x, u, v, t, d: u[0] - v[0], 0.3, range(N))],
        lower=[-1, -1],
        upper=[1, 1],
    )
    return ocp, by_hand, [2.0, 0.0], [0.2, 0.0]


def timed_vessel(name: str = "vessel") -> Tuned:
    """Return an OCP with time in derivatives, cost and rows, the previous control in derivatives, and a counter."""
    N = 8
    ocp = OCP(name, T=4.0, N=N)
    x, y = ocp.state("x", initial=0.5), ocp.state("y")
    n = ocp.state("n", initial=0.2)
    u = ocp.control("u")
    late, t = ocp.previous(u), ocp.time
    ocp.dynamics(
        {x: y + 0.3 * ca.sin(2 * t), y: -x + u + 0.5 * late - 0.1 * y**3 + 0.1 * n},
        discrete={n: 0.8 * n + 0.1 * x * x + 0.05 * u},
    )
    ocp.least_squares(ca.vertcat(x - ca.cos(t), y, ocp.rate(u), n), [2, 0.1, 0.05, 0.1])
    ocp.terminal_least_squares(ca.vertcat(x - ca.cos(t), y, n), [4, 0.2, 1.0])
    ocp.subject_to(-3, x + 0.1 * t, 1.1, name="wall")
    ocp.subject_to(-1.5, u, 1.5)
    by_hand = Transcription(
        3,
        1,
        (0.5,) * N,
        lambda x, u, v, t: ca.vertcat(
            x[1] + 0.3 * ca.sin(2 * t), -x[0] + u + 0.5 * v - 0.1 * x[1] ** 3 + 0.1 * x[2], 0
        ),
        lambda x, u, v, t, dt: {2: 0.8 * x[2] + 0.1 * x[0] ** 2 + 0.05 * u},
        lambda x, u, v, t, d: (
            (2 * (x[0] - np.cos(t)) ** 2 + 0.1 * x[1] ** 2 + 0.05 * ((u - v) / d) ** 2 + 0.1 * x[2] ** 2) / 2
        ),
        lambda x, v, t: (4 * (x[0] - np.cos(t)) ** 2 + 0.2 * x[1] ** 2 + x[2] ** 2) / 2,
        rows=[(-3, lambda x, u, v, t, d: x[0] + 0.1 * t, 1.1, range(1, N))],
        end_rows=[(-3, lambda x, v, t: x[0] + 0.1 * t, 1.1)],
        lower=[-1.5],
        upper=[1.5],
    )
    return ocp, by_hand, [0.5, 0.0, 0.2], [0.3]


def blocked_crane(name: str = "blocked") -> Tuned:
    """Return the OCP of the crane on blocks: four values over eight intervals, a rate penalty, a row with the force."""
    N, blocks = 8, (1, 1, 2, 4)
    ocp = OCP(name, T=0.3 * N, N=N)
    p, v, q, w = (ocp.state(n) for n in ("p", "v", "q", "w"))
    F = ocp.control("F", unit="N", hold=blocks)
    G = ocp.control("G")
    x = ca.vertcat(p, v, q, w)
    ocp.dynamics({p: v, v: F, q: w, w: -9.81 * ca.sin(q) - F * ca.cos(q) + 0.5 * G})
    ocp.least_squares(ca.vertcat(x, F, G), [10, 1, 5, 1, 0.02, 0.5], reference=[1, 0, 0, 0, 0.5, 0])
    ocp.least_squares(ocp.rate(F), 0.05, names="slew")
    ocp.subject_to(-4, F + v, 1.2, name="power")
    ocp.terminal_least_squares(x, [50, 5, 25, 5], reference=[1, 0, 0, 0])
    ocp.subject_to(-5, F, 5)
    ocp.subject_to(-1, G, 1)
    path, end = np.array([10, 1, 5, 1.0]), np.array([50, 5, 25, 5.0])
    target = np.array([1.0, 0, 0, 0])

    def cost(x: Any, u: Any, v: Any, t: Any, d: float) -> Any:
        square = ca.dot(path * (x - target), x - target) + 0.02 * (u[0] - 0.5) ** 2 + 0.5 * u[1] ** 2
        return (square + 0.05 * ((u[0] - v[0]) / d) ** 2) / 2

    by_hand = Transcription(
        4,
        2,
        (0.3,) * N,
        lambda x, u, v, t: ca.vertcat(x[1], u[0], x[3], -9.81 * ca.sin(x[2]) - u[0] * ca.cos(x[2]) + 0.5 * u[1]),
        _none,
        cost,
        lambda x, v, t: ca.dot(end * (x - target), x - target) / 2,
        rows=[(-4, lambda x, u, v, t, d: u[0] + x[1], 1.2, range(N))],
        lower=[-5, -1],
        upper=[5, 1],
        hold=[blocks, (1,) * N],
    )
    return ocp, by_hand, [0.0, 0.0, 0.1, 0.0], [0.4, 0.0]


PROBLEMS: dict[str, Callable[[], Tuned]] = {
    "slewed crane": slewed_crane,
    "graded tank": graded_tank,
    "dead time": dead_time,
    "timed vessel": timed_vessel,
    "blocked crane": blocked_crane,
}
