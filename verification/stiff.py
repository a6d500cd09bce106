"""Stiff problems of users have closed loops: kinetics, a distillation column, a converter, a battery cell.

Radau's method of SciPy simulates the same model as the plant, with other parameters and measurement noise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from examples import fast_charge
from nmpc_codegen import OCP, Controller, Options, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.reference import Reference, ReferenceSolution, Tableau, node_data

Array = NDArray[Any]


def kinetics() -> OCP:
    """Return the OCP of Robertson's reactions in a stirred tank: a slow one, a fast intermediate, an autocatalytic one.

    Rates differ by 1e9. The feed holds the product at its set point. Time is in s.
    """
    ocp = OCP("kinetics", T=400.0, N=20)
    a, b, c = (ocp.state(n, initial=v, unit="mol/l") for n, v in (("a", 0.6), ("b", 1e-5), ("c", 0.4)))
    q = ocp.control("q", unit="1/s")
    k = ocp.parameter("k", value=0.04, bounds=(0.03, 0.05))
    slow, fast, very_fast = k * a, 1e4 * b * c, 3e7 * b**2
    ocp.dynamics({a: q * (1 - a) - slow + fast, b: slow - fast - very_fast - q * b, c: very_fast - q * c})
    ocp.least_squares(ca.vertcat(c, q), weight=[10, 200], reference=[0.3, 0.002])
    ocp.subject_to(0, q, 0.02)
    ocp.subject_to(0, c, 0.5)
    return ocp


def reactor() -> OCP:
    """Return the OCP of A -> R -> B in a stirred tank with a jacket.

    R reacts in seconds, the tank takes an hour. Time is in min.
    """
    ocp = OCP("reactor", T=60.0, N=30, time_unit="min")
    a, r, b = ocp.state("a", initial=1.0), ocp.state("r", initial=0.1), ocp.state("b", initial=0.5)
    T, Tj = ocp.state("T", initial=350.0, unit="K"), ocp.state("Tj", initial=340.0, unit="K")
    q, Tc = ocp.control("q", unit="1/min"), ocp.control("Tc", unit="K")
    k = ocp.parameter("k", value=0.02, bounds=(0.015, 0.025))
    slow, fast = k * ca.exp(3000 * (1 / 350 - 1 / T)) * a, 2 * r * a
    ocp.dynamics(
        {
            a: q * (2 - a) - slow - fast,
            r: 1e3 * (slow - fast) - 50 * r,
            b: fast - q * b,
            T: q * (320 - T) + 40 * (slow + fast) - 0.5 * (T - Tj),
            Tj: 20 * (Tc - Tj) + 2 * (T - Tj),
        }
    )
    ocp.least_squares(ca.vertcat(b, T, q, Tc), weight=[100, 0.1, 10, 0.01], reference=[1.0, 355, 0.05, 340])
    ocp.subject_to([0, 290, -ca.inf], ca.vertcat(q, Tc, T), [0.5, 360, 365])
    return ocp


#: Number of trays between reboiler (0) and condenser (TRAYS + 1), feed tray, hydraulic time constant (min), volatility.
TRAYS, FEED_TRAY, HYDRAULIC, VOLATILITY = 8, 4, 0.06, 2.0


def column() -> OCP:
    """Return the OCP of a binary distillation column with constant relative volatility and liquid hydraulics.

    Holdups are fast, compositions slow (Skogestad, Trans. IChemE 75, 1997, with fewer trays). Time is in min.
    """
    n = TRAYS + 2
    ocp = OCP("column", T=120.0, N=24, time_unit="min")
    start = np.linspace(0.06, 0.94, n)
    x = ocp.state("x", size=n, initial=start)
    M = ocp.state("M", size=n, initial=np.full(n, 0.5), unit="kmol")
    L, V = ocp.control("L", unit="kmol/min"), ocp.control("V", unit="kmol/min")
    F = ocp.parameter("F", value=1.0, bounds=(0.9, 1.1))
    zF = ocp.parameter("zF", value=0.5, bounds=(0.45, 0.55))
    y = VOLATILITY * x / (1 + (VOLATILITY - 1) * x)
    liquid = [2.7 + (i <= FEED_TRAY) * 1.0 + (M[i] - 0.5) / HYDRAULIC for i in range(n)]
    liquid[n - 1] = L
    bottom, top = 0.5 + 10 * (M[0] - 0.5), 0.5 + 10 * (M[n - 1] - 0.5)  # level controllers of reboiler and condenser
    dM, dx = [], []
    for i in range(n):
        vapour_in, vapour_out = (V if i > 0 else 0, V if i < n - 1 else 0)
        liquid_in = liquid[i + 1] if i < n - 1 else 0
        liquid_out = bottom if i == 0 else liquid[i] + (top if i == n - 1 else 0)
        feed = F if i == FEED_TRAY else 0
        dM.append(liquid_in - liquid_out + vapour_in - vapour_out + feed)
        rate = vapour_in * ((y[i - 1] if i else 0) - x[i]) - vapour_out * (y[i] - x[i]) + feed * (zF - x[i])
        rate += liquid_in * ((x[i + 1] if i < n - 1 else 0) - x[i])
        dx.append(rate / M[i])
    ocp.dynamics({x: ca.vertcat(*dx), M: ca.vertcat(*dM)})
    ocp.least_squares(ca.vertcat(x[n - 1], x[0], L, V), weight=[1e3, 1e3, 0.1, 0.1], reference=[0.94, 0.06, 2.7, 3.2])
    ocp.subject_to(2.0, L, 3.5)
    ocp.subject_to(2.5, V, 4.0)
    return ocp


def converter() -> OCP:
    """Return the OCP of a buck converter with input filter and the inductance of its capacitor's leads.

    It rings in ns and is regulated in us. Time is in us, averaged over a switching period.
    """
    ocp = OCP("converter", T=200.0, N=20, time_unit="us")
    ii, vi = ocp.state("ii", initial=1.7, unit="A"), ocp.state("vi", initial=24.0, unit="V")
    i, vp = ocp.state("i", initial=5.0, unit="A"), ocp.state("vp", initial=12.0, unit="V")
    v = ocp.state("v", initial=12.0, unit="V")
    d, source = ocp.control("d"), ocp.parameter("source", value=24.0, bounds=(20, 28))
    load = ocp.parameter("load", value=0.4, bounds=(0.2, 0.6))  # A/V, and a part that grows with the square
    out = load * vp + 0.002 * vp**2
    ocp.dynamics(
        {
            ii: (source - vi - 0.05 * ii) / 2.0,
            vi: (ii - d * i) / 20.0,
            i: (d * vi - vp - 0.02 * i) / 10.0,
            vp: (i - out - (vp - v) / 0.01) / 0.05,
            v: (vp - v) / 0.01 / 100.0,
        }
    )
    ocp.least_squares(ca.vertcat(v, i, d), weight=[10, 0.1, 1], reference=[12, 5, 0.5])
    ocp.subject_to(0.05, d, 0.95)
    ocp.subject_to(-2, i, 10)
    return ocp


@dataclass(frozen=True)
class Stiff:
    """A stiff problem has relative spreads of initial states and parameters, and a limit at the end of its loop.

    ``distance``: distance of the last states and controls from the set point; ``reach``: its limit.
    """

    make: Callable[[], OCP]
    spread: float
    parameters: float
    samples: int
    distance: Callable[[Array, Array], float]
    reach: float


PROBLEMS = {
    "kinetics": Stiff(kinetics, 0.2, 0.1, 40, lambda x, u: abs(float(x[2]) - 0.3), 0.05),
    "column": Stiff(column, 0.05, 0.03, 40, lambda x, u: float(max(abs(x[9] - 0.94), abs(x[0] - 0.06))), 0.02),
    "converter": Stiff(converter, 0.1, 0.1, 60, lambda x, u: abs(float(x[4]) - 12), 0.5),
    "reactor": Stiff(reactor, 0.02, 0.1, 60, lambda x, u: max(0.0, float(x[3]) - 365), 0.5),
    "battery": Stiff(fast_charge.build_ocp, 0.1, 0.2, 60, lambda x, u: max(0.0, float(x[7]) - 41), 0.5),
}


class Plant:
    """Radau's method of SciPy simulates the model."""

    def __init__(self, ocp: OCP) -> None:
        problem = self.problem = classify(ocp)
        x, u, p = problem.path.x, problem.path.u, problem.path.p
        f = ca.densify(problem.dynamics(x, u, p))
        self._f = ca.Function("f", [x, u, p], [f])
        self._slopes = ca.Function("f_x", [x, u, p], [ca.densify(ca.jacobian(f, x))])

    def step(self, x: Array, u: Array, p: Array) -> Array:
        """Return the state one interval later."""
        found = solve_ivp(
            lambda t, x: np.asarray(self._f(x, u, p)).ravel(),
            (0.0, self.problem.dt[0]),
            x,
            method="Radau",
            jac=lambda t, x: np.asarray(self._slopes(x, u, p)),
            rtol=1e-6,
            atol=1e-8,
        )
        return np.asarray(found.y[:, -1], dtype=float)


