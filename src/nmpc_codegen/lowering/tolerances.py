"""All tolerances of the generated code are named multiples of the machine epsilon of the working precision."""

import math

from nmpc_codegen.package.struct_layout import EPS

TOLERANCES: dict[str, tuple[float, str]] = {
    "qp_pivot": (2.0**5, "rounding of the curvature of a semidefinite Hessian, relative to its diagonal"),
    "qp_dependent": (2.0**10, "part of a normal outside the span of the working set that counts as zero, relative"),
    "qp_dependent_prediction": (
        2.0**14,
        "part of a normal outside the span of a predicted working set that counts as zero",
    ),
    "qp_feasibility": (2.0**2, "violation of a row that is taken as rounding, relative to |m|'(|y0| + |y|)"),
    "qp_redundant": (2.0**8, "violation of a row that depends on the working set and is taken as rounding, relative"),
    "qp_sign": (2.0**6, "wrong sign of a multiplier that is taken as rounding: |m| |lam| relative to |y0| + |y|"),
    "qp_proximal": (2.0**8, "step of the proximal point method that is taken as rounding, relative to |y0| + |y|"),
    "qp_proximal_stagnation": (
        2.0**12,
        "proximal point step that is rounding where it does not decrease any more, relative",
    ),
    "qp_accepted": (
        2.0**12,
        "residual of a row or of the gradient in a result that is called OK, relative to its terms",
    ),
    "qp_noise": (
        2.0**4,
        "residual of the gradient in a result that is called OK, relative to what moves the cost",
    ),
    "step": (
        2.0**13,
        "residual of a row in the expanded result of a condensed QP that is called OK, relative to its terms",
    ),
    "step_gradient": (
        2.0**13,
        "residual of the gradient of a condensed QP, in which condensing of an unstable plant costs digits, relative",
    ),
    "qp_residual": (2.0**10, "residual of a row or of the gradient in an answer, relative to its terms"),
    "riccati_pivot": (2.0**5, "rounding of a pivot of the Riccati recursion, relative to its diagonal entry"),
    "riccati_dependent": (2.0**10, "part of a row outside the span of others that counts as zero, relative, squared"),
    "riccati_feasibility": (2.0**6, "violation of a bound that is taken as rounding, relative to |a|'|z| + |bound|"),
    "riccati_sign": (2.0**8, "wrong sign of a multiplier that is taken as rounding, relative to its terms"),
    "riccati_refined": (2.0**2, "residual on a working set that is taken as rounding, relative to its terms"),
    "riccati_rounding": (
        2.0**20,
        "residual on a working set that is rounding where it does not decrease any more, relative",
    ),
    "ipm_dual_regularization": (2.0**22, "compliance of an active row, relative to that of the cost along it"),
    "ipm_equation_regularization": (2.0**22, "compliance of an equation, relative to that of the cost along it"),
    "ipm_dynamics": (2.0**8, "gap of the dynamics, relative to its terms"),
    "ipm_gap": (2.0**-20, "product of multiplier and distance, relative to the cost of the most expensive row"),
    "ipm_primal": (2.0**2, "residual of a row, relative to its size"),
    "ipm_stationarity": (2.0**8, "gradient of the Lagrangian, relative to its largest term"),
    "ipm_violation": (2.0**8, "violation of a row without multiplier that is taken as rounding, relative to its size"),
    "ipm_ray": (2.0**12, "rest of a sum of row gradients that is taken as zero, relative to its terms"),
    "ipm_contradiction": (2.0**12, "contradiction of weighted bounds that may be rounding, relative to its terms"),
    "curved_pivot": (2.0**12, "pivot of the Hessian of a search that counts as zero, in units of its variable"),
    "zero": (1.0, "value that is no size, relative to the scale"),
    "rounding": (2.0**6, "residual that rounding leaves of a quantity, relative to its scale"),
    "unit": (1.0, "the machine epsilon"),
    "root": (0.0, "square root of the machine epsilon"),
    "merit_rounding": (2.0**6, "change of the cost or of the violation taken as rounding, relative to its size"),
    "semidefinite": (2.0**10, "pivot of the curvature of rows taken as zero, relative to its largest diagonal entry"),
    "eigen_offdiagonal": (1.0, "element off the diagonal that Jacobi rotations leave, relative to the largest entry"),
    "eigen_tiny": (2.0**-40, "is added to denominators of a decomposition, relative to the largest entry"),
    "face": (2.0**6, "distance from a bound of the box that is taken as zero, relative to its width"),
    "terminal_compliance": (
        2.0**10,
        "what remains of a terminal row in a step of single shooting, relative to its share",
    ),
    "terminal_gap": (2.0**10, "rest of a terminal row that counts as met by a step, relative to 1 + its violation"),
    "newton": (2.0**6, "correction of a stage that is taken as rounding, relative to its state and the scale"),
    "newton_stalled": (
        2.0**14,
        "correction of a stage that is rounding where it does not decrease any more, relative to its state",
    ),
    "step_count": (2.0**12, "part of an integration step that is taken as rounding of dt / h"),
}

