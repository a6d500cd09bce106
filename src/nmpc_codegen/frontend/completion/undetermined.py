"""Some controls are not determined by a QP, because neither the cost nor the states that they move give them curvature.

The minimum of a QP in such a control lies where bounds and rows cross. It jumps from sample to sample, and plans of a
nonlinear problem jump beyond the range in which their linearisation is valid. Samples therefore add P_i dz_i^2 / 2 to
their QP, z = (x, u). This term limits the step and vanishes at the solution, so that it does not change the solution
(proximal point method: Rockafellar, SIAM J. Control Optim. 14, 1976).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.completion.scales import Scales
from nmpc_codegen.frontend.problem import Array, Problem, Stage
from nmpc_codegen.ir.casadi_types import curved_rows

#: Curvature of a control below this value, relative to the scale of the cost, counts as none.
NONE = 1e-6
#: Curvature that samples add, for the scale of the cost, and half the width of bounds or the scale of a variable.
PROXIMAL = 0.03
#: Least width of bounds, relative to the scale of their variable.
LITTLE = 0.05
#: Number of points at which curvature is evaluated: the initial state, and random ones within the scales.
POINTS = 4


def flat_controls(problem: Problem, sizes: Scales) -> tuple[int, ...]:
    """Return the indices of the controls without curvature.

    None for a linear program, whose vertices are found exactly.
    """
    if problem.augmentation.idle or not (problem.nonlinear_model or problem.nonlinear_rows):
        return ()
    bent, curvature = _bends_model(problem), _curvature(problem, sizes)
    return tuple(j for j in range(problem.nu) if not bent[j] and curvature[j] <= NONE * sizes.cost)


def proximal_terms(problem: Problem, sizes: Scales) -> tuple[float, ...]:
    """Return P (nx + nu,)."""
    width = sizes.z.copy()
    for row in problem.rows:
        half = (row.upper - row.lower) / 2
        place = row.variable(problem.nx)
        if place is not None and 0.0 < half < np.inf and tuple(row.nodes) != (problem.N,):
            width[place] = max(half, LITTLE * sizes.z[place])  # a narrow band says little about how far a state moves
    return tuple(float(p) for p in PROXIMAL * sizes.cost / np.square(width))


def _bends_model(problem: Problem) -> list[bool]:
    """Return for every control True if the dynamics or a row has a second derivative with respect to it.

    Multipliers then give the Lagrangian curvature in this control.
    """
    path = problem.path
    z = path.x, path.u, path.p
    maps = ca.SX(0, 1) if problem.jump is None else problem.jump(*z, path.dt)
    f = ca.vertcat(problem.dynamics(*z), maps, path.h)
    return [bool(curved_rows(f, path.u[j])) for j in range(problem.nu)]


def _curvature(problem: Problem, sizes: Scales) -> Array:
    """Return the scaled curvature of the cost in each control (nu,), including the effect through the states."""
    nx = problem.nx
    path, end = _diagonal(problem.path, problem, sizes.z), _diagonal(problem.terminal, problem, sizes.z)
    of_states = np.maximum(path[:nx], end[:nx])
    moved = np.square(sizes.reach * sizes.z[nx:])
    with np.errstate(all="ignore"):
        through = np.nan_to_num(of_states @ moved, nan=np.inf)
        return np.asarray(path[nx:] * np.square(sizes.z[nx:]) + through)


def _diagonal(stage: Stage, problem: Problem, z: Array) -> Array:
    """Return the largest magnitudes of the second derivatives of the cost of a stage, one for each variable."""
    v = ca.vertcat(stage.x, stage.u)
    J = ca.jacobian(stage.y, v)
    bend = ca.diag(J.T @ ca.DM(stage.weight) @ J) if stage.ny else ca.SX(v.numel(), 1)
    for cost in (stage.cost, stage.cost_rate):
        if cost is not None:
            bend = bend + ca.fabs(ca.diag(ca.hessian(cost, v)[0]))
    at = ca.Function("bend", [v, stage.p, stage.dt], [ca.densify(bend)])
    start = np.concatenate([problem.x_initial, np.zeros(problem.nu)])[: v.numel()]
    random = np.random.default_rng(0)
    points = [start, *(z[: v.numel()] * random.uniform(-1, 1, v.numel()) for _ in range(POINTS))]
    values = [problem.node_values(point[: problem.nx], point[problem.nx :]) for point in points]
    found = [np.abs(np.asarray(at(*each, max(problem.dt))).ravel()) for each in zip(points, values, strict=True)]
    return np.asarray(np.nan_to_num(np.max(found, axis=0), nan=np.inf))
