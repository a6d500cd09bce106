"""A Hessian that was computed at a steady state depends on the bounds that are active there, and on parameters.

This module also decides whether equations fix the terminal state.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Array, Problem, Row, Stage

#: Distance from a bound, relative to 1 + |bound|, up to which a row is active at the steady state.
ACTIVE = 1e-6


def limits(problem: Problem, steady_state: tuple[ArrayLike, ArrayLike] | None) -> Array:
    """Return limits of the least and largest lower and upper bound of every row that keep the steady state, (4, nr).

    A bound that is active at the steady state must keep its declared value; any other bound must admit the steady
    state. Without a steady state, all bounds must keep their values. Bounds of cyclic states are free, because these
    have no steady value.

    Raises:
        OptionError: the steady state violates a row.
    """
    found = np.zeros((4, len(problem.rows)))
    values = None if steady_state is None else _row_values(problem, *steady_state)
    for i, row in enumerate(problem.rows):
        if _grows(problem, row):
            found[:, i] = -np.inf, np.inf, -np.inf, np.inf
        elif values is None:
            found[:, i] = row.lower, row.lower, row.upper, row.upper
        else:
            found[:, i] = _limits(row, float(values[i]))
    return found


def _limits(row: Row, value: float) -> tuple[float, float, float, float]:
    if not row.lower - _margin(row.lower) <= value <= row.upper + _margin(row.upper):
        raise OptionError(
            f"EconomicGaussNewton.steady_state: row {row.name!r} has the value {value:.9g} there; "
            f"expected {row.lower:.9g} .. {row.upper:.9g}"
        )
    at_lower, at_upper = value <= row.lower + _margin(row.lower), value >= row.upper - _margin(row.upper)
    lower = (row.lower, row.lower) if at_lower else (-np.inf, value)
    upper = (row.upper, row.upper) if at_upper else (value, np.inf)
    return *lower, *upper


def _margin(bound: float) -> float:
    return ACTIVE * (1.0 + abs(bound)) if np.isfinite(bound) else 0.0


def _row_values(problem: Problem, x_s: ArrayLike, u_s: ArrayLike) -> Array:
    """Return the value of every row if all nodes are at the steady state."""
    x, u = np.asarray(x_s, dtype=float), np.asarray(u_s, dtype=float)
    path, terminal = problem.path, problem.terminal
    p = problem.p_value
    h = _evaluate([path.x, path.u, path.p], path.h, [x, u, p])
    h_N = _evaluate([terminal.x, terminal.p], terminal.h, [x, p])
    r = np.zeros(0) if problem.coupled is None else np.asarray(problem.coupled(x, x), dtype=float).ravel()
    ends = ((row, row.is_general and row.index < 0) for row in problem.rows)
    return np.array([float(row.value(x, u, h_N if end else h, r, end)) for row, end in ends])


def _evaluate(symbols: list[ca.SX], expression: ca.SX, values: list[Array]) -> Array:
    return np.asarray(ca.Function("rows", symbols, [ca.densify(expression)])(*values), dtype=float).ravel()


def _grows(problem: Problem, row: Row) -> bool:
    """Return True if the value of the row depends on a cyclic state."""
    cyclic = list(problem.cyclic)
    if not row.is_general:
        return row.variable(problem.nx) in cyclic
    stages = ((problem.path, row.index), (problem.terminal, row.index_terminal))
    return any(ca.jacobian(stage.h[i], stage.x)[0, cyclic].nnz() > 0 for stage, i in stages if 0 <= i < stage.nh)


def tied_parameters(problem: Problem) -> tuple[bool, ...]:
    """Return for every element of p True if dynamics, rows or second derivatives of the cost depend on it, (np,).

    Other parameters only enter the gradient, as references do.
    """
    path, terminal = problem.path, problem.terminal
    z = ca.vertcat(path.x, path.u)
    r = [problem.dynamics(path.x, path.u, path.p), path.h, *(_curvature(cost, z) for cost in _costs(path))]
    r_N = [terminal.h, *(_curvature(cost, terminal.x) for cost in _costs(terminal))]
    depends = np.zeros(problem.np, dtype=bool)
    for p, expressions in ((path.p, r), (terminal.p, r_N)):
        for expression in expressions:
            if problem.np and expression.numel():
                depends |= np.array(ca.which_depends(ca.vec(ca.densify(expression)), p, 1, False), dtype=bool)
    return tuple(map(bool, depends))


def _costs(stage: Stage) -> list[ca.SX]:
    """Return the terms of the cost with second derivatives; the reference of least squares is 0."""
    least_squares = [ca.bilin(ca.SX(stage.weight), stage.y, stage.y) / 2] if stage.ny else []
    return [*least_squares, *(term for term in (stage.cost, stage.cost_rate) if term is not None)]


def _curvature(cost: ca.SX, z: ca.SX) -> ca.SX:
    return ca.hessian(cost, z)[0]


def terminal_state_is_fixed(problem: Problem) -> bool:
    """Return True if hard equations at the end fix all states except cyclic ones.

    The equations are linearised at the initial state.
    """
    stage = problem.terminal
    J = ca.Function("J", [stage.x, stage.p], [ca.densify(ca.jacobian(stage.h, stage.x))]) if stage.nh else None
    slopes = np.zeros((0, problem.nx)) if J is None else np.asarray(J(problem.x_initial, problem.p_value), dtype=float)
    gradients = []
    for row in problem.rows:
        if not row.is_equation or problem.N not in row.nodes:
            continue
        if not row.is_coupled:
            gradients.append(row.value(np.eye(problem.nx), None, slopes, None, at_end=True))
    others = [i for i in range(problem.nx) if i not in problem.cyclic]
    return bool(np.linalg.matrix_rank(np.reshape(gradients, (-1, problem.nx))[:, others]) == len(others))
