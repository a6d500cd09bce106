"""Warnings name problems at the first plan, which has the initial states and the references of controls.

A derivative that is not finite there makes the first sample fail. A variable without a gradient does not move: a
control without influence (u^3 at 0), a row whose gradient vanishes although it is violated or active (w^2 <= v^2 at
rest), an end time of 0 that scales all derivatives.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.frontend.completion.complete import CompleteProblem
from nmpc_codegen.frontend.completion.first_plan import first_plan
from nmpc_codegen.frontend.completion.saddles import Saddles
from nmpc_codegen.frontend.problem import Array, Problem, Row, Stage
from nmpc_codegen.ir.casadi_types import Expression, Function
from nmpc_codegen.package.program import NOT_FINITE, Program, in_words, locate

Marks = NDArray[np.bool_]

#: Number of points at which a property for all states is tested.
DRAWN = 4
#: Distance from a bound, relative to it, up to which a row counts as active.
ACTIVE = 1e-9


def first_plan_warnings(problem: CompleteProblem, program: Program, second: bool) -> tuple[str, ...]:
    """Return one text for all problems at the first plan, and one for the first corner with further problems.

    Corners are those of the ranges of parameters and initial states; with ``second``, second derivatives are evaluated.
    """
    (_, declared), *corners = problem.corners
    found = tuple(_warnings(declared, program, second))
    for where, corner in corners:
        texts = _warnings(corner, program, second, given=True)
        more = [f"{text} (with {where})" for text in texts if text not in found]
        if more:
            return (*found, *more)
    return found


def _warnings(problem: CompleteProblem, program: Program, second: bool, given: bool = False) -> tuple[str, ...]:
    x, u = first_plan(problem)
    still = tuple(_end_time(problem, x, u)) or tuple(_without_influence(problem, x, u))
    return (*_not_finite(problem, program, second, x, u, given), *still, *_without_gradient(problem, x, u))


def _not_finite(problem: Problem, program: Program, second: bool, x: Array, u: Array, given: bool) -> Iterator[str]:
    """Yield operations that are not finite at the first plan.

    With ``given``, operations count whose domain depends only on parameters.
    """
    nodes = problem.N + 1
    plan = (np.tile(x, (nodes, 1)), np.tile(u, (problem.N, 1)), np.tile(problem.node_values(x, u), (nodes, 1)))
    found = [finding for finding in locate(program, *plan, second) if given or not finding.given]
    for text in in_words(found):
        yield f"{NOT_FINITE}: {text}"


def _end_time(problem: Problem, x: Array, u: Array) -> Iterator[str]:
    """Yield constant states at 0 without which no control acts, and parameters at 0 that scale all derivatives."""
    path = problem.path
    f = problem.dynamics(path.x, path.u, path.p)
    slopes = _function(path, [ca.densify(f), ca.densify(ca.jacobian(f, path.u))])
    draws = [
        (d, u + 1 + _noise(problem.nu, k), problem.p_value + _noise(problem.np, k)) for k, d in enumerate(_draw(x))
    ]

    def at(kind: str, i: int, value: float) -> tuple[Array, Array]:
        """Return the derivatives, or the steps of a map, at all draws with element i set to a value.

        The second result is the influence of the controls there.
        """
        found = []
        for states, controls, parameters in draws:
            z, p = states.copy(), parameters.copy()
            (z if kind == "state" else p)[i] = value
            values = problem.node_values(z, controls, p)
            rate, influence = (np.asarray(v, dtype=float) for v in slopes(z, controls, values, problem.dt[0]))
            found.append((rate.ravel() - (z if problem.discrete else 0), influence))
        return np.array([rate for rate, _ in found]), np.array([influence for _, influence in found])

    for kind, values, names, option in (
        ("state", x, problem.state_names, "initial"),
        ("parameter", problem.p_value, problem.parameter_names, "value"),
    ):
        for i in map(int, np.flatnonzero(values == 0)):
            (still, without), (moving, influence) = at(kind, i, 0.0), at(kind, i, 1.0)
            if kind == "state":
                scales = not np.any(moving[:, i]) and not np.any(without) and np.any(influence)
            else:
                scales = not np.any(still) and np.any(moving)
            if scales:
                yield (
                    f"{kind} '{names[i]}' is 0 at the first plan and scales the derivatives, so that no control moves "
                    f"anything: give it another value, e.g. ocp.{kind}({names[i].partition('[')[0]!r}, {option}=1.0)"
                )


def _without_influence(problem: CompleteProblem, x: Array, u: Array) -> Iterator[str]:
    """Yield controls whose first derivatives vanish at the first plan, in dynamics, cost and rows.

    They are reported if no state or control that moves gives them an influence. Controls without a weight that depend
    on others in this way are reported as well.
    """
    if problem.augmentation.idle:
        return
    (at_plan, moves), saddles = _movable(problem, x, u), problem.saddles
    still = np.flatnonzero(~moves)
    probed = still.size > 0 and any(_is_probed(problem, x, u, j, saddles) for j in saddles.controls)
    for j in (j for j in still if not (probed and j in saddles.controls)):
        yield (
            f"control '{problem.control_names[j]}' is {u[j]:g} at the first plan, where its first derivatives in "
            "dynamics, cost and rows vanish: no iteration moves it. Start where a state or parameter that scales it is "
            f"not 0, by initial= or value=, or write another value, e.g. ctrl.u[:, {j}] = 0.1, after build() and after "
            "every reset()"
        )
    curvature = sum(
        (ca.hessian(part, problem.path.u)[0] for part in _costs(problem.path)), ca.SX(problem.nu, problem.nu)
    )
    H = np.asarray(
        _function(problem.path, [ca.densify(curvature)])(x, u, problem.node_values(x, u), problem.dt[0]), dtype=float
    )
    for j in np.flatnonzero(moves & ~at_plan & ~np.any(H, axis=1)):
        name = problem.control_names[j]
        yield (
            f"control '{name}' has neither a weight nor an influence at the first plan, so that the first QP does not "
            f"determine it: give it a weight, e.g. least_squares({name}, weight=1e-2)"
        )


def _is_probed(problem: Problem, x: Array, u: Array, j: int, saddles: Saddles) -> bool:
    """Return True if a finite move of an idle control, or of it and its partner, changes a state that matters.

    A state matters if cost or rows depend on it at this point; then a probe of the sample moves the control.
    """
    path = problem.path
    f = problem.dynamics(path.x, path.u, path.p)
    at = _function(path, [ca.densify(f), ca.densify(ca.jacobian(f, path.x))])
    values = problem.node_values(x, u)
    rate, A = (np.asarray(v, dtype=float) for v in at(x, u, values, problem.dt[0]))
    changed = np.zeros(problem.nx, dtype=bool)
    partner = saddles.partners[j]
    for side, other in ((1, 0), (-1, 0), (1, 1), (1, -1)):
        moved = u.copy()
        moved[j] += side * (1 + abs(u[j]))
        if partner >= 0:
            moved[partner] += other * (1 + abs(u[partner]))
        changed |= (np.asarray(at(x, moved, values, problem.dt[0])[0], dtype=float) != rate).ravel()
    seen = _asked_for(problem, x, u)
    for _ in range(problem.nx):
        seen = seen | np.any(A[seen] != 0, axis=0)
    return bool(np.any(changed & seen))


def _asked_for(problem: Problem, x: Array, u: Array) -> Marks:
    """Return the states along which the cost changes or, if there are none, the states in residuals, costs and rows."""
    slopes, depends = np.zeros(problem.nx, dtype=bool), np.zeros(problem.nx, dtype=bool)
    for stage, control in ((problem.path, u), (problem.terminal, np.zeros(0))):
        cost = sum(_costs(stage), ca.SX(0))
        terms = ca.vertcat(cost, stage.h)
        slope = _function(stage, [ca.densify(ca.gradient(cost, stage.x))])
        values = problem.node_values(x, control)
        slopes |= np.asarray(slope(x, control, values, problem.dt[0]), dtype=float).ravel() != 0
        depends |= np.array(ca.which_depends(terms, stage.x, 1, False), dtype=bool)
    bounded = [row.index for row in problem.rows if row.kind == "state"]
    depends[bounded] = True
    return slopes if np.any(slopes) else depends


def _movable(problem: Problem, x: Array, u: Array) -> tuple[Marks, Marks]:
    """Return the controls with an influence at the first plan, and those that a move of other variables gives one.

    Parameters are drawn at random. Controls outside the dynamics count as both.
    """
    path = problem.path
    f = problem.dynamics(path.x, path.u, path.p)
    jacobians = [ca.jacobian(f, path.u), ca.jacobian(path.h, path.u)]
    slopes = ca.vertcat(ca.SX(0, problem.nu), *(ca.jacobian(part, path.u) for part in _costs(path)))
    evaluate = _function(path, [ca.densify(part) for part in (f, *jacobians, slopes)])
    moves = ~np.any(np.asarray(ca.DM(jacobians[0].sparsity(), 1)), axis=0)
    moved, at_plan = np.zeros(problem.nx, dtype=bool), np.zeros(0, dtype=bool)
    for _ in range(problem.nx + problem.nu + 1):
        seen, going = moves, moved
        for k in range(DRAWN):
            state = np.where(moved, _draw(x)[k], x)
            control = np.where(moves, u + _noise(problem.nu, k), u)
            values = problem.node_values(state, control, problem.p_value + _noise(problem.np, k))
            rate, *parts = evaluate(state, control, values, problem.dt[0])
            going = going | (np.asarray(rate, dtype=float).ravel() - (state if problem.discrete else 0) != 0)
            sizes = [np.abs(np.asarray(part, dtype=float)).reshape(-1, problem.nu) for part in parts]
            seen = seen | np.any([np.any((size > 0) | ~np.isfinite(size), axis=0) for size in sizes], axis=0)
        at_plan = at_plan if at_plan.size else seen
        if np.array_equal(seen, moves) and np.array_equal(going, moved):
            break
        moves, moved = seen, going
    return at_plan, moves


def _costs(stage: Stage) -> list[Expression]:
    """Return the scalar terms of the cost of a stage, with the declared weights and references."""
    y = stage.y - ca.DM(stage.reference)
    squares = [ca.bilin(ca.SX(ca.DM(stage.weight)), y, y) / 2] if stage.ny else []
    return [*squares, *(c for c in (stage.cost, stage.cost_rate) if c is not None)]


def _without_gradient(problem: Problem, x: Array, u: Array) -> Iterator[str]:
    """Yield general rows with gradient 0 that are violated, or active and may become violated; once per row."""
    said: set[str] = set()
    for stage, control in ((problem.path, u), (problem.terminal, np.zeros(0))):
        if not stage.nh:
            continue
        z = ca.vertcat(stage.x, stage.u)
        evaluate = _function(stage, [ca.densify(stage.h), ca.densify(ca.jacobian(stage.h, z))])
        parameters = problem.p_value, problem.p_value + _noise(problem.np, 0)
        values, others = (problem.node_values(x, control, p) for p in parameters)
        h, J = (np.asarray(v, dtype=float) for v in evaluate(x, control, values, problem.dt[0]))
        other = np.asarray(evaluate(x, control, others, problem.dt[0])[1], dtype=float)
        for row in problem.rows:
            at = row.index if stage is problem.path else row.index_terminal
            if not row.is_general or at < 0 or row.name in said or np.any(J[at]) or np.any(other[at]):
                continue
            H = _function(stage, [ca.densify(ca.hessian(stage.h[at], z)[0])])
            curvature = np.nan_to_num(np.asarray(H(x, control, values, problem.dt[0]), dtype=float))
            if _is_lost(h[at, 0], row, curvature):
                said.add(row.name)
                cone = "; a cone w**2 <= g**2 v**2 is better stated as -g v <= w and w <= g v"
                yield (
                    f"row '{row.name}': its gradient vanishes at the first plan, where it is {h[at, 0]:g} and its "
                    f"bounds are {row.lower:g} and {row.upper:g}, so that QPs do not see it: start where it has one, "
                    "by initial=, references of controls, or ctrl.x and ctrl.u after build()"
                    f"{cone if row.lower != row.upper else ''}"
                )


def _is_lost(value: float, row: Row, curvature: Array) -> bool:
    """Return True if a row with a zero gradient is violated, or is active and bends to outside its bounds."""
    below, above = _room(value - row.lower, row.lower), _room(row.upper - value, row.upper)
    if min(below, above) < -ACTIVE:
        return True
    eigenvalues = np.linalg.eigvalsh(curvature)
    return bool((below <= ACTIVE and eigenvalues.min() < 0) or (above <= ACTIVE and eigenvalues.max() > 0))


def _room(distance: float, bound: float) -> float:
    """Return the distance from a bound, relative to it."""
    return distance / (1 + abs(bound)) if np.isfinite(bound) else np.inf


def _function(stage: Stage, outputs: list[Expression]) -> Function:
    return ca.Function("at_first_plan", [stage.x, stage.u, stage.p, stage.dt], outputs)


def _draw(x: Array) -> list[Array]:
    """Return states around x, the same at every call."""
    return [x + (1 + np.abs(x)) * _noise(len(x), k) for k in range(DRAWN)]


def _noise(size: int, seed: int) -> Array:
    return np.random.default_rng([7, seed]).uniform(-1, 1, size)
