"""All tolerances of the generated code, as named multiples of the machine epsilon of the working precision."""

import math

EPS = {"double": 2.0**-52, "single": 2.0**-23}

TOLERANCES: dict[str, tuple[float, str]] = {
    "qp_pivot": (2.0**5, "rounding of the curvature of a semidefinite Hessian, relative to its diagonal"),
    "qp_dependent": (2.0**10, "part of a normal outside the span of the working set that counts as zero, relative"),
    "qp_dependent_prediction": (2.0**14, "the same while the predicted working set is factorised"),
    "qp_feasibility": (2.0**2, "violation of a row that is taken as rounding, relative to |m|'(|y0| + |y|)"),
    "qp_redundant": (2.0**8, "the same for a row that depends on the working set"),
    "qp_sign": (2.0**6, "wrong sign of a multiplier that is taken as rounding: |m| |lam| relative to |y0| + |y|"),
    "qp_proximal": (2.0**8, "step of the proximal point method that is taken as rounding, relative to |y0| + |y|"),
    "qp_proximal_stagnation": (2.0**12, "the same if the step does not decrease any more"),
    "qp_accepted": (
        2.0**12,
        "residual of a row or of the gradient in a result that is called OK, relative to its terms",
    ),
    "qp_noise": (
        2.0**4,
        "the same for the gradient, relative to what moves the cost by its terms or to all that travels along the grid",
    ),
    "step": (2.0**13, "the same in a result of a condensed QP, expanded, with less of the terms counted"),
    "step_gradient": (2.0**13, "the same for the gradient, in which condensing of an unstable plant costs digits"),
    "qp_residual": (2.0**10, "residual of a row or of the gradient in an answer, relative to its terms"),
    "riccati_pivot": (2.0**5, "rounding of a pivot of the Riccati recursion, relative to its diagonal entry"),
    "riccati_dependent": (2.0**10, "part of a row outside the span of others that counts as zero, relative, squared"),
    "riccati_feasibility": (2.0**6, "violation of a bound that is taken as rounding, relative to |a|'|z| + |bound|"),
    "riccati_sign": (2.0**8, "wrong sign of a multiplier that is taken as rounding, relative to its terms"),
    "riccati_refined": (2.0**2, "residual on a working set that is taken as rounding, relative to its terms"),
    "riccati_rounding": (2.0**20, "the same if it does not decrease any more"),
    "ipm_dual_regularization": (2.0**22, "compliance of an active row, relative to that of the cost along it"),
    "ipm_equation_regularization": (2.0**22, "the same for an equation"),
    "ipm_dynamics": (2.0**8, "gap of the dynamics, relative to its terms"),
    "ipm_gap": (2.0**-20, "product of multiplier and distance, relative to the cost of the most expensive row"),
    "ipm_primal": (2.0**2, "residual of a row, relative to its size"),
    "ipm_stationarity": (2.0**8, "gradient of the Lagrangian, relative to its largest term"),
    "ipm_violation": (2.0**8, "violation of a row without multiplier that is taken as rounding, relative to its size"),
    "ipm_ray": (2.0**12, "rest of a sum of row gradients that is taken as zero, relative to its terms"),
    "ipm_contradiction": (2.0**12, "contradiction of weighted bounds that may be rounding, relative to its terms"),
    "curved_pivot": (2.0**12, "pivot of the Hessian of solve() that counts as zero, in units of its variable"),
    "unit": (1.0, "the machine epsilon; its square root separates a zero pivot from a positive one"),
    "merit_rounding": (2.0**6, "change of the merit function taken as rounding, relative to 1 + |phi|"),
    "semidefinite": (2.0**10, "pivot of the curvature of rows taken as zero, relative to its largest diagonal entry"),
    "eigen_offdiagonal": (1.0, "element off the diagonal that Jacobi rotations leave, relative to the largest entry"),
    "eigen_tiny": (2.0**-40, "entries below it, relative to the largest, do not count in a decomposition"),
    "face": (2.0**6, "distance from a bound of the box that is taken as zero, relative to its width"),
    "terminal_compliance": (
        2.0**10,
        "what remains of a terminal row in a step of single shooting, relative to its share",
    ),
    "terminal_gap": (2.0**10, "rest of a terminal row that counts as met by a step, relative to 1 + its violation"),
    "step_count": (2.0**12, "part of an integration step that is taken as rounding of dt / h"),
}

#: Thresholds of methods that are the same in every precision.
FACTORS: dict[str, tuple[float, str]] = {
    "sufficient": (0.01, "share of the predicted decrease below which a step is refused"),
    "good": (0.75, "the same above which a long step enlarges the trust region"),
    "poor": (0.25, "the same below which the trust region shrinks"),
    "shrink": (0.25, "ratio of successive radii of a trust region and of successive trials of a projected search"),
    "grow": (4.0, "ratio of radii where the model is good"),
    "least_radius": (1e-4, "radius with which a sample begins at least, relative to the first one"),
    "longest": (1e30, "multiple of a direction of negative curvature that is tried"),
    "first_shift": (0.01, "first shift of an indefinite block, relative to the largest curvature of the stages"),
    "next_shift": (10.0, "ratio of successive shifts"),
    "precision": (1e-4, "squared residual of conjugate gradients, preconditioned, relative to the first one"),
    "precision_of_solve": (1e-8, "the same in solve()"),
    "progress": (0.1, "decrease of the violation between updates of multipliers that keeps the penalty"),
    "stiffer": (10.0, "ratio of successive penalties"),
    "fall": (0.5, "decrease of the violation in a sample that keeps the penalty"),
    "soft": (0.1, "first penalty of a new plan, relative to that of later samples"),
    "softest": (0.01, "first penalty of solve(), relative to that of samples"),
    "stiffest": (100.0, "largest penalty of a sample, relative to the one at the start"),
    "multiplier": (100.0, "largest multiplier, relative to that of a gap of one scale"),
}

#: Multiples of the square root of the machine epsilon below which a tolerance does not fall.
ROOTS: dict[str, float] = {
    "qp_accepted": 0.25,
    "step": 0.5,
    "ipm_ray": 2.0**-4,
    "ipm_contradiction": 2.0**-10,
}

#: Values below which a tolerance does not fall in any precision.
FLOORS: dict[str, float] = {
    "step_gradient": 2.0**-20,
    "qp_residual": 2.0**-35,
    "terminal_gap": 2.0**-10,
    "terminal_compliance": 2.0**-24,
}


def tolerance(name: str, precision: str) -> float:
    """Value of a named tolerance in the given precision."""
    eps = EPS[precision]
    return max(TOLERANCES[name][0] * eps, ROOTS.get(name, 0.0) * math.sqrt(eps), FLOORS.get(name, 0.0))
