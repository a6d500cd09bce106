"""A trajectory is evaluated with the data of every node: cost, rows, KKT residuals.

CasADi Functions of single nodes and NumPy sums are used, independently of the code generator and of IPOPT. The
Runge-Kutta method is implemented here, for a tableau of plain arrays, and residuals come from stage Jacobians.

    L = sum l_k + lam_0'(xhat - x_0) + lam_{k+1}'(Phi_k - x_{k+1}) + mu_k'h_k + mu_N'h_N + mu_x'x + mu_u'u + eta'r

Multipliers of bounded quantities are positive at the upper bound and negative at the lower one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.problem import Array, Problem, Row, Stage


@dataclass(frozen=True, eq=False)
class Tableau:
    """A tableau is a Runge-Kutta scheme: A (s, s), b (s,), ``steps`` equal steps per interval.

    The scheme is explicit if A is strictly lower triangular.
    """

    A: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    steps: int = 1

    @property
    def implicit(self) -> bool:
        """Return True if some stage depends on itself or a later one."""
        return bool(np.any(np.triu(np.asarray(self.A, dtype=float))))


#: The controls of node N.
NONE: Array = np.zeros(0)

CLASSICAL = Tableau(((0, 0, 0, 0), (0.5, 0, 0, 0), (0, 0.5, 0, 0), (0, 0, 1, 0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6), 2)


@dataclass(frozen=True, eq=False)
class Data:
    """All data that may change at run time, given for every node."""

    x0: Array  # (nx,)
    p: Array  # (N+1, np)
    yref: Array  # (N, ny)
    yref_N: Array  # (ny_N,)
    W: Array  # (N, ny, ny), not yet scaled by dt
    W_N: Array  # (ny_N, ny_N)
    lower: Array  # (N+1, rows); a coupled row uses entry 0
    upper: Array


@dataclass(frozen=True, eq=False)
class Point:
    """A point has primal and dual variables; x (N+1, nx), u (N, nu)."""

    x: Array
    u: Array
    lam: Array  # (N+1, nx)
    mu_x: Array  # (N+1, nx)
    mu_u: Array  # (N, nu)
    mu: Array  # (N, nh)
    mu_N: Array  # (nh_N,)
    eta: Array  # (nr,)


@dataclass(frozen=True)
class Residuals:
    """The KKT residuals are given in the maximum norm."""

    stationarity: float
    equality: float
    inequality: float
    complementarity: float

    @property
    def worst(self) -> float:
        """Return the largest of the four residuals; NaN if one of them is NaN."""
        return float(np.max([self.stationarity, self.equality, self.inequality, self.complementarity]))


def node_data(
    problem: Problem,
    *,
    x0: Any = None,
    p: Any = None,
    yref: Any = None,
    yref_N: Any = None,
    W: Any = None,
    W_N: Any = None,
    bounds: Mapping[str, tuple[Any, Any]] | None = None,
) -> Data:
    """Return the data of every node; data that are not given have the values that the problem declares.

    Args:
        problem: the problem.
        x0: (nx,), states of the user, or including the added ones; entries of accumulators are ignored.
        p: (np,) or (N+1, np), or {name: value}.
        yref: (ny,) or (N, ny).
        yref_N: (ny_N,).
        W: (ny,) diagonal, (ny, ny), or (N, ny, ny).
        W_N: (ny_N,) diagonal or (ny_N, ny_N).
        bounds: {row name: (lower, upper)}, each a number or (N+1,).

    Raises:
        ProblemError: a shape does not fit, or a name is unknown.
    """
    N, path, end = problem.N, problem.path, problem.terminal
    x = _initial(problem, x0)
    x[list(problem.accumulators)] = 0.0
    lower = np.tile([r.lower for r in problem.rows], (N + 1, 1)).reshape(N + 1, -1)
    upper = np.tile([r.upper for r in problem.rows], (N + 1, 1)).reshape(N + 1, -1)
    names = [r.name for r in problem.rows]
    for name, (low, high) in (bounds or {}).items():
        if name not in names:
            raise ProblemError(f"bounds: no row is named '{name}'; rows are: {', '.join(names)}")
        lower[:, names.index(name)] = low
        upper[:, names.index(name)] = high
    return Data(
        x0=x,
        p=_with_node_data(problem, p),
        yref=shape_of("yref", path.reference if yref is None else yref, (N, path.ny)),
        yref_N=shape_of("yref_N", end.reference if yref_N is None else yref_N, (end.ny,)),
        W=shape_of("W", _square(path.weight if W is None else W), (N, path.ny, path.ny)),
        W_N=shape_of("W_N", _square(end.weight if W_N is None else W_N), (end.ny, end.ny)),
        lower=lower,
        upper=upper,
    )


def _with_node_data(problem: Problem, p: Any) -> Array:
    """Return p (N+1, np) with the added parameters."""
    N, more = problem.N, problem.augmentation.data
    if not more:
        return shape_of("p", _parameters(problem, p), (N + 1, problem.np))
    given = np.asarray(_parameters(problem, p), dtype=float)
    own = given[..., : problem.np - more]
    return np.hstack([shape_of("p", own, (N + 1, problem.np - more)), problem.node_data])


def _initial(problem: Problem, x0: Any) -> Array:
    """Return x_0 with the added states, which have their initial values if they are not given."""
    given = np.asarray(problem.x_initial if x0 is None else x0, dtype=float)
    if given.shape == (problem.nx,) or not problem.augmentation.count:
        return shape_of("x0", given, (problem.nx,))
    return np.concatenate([shape_of("x0", given, (problem.measured,)), problem.x_initial[problem.measured :]])


def shape_of(what: str, value: Any, shape: tuple[int, ...]) -> Array:
    try:
        return np.array(np.broadcast_to(np.asarray(value, dtype=float), shape))
    except ValueError as error:
        raise ProblemError(f"{what} has shape {np.shape(value)}, expected {shape} or one row of it") from error


def _square(W: Any) -> Array:
    W = np.asarray(W, dtype=float)
    return np.diag(W) if W.ndim == 1 else W


def _parameters(problem: Problem, p: Any) -> Any:
    if not isinstance(p, Mapping):
        return problem.p_value if p is None else p
    values = problem.p_value
    for name, value in p.items():
        found = [s for s in problem.parameters if s.name == name]
        if not found:
            raise ProblemError(f"p: no parameter is named '{name}'")
        values[found[0].offset : found[0].offset + found[0].size] = value
    return values


# Functions of one interval or node ------------------------------------------------------------------------------------


def interval_map(problem: Problem, integrator: Tableau = CLASSICAL) -> Any:
    """Return the function (x, u, p, dt) -> (Phi, q): state at the end of an interval, integral of the cost rate.

    X_i = x + h sum_j a_ij K_j, K_i = f(X_i, u, p), x+ = x + h sum_i b_i K_i, h = dt / steps.
    """
    if integrator.implicit and not problem.discrete:
        return _implicit_map(problem, integrator)
    s = problem.path
    if problem.discrete:
        end = problem.dynamics(s.x, s.u, s.p)
        return ca.Function("Phi", [s.x, s.u, s.p, s.dt], [end, ca.SX(1, 1)])
    rate = ca.SX(0) if s.cost_rate is None else s.cost_rate
    quadrature = ca.Function("rate", [s.x, s.u, s.p], [rate])
    A, b = np.asarray(integrator.A, dtype=float), np.asarray(integrator.b, dtype=float)
    h = s.dt / integrator.steps
    x, q = s.x, ca.SX(0)
    for _ in range(integrator.steps):
        K: list[Any] = []
        L: list[Any] = []
        for i in range(len(b)):
            X = x
            for j in range(i):
                X = X + h * A[i, j] * K[j]
            K.append(problem.dynamics(X, s.u, s.p))
            L.append(quadrature(X, s.u, s.p))
        for i in range(len(b)):
            x, q = x + h * b[i] * K[i], q + h * b[i] * L[i]
    return ca.Function("Phi", [s.x, s.u, s.p, s.dt], [with_maps(problem, x, s.x, s.u, s.p, s.dt), q])


def with_maps(problem: Problem, end: Any, x: Any, u: Any, p: Any, dt: Any) -> Any:
    """Return the end of an interval with the next values of discrete states, and with noise."""
    added = {i: u[j] for i, j in problem.noise}
    end = ca.vertcat(*(end[i] + added.get(i, 0) for i in range(problem.nx)))
    if problem.jump is None:
        return end
    zeros = ca.DM.zeros(problem.np + problem.solved - p.numel())
    maps = problem.jump(x, u, ca.vertcat(p, zeros), dt)
    parts = {i: maps[n] for n, i in enumerate(problem.maps)}
    return ca.vertcat(*(parts.get(i, end[i]) for i in range(problem.nx)))


def stage_equations(problem: Problem, integrator: Tableau) -> Any:
    """Return the function (v, x, u, p, h) -> (rest, x_next, q) of one step of an implicit scheme.

    v contains the increments D_i = h K_i of all stages, and then their algebraic variables z_i. rest is D_i - h f(X_i,
    z_i, u, p) = 0 and g(X_i, z_i, u, p) = 0 with X_i = x + sum_j a_ij D_j; x_next = x + sum_i b_i D_i, q = h sum_i b_i
    rate(X_i, z_i, u, p).
    """
    s, n, m = problem.path, problem.nx, len(problem.newton_names)
    A, b = np.asarray(integrator.A, dtype=float), np.asarray(integrator.b, dtype=float)
    D, Z, h = ca.SX.sym("D", n * len(b)), ca.SX.sym("Z", m * len(b)), ca.SX.sym("h")
    p = ca.SX.sym("p", problem.np)
    parts, z = ca.vertsplit(D, n), [Z[m * i : m * (i + 1)] for i in range(len(b))]
    rate = ca.Function("rate", [s.x, s.u, s.p], [ca.SX(0) if s.cost_rate is None else s.cost_rate])
    rest: list[Any] = []
    equations: list[Any] = []
    q: Any = ca.SX(0)
    for i in range(len(b)):
        X, data = s.x + sum(A[i, j] * part for j, part in enumerate(parts)), node_values(p, z[i])
        rest.append(parts[i] - h * problem.dynamics(X, s.u, data))
        equations += [problem.algebra.equations(X, s.u, p, z[i])] if problem.algebra and m else []
        q = q + h * b[i] * rate(X, s.u, data)
    end = s.x + sum(b[i] * part for i, part in enumerate(parts))
    return ca.Function("stages", [ca.vertcat(D, Z), s.x, s.u, p, h], [ca.vertcat(*rest, *equations), end, q])


def node_values(p: Any, z: Any) -> Any:
    """Return the values that expressions use for p if z is a separate variable: z, and no derivative of z."""
    return ca.vertcat(p, z, ca.DM.zeros(z.numel() ** 2)) if z.numel() else p


#: Options of CasADi's Newton method, which iterates until its steps are rounding errors.
_ROOTFINDER = {"abstol": 0.0, "abstolStep": 1e-14, "max_iter": 30, "error_on_fail": False}


def _implicit_map(problem: Problem, integrator: Tableau) -> Any:
    """Return the map of an interval whose stages a rootfinder of CasADi solves.

    CasADi computes its derivatives by the implicit function theorem.
    """
    equations = stage_equations(problem, integrator)
    solver = ca.rootfinder("increments", "newton", equations, _ROOTFINDER)
    x, u = ca.MX.sym("x", problem.nx), ca.MX.sym("u", problem.nu)
    p, dt = ca.MX.sym("p", problem.np), ca.MX.sym("dt")
    end, q = x, ca.MX(0)
    h = dt / integrator.steps
    start = stage_start(problem, integrator)
    for _ in range(integrator.steps):
        _, end, more = solver(start, end, u, p, h)
        q = q + more
    return ca.Function("Phi", [x, u, p, dt], [with_maps(problem, end, x, u, p, dt), q])


def stage_start(problem: Problem, integrator: Tableau) -> Array:
    """Return the start for the equations of a step: no increments, algebraic variables of the first plan."""
    stages = len(integrator.b)
    known = problem.algebra.first if problem.algebra else np.zeros(0)
    return np.concatenate([np.zeros(problem.nx * stages), np.tile(known, stages)])


def node_cost(stage: Stage) -> Any:
    """Return the function (x, u, p, dt, yref, W) -> 1/2 |y - yref|^2_W + general cost at the node."""
    yref, W = ca.SX.sym("yref", stage.ny), ca.SX.sym("W", stage.ny, stage.ny)
    r = stage.y - yref
    cost = ca.SX(0) if stage.cost is None else stage.cost
    if stage.ny:
        cost = cost + ca.dot(r, W @ r) / 2
    if stage.ties is not None:
        cost = cost + ca.sumsqr(stage.ties) / 2
    return ca.Function("l", [stage.x, stage.u, stage.p, stage.dt, yref, W], [cost])


def start_cost(problem: Problem) -> Any:
    """Return the function (x, p) -> additional cost at node 0, with declared weight and reference."""
    stage = problem.start
    p = ca.SX.sym("p", problem.np)
    values = node_values(p, ca.SX.zeros(len(problem.newton_names)))
    l = node_cost(stage)(stage.x, stage.u, values, 0.0, stage.reference, stage.weight)  # noqa: E741
    return ca.Function("l_0", [stage.x, p], [l])


def node_rows(stage: Stage) -> Any:
    return ca.Function("h", [stage.x, stage.u, stage.p], [stage.h])


def scaled_weight(problem: Problem, W: Array, k: int) -> Array:
    """Return W with the rows of scale_with_dt multiplied by dt_k; a mixed entry gets the geometric mean."""
    s = np.where(np.array(problem.path.scale_with_dt, dtype=bool), problem.dt[k], 1.0)
    return np.asarray(W * np.where(s[:, None] == s[None, :], s[:, None], np.sqrt(s[:, None] * s[None, :])))


def evaluate_cost(problem: Problem, x: Any, u: Any, data: Data, integrator: Tableau = CLASSICAL) -> float:
    """Return the cost of a trajectory x (N+1, nx), u (N, nu), with the penalties of violated soft rows."""
    Phi, cost, cost_N = interval_map(problem, integrator), node_cost(problem.path), node_cost(problem.terminal)
    x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)
    at_end = problem.node_values(x[-1], NONE, data.p[-1])
    total = float(cost_N(x[-1], ca.DM(0, 1), at_end, 0.0, data.yref_N, data.W_N))
    total += float(start_cost(problem)(x[0], data.p[0]))
    for k in range(problem.N):
        total += float(Phi(x[k], u[k], data.p[k], problem.dt[k])[1])
        W = scaled_weight(problem, data.W[k], k)
        values = problem.node_values(x[k], u[k], data.p[k])
        total += float(cost(x[k], u[k], values, problem.dt[k], data.yref[k], W))
    value = _row_values(problem, data)
    for i, row in enumerate(problem.rows):
        for k in row_nodes(row):
            soft, v = row.penalty(k, problem.dt), value(row, k, x, u)
            if soft is None:
                continue
            for s in (max(0.0, v - data.upper[k, i]), max(0.0, data.lower[k, i] - v)):
                total += soft[0] * s + soft[1] * s * s / 2
    return total


def row_nodes(row: Row) -> tuple[int, ...]:
    """Return the nodes at which a row occurs in the nonlinear program; a coupled row occurs once, as node 0."""
    return (0,) if row.is_coupled else row.nodes


def _row_values(problem: Problem, data: Data) -> Callable[[Row, int, Array, Array], float]:
    """Return a function (row, k, x, u) -> value of the row."""
    h, h_N, N = node_rows(problem.path), node_rows(problem.terminal), problem.N

    def at_end(x: Array, k: int) -> Any:
        return h_N(x, ca.DM(0, 1), problem.node_values(x, NONE, data.p[k]))

    def value(row: Row, k: int, x: Array, u: Array) -> float:
        if row.is_coupled and problem.coupled is not None:
            return float(problem.coupled(x[0], x[N])[row.index])
        if k == N:
            return float(row.value(x[N], None, at_end(x[N], k), None, at_end=True))
        return float(row.value(x[k], u[k], h(x[k], u[k], problem.node_values(x[k], u[k], data.p[k])), None))

    return value


def multiplier_of(problem: Problem, point: Point, row: Row, k: int) -> tuple[Array, tuple[int, ...]]:
    """Return the array that holds the multiplier of a row at node k, and its index there."""
    at_end = k == problem.N
    array = row.of_kind(point.mu_x, point.mu_u, point.mu_N if at_end else point.mu, point.eta)
    return array, (row.place(at_end),) if array.ndim == 1 else (k, row.place(at_end))


# Optimality -----------------------------------------------------------------------------------------------


def kkt_residuals(problem: Problem, point: Point, data: Data, integrator: Tableau = CLASSICAL) -> Residuals:
    """Return the KKT residuals of a point, computed stage by stage without IPOPT.

    stationarity: gradients of L in x_k, u_k (and lam_0 of free components of x_0, which must vanish);
    equality: gaps, x_0 - xhat included; inequality: violation of hard rows, equalities included;
    complementarity: multiplier times distance to the bound of its sign; for soft rows also the slack's conditions.
    """
    N = problem.N
    x, u = point.x, point.u
    (Phi, Phi_z), *others = _jacobians(problem, integrator)
    cost_z, h_z, cost_N, h_N, cost_0, coupled_z = (jacobian for _, jacobian in others)
    grad_x = np.array(point.mu_x, dtype=float) - point.lam
    grad_u = np.array(point.mu_u, dtype=float)
    given = [i for i in range(problem.nx) if i not in problem.free_initial]
    gaps = [(data.x0 - x[0])[given]]
    for k in range(N):
        end, _ = Phi(x[k], u[k], data.p[k], problem.dt[k])
        gaps.append(end.full().ravel() - x[k + 1])
        AB, q = (J.full() for J in Phi_z(x[k], u[k], data.p[k], problem.dt[k]))
        W = scaled_weight(problem, data.W[k], k)
        values = problem.node_values(x[k], u[k], data.p[k])
        cost_gradient = cost_z(x[k], u[k], values, problem.dt[k], data.yref[k], W).full()
        CD = h_z(x[k], u[k], values).full()
        grad = AB.T @ point.lam[k + 1] + (q + cost_gradient).ravel() + CD.T @ point.mu[k]
        grad_x[k] += grad[: problem.nx]
        grad_u[k] += grad[problem.nx :]
    empty = ca.DM(0, 1)
    start, values = problem.start, problem.node_values(x[N], NONE, data.p[N])
    first = problem.node_values(x[0], NONE, data.p[0])
    grad_x[0] += cost_0(x[0], empty, first, 0.0, start.reference, start.weight).full().ravel()
    grad_x[N] += cost_N(x[N], empty, values, 0.0, data.yref_N, data.W_N).full().ravel()
    grad_x[N] += h_N(x[N], empty, values).full().T @ point.mu_N
    if problem.coupled is not None:
        E = coupled_z(x[0], x[N]).full().T @ point.eta
        grad_x[0] += E[: problem.nx]
        grad_x[N] += E[problem.nx :]
    violation, slackness = _row_residuals(problem, point, data)
    free = point.lam[0, list(problem.free_initial)]
    return Residuals(
        stationarity=_norm(np.concatenate([grad_x.ravel(), grad_u.ravel(), free])),
        equality=_norm(np.concatenate(gaps)),
        inequality=violation,
        complementarity=slackness,
    )


def _norm(values: Array) -> float:
    """Return the maximum norm; NaN stays NaN."""
    return float(np.abs(values).max(initial=0.0))


@lru_cache(maxsize=8)
def _jacobians(problem: Problem, integrator: Tableau) -> tuple[tuple[Any, Any], ...]:
    """Return (value, Jacobian) of interval map, cost and rows of path and terminal stage, start cost, coupled rows."""
    nodes = [f(stage) for stage in (problem.path, problem.terminal) for f in (node_cost, node_rows)]
    nodes.append(node_cost(problem.start))
    coupled = (None, None) if problem.coupled is None else _with_jacobian(problem.coupled)
    return (_with_jacobian(interval_map(problem, integrator)), *map(_with_jacobian, nodes), coupled)


def _with_jacobian(f: Any) -> tuple[Any, Any]:
    """Return a function, and the function of the Jacobians of its outputs in its first two inputs."""
    kind = ca.SX if f.is_a("SXFunction") else ca.MX
    inputs: list[Any] = [kind.sym(f.name_in(i), f.sparsity_in(i)) for i in range(f.n_in())]
    outputs: Any = f.call(inputs)
    z = ca.vertcat(inputs[0], inputs[1])
    return f, ca.Function("with_jacobian", inputs, [ca.jacobian(o, z) for o in outputs])


def _row_residuals(problem: Problem, point: Point, data: Data) -> tuple[float, float]:
    """Return the violation of hard rows, and the complementarity of all rows."""
    value = _row_values(problem, data)
    violation, slackness = [0.0], [0.0]
    for i, row in enumerate(problem.rows):
        for k in row_nodes(row):
            v = value(row, k, point.x, point.u)
            where, index = multiplier_of(problem, point, row, k)
            mu = float(where[index])
            low, high = float(data.lower[k, i]), float(data.upper[k, i])
            soft = row.penalty(k, problem.dt)
            for excess, m in ((v - high, max(mu, 0.0)), (low - v, max(-mu, 0.0))):
                if soft is None:
                    violation.append(excess)
                    slackness.append(_product(m, excess))
                else:
                    slackness.append(_soft_product(m, excess, *soft))
    return float(np.max(violation)), float(np.max(slackness))


def _product(m: float, distance: float) -> float:
    """Return |m distance|; for an infinite bound, the multiplier itself."""
    if m == 0.0:
        return 0.0
    return m if np.isinf(distance) else abs(m * distance)


def _soft_product(m: float, excess: float, l1: float, l2: float) -> float:
    """Return the residual of min_s l1 s + l2/2 s^2, s >= max(0, excess), at s = max(0, excess).

    m is the multiplier of excess <= s, and nu = l1 + l2 s - m >= 0 that of s >= 0: nu s = 0 and m (excess - s) = 0.
    """
    s = max(0.0, excess)
    nu = l1 + l2 * s - m
    return float(np.max([abs(nu * s), max(0.0, -nu), _product(m, excess - s)]))
