"""Choice of the Hessian: Gauss-Newton, unless the cost is no least squares, a row excludes a convex set, or the penalty
of a soft row has far more curvature than the cost."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from nmpc_codegen.components.hessians import ExactHessian, GaussNewton
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.lowering.growth import points
from nmpc_codegen.options import Options

#: Points beside the initial state at which the curvature of rows is judged, and how far from it they lie.
POINTS, REACH = 8, 1.0

#: Curvature of the penalty of a soft row, relative to that of the cost, from which Gauss-Newton steps are too long.
TOO_LONG = 100.0


def choose_hessian(problem: Problem, options: Options) -> tuple[Options, tuple[str, ...]]:
    """The options with a Hessian, and the reason if it is not the default of the algorithm.

    Gauss-Newton ignores the curvature of a row that excludes a convex set, such as an obstacle, and may cycle round it.
    It also ignores that of the dynamics, which counts with the multipliers: those of a violated soft row are its l1.
    """
    if options.hessian is not None or options.algorithm.default("hessian") != GaussNewton.name:
        return options, ()
    why = _why_exact(problem)
    if why is None:
        return options, ()
    return replace(options, hessian=ExactHessian()), (f"hessian: {ExactHessian.name}; {why}",)


def _why_exact(problem: Problem) -> str | None:
    beyond = problem.features - GaussNewton.supports
    if beyond and beyond <= ExactHessian.supports:
        return f"the problem has a {sorted(beyond)[0]}"
    for row in problem.rows:
        if row.kind != "general" or row.lower == row.upper:
            continue
        for stage, index in ((problem.path, row.index), (problem.terminal, row.index_terminal)):
            if 0 <= index < stage.nh and _excludes_convex(problem, stage, index, row.lower, row.upper):
                return f"row {row.name!r} excludes a convex set"
    return _steep_row(problem)


def _steep_row(problem: Problem) -> str | None:
    """Why the curvature of a soft row in the controls of one interval, l1 d^2 h(F(x, u)) / du_j^2, exceeds that of the
    cost by far, (J_u' W J_u)_jj + (F_u' J_x' W J_x F_u)_jj; None if no row has so much."""
    stage = problem.path
    x, u, p = stage.x, stage.u, stage.p
    f = problem.dynamics(x, u, p)
    end = f if problem.discrete else x + max(problem.dt) * f
    changes = ca.horzcat(ca.jacobian(stage.y, u).T, (ca.jacobian(stage.y, x) @ ca.jacobian(end, u)).T)
    cost = ca.diag(changes @ ca.diagcat(stage.weight, stage.weight) @ changes.T)
    for row in problem.rows:
        of_path = row.kind == "general" and 0 <= row.index < stage.nh
        if row.soft is None or not (row.kind == "state" or of_path):
            continue
        value = end[row.index] if row.kind == "state" else ca.substitute(stage.h[row.index], x, end)
        curvature = ca.diag(ca.hessian(value, u)[0])
        evaluate = ca.Function("curvatures", [x, u, p], [ca.densify(curvature), ca.densify(cost)])
        for state, control in points(problem):
            penalty, known = (np.asarray(m).ravel() for m in evaluate(state, control, problem.p_value))
            if np.any(row.soft[0] * np.abs(penalty) > TOO_LONG * np.abs(known)):
                return f"the penalty of row {row.name!r} has much more curvature than the cost"
    return None


def _excludes_convex(problem: Problem, stage: Stage, index: int, lower: float, upper: float) -> bool:
    """True if the row has one bound, its excluded side is convex at all points, and strictly at one of them."""
    if np.isfinite(lower) == np.isfinite(upper):
        return False
    z = ca.vertcat(stage.x, stage.u)
    sign = 1.0 if np.isfinite(lower) else -1.0
    H = sign * ca.hessian(stage.h[index], z)[0]
    if not H.nnz():
        return False
    evaluate = ca.Function("curvature", [z, stage.p], [ca.densify(H)])
    random = np.random.default_rng(0)
    center = np.concatenate([problem.x_initial, np.zeros(stage.nu)])
    values = []
    for n in range(POINTS + 1):
        point = center + (REACH if n else 0.0) * random.uniform(-1, 1, center.size) * np.maximum(1.0, np.abs(center))
        matrix = np.asarray(evaluate(point, problem.p_value))
        if np.all(np.isfinite(matrix)):
            values.append(np.linalg.eigvalsh(matrix))
    if not values:
        return False
    largest = np.max(np.abs(values))
    return bool(np.min(values) >= -1e-9 * largest and np.max(values) > 1e-9 * largest)
