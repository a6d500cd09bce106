"""These strangers are reactors, tanks, epidemics, and ecology."""

from __future__ import annotations

from typing import Any

import casadi as ca

from verification.strangers.statement import Limit, Stranger


def _hicks_ray(x: Any, u: Any) -> Any:
    """Return the slopes of an exothermic stirred tank, dimensionless: concentration, temperature; coolant flow."""
    rate = 300 * x[0] * ca.exp(-5 / (x[1] + 1e-6))
    return ca.vertcat((1 - x[0]) / 20 - rate, (0.3947 - x[1]) / 20 + rate - 1.95e-4 * u[0] * (x[1] - 0.3816))


# Exothermic reactor that is brought to its unstable steady state.
REACTOR = Stranger(
    "reactor",
    "reactors",
    *(60.0, 30, ("c", "T"), {"coolant": (0.0, 700.0)}),
    model=_hicks_ray,
    start=((0.55, 0.48), (0.8, 0.54)),
    samples=60,
    kick=(30, (0.02, 0.02)),
    residual=lambda x, u: ca.vertcat(10 * (x[0] - 0.6416), 10 * (x[1] - 0.5387), 1e-3 * (u[0] - 378)),
    weight=(1, 1, 1),
    end_residual=lambda x: ca.vertcat(10 * (x[0] - 0.6416), 10 * (x[1] - 0.5387)),
    end_weight=(5, 5),
    limits=(Limit("hot", lambda x, _: x[1], upper=0.75, scale=0.1),),
    distance=lambda x: float(abs(x[0] - 0.6416) + abs(x[1] - 0.5387)),
    reach=0.1,
)


def _out(level: Any) -> Any:
    """Return the outflow of a tank in cm/s: sqrt(2 g h), smooth at the bottom."""
    return ca.sqrt(2 * 981 * (level + 0.01))


# Four coupled tanks in centimetres; the levels of the lower two are to be exchanged.
TANKS = Stranger(
    "tanks",
    "reactors",
    *(120.0, 24, ("h1", "h2", "h3", "h4"), {"v1": (0.0, 10.0), "v2": (0.0, 10.0)}),
    model=lambda x, u: ca.vertcat(
        (-0.071 * _out(x[0]) + 0.071 * _out(x[2]) + 0.7 * 3.33 * u[0]) / 28,
        (-0.057 * _out(x[1]) + 0.057 * _out(x[3]) + 0.6 * 3.35 * u[1]) / 32,
        (-0.071 * _out(x[2]) + 0.4 * 3.35 * u[1]) / 28,
        (-0.057 * _out(x[3]) + 0.3 * 3.33 * u[0]) / 32,
    ),
    start=((8.0, 8.0, 1.0, 1.0), (14.0, 14.0, 3.0, 3.0)),
    samples=60,
    kick=(30, (1.0, -1.0, 0.3, 0.0)),
    residual=lambda x, u: ca.vertcat(x[0] - 15, x[1] - 11, u - 3),
    weight=(1, 1, 0.01, 0.01),
    end_residual=lambda x: ca.vertcat(x[0] - 15, x[1] - 11),
    end_weight=(5, 5),
    limits=(Limit("levels", lambda x, _: x[0] + x[1], upper=30.0, scale=10.0), Limit("low", lambda x, _: x[2], 0.2)),
    distance=lambda x: float(abs(x[0] - 15) + abs(x[1] - 11)),
    reach=2.0,
)

# Epidemic with an incubation time: contacts are reduced so that hospitals suffice, at the least economic loss.
SEIR = Stranger(
    "seir",
    "epidemics",
    *(90.0, 45, ("S", "E", "I"), {"contact": (0.2, 1.0)}),
    model=lambda x, u: ca.vertcat(-0.6 * u[0] * x[0] * x[2], 0.6 * u[0] * x[0] * x[2] - x[1] / 4, x[1] / 4 - x[2] / 6),
    start=((0.90, 0.002, 0.002), (0.98, 0.01, 0.01)),
    samples=60,
    kick=(20, (0.0, 0.003, 0.003)),
    rate=lambda x, u: (1 - u[0]) ** 2 + 0.2 * x[2],
    end_cost=lambda x: 20 * (x[1] + x[2]),
    limits=(Limit("beds", lambda x, _: x[2], upper=0.04, scale=0.04),),
)

# Predator and prey: fishing brings both to rest.
FISHING = Stranger(
    "fishing",
    "ecology",
    *(12.0, 40, ("prey", "predator"), {"effort": (0.0, 1.0)}),
    model=lambda x, u: ca.vertcat(x[0] - x[0] * x[1] - 0.4 * x[0] * u[0], -x[1] + x[0] * x[1] - 0.2 * x[1] * u[0]),
    start=((0.3, 0.4), (0.9, 1.2)),
    samples=60,
    kick=(30, (0.1, -0.1)),
    residual=lambda x, u: ca.vertcat(x - 1, u),
    weight=(1, 1, 0.05),
    end_residual=lambda x: x - 1,
    end_weight=(5, 5),
    limits=(Limit("prey", lambda x, _: x[0], lower=0.25, scale=0.25),),
    distance=lambda x: float(abs(x[0] - 1) + abs(x[1] - 1)),
    reach=0.3,
)
