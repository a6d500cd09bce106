"""ADD AN INTEGRATOR HERE: a component that implements `Integrator` of base.py.

interval() returns the routines integrator_interval(x, u, p, dt -> x_next, S) and integrator_step(x, u, p, h -> x_next).
"""

from collections.abc import Mapping

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators.discrete import Discrete
from nmpc_codegen.components.integrators.explicit_runge_kutta import ExplicitRungeKutta
from nmpc_codegen.components.integrators.implicit_runge_kutta import ImplicitRungeKutta
from nmpc_codegen.components.integrators.tableau import (
    ESDIRK3,
    RK4,
    SDIRK2,
    SDIRK3,
    SSPRK3,
    TABLEAUS,
    ButcherTableau,
    Euler,
    GaussLegendre2,
    GaussLegendre3,
    Heun,
    ImplicitEuler,
    ImplicitMidpoint,
    Midpoint,
    RadauIIA2,
    RadauIIA3,
)

REGISTRY: Mapping[str, type[Integrator]] = {
    ExplicitRungeKutta.name: ExplicitRungeKutta,
    ImplicitRungeKutta.name: ImplicitRungeKutta,
    Discrete.name: Discrete,
}

__all__ = [
    "ESDIRK3",
    "REGISTRY",
    "RK4",
    "SDIRK2",
    "SDIRK3",
    "SSPRK3",
    "TABLEAUS",
    "ButcherTableau",
    "Discrete",
    "Euler",
    "ExplicitRungeKutta",
    "GaussLegendre2",
    "GaussLegendre3",
    "Heun",
    "ImplicitEuler",
    "ImplicitMidpoint",
    "ImplicitRungeKutta",
    "Midpoint",
    "RadauIIA2",
    "RadauIIA3",
]