#: Thresholds of methods that are the same in every precision.
FACTORS: dict[str, tuple[float, str]] = {
    "augmented_sufficient": (0.01, "share of the predicted decrease below which a step is refused"),
    "augmented_good": (0.75, "share of the predicted decrease above which a long step enlarges the trust region"),
    "augmented_poor": (0.25, "share of the predicted decrease below which the trust region shrinks"),
    "augmented_shrink": (
        0.25,
        "ratio of successive radii of a trust region and of successive trials of a projected search",
    ),
    "augmented_grow": (4.0, "ratio of radii where the model is good"),
    "augmented_least_radius": (1e-4, "radius with which a sample begins at least, relative to the first one"),
    "augmented_longest": (1e30, "multiple of a direction of negative curvature that is tried"),
    "augmented_first_shift": (
        0.01,
        "first shift of an indefinite block, relative to the largest curvature of the stages",
    ),
    "augmented_next_shift": (10.0, "ratio of successive shifts"),
    "augmented_precision": (1e-4, "squared residual of conjugate gradients, preconditioned, relative to the first one"),
    "augmented_precision_of_solve": (
        1e-8,
        "squared residual of conjugate gradients in solve(), relative to the first one",
    ),
    "augmented_progress": (0.1, "decrease of the violation between updates of multipliers that keeps the penalty"),
    "augmented_fall": (0.5, "decrease of the violation in a sample that keeps the penalty"),
    "augmented_first_penalty": (0.1, "first penalty of a new plan, relative to that of later samples"),
    "augmented_first_penalty_of_solve": (0.01, "first penalty of solve(), relative to that of samples"),
    "augmented_most_penalty": (100.0, "largest penalty of a sample, relative to the first one"),
    "augmented_multiplier": (100.0, "largest multiplier, relative to that of a gap of one scale"),
    "augmented_settled_length": (0.9, "part of the trust region below which a step is not limited by it"),
    "augmented_tiny_step": (0.01, "length of a step, in scales, below which the plan is settled"),
    "shooting_terminal_share": (
        4.0,
        "decrease of the terms of terminal rows by a step, relative to the increase of the others",
    ),
    "shooting_longer": (4.0, "ratio of the first length of a step to the last accepted one, and of successive lengths"),
    "rows_sharpen": (4.0, "ratio of successive sharpnesses of the smooth max in solve()"),
    "rows_approach": (
        2.0,
        "ratio of successive sharpnesses of terms of rows after a sample whose steps were accepted at once",
    ),
    "rows_retreat": (
        0.25,
        "ratio of successive sharpnesses of terms of rows after a sample that had to shorten a step",
    ),
    "rows_enough": (0.25, "decrease of the violation by an update of multipliers in solve() that keeps the penalty"),
    "rows_inner": (
        0.1,
        "accuracy of the iterations between two updates of multipliers, relative to the tolerance or the violation",
    ),
    "rows_central": (0.1, "ratio of successive weights of the barriers in solve()"),
    "penalty_ratio": (10.0, "ratio of successive penalties"),
    "reduced_linear_share": (
        1e-06,
        "share of the curvature of linear costs that is added to the diagonal of a semidefinite Hessian",
    ),
    "reduced_mirrored_share": (
        0.1,
        "share of the largest negative curvature below which small ones are mirrored as well, against long steps",
    ),
    "shift_small": (1e-06, "shift of a stage Hessian that is tried before rows are held"),
    "shift_firm_hold": (256.0, "second weight of held rows, in units of their variables; the first one is 1"),
    "shift_first": (0.001, "first shift of an indefinite Hessian, in units of its variables"),
    "shift_ratio": (4.0, "ratio of successive shifts between which the least one is searched"),
    "shift_margin": (
        1.125,
        "shift that is taken, relative to the least one found, which is known up to a factor of 4^(1/8)",
    ),
    "shift_at_kink": (
        0.999,
        "part of its penalty below which the multiplier of a soft row is that of a row at its bound",
    ),
    "shift_restart": (1e-08, "least shift of the last Hessian with which the next search begins"),
    "sqp_damp": (4.0, "ratio of successive proximal shifts and dampings of a search"),
    "sqp_first_damping": (
        1e-3,
        "damping of the first Hessian after a step that had to be shortened, in units of its variables",
    ),
    "sqp_armijo": (0.0001, "share of the predicted decrease that a step of a search has to achieve"),
    "sqp_most_growth": (
        10.0,
        "growth of the violation in one step of a search that is accepted",
    ),
    "sqp_growth_floor": (0.1, "growth of the violation, in scales, that a step may have in any case"),
    "sqp_restoration": (16.0, "violation, in roundings of the merit function, above which feasibility is restored"),
    "sqp_least_reduction": (
        1e-08,
        "least reduction of the violation that a step has to promise, relative to it; else a search stalls",
    ),
    "sqp_most_multiplier": (100.0, "largest multiplier while rows are violated, in the units of the cost"),
    "sqp_infeasible": (0.0001, "violation, in scales, above which a point is infeasible"),
    "sqp_least_proximal": (1e-08, "least proximal shift"),
    "sqp_last_damping": (1e20, "damping at which a search stops although steps are accepted"),
    "sqp_unbounded": (
        1e6,
        "value of a variable, and decrease of the cost, in scales, from which a problem is unbounded",
    ),
    "sqp_short_step": (0.25, "length of a step below which the next Hessian is damped more"),
    "sqp_very_short_step": (0.01, "length of a step below which the next Hessian is damped much more"),
    "sqp_damp_strongly": (
        16.0,
        "ratio of successive dampings after a very short step, or after a QP without a solution",
    ),
    "sqp_least_damping": (1e-05, "damping that is dropped after full steps"),
    "sqp_most_damping": (1000000.0, "damping at which a search stops where no step is accepted"),
    "sqp_little_progress": (
        0.001,
        "reduction of the violation by an elastic QP, relative to it, that counts as progress",
    ),
    "sqp_first_proximal": (0.01, "first proximal shift"),
    "sqp_second_start": (0.1, "first damping of every second start"),
    "sqp_elastic_weight": (1000.0, "first weight of the rows in the elastic QP"),
    "sqp_most_elastic_weight": (100000000.0, "weight from which on rows that remain violated contradict each other"),
    "filter_share": (1e-05, "improvement of the violation, or of the cost by the violation, that the filter demands"),
    "filter_descent": (1e-08, "violation, relative to the largest one accepted, below which the cost has to fall"),
    "filter_limit": (10000.0, "violation that no step may reach, relative to the first one"),
    "condensed_least_terms": (
        2.0**-4,
        "least magnitude of the terms of a row, relative to its scale: the accepted residual of it is a rounding error",
    ),
    "dense_step_rounding": (0.25, "part of |m| |y| that counts as rounding of a row with the normal m"),
    "dense_independent": (
        16.0,
        "part of an equality outside the span of others, in roots of the epsilon, for which it enters first",
    ),
    "dense_cancelled": (0.125, "part of its terms below which a difference is computed again without cancellation"),
    "dense_strict": (0.25, "part of the accepted residual that a row may take up when a result has been refused"),
    "dense_path_rounding": (2.0**-20, "part of |m| |y0| that counts as rounding of a row with the normal m"),
    "riccati_raised_pivot": (512.0, "value that replaces a pivot which may be zero, in units of its rounding"),
    "riccati_unrefined": (16.0, "tolerance of a minimiser that is not refined, in square roots of the machine epsilon"),
    "riccati_weight_ratio": (1024.0, "ratio of successive weights of a member that is not at its bound"),
    "riccati_longest_step": (
        65536.0,
        "longest correction of members that nearly depend on one another, relative to the first",
    ),
    "ipm_regularize": (1024.0, "ratio of successive values that are added to pivots that may be zero"),
    "ipm_proximal": (2.0**-10, "proximal term of a damped QP, relative to the largest curvature of its variable"),
    "ipm_proximal_zero": (64.0, "proximal term of a variable without curvature, in units of the least pivot"),
    "ipm_least_stiffening": (
        0.0625,
        "least stiffening of a damped QP, relative to what keeps half the digits of its rows",
    ),
    "ipm_range": (0.0625, "distance of two bounds, relative to their magnitude, below which they are close"),
    "ipm_warm_violation": (
        1024.0,
        "violation of a row, relative to the distance of its bounds, above which a warm start is discarded",
    ),
    "ipm_most_multiplier": (
        4.0,
        "first multiplier of a warm start, relative to the one that the cost of the violation explains",
    ),
    "ipm_longest_ascent": (64.0, "longest step on equations that nearly depend on one another, relative to the first"),
    "ipm_certified": (
        4.0,
        "multiple of what is left of the gradients that a certificate of infeasibility has to exceed",
    ),
    "ipm_small_distance": (
        2.0**-8,
        "distance, relative to that of the farthest bound, whose square is negligible in the cost",
    ),
    "ipm_full_step": (0.9, "length from which a step counts as full"),
    "ipm_slow_rows": (0.125, "decrease of the residual of the rows by a full step that keeps the stiffening"),
    "ipm_stiffening_ratio": (16.0, "ratio of successive stiffenings of rows"),
    "ipm_most_stiffening": (65536.0, "largest stiffening of rows: beyond it their rounding covers the gradient"),
    "ipm_stiffest_ratio": (
        0.0625,
        "limit of the stiffening after rounding of stiff rows has covered the gradient, relative to the last one",
    ),
    "ipm_setback_cycle": (0.1, "part of the distance to the boundary that is kept by iterations that go in a circle"),
    "ipm_setback_early": (0.005, "part of the distance to the boundary that is kept while the gap is large"),
    "ipm_early_gap": (0.0005, "gap, in units of the cost, above which it counts as large"),
    "ipm_setback_late": (1e-06, "part of the distance to the boundary that is kept where the gap is small"),
    "ipm_late_gap": (1e-07, "gap, in units of the cost, below which it counts as small"),
    "ipm_setback_share": (
        10.0,
        "part of the distance to the boundary that is kept in between, relative to the gap in units of the cost",
    ),
    "ipm_least_target": (2.0**-10, "least complementarity that a step aims at, in tolerances of the gap"),
    "ipm_most_correction": (
        4.0,
        "inverse length of the affine step from which its second-order correction is shortened",
    ),
    "ipm_accepted_rows": (16384.0, "residual of the rows, in tolerances, that is accepted where it stops decreasing"),
    "ipm_accepted_gradient": (
        1024.0,
        "residual of the gradient, in tolerances, that is accepted; above it, stiff rows cover it with rounding",
    ),
    "ipm_stagnant": (0.875, "decrease of a residual above which it counts as stagnant"),
    "ipm_negligible_row": (16.0, "row whose multiplier moves the cost by less than this many roundings of its unit"),
    "ipm_improvement": (
        0.25,
        "decrease of the residual of the rows for which an accepted result is improved once more",
    ),
    "ipm_least_proximal": (8192.0, "least proximal term, in units of the square root of the machine epsilon"),
    "ipm_proximal_ratio": (0.0625, "ratio of successive proximal terms"),
    "ipm_inexact": (4.0, "residual of equations, in tolerances, from which a further step is worth while"),
    "ipm_hand_over": (
        0.0001,
        "gap, in units of the cost, and residual below which an iterate indicates the working set",
    ),
    "ipm_warm": (0.1, "first complementarity of a warm start, relative to that of a cold one"),
    "step_gradient_cost": (2.0**-8, "part of the rounding of the cost that a remaining gradient may change it by"),
    "scale_moving_row": (0.001, "scale of a row whose bounds are 0, relative to its largest value lately"),
    "scale_little_of_state": (0.1, "least size in which a gap is measured, relative to the scale of its state"),
    "scale_state_growth": (
        10.0,
        "growth of a state since the last plan that was OK, above which it is no scale of its gaps",
    ),
    "estimate_known": (8.0, "least deviation before the window, in epsilons of that of the state or of its scale"),
    "innovation_quantile": (4.5, "quantile of the normal distribution beyond which innovations are unexpected"),
    "innovation_memory": (0.9, "weight of innovations relative to those of the previous sample"),
    "innovation_memory_of_signs": (
        0.8,
        "weight of innovations with their signs relative to those of the previous sample",
    ),
    "innovation_cube_root": (2.0 / 9.0, "variance of the cube root of a mean square of one normal number"),
    "innovation_far": (5.0, "innovation that no noise explains, in standard deviations"),
    "innovation_largest": (1e9, "innovation above which its size is not told"),
    "innovation_widest": (
        1000.0,
        "innovation that is absurd, and the ratio of the deviations of a new beginning to the declared ones at most",
    ),
    "scale_little_of_row": (0.01, "least scale of a row, relative to that of its terms"),
    "near_short_step": (1e-3, "length of a step, in the scales of its variables, after which nothing is evaluated"),
    "near_trusted": (0.25, "fraction of the tolerance that earlier steps of this length may leave as a residual"),
    "near_contraction": (0.5, "residual after an iteration, relative to that before it, with which a Hessian is kept"),
    "near_rows": (0.02, "part of the tolerance by which a plan may leave hard rows before its sample goes on"),
    "near_enough": (0.1, "part of the tolerance at which the iterations of a sample end"),
    "idle_step": (0.1, "part of its scale by which an idle control may move in a step"),
    "idle_change": (0.01, "part of its scale by which a control is changed to see whether it is idle"),
    "departure": (0.5, "part of their probe by which idle controls depart from a saddle"),
    "second_departure": (
        0.125,
        "part of their probe by which they depart again, after a departure that has led to no better plan",
    ),
    "saddle_gain": (1e-4, "part of its cost by which a probe of idle controls lowers that of a plan at a saddle"),
    "saddle_nearer": (
        0.9,
        "violation of hard rows with which a probe of idle controls is taken, relative to that before",
    ),
    "relaxation_weight": (
        1e4,
        "l1 weight of hard rows where a QP is infeasible, in their scales",
    ),
    "hessian_floor": (1e-8, "least eigenvalue of a Hessian that is made convex, relative to the largest one"),
    "augmented_first_radius": (10.0, "radius of the trust region of a new plan, in the scales"),
    "relaxation_falls": (0.999, "violation, relative to that of the previous sample, below which it falls"),
}

