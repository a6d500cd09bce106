"""Choice of the Hessian: Gauss-Newton, unless the cost is no least squares or a row excludes a convex set."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from nmpc_codegen.components.hessians import ExactHessian, GaussNewton
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.options import Options

#: Points beside the initial state at which the curvature of rows is judged, and how far from it they lie.
POINTS, REACH = 8, 1.0


def choose_hessian(problem: Problem, options: Options) -> tuple[Options, tuple[str, ...]]:
    """The options with a Hessian, and the reason if it is not the default of the algorithm.

    Gauss-Newton ignores the curvature of a row that excludes a convex set, such as an obstacle, and may cycle round it.
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
