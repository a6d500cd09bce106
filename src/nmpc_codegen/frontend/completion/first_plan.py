"""In the first plan all states have their initial values, and controls their references, clipped to their bounds."""

from __future__ import annotations

import numpy as np

from nmpc_codegen.frontend.problem import Array, Problem, Stage


def first_plan(problem: Problem) -> tuple[Array, Array]:
    """Return (x, u) at all nodes of the first plan: initial states, and references of controls inside their bounds."""
    u = problem.reference_controls
    for row in problem.rows:
        if row.kind == "control":
            u[row.index] = np.clip(u[row.index], row.lower, row.upper)
    return problem.x_initial, u


def points(problem: Problem) -> list[tuple[Array, Array]]:
    """Return the point (x, u) of the first plan, and the same points with the states at the references of the cost."""
    start, u = first_plan(problem)
    states = [start, *(_at_reference(problem, stage, start) for stage in (problem.path, problem.terminal))]
    return [(x, u) for x in np.unique(states, axis=0)]


def _at_reference(problem: Problem, stage: Stage, start: Array) -> Array:
    """Return ``start`` with the states replaced for which a residual defines a value."""
    x = start.copy()
    for place, value in stage.targets(problem.data):
        if place < problem.nx:
            x[place] = value
    return x