@dataclass(frozen=True)
class Outcome:
    """A loop has its statuses, the distance from the set point at its end, and the reason why it is lost, or ""."""

    statuses: Counter[str]
    distance: float
    lost: str


class Moving(Protocol):
    """A moving object is a plant of a problem."""

    problem: Problem

    def step(self, x: Array, u: Array, p: Array) -> Array:
        """Return the state one interval later."""
        ...


def run(case: Stiff, ctrl: Controller, plant: Moving, seed: int) -> Outcome:
    """Run a closed loop from a random start, with other parameters than those of the model and noise on the states."""
    rng, problem = np.random.default_rng(seed), plant.problem
    x = problem.x_initial[: problem.measured]
    x = x * (1 + case.spread * rng.uniform(-1, 1, x.size))
    p = problem.p_value * (1 + case.parameters * rng.uniform(-1, 1, problem.np))
    statuses, u = Counter[str](), np.zeros(problem.nu)
    ctrl.reset()
    for k in range(case.samples):
        measured = x * (1 + 1e-3 * case.spread * rng.normal(size=x.size))
        u = np.asarray(ctrl.step(measured), dtype=float)
        statuses[ctrl.status.name] += 1
        x = plant.step(x, u, p)
        if k == case.samples // 2:
            x = x * (1 + case.spread / 4 * rng.uniform(-1, 1, x.size))
        if not np.all(np.isfinite(x)):
            return Outcome(statuses, np.inf, "not finite")
    distance = case.distance(x, u)
    good = statuses["OK"] + statuses["RELAXED"]
    lost = f"{distance:.3g} from the goal" if distance > case.reach else ""
    return Outcome(statuses, distance, lost or ("" if good >= 0.8 * case.samples else f"{dict(statuses)}"))


