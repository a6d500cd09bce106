"""ADD AN INTEGRATOR HERE: a component with seam "integrator" that yields the routines

integrator_interval(x, u, p, dt -> x_next, S) and integrator_step(x, u, p, h -> x_next).
"""

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

REGISTRY: dict[str, type[ExplicitRungeKutta] | type[Discrete]] = {
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
