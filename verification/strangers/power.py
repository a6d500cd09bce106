"""These strangers are tariffs, converters, and reservoirs."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from verification.strangers.statement import Limit, Stranger


def _price(clock: Any) -> Any:
    """Return the price in EUR/kWh over a day of 2 pi, with a peak in the evening."""
    return 0.2 + 0.08 * ca.sin(clock - 2.0) + 0.05 * ca.sin(2 * clock)


# Battery of a house: charges when energy is cheap; losses grow with the square of the power.
STORAGE = Stranger(
    "storage",
    "tariffs",
    *(24.0, 24, ("energy", "clock"), {"power": (-3.0, 3.0)}),
    model=lambda x, u: ca.vertcat(u[0] - 0.02 * u[0] ** 2, 2 * np.pi / 24),
    start=((2.0, 0.0), (8.0, 6.0)),
    samples=48,
    kick=(20, (-1.0, 0.0)),
    rate=lambda x, u: _price(x[1]) * u[0],
    end_cost=lambda x: -0.2 * x[0],
    limits=(Limit("capacity", lambda x, _: x[0], 1.0, 10.0, 10.0),),
)

# House with a heat pump whose efficiency falls with the temperature outside.
HEAT_PUMP = Stranger(
    "heat_pump",
    "tariffs",
    *(24.0, 48, ("room", "floor", "clock"), {"electric": (0.0, 3.0)}),
    model=lambda x, u: ca.vertcat(
        (0.6 * (x[1] - x[0]) - 0.15 * (x[0] - 3 - 4 * ca.sin(x[2] - 1.8))) / 4,
        ((3.2 + 0.2 * ca.sin(x[2] - 1.8)) * u[0] - 0.6 * (x[1] - x[0])) / 6,
        2 * np.pi / 24,
    ),
    start=((19.0, 21.0, 0.0), (22.0, 26.0, 6.0)),
    samples=60,
    kick=(25, (-0.5, 0.0, 0.0)),
    rate=lambda x, u: _price(x[2]) * u[0] + 0.02 * u[0] ** 2,
    end_cost=lambda x: -0.05 * (4 * x[0] + 6 * x[1]) / 3,
    limits=(Limit("comfort", lambda x, _: x[0], 20.0, 23.0, soft=(2.0, 2.0)),),
)

# Boost converter, averaged, in volts, amperes and microseconds: the voltage falls first when it has to rise.
BOOST = Stranger(
    "boost",
    "converters",
    *(1e-3, 40, ("current", "voltage"), {"duty": (0.05, 0.85)}),
    model=lambda x, u: ca.vertcat(
        (12 - (1 - u[0]) * x[1] - 0.05 * x[0]) / 150e-6, ((1 - u[0]) * x[0] - x[1] / 20) / 100e-6
    ),
    start=((0.5, 12.0), (3.0, 20.0)),
    samples=80,
    kick=(40, (0.5, -2.0)),
    residual=lambda x, u: ca.vertcat(x[1] - 24, 0.2 * (x[0] - 2.42), u - 0.505),
    weight=(1, 1, 5),
    end_residual=lambda x: ca.vertcat(x[1] - 24, x[0] - 2.42),
    end_weight=(10, 10),
    limits=(Limit("current", lambda x, _: x[0], upper=8.0, scale=8.0),),
    distance=lambda x: float(abs(x[1] - 24)),
    reach=0.5,
)

# Reservoir in cubic metres and seconds: power is the product of flow and head.
RESERVOIR = Stranger(
    "reservoir",
    "unscaled units",
    *(7 * 86400.0, 42, ("volume", "clock"), {"flow": (5.0, 120.0)}),
    model=lambda x, u: ca.vertcat(50 + 20 * ca.sin(x[1]) - u[0], 2 * np.pi / 86400 / 5),
    start=((1.5e7, 0.0), (3.0e7, 6.0)),
    samples=60,
    kick=(25, (2e6, 0.0)),
    rate=lambda x, u: (
        -1e-9 * (30 + 20 * x[0] / 4e7) * u[0] * 9.81 * (1 + 0.3 * ca.sin(5 * x[1])) + 1e-12 * u[0] ** 2 * 50
    ),
    end_cost=lambda x: -5e-7 * x[0],
    limits=(
        Limit("volume", lambda x, _: x[0], 1e7, 4e7, 4e7),
        Limit("river", lambda x, u: u[0] * (1 + 1e-9 * x[0]), 8.0, 120.0, 100.0),
    ),
)

# Cell that is charged fast below a limit of its temperature; its heat grows with the square of the current, so that it
# does not show in a linearisation without current.
CHARGE = Stranger(
    "charge",
    "batteries",
    *(1800.0, 60, ("soc", "temp"), {"current": (0.0, 15.0)}),
    model=lambda x, u: ca.vertcat(u[0] / 18000, (0.05 * u[0] ** 2 - 0.18 * (x[1] - 25)) / 75),
    start=((0.05, 20.0), (0.3, 35.0)),
    samples=110,
    kick=(40, (0.0, -2.0)),
    residual=lambda x, u: ca.vertcat(x[0] - 0.9, u[0]),
    weight=(100, 1e-3),
    end_residual=lambda x: x[0] - 0.9,
    end_weight=(1000,),
    limits=(Limit("soc", lambda x, _: x[0], 0.0, 0.9, 0.9), Limit("temp", lambda x, _: x[1], -20.0, 42.0, 31.0)),
    distance=lambda x: float(0.9 - x[0]),
    reach=0.05,
)
