"""A house has a heat pump, a buffer and a tariff: costs without curvature in all controls, forecasts, soft comfort.

Three days in steps of a quarter of an hour. OPTIMUM is the cost of the loop in which every sample is solved to
convergence.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, Controller, Online, Options, Status, simulate
from verification.strangers.statement import Array

N, DT, SAMPLES = 96, 0.25, 288
START = (20.5, 19.5, 38.0)
OPTIMUM = 10.456  # EUR


def ocp() -> OCP:
    """Return the OCP of two zones (degC) heated from a buffer, which a heat pump heats.

    The efficiency of the pump falls with the buffer temperature.
    """
    ocp = OCP("house", T=N * DT, N=N, time_unit="h")
    zone, buffer = ocp.state("zone", size=2, unit="degC", initial=START[:2]), ocp.state("buffer", initial=START[2])
    pump, heat = ocp.control("pump", unit="kW"), ocp.control("heat", size=2, unit="kW")
    price, outside, sun = ocp.parameter("price", value=0.3), ocp.parameter("outside"), ocp.parameter("sun")
    between = 0.05 * (zone[1] - zone[0])
    gained = ca.DM([0.12, 0.09]) * (outside - zone) + heat + ca.DM([3, 1]) * sun + ca.vertcat(between, -between)
    efficiency = 4.5 - 0.06 * (buffer - 35) + 0.05 * outside
    ocp.dynamics({zone: gained / ca.DM([6.0, 4.0]), buffer: (efficiency * pump - ca.sum1(heat)) / 0.6})
    ocp.stage_cost(price * pump)
    ocp.subject_to(0, pump, 3)
    ocp.subject_to(0, heat, 4)
    ocp.subject_to(20, zone, 23, soft=(0.5, 1.0), name="comfort")
    ocp.subject_to(28, buffer, 50, name="buffer")
    return ocp


def options(**more: object) -> Options:
    """Return options with comfort bounds that differ from node to node, and with the given ones."""
    return Options(online=Online(bounds="node"), **more)  # type: ignore[arg-type]


def _tariff(hour: Array) -> Array:
    evening, night = (hour % 24 >= 17) & (hour % 24 < 20), hour % 24 < 6
    return np.where(evening, 0.45, np.where(night, 0.18, 0.3))


def forecast() -> dict[str, Any]:
    """Return prices, weather and comfort over the samples and the last horizon, as simulate() takes them."""
    t = np.arange(SAMPLES + N + 1) * DT
    hour = t % 24
    day, asleep = (hour > 7) & (hour < 17), (hour < 6) | (hour > 22)
    sun = np.clip(np.sin((hour - 7) / 10 * np.pi), 0, None) * 0.5 * day
    outside = 2 + 5 * np.sin((t - 9) / 24 * 2 * np.pi)
    lower = np.where(asleep, 18.0, 20.5)
    return {
        "parameters": {"price": _tariff(t), "outside": outside, "sun": sun},
        "bounds": {"comfort": (np.column_stack([lower, lower]), 23.0)},
    }


def run(controller: Controller) -> tuple[Counter[str], float]:
    """Return the statuses of the loop and its cost in EUR."""
    controller.reset()
    log = simulate(controller, START, SAMPLES, plans=0, **forecast())
    cost = float(np.sum(_tariff(log.t[:-1]) * log.u[:, 0])) * DT
    return Counter(Status(status).name for status in log.status), cost