def controller(case: Stiff) -> Controller:
    """Return the controller with default options."""
    return build(case.make(), profile="fast")


def distance_from_optimum(case: Stiff, options: Options | None, profile: str) -> tuple[float, int]:
    """Return the distance of solve() from IPOPT's optimum of the same discretisation, and the iterations of solve().

    The distance is the largest difference of states, controls, algebraic variables and multipliers, in their sizes;
    infinite if there is no solution.
    """
    ocp = case.make()
    ctrl = build(ocp, options, profile)
    chosen, problem = ctrl.description.options, classify(ocp)
    n, rows = problem.measured, tuple(map(tuple, chosen["integrator.tableau.a"]))
    scheme = Tableau(rows, tuple(chosen["integrator.tableau.b"]), int(chosen["integrator.steps"]))
    ours = ctrl.solve(problem.x_initial[:n], tol=1e-13, max_iterations=300)
    theirs = Reference(problem, scheme).solve(node_data(problem), x=ctrl.whole_x, u=ours.u)
    pairs = [(ours.x, theirs.x[:, :n]), (ours.u, theirs.u), (ours.mu, theirs.mu), (ours.mu_u, theirs.mu_u)]
    pairs += [(ours.lam, theirs.lam[:, :n]), (ours.z[:-1], _algebraic(problem, theirs))]
    error = 0.0
    for mine, other in pairs:
        size = np.maximum(1.0, np.abs(other).max(axis=0, initial=0.0))
        error = max(error, float(np.max(np.abs(mine - other) / size, initial=0.0)))
    return error if theirs.success else np.inf, ours.iterations


def _algebraic(problem: Problem, found: ReferenceSolution) -> Array:
    """Return the algebraic variables of IPOPT's optimum at the nodes before the end."""
    algebra, n = problem.algebra, problem.np
    if algebra is None:
        return np.zeros((problem.N, 0))
    at = ((x, u, problem.node_values(x, u)) for x, u in zip(found.x[:-1], found.u, strict=True))
    z = (algebra.values(x, u, p[:n], p[n : n + algebra.size]) for x, u, p in at)
    return np.array([np.asarray(each, dtype=float).ravel() for each in z])
