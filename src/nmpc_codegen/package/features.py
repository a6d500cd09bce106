"""Features of a package, besides its sizes, come from the problem, the options and the target.

`#if` in a part and plain conditions of C test them by their names in upper case: ``repair`` is REPAIR. A component sets
its features with ``dataclasses.replace``, and a member of a struct names its feature as an attribute, so that a type
checker finds a misspelling.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal, get_args

#: Kernels that a package may lack; in C, HAS_<NAME> is 1 if the package has it.
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
    """A package has features; 0 or False: the package lacks the feature."""

    kernels: frozenset[KernelName] = frozenset()

    # data that can be changed at run time
    set_reference: bool = False
    set_weight: bool = False
    set_parameter: bool = False
    set_bounds: bool = False
    set_soft: bool = False
    takes_penalties: bool = False  # a preparation copies the penalties that have been set
    reference_by_node: bool = False  # every node has separate data
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
    nonlinear_rows: bool = False  # the curvature of rows is missing in a QP
    pulled_rows: bool = False  # hard rows only on controls and previous controls
    nonlinear_model: bool = False  # gaps remain after a step
    proximal: bool = False  # samples limit steps of controls without curvature
    saddles: bool = False  # the slope of a control vanishes somewhere
    idle_states: bool = False  # the same for a state that only controls drive
    idle_end: bool = False  # the last control influences only its own terms
    end_equations: bool = False  # hard equations at the last node
    control_bounds: bool = False
    accumulators: bool = False
    all_measured: bool = False  # x_0 is the measured state
    augmented: bool = False  # states are added to the measured ones
    previous: bool = False  # some added states are controls of the previous node
    timed: bool = False  # one added state is time
    estimator: bool = False  # states are estimated from measurements
    known_controls: bool = False  # the plant of the estimator has controls

    # integrator
    implicit: bool = False  # stages are solved by Newton's method

    # options, and parts of the core that the algorithm uses
    solve: bool = False
    nodes: bool = False  # a linearisation per node
    products: bool = False
    kkt: bool = False

    # Hessian
    node_kernels: bool = False  # the linearisation of a node needs no neighbour
    node_memory: bool = False  # it needs data that the node keeps from the last linearisation
    lagrangian: bool = False  # the Hessian depends on multipliers
    tuned: bool = False  # the Hessian was computed for data that may change
    regularize_stages: bool = False
    regularize_reduced: bool = False
    two_hessians: bool = False  # solve() has another Hessian than samples
    curved: bool = False  # solve() makes an exact Hessian convex itself
    terminal_block: bool = False  # the terminal block is not zero

    # condensing and QP solver
    has_qp: bool = False
    stage_multipliers: bool = False  # the QP has the multipliers of the dynamics
    elastic: bool = False  # rows may have a finite penalty
    interior_point: bool = False
    approximate: bool = False
    check_step: bool = False
    keeps_multipliers: bool = False

    # algorithm
    repair: int = 0  # largest number of repairs of a plan
    iterates: bool = False  # a sample may take several QPs
    search: bool = False  # steps of QPs may be shortened: solve(), samples that iterate
    exact_qp: bool = False  # the QP of a sample is the problem itself
    shifts_back: bool = False  # a sample may return to the plan before its shift
    judges: bool = False  # a sample checks whether its plan is near a solution
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
        """Return True if the package has a kernel."""
        return kernel in self.kernels

    def without(self, *kernels: KernelName) -> Features:
        """Return the same features without these kernels."""
        return replace(self, kernels=self.kernels.difference(kernels))

    @property
    def macros(self) -> dict[str, int]:
        """Return {name in C: value}."""
        values = {f.name.upper(): int(getattr(self, f.name)) for f in fields(self) if f.name != "kernels"}
        return values | {f"HAS_{name.upper()}": int(name in self.kernels) for name in KERNELS}
