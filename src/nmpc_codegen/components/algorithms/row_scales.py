"""Scales of variables and rows follow from declared values and bounds, for algorithms that sum gaps and violations."""

from __future__ import annotations

import casadi as ca
import numpy as np

from nmpc_codegen.components.stage_cost import StageCost, stage_cost
from nmpc_codegen.frontend.completion.scales import stated_scales
from nmpc_codegen.frontend.problem import Array, Problem, Stage
from nmpc_codegen.ir.casadi_types import Expression, curved_rows
from nmpc_codegen.ir.cmodule import Table


def tolerance_table(tolerance: float) -> Table:
    """Return the table with the residual of gaps and rows, in their scales, above which a sample is NOT_CONVERGED."""
    return Table("residual_tolerance", "real", (float(tolerance),), "residual of a plan that is converged")


def variable_scales(problem: Problem) -> Array:
    """Return the scales of (x, u), (nx + nu,).

    They are declared, or the largest magnitude of the initial value and finite bounds, or 1 if all are 0. A control
    with two finite bounds has half the distance between them.
    """
    nx = problem.nx
    largest = np.concatenate([np.abs(problem.x_initial), np.zeros(problem.nu)])
    for row in problem.rows:
        bounds = [abs(bound) for bound in (row.lower, row.upper) if np.isfinite(bound)]
        place, half = row.variable(nx), (row.upper - row.lower) / 2
        if place is not None and place < nx:
            largest[place] = max([largest[place], *bounds])
        elif place is not None:
            largest[place] = half if np.isfinite(half) else max(bounds, default=0.0)
    stated = stated_scales(problem)
    return np.where(stated > 0.0, stated, np.where(largest > 0.0, largest, 1.0))


def row_scales(problem: Problem, scale: Array) -> Array:
    """Return the scales of the rows of the QP: sqrt(sum_i (J_i scale_i)^2) at the initial state and u = 0.

    The scale is 1 where that is 0 or not finite. A coupled row counts as a function of x_N.
    """
    nx, x = problem.nx, problem.x_initial
    stages = ((False, problem.path), (True, problem.terminal))
    slopes = {at_end: _slopes(stage.h, stage, problem) for at_end, stage in stages if stage.nh}
    coupled = np.zeros((0, nx))
    if problem.coupled is not None:
        x_0, x_N = ca.SX.sym("x_0", nx), ca.SX.sym("x_N", nx)
        J = ca.jacobian(problem.coupled(x_0, x_N), x_N)
        coupled = np.asarray(ca.Function("slopes", [x_0, x_N], [ca.densify(J)])(x, x))
    found = np.ones(len(problem.qp_rows))
    for m, (k, _, _, row) in enumerate(problem.qp_rows):
        end = k == problem.N
        J = problem.rows[row].value(np.eye(nx), None, slopes.get(end), coupled, end)
        size = float(np.linalg.norm(J * scale[: J.size]))
        found[m] = size if np.isfinite(size) and size > 0 else 1.0
    return found


def row_sizes(problem: Problem, scale: Array) -> Array:
    """Return the sizes by which violations of the rows of the QP are measured.

    The size is the smaller of the scale of a row and its largest finite bound, because the gradient at the initial
    state is no measure for a distant obstacle. The size is at least a hundredth of the scale, because a bound near 0 is
    no measure either.
    """
    found = row_scales(problem, scale)
    for m, (_, kind, _, row) in enumerate(problem.qp_rows):
        bounds = [abs(b) for b in (problem.rows[row].lower, problem.rows[row].upper) if np.isfinite(b) and b]
        if kind and bounds:
            found[m] = min(found[m], max(*bounds, 0.01 * found[m]))
    return found


def linear_rows(problem: Problem) -> tuple[int, ...]:
    """Return 1 for every row of the QP that is linear in the variables of its node (a coupled row in x_N), else 0."""
    stages = ((False, problem.path), (True, problem.terminal))
    bent = {(1, at_end): curved_rows(stage.h, ca.vertcat(stage.x, stage.u)) for at_end, stage in stages}
    if problem.coupled is not None:
        x_0, x_N = ca.SX.sym("x_0", problem.nx), ca.SX.sym("x_N", problem.nx)
        bent[2, True] = curved_rows(problem.coupled(x_0, x_N), x_N)
    rows = problem.qp_rows
    return tuple(int(index not in bent.get((kind, k == problem.N), ())) for k, kind, index, _ in rows)


def cost_magnitude(problem: Problem, scale: Array, otherwise: float = 1.0) -> float:
    """Return the change of a plan's cost for a change of a variable by its scale, at the initial state.

    The change is the largest second derivative of a path node or gradient of a general cost; the gradient of a path
    node counts N times, because a change of a state persists. If all these are 0, the second derivative of the terminal
    node counts, else ``otherwise``.
    """
    path, terminal = (_sizes(stage, problem, scale) for stage in (problem.path, problem.terminal))
    most = max(path[0], problem.N * path[1], terminal[1]) or terminal[0]
    return most if most > 0 else otherwise


def _sizes(stage: Stage, problem: Problem, scale: Array) -> tuple[float, float]:
    """Return the largest curvature of the cost of a stage and slope of its general cost, in scales; 0 if not finite."""
    cost = stage_cost(stage, "path" if stage.nu else "terminal")
    general = ca.SX(0) if cost.general is None else cost.general
    if stage.cost_rate is not None:
        general = general + stage.dt * stage.cost_rate
    bend = ca.diag(ca.densify(cost.gauss_newton)) + ca.diag(ca.densify(ca.hessian(general, cost.z)[0]))
    curvature, slope = _magnitudes_at_start(cost, stage, problem, bend, ca.gradient(general, cost.z))
    size = scale[: slope.size]
    largest = [float(np.max(v, initial=0.0, where=np.isfinite(v))) for v in (curvature * size**2, slope * size)]
    return largest[0], largest[1]


def _magnitudes_at_start(cost: StageCost, stage: Stage, problem: Problem, *expressions: Expression) -> list[Array]:
    """Return magnitudes of expressions of a stage at the initial state, control references and declared data."""
    x, u = problem.x_initial, problem.reference_controls if stage.nu else np.zeros(0)
    values = problem.node_values(x, u)
    at = (x, u, values, problem.dt[0]) if stage.nu else (x, values)
    weight = np.diag(stage.weight) if stage.diagonal_weight else stage.weight.ravel()
    evaluate = ca.Function("sizes", [*cost.inputs, cost.yref, cost.W, cost.mu], list(expressions))
    return [np.abs(np.asarray(v).ravel()) for v in evaluate(*at, stage.reference, weight, np.zeros(stage.nh))]


def _slopes(h: Expression, stage: Stage, problem: Problem) -> Array:
    """Return the Jacobian of the rows of a stage at the initial state."""
    z = ca.vertcat(stage.x, stage.u)
    J = ca.Function("slopes", [stage.x, stage.u, stage.p], [ca.densify(ca.jacobian(h, z))])
    x, u = problem.x_initial, np.zeros(stage.nu)
    return np.asarray(J(x, u, problem.node_values(x, u)))
