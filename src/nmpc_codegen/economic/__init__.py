"""Economic NMPC is prepared off line: steady state, terminal cost, and a Hessian as cheap as that of tracking.

    steady_state(ocp)       the optimal steady state and its multipliers
    tune(ocp)               M of EconomicGaussNewton, by a semidefinite program
    tune_periodic(ocp)      the best periodic operation, and Hessians along it
    lqr_terminal_cost(ocp)  the numbers of ocp.lqr_terminal_cost()
    letempc_cost, periodic_letempc, tracking_cost, rotate   companions: other costs of the same problem
    kkt_step, corrected_multipliers       one SQP step with any Hessian, also an indefinite one

It works with the discrete map of the controller, so it stands above the components; the controllers do not need it.
"""

from nmpc_codegen.economic.companions import (
    letempc_cost,
    letempc_terminal_cost,
    periodic_letempc,
    rotate,
    tracking_cost,
)
from nmpc_codegen.economic.convex_hessian import Tuning, steady_state, tune
from nmpc_codegen.economic.periodic import PeriodicTuning, tune_periodic
from nmpc_codegen.economic.stationary import SteadyState
from nmpc_codegen.economic.steps import StageQp, Step, corrected_multipliers, kkt_step
from nmpc_codegen.economic.terminal import TerminalCost, lqr_terminal_cost, with_terminal_cost

__all__ = [
    "PeriodicTuning",
    "StageQp",
    "SteadyState",
    "Step",
    "TerminalCost",
    "Tuning",
    "corrected_multipliers",
    "kkt_step",
    "letempc_cost",
    "letempc_terminal_cost",
    "lqr_terminal_cost",
    "periodic_letempc",
    "rotate",
    "steady_state",
    "tracking_cost",
    "tune",
    "tune_periodic",
    "with_terminal_cost",
]
