"""ADD AN INTEGRATOR HERE: a component that fulfils `Integrator` of base.py.

interval() returns the routines integrator_interval(x, u, p, dt -> x_next, S) and integrator_step(x, u, p, h -> x_next).
"""

from collections.abc import Mapping

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators.discrete import Discrete
from nmpc_codegen.components.integrators.explicit_runge_kutta import ExplicitRungeKutta
from nmpc_codegen.components.integrators.tableau import (
    RK4,
    SSPRK3,
    TABLEAUS,
    ButcherTableau,
    Euler,
    Heun,
    Midpoint,
)

REGISTRY: Mapping[str, type[Integrator]] = {
    ExplicitRungeKutta.name: ExplicitRungeKutta,
    Discrete.name: Discrete,
}

__all__ = [
    "REGISTRY",
    "RK4",
    "SSPRK3",
    "TABLEAUS",
    "ButcherTableau",
    "Discrete",
    "Euler",
    "ExplicitRungeKutta",
    "Heun",
    "Midpoint",
]
