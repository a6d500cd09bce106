"""A battery and a heated tank with tariffs have linear costs, so that their samples are linear programs for linprog."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from nmpc_codegen import OCP, Controller
from verification.strangers.statement import Array

SAME = 1e-6  # of the cost, relative to 1 + its magnitude


@dataclass(frozen=True)
class LinearCase:
    """A case has ``data``, parameters (N + 1,) at sample k, and ``optimum``, the cost of a plan from a state there."""

    name: str
    start: float
    samples: int
    dt: float
    ocp: Callable[[], OCP]
    data: Callable[[int], Mapping[str, Array]]
    optimum: Callable[[float, int], float]

    def run(self, controller: Controller) -> tuple[int, float]:
        """Count samples not OK in the loop of the model; return the count and the largest cost error.

        The error is the difference from the optimum. solve() follows after every eighth sample.
        """
        x, bad, worst = np.array([self.start]), 0, 0.0
        controller.reset()
        for k in range(self.samples):
            for name, values in self.data(k).items():
                for node, value in enumerate(values):
                    controller.set_parameter(name, value, node=node)
            u = controller.step(x)
            bad += controller.status.name != "OK"
            best = self.optimum(float(x[0]), k)
            worst = max(worst, self._difference(controller.cost, best))
            if k % 8 == 0:
                solved = controller.copy().solve(x)
                bad += solved.status.name != "OK"
                worst = max(worst, self._difference(solved.cost, best))
            x = controller.integrate(x, u, self.dt)
        return bad, worst

    def _difference(self, cost: float, best: float) -> float:
        return abs(cost - best) / (1 + abs(best))


# ---- a battery of 1 to 7 kWh beside the load of a house; buying is dearer than selling

HOURS = 24


def _tariff(k: int) -> Array:
    return 0.2 + 0.12 * np.sin(2 * np.pi * (k + np.arange(HOURS + 1) - 9) / 24)


def _load(k: int) -> Array:
    return 1 + 0.6 * np.sin(2 * np.pi * (k + np.arange(HOURS + 1) - 14) / 24)


def battery() -> OCP:
    """Return the OCP energy' = 0.95 charge - discharge / 0.95; buy - sell = load + charge - discharge."""
    ocp = OCP("home_battery", T=float(HOURS), N=HOURS)
    energy = ocp.state("energy", unit="kWh", initial=4.0)
    charge, discharge, buy, sell = (ocp.control(name, unit="kW") for name in ("charge", "discharge", "buy", "sell"))
    price, load = ocp.parameter("price"), ocp.parameter("load", unit="kW")
    ocp.dynamics({energy: 0.95 * charge - discharge / 0.95})
    ocp.subject_to(1, energy, 7)
    ocp.subject_to(0, charge, 3)
    ocp.subject_to(0, discharge, 3)
    ocp.subject_to(0, buy, 8)
    ocp.subject_to(0, sell, 8)
    ocp.subject_to(0, buy - sell - load - charge + discharge, 0, name="balance")
    ocp.stage_cost(price * (buy - 0.6 * sell))
    ocp.terminal_cost(-0.2 * energy)
    return ocp


def _cheapest_battery(energy: float, k: int) -> float:
    """Solve for charge, discharge, buy, sell by linprog."""
    price, load, one = _tariff(k)[:HOURS], _load(k)[:HOURS], np.eye(HOURS)
    sums = np.tril(np.ones((HOURS, HOURS)))
    stored = np.hstack([0.95 * sums, -sums / 0.95, np.zeros((HOURS, 2 * HOURS))])
    ends = -0.2 * stored[-1]
    cost = np.concatenate([np.zeros(2 * HOURS), price, -0.6 * price]) + ends
    balance = np.hstack([-one, one, one, -one])
    room = np.concatenate([np.full(HOURS, 7 - energy), np.full(HOURS, energy - 1)])
    bounds = [(0, 3)] * (2 * HOURS) + [(0, 8)] * (2 * HOURS)
    found = linprog(cost, np.vstack([stored, -stored]), room, balance, load, bounds)
    return float(found.fun) - 0.2 * energy


BATTERY = LinearCase(
    "battery", 4.0, 96, 1.0, battery, lambda k: {"price": _tariff(k), "load": _load(k)}, _cheapest_battery
)

# ---- a tank of hot water, from which water is drawn in the morning and in the evening

NODES, STEP, HEAT = 48, 0.5, 1.16


def _prices(k: int) -> Array:
    return 0.2 + 0.1 * np.sin((k + np.arange(NODES + 1)) / 8)


def _draw(k: int) -> Array:
    hour = (k + np.arange(NODES + 1)) * STEP % 24
    return np.asarray(2.0 * np.exp(-((hour - 7) ** 2)) + 1.5 * np.exp(-((hour - 19) ** 2)))


def tank() -> OCP:
    """Return the OCP 1.16 T' = P - 0.05 (T - 20) - draw, 45 <= T <= 80 soft."""
    ocp = OCP("tank", T=NODES * STEP, N=NODES)
    temperature, power = ocp.state("T", unit="degC", initial=50.0), ocp.control("P", unit="kW")
    price, draw = ocp.parameter("price", value=0.2), ocp.parameter("draw", unit="kW")
    ocp.dynamics({temperature: (power - 0.05 * (temperature - 20) - draw) / HEAT})
    ocp.stage_cost(price * power)
    ocp.subject_to(0, power, 6)
    ocp.subject_to(45, temperature, 80, soft=(10, 0))
    return ocp


def _cheapest_tank(temperature: float, k: int) -> float:
    """Solve for powers and violations below and above by linprog; T_{i+1} = a T_i + b (P_i + 1 - draw_i) by RK4."""
    z = -0.05 / HEAT * STEP
    a = 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24
    b = (a - 1) / -0.05
    effect = np.array([[b * a ** (i - j) if j <= i else 0.0 for j in range(NODES)] for i in range(NODES)])
    free = temperature * a ** np.arange(1, NODES + 1) + effect @ (1 - _draw(k)[:NODES])
    one, none = np.eye(NODES), np.zeros((NODES, NODES))
    rows = np.vstack([np.hstack([effect, none, -one]), np.hstack([-effect, -one, none])])
    room = np.concatenate([80 - free, free - 45])
    cost = np.concatenate([STEP * _prices(k)[:NODES], np.full(2 * NODES, 10.0)])
    bounds = [(0.0, 6.0)] * NODES + [(0.0, None)] * (2 * NODES)
    return float(linprog(cost, rows, room, bounds=bounds).fun)


TANK = LinearCase("tank", 50.0, 96, STEP, tank, lambda k: {"price": _prices(k), "draw": _draw(k)}, _cheapest_tank)

CASES = (BATTERY, TANK)
