"""What cannot work at the first plan, where all states are at their initial values and controls at their references.

A derivative that is not finite there fails the first sample. What has no gradient there moves no iterate: a control
without influence (u^3 at 0), a row whose gradient vanishes although it is not satisfied with room to spare (w^2 <= v^2
at rest), an end time of 0 that scales all derivatives.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.problem import Array, Problem, Stage
from nmpc_codegen.ir.casadi_types import Expression, Function
from nmpc_codegen.lowering.growth import first_plan
from nmpc_codegen.runtime.diagnosis.domains import in_words, locate
from nmpc_codegen.runtime.diagnosis.program import Program

#: Points at which a property that is to hold for all states is tested.
DRAWN = 4
#: Distance from a bound, relative to it, up to which a row counts as active.
ACTIVE = 1e-9


def first_plan_warnings(problem: Problem, program: Program, second: bool) -> tuple[str, ...]:
    """One text for everything that cannot work at the first plan; ``second``: second derivatives are evaluated."""
    x, u = first_plan(problem)
    return (
        *_not_finite(problem, program, second, x, u),
        *_end_time(problem, x, u),
        *_without_influence(problem, x, u),
        *_without_gradient(problem, x, u),
    )


def _not_finite(problem: Problem, program: Program, second: bool, x: Array, u: Array) -> Iterator[str]:
    nodes = problem.N + 1
    plan = (np.tile(x, (nodes, 1)), np.tile(u, (problem.N, 1)), np.tile(problem.p_value, (nodes, 1)))
    for text in in_words(locate(program, *plan, second)):
        yield f"the first plan has no finite derivatives: {text}"


def _end_time(problem: Problem, x: Array, u: Array) -> Iterator[str]:
    """Constant states and parameters at 0 that scale all derivatives."""
    if problem.discrete:
        return
    names = (*problem.state_names, *problem.parameter_names)
    values = np.concatenate([x, problem.p_value])
    draws = [np.concatenate([d, problem.p_value + _noise(problem.np, k)]) for k, d in enumerate(_drawn(x))]
    controls = [u + 1 + _noise(problem.nu, k) for k in range(DRAWN)]

    def slopes(index: int, value: float) -> Array:
        found = []
        for point, control in zip(draws, controls, strict=True):
            at = point.copy()
            at[index] = value
            found.append(np.asarray(problem.dynamics(at[: problem.nx], control, at[problem.nx :]), dtype=float).ravel())
        return np.array(found)

    for i in map(int, np.flatnonzero(values == 0)):
        moving = slopes(i, 1.0)
        if np.any(slopes(i, 0.0)) or not np.any(moving) or (i < problem.nx and np.any(moving[:, i])):
            continue
        kind, option = ("state", "initial") if i < problem.nx else ("parameter", "value")
        yield (
            f"{kind} '{names[i]}' is 0 at the first plan and scales all derivatives, so nothing moves there: "
            f"give it another value, e.g. ocp.{kind}({names[i].partition('[')[0]!r}, {option}=1.0)"
        )


def _without_influence(problem: Problem, x: Array, u: Array) -> Iterator[str]:
    """Controls whose first derivatives vanish in dynamics, cost and rows at their first value, whatever the states, the
    parameters and the other controls that do have an influence."""
    path = problem.path
    f = problem.dynamics(path.x, path.u, path.p)
    slopes = ca.vertcat(ca.SX(0, problem.nu), *(ca.jacobian(part, path.u) for part in _costs(path)))
    jacobians = [ca.jacobian(f, path.u), ca.jacobian(path.h, path.u)]
    evaluate = _function(path, [ca.densify(j) for j in (*jacobians, slopes)])
    moves = np.array([not any(rows) for rows in np.asarray(ca.DM(jacobians[0].sparsity(), 1)).T], dtype=bool)
    for _ in range(problem.nu):  # each pass may move a control that gives others an influence
        found = np.zeros(problem.nu, dtype=bool)
        for k in range(DRAWN):
            control = np.where(moves, u + _noise(problem.nu, k), u)
            parts = evaluate(_drawn(x)[k], control, problem.p_value + _noise(problem.np, k), problem.dt[0])
            for part in parts:
                size = np.abs(np.asarray(part, dtype=float)).reshape(-1, problem.nu)
                found |= np.any((size > 0) | ~np.isfinite(size), axis=0)
        moves |= found
    for j in np.flatnonzero(~moves):
        yield (
            f"control '{problem.control_names[j]}' is {u[j]:g} at the first plan, where its first derivatives in "
            f"dynamics, cost and rows vanish: no iteration moves it. Write another value, e.g. ctrl.u[:, {j}] = 0.1, "
            "after build() and after every reset(); or state a residual of it with another reference; or take the "
            "whole term that contains it as the control"
        )


def _costs(stage: Stage) -> list[Expression]:
    """The scalar terms of the cost of a stage, with the declared weights and references."""
    y = stage.y - ca.DM(stage.reference)
    squares = [ca.bilin(ca.SX(ca.DM(stage.weight)), y, y) / 2] if stage.ny else []
    return [*squares, *(c for c in (stage.cost, stage.cost_rate) if c is not None)]


def _without_gradient(problem: Problem, x: Array, u: Array) -> Iterator[str]:
    """General rows that are active or violated, but whose gradient is 0."""
    for stage, control in ((problem.path, u), (problem.terminal, np.zeros(0))):
        if not stage.nh:
            continue
        z = ca.vertcat(stage.x, stage.u)
        evaluate = _function(stage, [ca.densify(stage.h), ca.densify(ca.jacobian(stage.h, z))])
        h, J = (np.asarray(v, dtype=float) for v in evaluate(x, control, problem.p_value, problem.dt[0]))
        other = np.asarray(evaluate(x, control, problem.p_value + _noise(problem.np, 0), problem.dt[0])[1], dtype=float)
        for row in problem.rows:
            at = row.index if stage is problem.path else row.index_terminal
            if row.kind != "general" or at < 0 or np.any(J[at]) or np.any(other[at]):
                continue
            value = h[at, 0]
            room = min(_room(value - row.lower, row.lower), _room(row.upper - value, row.upper))
            if room <= ACTIVE:
                cone = "; a cone w**2 <= g**2 v**2 is better stated as -g v <= w and w <= g v"
                yield (
                    f"row '{row.name}': its gradient vanishes at the first plan, where it is {value:g} and its bounds "
                    f"are {row.lower:g} and {row.upper:g}, so that QPs do not see it: start where it has one, by "
                    "initial=, references of controls, or ctrl.x and ctrl.u after build()"
                    f"{cone if row.lower != row.upper else ''}"
                )


def _room(distance: float, bound: float) -> float:
    """Distance from a bound, relative to it."""
    return distance / (1 + abs(bound)) if np.isfinite(bound) else np.inf


def _function(stage: Stage, outputs: list[Expression]) -> Function:
    return ca.Function("at_first_plan", [stage.x, stage.u, stage.p, stage.dt], outputs)


def _drawn(x: Array) -> list[Array]:
    """States around x, the same at every call."""
    return [x + (1 + np.abs(x)) * _noise(len(x), k) for k in range(DRAWN)]


def _noise(size: int, seed: int) -> Array:
    return np.random.default_rng([7, seed]).uniform(-1, 1, size)