#: Tolerance -> multiple of the square root of the machine epsilon that it is at least.
ROOTS: dict[str, float] = {
    "root": 1.0,
    "zero": 2.0**-3,
    "qp_accepted": 0.25,
    "step": 0.5,
    "ipm_ray": 2.0**-4,
    "ipm_contradiction": 2.0**-10,
}

#: Tolerance -> number that it is at least in any precision.
FLOORS: dict[str, float] = {
    "step_gradient": 2.0**-20,
    "qp_residual": 2.0**-35,
    "terminal_gap": 2.0**-10,
    "terminal_compliance": 2.0**-24,
}


#: The tolerances of which the others are multiples: the machine epsilon and its square root.
UNIT, ROOT = "unit", "root"


def tolerance(name: str, precision: str) -> float:
    """Return the value of a named tolerance in the given precision."""
    multiples, eps = _multiples(name), EPS[precision]
    return max(multiples[UNIT] * eps, multiples[ROOT] * math.sqrt(eps), FLOORS.get(name, 0.0))


def origin(name: str, precision: str) -> tuple[str, float]:
    """Return the unit of which a tolerance is a multiple in the given precision, and the factor.

    ("", value) for a number.
    """
    value = tolerance(name, precision)
    sizes = {UNIT: EPS[precision], ROOT: math.sqrt(EPS[precision])}
    found = ((unit, factor) for unit, factor in _multiples(name).items() if factor and factor * sizes[unit] == value)
    return ("", value) if name in sizes else next(found, ("", value))


def _multiples(name: str) -> dict[str, float]:
    return {UNIT: TOLERANCES[name][0], ROOT: ROOTS.get(name, 0.0)}
