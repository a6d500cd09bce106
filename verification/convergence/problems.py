"""solve() has to solve these problems from cold; each has a box from which measured states are drawn.

The boxes were written down before the first run and are not adapted to its results; starts that IPOPT does not solve
are listed by the benchmark.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from examples import bioreactor, cart_pole, chain, crane, cstr, quadrotor
from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, Options
from nmpc_codegen.frontend.classify import classify

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class StartProblem:
    """A start problem has RK4 steps per interval (0: discrete map), and the box (nx,) x 2 of its measured states."""

    name: str
    make: Callable[[], OCP] = field(repr=False)
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)
    steps: int = 1

    def options(self) -> Options:
        """Return the options that a user has to state: the number of steps."""
        return Options(ExplicitRungeKutta(RK4, steps=self.steps) if self.steps else None)

    def start(self, number: int) -> Array:
        """Return the measured state (nx,) of this number."""
        random = np.random.default_rng([12, number])
        return random.uniform(self.lower, self.upper)


def _around(center: object, reach: object) -> tuple[Array, Array]:
    c, r = np.asarray(center, dtype=float), np.asarray(reach, dtype=float)
    return c - r, c + r


def bicycle() -> OCP:
    """Return the OCP of a kinematic bicycle whose goal is behind an obstacle of radius 1 m on the straight line."""
    ocp = OCP("bicycle", T=4.0, N=40)
    x, y, psi = ocp.state("x", unit="m"), ocp.state("y", unit="m"), ocp.state("psi", unit="rad")
    v = ocp.state("v", unit="m/s", initial=1.0)
    a, delta = ocp.control("a", unit="m/s^2"), ocp.control("delta", unit="rad")
    ocp.dynamics({x: v * ca.cos(psi), y: v * ca.sin(psi), psi: v * ca.tan(delta) / 0.5, v: a})
    ocp.least_squares(ca.vertcat(ocp.x, a, delta), weight=[1, 1, 0.1, 0.1, 0.1, 0.1], reference=[6, 0, 0, 0, 0, 0])
    ocp.terminal_least_squares(ocp.x, weight=[10, 10, 1, 1], reference=[6, 0, 0, 0])
    ocp.subject_to(-2, a, 2)
    ocp.subject_to(-0.5, delta, 0.5)
    ocp.subject_to(-0.5, v, 3)
    ocp.subject_to(1.0, (x - 3) ** 2 + (y - 0.1) ** 2, np.inf, name="obstacle")
    return ocp


def discs() -> OCP:
    """Return the OCP of a mass in the plane with position, velocity and force in discs, and a target outside them."""
    ocp = OCP("discs", T=3.0, N=20)
    p, v, F = ocp.state("p", size=2), ocp.state("v", size=2), ocp.control("F", size=2)
    ocp.dynamics({p: v, v: F})
    ocp.least_squares(ca.vertcat(p, v, F), weight=[1, 1, 0.01, 0.01, 0.01, 0.01], reference=[3, 2, 0, 0, 0, 0])
    ocp.terminal_least_squares(ca.vertcat(p, v), weight=[1, 1, 0.1, 0.1], reference=[3, 2, 0, 0])
    ocp.subject_to(-np.inf, ca.sumsqr(F), 4.0, name="force")
    ocp.subject_to(-np.inf, ca.sumsqr(v), 1.0, name="speed")
    ocp.subject_to(-np.inf, ca.sumsqr(p), 4.0, name="field")
    return ocp


def _hoist(x: Any, a: Any) -> Any:
    """Return the derivatives of (p, v, phi, omega): a trolley with acceleration a and a load on a rope of 1 m."""
    return ca.vertcat(x[1], a, x[3], -9.81 * ca.sin(x[2]) - a * ca.cos(x[2]) - 0.2 * x[3])


def fastest_crane() -> OCP:
    """Return the OCP of the crane that comes to rest at the origin in the shortest time, which is a free state."""
    ocp = OCP("fastest_crane", T=1.0, N=40)
    x, Tf = ocp.state("x", size=4, initial=[2.0, 0, 0, 0]), ocp.state("Tf", unit="s", initial=4.0)
    a = ocp.control("a", unit="m/s^2")
    ocp.dynamics({x: Tf * _hoist(x, a), Tf: 0})
    ocp.free_initial(Tf)
    ocp.terminal_cost(Tf)
    ocp.least_squares(a, weight=1e-3)
    ocp.subject_to(-1, a, 1)
    ocp.subject_to(-1.2, x[1], 1.2)
    ocp.subject_to(0.1, Tf, 20, name="duration")
    ocp.subject_to(0, x, 0, at="end", name="rest")
    return ocp


def swing_up() -> OCP:
    """Return the OCP of a pendulum with little torque that swings up from hanging to upright, th = 0, within 4 s."""
    ocp = OCP("swing_up", T=4.0, N=40)
    th, w, u = ocp.state("th", unit="rad", initial=np.pi), ocp.state("w", unit="rad/s"), ocp.control("u")
    ocp.dynamics({th: w, w: 9.81 * ca.sin(th) + u})
    ocp.least_squares(ca.vertcat(w, u), weight=[0.01, 1.0])
    ocp.subject_to(-4, u, 4)
    ocp.subject_to(0, ca.vertcat(th, w), 0, at="end", name="upright")
    return ocp


def fastest_swing_up() -> OCP:
    """Return the OCP of the swing-up in the shortest time."""
    ocp = OCP("fastest_swing_up", T=1.0, N=40)
    th, w = ocp.state("th", unit="rad", initial=np.pi), ocp.state("w", unit="rad/s")
    Tf, u = ocp.state("Tf", unit="s", initial=3.0), ocp.control("u")
    ocp.dynamics({th: Tf * w, w: Tf * (9.81 * ca.sin(th) + u), Tf: 0})
    ocp.free_initial(Tf)
    ocp.terminal_cost(Tf)
    ocp.least_squares(u, weight=1e-3)
    ocp.subject_to(-4, u, 4)
    ocp.subject_to(0.5, Tf, 10, name="duration")
    ocp.subject_to(0, ca.vertcat(th, w), 0, at="end", name="upright")
    return ocp


def battery() -> OCP:
    """Return the OCP of fast charging within soft limits of temperature and voltage.

    A linearly implicit map integrates the fast overpotential.
    """
    ocp = OCP("battery", N=30)
    soc, v1 = ocp.state("soc", initial=0.2), ocp.state("v1", unit="V")
    Tc, current = ocp.state("Tc", unit="degC", initial=30.0), ocp.control("I", unit="A")

    def slope(x: Any) -> Any:
        r = 0.01 * ca.exp(-0.02 * (x[2] - 25))
        heat = current**2 * 0.02 + x[1] * current - 0.1 * (x[2] - 25)
        return ca.vertcat(current / 9000, (current * r - x[1]) / 0.005, heat / 60)

    s, z = ca.SX.sym("s", 3), ocp.x
    jacobian = ca.jacobian(slope(s), s)
    for _ in range(2):
        A = ca.SX.eye(3) - 0.5 * ca.substitute(jacobian, s, z)
        z = z + ca.solve(A, 0.5 * slope(z))
    ocp.dynamics(z, discrete=True)
    voltage = 3.2 + 0.8 * soc + 0.1 * ca.tanh(8 * (soc - 0.1)) + v1 + 0.02 * current
    ocp.least_squares(ca.vertcat(soc, current), weight=[1e4, 1e-3], reference=[0.8, 0])
    ocp.terminal_least_squares(soc, weight=1e5, reference=0.8)
    ocp.subject_to(0, current, 20)
    ocp.subject_to(-np.inf, Tc, 32, name="hot", soft=(2000, 0))
    ocp.subject_to(-np.inf, voltage, 4.0, name="voltage", soft=(1000, 0))
    return ocp


def reaction() -> OCP:
    """Return the OCP of the economic control of a reactor A -> B by its flow (Diehl, Amrit and Rawlings 2011).

    Only c_A is fixed at the end: c_A + c_B tends to 1 whatever the flow is.
    """
    ocp = OCP("reaction", T=10.0, N=50)
    cA, cB = ocp.state("cA", initial=0.5), ocp.state("cB", initial=0.5)
    q = ocp.control("q")
    ocp.dynamics({cA: q / 10 * (1 - cA) - 0.4 * cA, cB: -q / 10 * cB + 0.4 * cA})
    ocp.stage_cost(-q * (2 * cB - 0.5) + 0.505 * (q - 4) ** 2)
    ocp.subject_to(0, q, 20)
    ocp.subject_to(0.5, cA, 0.5, at="end", name="steady_A")
    return ocp


def oscillator() -> OCP:
    """Return the OCP of a van der Pol oscillator with a bound on a state that is active for a while."""
    ocp = OCP("oscillator", T=10.0, N=20)
    x, y, u = ocp.state("x", initial=0.0), ocp.state("y", initial=1.0), ocp.control("u")
    ocp.dynamics({x: (1 - y**2) * x - y + u, y: x})
    ocp.least_squares(ca.vertcat(x, y, u), weight=[1, 1, 1])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-0.25, x, np.inf, name="slow")
    return ocp


def free_period() -> OCP:
    """Return the OCP of the most productive orbit of the fermentation, whose period is free."""
    D, KI, KM, PM, Y = 0.15, 22.0, 1.2, 50.0, 0.4
    ocp = OCP("free_period", T=1.0, N=24)
    X, S = ocp.state("X", initial=5.8), ocp.state("S", initial=18.0)
    P, period = ocp.state("P", initial=20.5), ocp.state("period", unit="h", initial=48.0)
    feed, biomass = ocp.state("feed"), ocp.state("biomass")
    Sf = ocp.control("Sf", unit="g/L")
    mu = 0.48 * (1 - P / PM) * S / (KM + S + S**2 / KI)
    ocp.dynamics({X: period * (mu - D) * X, S: period * (D * (Sf - S) - mu * X / Y), period: 0})
    ocp.dynamics({P: period * (-D * P + (2.2 * mu + 0.2) * X), feed: Sf, biomass: X})
    ocp.accumulator(feed, biomass)
    ocp.free_initial(X, S, P, period)
    ocp.stage_cost(-D * P, integrate=True)
    ocp.subject_to(28.7, Sf, 40)
    ocp.subject_to(20, period, 80, name="duration")
    ocp.subject_to(32.9, feed, 32.9, at="end", name="feed_average")
    ocp.subject_to(-np.inf, biomass, 5.8, at="end", name="biomass_average")
    ocp.boundary(0, ocp.at_start(ocp.x[:3]) - ocp.at_end(ocp.x[:3]), 0, name="orbit")
    return ocp


def problems() -> tuple[StartProblem, ...]:
    """Return all problems."""
    tip = np.asarray(classify(chain.build_ocp(3)).x_initial, dtype=float)
    steady = cstr.SET_POINTS[0][:4]
    orbit = np.array([5.8, 18.0, 20.5])
    return (
        StartProblem("crane", crane.build_ocp, *_around([0, 0, 0, 0], [1.0, 0.3, 0.3, 0.3])),
        StartProblem("reactor", cstr.build_ocp, *_around(steady, [1.0, 0.5, 15.0, 15.0]), steps=2),
        StartProblem("cart_pole", cart_pole.build_ocp, *_around([0, np.pi, 0, 0], [0.5, 1.0, 1.0, 2.0]), steps=2),
        StartProblem("quadrotor", quadrotor.build_ocp, *_around(np.zeros(12), [2] * 3 + [1] * 3 + [0.5] * 3 + [1] * 3)),
        StartProblem("chain", lambda: chain.build_ocp(3), *_around(tip, np.full(tip.size, 0.3)), steps=2),
        StartProblem("fermenter", lambda: bioreactor.build_ocp("b"), *_around([*orbit, 0, 0], [*0.3 * orbit, 0, 0]), 3),
        StartProblem("bicycle", bicycle, *_around([-0.5, 0, 0, 1], [1.0, 1.5, 0.8, 1.0])),
        StartProblem("discs", discs, *_around([0, 0, 0, 0], [1.0, 1.0, 0.5, 0.5])),
        StartProblem("fastest_crane", fastest_crane, *_around([0, 0, 0, 0, 5], [3.0, 0.5, 0.3, 0.5, 3]), 2),
        StartProblem("swing_up", swing_up, *_around([np.pi, 0], [0.5, 0.5])),
        StartProblem("fastest_swing_up", fastest_swing_up, *_around([np.pi, 0, 4], [0.5, 0.5, 2]), 1),
        StartProblem("battery", battery, *_around([0.4, 0, 29], [0.3, 0, 2]), steps=0),
        StartProblem("reaction", reaction, *_around([0.5, 0.5], [0.4, 0.4]), 1),
        StartProblem("oscillator", oscillator, *_around([0.4, 0], [0.6, 1.0])),
        StartProblem("free_period", free_period, *_around([*orbit, 50, 0, 0], [*0.2 * orbit, 15, 0, 0]), 2),
    )
