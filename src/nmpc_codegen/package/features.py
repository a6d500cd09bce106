"""What a package has, besides its sizes: features of the problem, of the options, of the target.

`#if` in a part and plain conditions of C test them by their names in upper case: ``repair`` is REPAIR. A component sets
its own with ``dataclasses.replace``, a member of a struct names the one to which it belongs by its attribute, so that a
type checker finds a typing error.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal, get_args

#: Kernels that a package may lack; in C, HAS_<NAME> is 1 if it has them.
KernelName = Literal[
    "path_cost",
    "path_gradient",
    "path_hessian",
    "path_rows",
    "path_curvature",
    "path_product",
    "terminal_cost",
    "terminal_gradient",
    "terminal_hessian",
    "terminal_rows",
    "terminal_curvature",
    "terminal_product",
    "start_cost",
    "start_gradient",
    "start_hessian",
    "start_exact",
    "terminal_exact",
    "initial_hessian",
    "initial_exact",
    "coupled_rows",
    "control_start",
    "stage_slope",
    "stage_equation",
    "stage_rate",
    "stage_rate_gradient",
    "stage_rate_product",
    "stage_curvature",
    "integrator_interval",
    "integrator_jump",
    "integrator_forward",
    "state_step",
    "adjoint_step",
    "cost_gradient",
    "terminal_adjoint",
]

KERNELS: tuple[KernelName, ...] = get_args(KernelName)


@dataclass(frozen=True)
class Features:
    """The features of a package; 0 or False: it lacks them."""

    kernels: frozenset[KernelName] = frozenset()

    # data that can be changed at run time
    set_reference: bool = False
    set_weight: bool = False
    set_parameter: bool = False
    set_bounds: bool = False
    set_soft: bool = False
    takes_penalties: bool = False  # a preparation takes over the penalties that have been set
    reference_by_node: bool = False  # every node has data of its own
    weight_by_node: bool = False
    parameter_by_node: bool = False
    bounds_by_node: bool = False
    soft_by_node: bool = False

    # the problem
    state_rows: bool = False  # bounds of states are rows of the QP
    general_rows: bool = False
    hard_rows: bool = False
    rows_move: bool = False  # some row holds at two consecutive nodes
    priced_rows: bool = False  # hard rows on states before the last node, which samples may relax
    nonlinear_rows: bool = False  # a QP does not see how rows bend
    pulled_rows: bool = False  # hard rows on controls, and on those before them, alone
    nonlinear_model: bool = False  # a step leaves gaps
    proximal: bool = False  # samples limit steps of controls without curvature
    saddles: bool = False  # the slope of a control vanishes somewhere
    idle_states: bool = False  # so does that of a state that controls drive
    idle_end: bool = False  # the last control influences nothing but its own terms
    end_equations: bool = False  # hard equations at the last node
    control_bounds: bool = False
    accumulators: bool = False
    all_measured: bool = False  # x_0 is the measured state
    augmented: bool = False  # states behind the measured ones
    previous: bool = False  # some are controls of the node before
    timed: bool = False  # the last one is time
    estimator: bool = False  # states follow from measurements
    known_controls: bool = False  # of its plant

    # integrator
    implicit: bool = False  # stages are solved by Newton's method

    # options, and parts of the core that the algorithm uses
    solve: bool = False
    nodes: bool = False  # a linearisation per node
    products: bool = False
    kkt: bool = False

    # Hessian
    node_kernels: bool = False  # the linearisation of a node needs no neighbour
    node_memory: bool = False  # it needs what the node keeps of the last one
    lagrangian: bool = False  # it depends on multipliers
    tuned: bool = False  # it was computed for data that have changed
    regularize_stages: bool = False
    regularize_reduced: bool = False
    two_hessians: bool = False  # solve() has one of its own
    curved: bool = False  # solve() makes an exact one convex by itself
    terminal_block: bool = False  # the terminal one is not zero

    # condensing and QP solver
    has_qp: bool = False
    stage_multipliers: bool = False  # the QP has the multipliers of the dynamics
    elastic: bool = False  # rows may have a finite penalty
    interior_point: bool = False
    approximate: bool = False
    check_step: bool = False
    keeps_multipliers: bool = False

    # algorithm
    repair: int = 0  # repairs of a plan, at most
    iterates: bool = False  # a sample may take several QPs
    search: bool = False  # steps of QPs may be shortened: solve(), samples that iterate
    exact_qp: bool = False  # the QP of a sample is the problem itself
    shifts_back: bool = False  # a sample may take the plan as it was before its shift
    judges: bool = False  # a sample tells whether its plan is near a solution
    relax: bool = False
    relaxation: bool = False  # hard rows of a QP may be relaxed
    row_scales: bool = False
    shift_resample: bool = False
    shift_periodic: bool = False
    start_is_measured: bool = False  # coupled rows read the measured state for x_0
    quasi_newton: bool = False
    lumped_rows: bool = False
    barrier_rows: bool = False

    # spelling and target
    single: bool = False
    own_math: bool = False
    small: bool = False  # goal="size"
    scalar: bool = False  # sums in variables, one after the other
    avx512: bool = False
    vector_lanes: int = 1
    pack_width: int = 0
    tiles: bool = False
    lane_nodes: bool = False
    lane_shift: bool = False  # the plan is resampled in lanes
    lane_conditions: bool = False
    lane_angles: bool = False
    lane_sqrt: bool = False

    def has(self, kernel: KernelName) -> bool:
        """True if the package has a kernel."""
        return kernel in self.kernels

    def without(self, *kernels: KernelName) -> Features:
        """The same features without these kernels."""
        return replace(self, kernels=self.kernels.difference(kernels))

    @property
    def macros(self) -> dict[str, int]:
        """Names in C -> values."""
        values = {f.name.upper(): int(getattr(self, f.name)) for f in fields(self) if f.name != "kernels"}
        return values | {f"HAS_{name.upper()}": int(name in self.kernels) for name in KERNELS}
