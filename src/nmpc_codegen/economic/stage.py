"""One stage of a problem at steady operation is given by CasADi functions of the states that are at rest.

    x+ = Phi(x, u),   l(x, u),   lower <= h(x, u) <= upper        V_f(x),   lower <= g(x) <= upper at node N

Phi is the discrete map of the controller, with its scheme and number of steps, and l contains the integral of the cost
rate by the same scheme. Parameters, weights, references and bounds have the values that the problem declares. Cyclic
states, which grow for ever, are left out: nothing but their own equations may depend on them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from nmpc_codegen.decisions.integrator import integrator_of
from nmpc_codegen.economic.newton_map import newton_map
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.problem import Array, Problem, Row
from nmpc_codegen.ir.casadi_types import Expression, Function
from nmpc_codegen.options import Options
from nmpc_codegen.oracle.trajectory import CLASSICAL, Tableau, interval_map, node_cost, scaled_weight

#: Values of w below this fraction of the largest one are rounding errors.
ROUNDING = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows are lower <= h(w) <= upper, with one name per row."""

    names: tuple[str, ...]
    h: Expression
    lower: Array
    upper: Array
    penalty: Array  # largest multiplier: l1 of soft rows, inf of hard rows


@dataclass(frozen=True, eq=False)
class SteadyStage:
    """Expressions in x (kept states) and u; ``kept`` holds the indices of the kept states in the problem."""

    problem: Problem
    kept: tuple[int, ...]
    x: Expression
    u: Expression
    Phi: Expression
    cost: Expression
    gauss_newton: Expression | None  # J' W J, None if the cost is no least squares
    rows: Rows
    terminal_cost: Expression
    terminal_rows: Rows
    point_terminal: bool  # x_N of every kept state is fixed by rows
    move: Expression | None  # dt f of an implicit scheme, whose map has fixed points beside those of f

    @property
    def w(self) -> Expression:
        """Return (x, u)."""
        return ca.vertcat(self.x, self.u)

    @property
    def nx(self) -> int:
        return len(self.kept)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the kept states and of the controls."""
        return (*(self.problem.state_names[i] for i in self.kept), *self.problem.control_names)

    @cached_property
    def values(self) -> Function:
        """Return the function w -> (Phi, l, h)."""
        return ca.Function("values", [self.w], [self.Phi, self.cost, self.rows.h])

    @cached_property
    def jacobians(self) -> Function:
        """Return the function w -> ([A B], dl / dw, dh / dw)."""
        gradient = ca.jacobian(self.cost, self.w)
        return ca.Function(
            "jacobians", [self.w], [ca.jacobian(self.Phi, self.w), gradient, ca.jacobian(self.rows.h, self.w)]
        )

    @cached_property
    def hessian(self) -> Function:
        """Return the function (w, lam, mu) -> d2 (l + lam' Phi + mu' h) / dw^2."""
        lam, mu = ca.SX.sym("lam", self.nx), ca.SX.sym("mu", len(self.rows.names))
        L = self.cost + ca.dot(lam, self.Phi) + ca.dot(mu, self.rows.h)
        return ca.Function("hessian", [self.w, lam, mu], [ca.hessian(L, self.w)[0]])

    def full(self, x: Array) -> Array:
        """Return the state (nx,) of the problem from the kept states; cyclic states have their initial values."""
        found = self.problem.x_initial
        found[list(self.kept)] = x
        return found


def magnitudes(stage: SteadyStage, *points: Array) -> Array:
    """Return typical sizes of w (n + nu,): the largest of given values and of finite simple bounds; 1 if all are zero.

    A row lower == upper states the value of a variable, not its range, so it is ignored. A given value that is a
    rounding error is ignored as well: x_N = x_s would measure a state in units of 1e-33.
    """
    size = np.max(np.abs(points), axis=0)
    size = np.where(size > ROUNDING * float(size.max()), size, 0.0)
    variables = (*stage.kept, *range(stage.problem.nx, stage.problem.nx + stage.problem.nu))
    for row in stage.problem.rows:
        place = row.variable(stage.problem.nx)
        if row.lower == row.upper or place not in variables:
            continue
        at = variables.index(place)
        size[at] = max(size[at], *(abs(bound) for bound in (row.lower, row.upper) if np.isfinite(bound)), 0.0)
    found: Array = np.where(size > 0, size, 1.0)
    return found


def units(stage: SteadyStage, w: Array, d: Array) -> tuple[float, Array]:
    """Return the units of the cost and of the rows in w / d.

    The unit of the cost is the larger one of its gradient and its curvature; the unit of a row is its gradient, or 1.
    """
    gradient, J = (np.asarray(part, dtype=float) * d for part in stage.jacobians(w)[1:])
    H = np.asarray(stage.hessian(w, np.zeros(stage.nx), np.zeros(len(stage.rows.names))), dtype=float) * np.outer(d, d)
    norms = np.linalg.norm(J, axis=1)
    return max(float(np.abs(gradient).max()), float(np.abs(H).max())), np.where(norms > 0, norms, 1.0)


def in_units(stage: SteadyStage, d: Array, money: float, rows: Array) -> SteadyStage:
    """Return the stage in w / d, cost / money, h / rows; multipliers are then lam d / money and mu rows / money."""
    w = ca.SX.sym("w", len(d))
    n, r = stage.nx, stage.rows
    Phi, cost, h = stage.values(w * d)
    return replace(
        stage,
        x=w[:n],
        u=w[n:],
        Phi=Phi / d[:n],
        cost=cost / money,
        rows=replace(r, h=h / rows, lower=r.lower / rows, upper=r.upper / rows, penalty=r.penalty * rows / money),
    )


def tableau(problem: Problem, options: Options | None) -> Tableau:
    """Return the scheme of the options, or the one that the compiler chooses, as plain numbers.

    A discrete map has no scheme; it gets CLASSICAL, which is not used.
    """
    chosen = integrator_of(problem, options or Options())
    scheme = getattr(chosen, "tableau", None)
    if scheme is None:
        return CLASSICAL
    A = tuple(tuple(float(a) for a in row) for row in scheme.a)
    return Tableau(A, tuple(float(b) for b in scheme.b), int(getattr(chosen, "steps", 1)))


def steady_stage(problem: Problem, options: Options | None = None, p: Array | None = None) -> SteadyStage:
    """Return the stage of the last interval, as steady operation repeats it, with declared parameters or with ``p``.

    Raises:
        ProblemError: another state or the cost depends on a cyclic state, or only cyclic states exist; or there are
            previous controls, time or discrete states.
    """
    problem.refuse_augmented("steady state")
    kept = tuple(i for i in range(problem.nx) if i not in problem.cyclic)
    if not kept:
        raise ProblemError(f"OCP '{problem.name}': all states are cyclic, so there is no steady state")
    x, u = ca.SX.sym("x", len(kept)), ca.SX.sym("u", problem.nu)
    cyclic = ca.SX.sym("cyclic", problem.nx)
    whole = ca.SX(cyclic)
    for position, i in enumerate(kept):
        whole[i] = x[position]
    p, dt = problem.p_value if p is None else p, problem.dt[-1]
    scheme = tableau(problem, options)
    of_interval = newton_map(problem, scheme) if scheme.implicit else interval_map(problem, scheme)
    Phi, integral = of_interval(whole, u, p, dt)
    W = scaled_weight(problem, problem.path.weight, problem.N - 1)
    cost = integral + node_cost(problem.path)(whole, u, p, dt, problem.path.reference, W)
    end = node_cost(problem.terminal)(whole, ca.SX(0, 1), p, 0.0, problem.terminal.reference, problem.terminal.weight)
    names = [problem.state_names[i] for i in problem.cyclic]
    if names:
        for what, value in (("the dynamics of another state", Phi[list(kept)]), ("the cost", cost), ("the cost", end)):
            if ca.sparsify(ca.jacobian(value, cyclic)).nnz():
                raise ProblemError(f"cyclic: {what} depends on {', '.join(names)}, which therefore cannot be left out")
    y = ca.Function("y", [problem.path.x, problem.path.u, problem.path.p], [problem.path.y])(whole, u, p)
    J = ca.jacobian(y, ca.vertcat(x, u))
    squares = problem.path.cost is None and problem.path.cost_rate is None
    return SteadyStage(
        problem=problem,
        kept=kept,
        x=x,
        u=u,
        Phi=Phi[list(kept)],
        cost=cost,
        gauss_newton=J.T @ W @ J if squares else None,
        rows=_steady_rows(problem, (whole, u, p), cyclic, terminal=False),
        terminal_cost=end,
        terminal_rows=_steady_rows(problem, (whole, u, p), cyclic, terminal=True),
        point_terminal=_is_point(problem, kept),
        move=dt * problem.dynamics(whole, u, p)[list(kept)] if scheme.implicit else None,
    )


def _steady_rows(
    problem: Problem, at: tuple[Expression, Expression, Array], cyclic: Expression, *, terminal: bool
) -> Rows:
    """Return the rows of all inner nodes, or those of node N, at (x, u, p), without rows on cyclic states.

    If N = 1 there is no inner node; then the rows of the only interval, and those at its end, hold at every sample.
    Equations at the end are left out: they do not belong to the steady operation, but must agree with it.
    """
    path, end, (x, u, p) = problem.path, problem.terminal, at
    h = ca.Function("h", [path.x, path.u, path.p], [path.h])(x, u, p)
    h_N = ca.Function("h", [end.x, end.p], [end.h])(x, p)
    chosen: list[tuple[Row, Expression]] = []
    for row in problem.rows:
        if row.is_coupled or not _holds(row, problem.N, terminal):
            continue
        at_end = terminal or row.index < 0
        value = row.value(x, u, h_N if at_end else h, None, at_end)
        if not ca.jacobian(value, cyclic).nnz():
            chosen.append((row, value))
    return Rows(
        names=tuple(row.name for row, _ in chosen),
        h=ca.vertcat(ca.SX(0, 1), *(value for _, value in chosen)),
        lower=np.array([row.lower for row, _ in chosen]),
        upper=np.array([row.upper for row, _ in chosen]),
        penalty=np.array([_least_penalty(row, problem.dt) for row, _ in chosen]),
    )


def _least_penalty(row: Row, dt: Sequence[float]) -> float:
    """Return the least linear penalty of a row over its nodes, infinite if the row is hard."""
    penalties = [row.penalty(k, dt) for k in row.nodes]
    return min((math.inf if penalty is None else penalty[0] for penalty in penalties), default=math.inf)


def _holds(row: Row, N: int, terminal: bool) -> bool:
    """Return True if the row is imposed at node N (``terminal``), or at all inner nodes."""
    if terminal:
        return N in row.nodes
    if N == 1:
        return 0 in row.nodes or (bool(row.nodes) and row.lower < row.upper)
    return set(range(1, N)) <= set(row.nodes)


def _is_point(problem: Problem, kept: tuple[int, ...]) -> bool:
    fixed = {row.variable(problem.nx) for row in problem.rows if problem.N in row.nodes and row.is_equation}
    return set(kept) <= fixed
