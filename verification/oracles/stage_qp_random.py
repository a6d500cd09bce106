"""Random stage QPs are built backwards: first the KKT point, then data that satisfy its optimality conditions.

    b_k = dx_{k+1} - S_k z_k,   g_k = -(Q_k z_k + S_k' lam_{k+1} - (lam_k, 0) + rows' mult),   bounds around the values

Every kind of a shape is drawn from a seed; infeasible QPs have a combination of bounds that proves infeasibility.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from verification.oracles.stage_qp import Array, Point, Rows, Shape, StageQP, cost_gradient, row_values, rows_of

#: Kinds with one minimiser, in the order of shrinking.
KINDS = (
    "plain", "none_active", "all_active", "equalities", "degenerate", "redundant", "singular_weights", "reduced",
    "scaled",
)  # fmt: skip
SEMIDEFINITE, INFEASIBLE = "semidefinite", "infeasible"

FREE, LOWER, UPPER, EQUAL, UNDER, OVER = 0, -1, 1, 2, -2, 3


def random_qp(
    shape: Shape, kind: str, seed: int, radius: float = 1.05, active: float = 0.5, digits: int | None = None
) -> StageQP:
    """Return a stage QP of a kind.

    Args:
        shape: dimensions.
        kind: one of kinds_of(shape).
        seed: any number >= 0.
        radius: spectral radius of A up to which it is drawn.
        active: share of bounds and rows that are candidates for active ones.
        digits: decimals of the numbers drawn (None: all), for readable counterexamples.
    """
    draw = _Draw(np.random.default_rng([seed, sum(map(ord, kind))]), digits)
    qp = _stages(draw, shape, kind, radius)
    share = {"none_active": 0.0, "all_active": 1.0, "equalities": max(active, 0.5)}.get(kind, active)
    if kind == INFEASIBLE:
        qp = _contradiction(draw, _around_point(draw, qp, kind, share))
    else:
        qp = _around_point(draw, qp, kind, share)
    if kind == "scaled":
        qp = _in_units(draw, qp)
    return dataclasses.replace(qp, kind=kind, seed=seed)


def kinds_of(shape: Shape) -> tuple[str, ...]:
    """Return the kinds that a shape has; infeasible ones need bounds on all controls, x_0 given and a hard row."""
    hard = np.any(np.isinf(rows_of(shape).l1))
    possible = hard and shape.bounded == shape.nu and not shape.free
    return (*KINDS, SEMIDEFINITE, *((INFEASIBLE,) if possible else ()))


@dataclasses.dataclass(frozen=True, eq=False)
class _Draw:
    """Random numbers are rounded to ``digits`` decimals."""

    rng: np.random.Generator
    digits: int | None

    def rounded(self, a: Array) -> Array:
        return a if self.digits is None else np.round(a, self.digits)

    def normal(self, *size: int) -> Array:
        return self.rounded(self.rng.normal(size=size))

    def positive(self, *size: int) -> Array:
        """Draw exponential numbers of at least 0.1."""
        return self.rounded(self.rng.exponential(size=size) + 0.1)

    def rotation(self, n: int) -> Array:
        Q, R = np.linalg.qr(self.rng.normal(size=(n, n)))
        return Q * np.sign(np.diag(R))


# Matrices -------------------------------------------------------------------------------------------------------------


def _stages(draw: _Draw, shape: Shape, kind: str, radius: float) -> StageQP:
    """Draw dynamics, Hessian and gradients of the rows; all data that depend on the point are still zero."""
    nx, nu, N = shape.nx, shape.nu, shape.N
    nz, rows = nx + nu, rows_of(shape)
    S = _dynamics(draw, shape, kind, radius)
    Q, Q_N = _hessian(draw, shape, kind)
    if kind == "reduced":
        Q, Q_N = _indefinite(draw, S, Q, Q_N)
    C, C0 = draw.normal(len(rows), nz), draw.normal(len(rows), nx)
    C0[rows.kind != 2] = 0.0
    C[rows.node == N, nx:] = 0.0
    C[(rows.kind == 1) & (rows.index >= shape.path), nx:] = 0.0
    if kind == "redundant":
        _repeat(draw, shape, rows, C)
    state = rows.kind == 0
    C[state] = np.eye(nz)[rows.index[state]]
    if kind == SEMIDEFINITE and shape.nu > 1:
        _idle_controls(draw, shape, S, Q, C, rows)
    zero = np.zeros
    return StageQP(
        shape=shape, rows=rows, S=S, b=zero((N, nx)), Q=Q, Q_N=Q_N, g=zero((N, nz)), g_N=zero(nx), C=C, C0=C0,
        c=zero(len(rows)), lower=zero(len(rows)), upper=zero(len(rows)), lower_u=zero((N, nu)), upper_u=zero((N, nu)),
        x=zero((N + 1, nx)), u=zero((N, nu)), dx0=zero(nx), optimum=None, proof=None,
        unit_x=np.ones(nx), unit_u=np.ones(nu), unique=kind != SEMIDEFINITE, growth=radius,
    )  # fmt: skip


def _dynamics(draw: _Draw, shape: Shape, kind: str, radius: float) -> Array:
    """Draw S_k = [T_{k+1}' A T_k c_k, B_k], T orthogonal: A_k varies, yet products grow as powers of one matrix."""
    nx, nu, N, rng = shape.nx, shape.nu, shape.N, draw.rng
    A = rng.normal(size=(nx, nx))
    if rng.random() < 0.3:
        A[rng.integers(nx)] = 0.0  # a singular transition
    largest = np.max(np.abs(np.linalg.eigvals(A)))
    A *= rng.uniform(0.3, radius) / max(largest, 1e-3)
    T = [draw.rotation(nx) for _ in range(N + 1)]
    S = np.empty((N, nx, nx + nu))
    for k in range(N):
        S[k, :, :nx] = rng.uniform(0.8, 1.0) * T[k + 1].T @ A @ T[k]
        S[k, :, nx:] = rng.normal(size=(nx, nu)) / np.sqrt(max(1, nx // 3))
        if nu > 1 and rng.random() < 0.1:
            S[k, :, nx + rng.integers(nu)] = 0.0  # a control without effect on the states
    return draw.rounded(S)


def _hessian(draw: _Draw, shape: Shape, kind: str) -> tuple[Array, Array]:
    """Draw Q_k = F F' + I/4 on the controls, of any rank; Q_N may be zero."""
    nx, nu, N, rng = shape.nx, shape.nu, shape.N, draw.rng
    nz = nx + nu
    low = kind in ("singular_weights", SEMIDEFINITE)
    rank = int(rng.integers(0, max(1, nx // 2) + 1)) if low else nz
    F = draw.normal(N, nz, rank) if rank else np.zeros((N, nz, 1))
    F_N = draw.normal(nx, max(1, rank if low else nx)) * (0.0 if low and rng.random() < 0.5 else 1.0)
    if low:
        F[rng.random(N) < 0.3] = 0.0
    Q = F @ F.transpose(0, 2, 1) / max(1, rank)
    Q[:, nx:, nx:] += 0.25 * np.eye(nu)
    if kind != SEMIDEFINITE:
        Q[0, : shape.free, : shape.free] += 0.25 * np.eye(shape.free)
    return Q, F_N @ F_N.T / F_N.shape[1]


def _idle_controls(draw: _Draw, shape: Shape, S: Array, Q: Array, C: Array, rows: Rows) -> None:
    """Give the last control at some nodes neither effect nor cost, or effect and cost of the first one."""
    nx, last = shape.nx, shape.nx + shape.nu - 1
    for k in np.flatnonzero(draw.rng.random(shape.N) < 0.3):
        twin = draw.rng.random() < 0.5
        here = rows.node == k
        S[k, :, last] = S[k, :, nx] if twin else 0.0
        C[here, last] = C[here, nx] if twin else 0.0
        Q[k, last, :] = Q[k, nx, :] if twin else 0.0
        Q[k, :, last] = Q[k, :, nx] if twin else 0.0


def _indefinite(draw: _Draw, S: Array, Q: Array, Q_N: Array) -> tuple[Array, Array]:
    """Draw indefinite blocks with the same Hessian on the null space of the dynamics.

    The terms 1/2 x_{k+1}'P_{k+1} x_{k+1} - 1/2 x_k'P_k x_k of all intervals and -1/2 x_N'P_N x_N add up to a constant.
    """
    N, nx = S.shape[:2]
    P = draw.normal(N + 1, nx, nx)
    P = P + P.transpose(0, 2, 1)
    P[0] = 0.0
    Q = Q + S.transpose(0, 2, 1) @ P[1:] @ S
    Q[:, :nx, :nx] -= P[:-1]
    return (Q + Q.transpose(0, 2, 1)) / 2, Q_N - P[-1]


def _repeat(draw: _Draw, shape: Shape, rows: Rows, C: Array) -> None:
    """Replace general rows by multiples of others of their node, single states and controls, or zero."""
    rng, nx, nz = draw.rng, shape.nx, shape.nx + shape.nu
    for k in range(shape.N + 1):
        general = np.flatnonzero((rows.node == k) & (rows.kind == 1))
        for place, m in enumerate(general):
            pure = k == shape.N or rows.index[m] >= shape.path
            choice = rng.integers(5)
            if choice == 0 and place and not (pure and np.any(C[general[0], nx:])):
                C[m] = rng.choice([-2.0, -1.0, 0.5, 1.0]) * C[general[0]]
            elif choice == 1:
                C[m] = np.eye(nz)[rng.integers(nx if pure else nz)]
            elif choice == 2 and rng.random() < 0.3:
                C[m] = 0.0


# The point ------------------------------------------------------------------------------------------------------------


def _around_point(draw: _Draw, qp: StageQP, kind: str, share: float) -> StageQP:
    """Return gaps, gradients and bounds for which a random point is the optimum."""
    s, rng, rows = qp.shape, draw.rng, qp.rows
    dx, du = draw.normal(s.N + 1, s.nx), draw.normal(s.N, s.nu)
    plan = 0.0 if kind == "scaled" or rng.random() < 0.2 else 1.0
    x, u, c = (plan * a for a in (draw.normal(s.N + 1, s.nx), draw.normal(s.N, s.nu), draw.normal(len(rows))))
    state = rows.kind == 0
    c[state] = x[rows.node[state], rows.index[state]]
    b = dx[1:] - np.einsum("kij,kj->ki", qp.S[:, :, : s.nx], dx[:-1])
    b -= np.einsum("kij,kj->ki", qp.S[:, :, s.nx :], du)
    qp = dataclasses.replace(qp, b=b, x=x, u=u, c=c, dx0=dx[0].copy())

    state_u, state_r = _states(draw, qp, kind, share)
    degenerate = 0.5 if kind == "degenerate" else 0.0
    lower_u, upper_u, mult_u = _bounds(draw, u + du, state_u, np.inf + 0 * du, 0 * du, degenerate)
    free = np.arange(s.nu) >= s.bounded
    lower_u[:, free], upper_u[:, free] = -np.inf, np.inf
    lower, upper, mult = _bounds(draw, row_values(qp, dx, du), state_r, rows.l1, rows.l2, degenerate)
    point = Point(dx, du, mult_u, mult)
    lam = draw.normal(s.N + 1, s.nx)
    lam[0, : s.free] = 0.0
    g, g_N = cost_gradient(qp, point)
    g += np.einsum("kji,kj->ki", qp.S, lam[1:])
    g[:, : s.nx] -= lam[:-1]
    return dataclasses.replace(
        qp, g=-g, g_N=lam[-1] - g_N, lower=lower, upper=upper, lower_u=lower_u, upper_u=upper_u, optimum=point
    )


def _states(draw: _Draw, qp: StageQP, kind: str, share: float) -> tuple[Array, Array]:
    """Choose the state of every control bound and every row at the optimum.

    Unless the kind is "redundant", the hard active rows up to any node are no more than the free controls up to it:
    more would depend on each other.
    """
    s, rng, rows = qp.shape, draw.rng, qp.rows
    count = s.N * s.bounded + len(rows)
    wanted = rng.permutation(count)[: round(share * count)]
    if kind == "all_active":
        wanted = np.arange(count)
    state_u, state_r = np.zeros((s.N, s.nu), int), np.zeros(len(rows), int)
    room = s.free + np.cumsum(np.append(np.zeros(1, int), np.full(s.N, s.nu)))  # free variables that affect node k
    for i in wanted:
        if i < s.N * s.bounded:
            k, j = divmod(int(i), s.bounded)
            if np.all(room[k + 1 :] > 0) or kind in ("redundant", "all_active"):
                state_u[k, j] = _side(draw, kind, soft=False)
                room[k + 1 :] -= 1
            continue
        m = int(i) - s.N * s.bounded
        side = _side(draw, kind, soft=bool(np.isfinite(rows.l1[m])))
        if side in (OVER, UNDER):
            state_r[m] = side
            continue
        # A row with controls depends on those of its node, the other rows only on earlier ones.
        sees = rows.node[m] + int(rows.kind[m] == 1 and rows.index[m] < s.path and rows.node[m] < s.N)
        if kind == "redundant" or np.all(room[sees:] > 0):
            state_r[m] = side
            room[sees:] -= 1
    return state_u, state_r


def _side(draw: _Draw, kind: str, soft: bool) -> int:
    equal = 0.7 if kind == "equalities" else 0.1
    if draw.rng.random() < equal:
        return EQUAL
    return int(draw.rng.choice([LOWER, UPPER, OVER, UNDER] if soft else [LOWER, UPPER]))


def _bounds(
    draw: _Draw, value: Array, state: Array, l1: Array, l2: Array, degenerate: float
) -> tuple[Array, Array, Array]:
    """Return bounds and multipliers of rows with these values and states."""
    rng, shape = draw.rng, value.shape
    sign = np.select([state == LOWER, state == UNDER], [-1.0, -1.0], 1.0)
    sign = np.where(state == EQUAL, rng.choice([-1.0, 1.0], size=shape), sign)
    violated = (state == OVER) | (state == UNDER)
    v = np.where(violated, draw.positive(*shape), 0.0)
    hard = draw.positive(*shape) * (rng.random(shape) >= degenerate)
    limit = np.where(np.isfinite(l1), l1, 0.0)
    soft = limit * np.minimum(draw.rounded(rng.random(shape)), 1.0)
    size = np.where(violated, limit + l2 * v, np.where(np.isfinite(l1), soft, hard))
    mult = np.where(state == FREE, 0.0, sign * size)
    margin = draw.positive(2, *shape)
    margin[rng.random((2, *shape)) < 0.2] = np.inf
    margin[:, violated & (rng.random(shape) < 0.2)] = 0.0  # a soft equality
    met = (state == UPPER) | (state == EQUAL)
    upper = np.select(
        [met, state == OVER, state == UNDER], [value, value - v, value + v + margin[0]], value + margin[0]
    )
    met = (state == LOWER) | (state == EQUAL)
    lower = np.select(
        [met, state == UNDER, state == OVER], [value, value + v, value - v - margin[1]], value - margin[1]
    )
    return lower, upper, mult


# Variants -------------------------------------------------------------------------------------------------------------


def _in_units(draw: _Draw, qp: StageQP) -> StageQP:
    """Return the same problem in units of 1e-6 to 1e6 of states, controls, hard rows and cost.

    Active bounds stay active. If there are soft rows, their unit and that of the cost are kept, because the penalties
    are part of the package.
    """
    rng, s, rows, p = draw.rng, qp.shape, qp.rows, qp.optimum
    assert p is not None
    soft = np.isfinite(rows.l1)
    x, u = 10 ** rng.uniform(-6, 6, s.nx), 10 ** rng.uniform(-6, 6, s.nu)
    x[rows.index[soft & (rows.kind == 0)]] = 1.0
    cost = 1.0 if soft.any() else 10 ** rng.uniform(-6, 6)
    user = 10 ** rng.uniform(-6, 6, s.user_rows)
    row = np.where(soft, 1.0, user[rows.user])
    row = np.where(rows.kind == 0, x[np.minimum(rows.index, s.nx - 1)], row)
    z = np.concatenate([x, u])
    C, C0 = qp.C / z * row[:, None], qp.C0 / x * row[:, None]
    C[rows.kind == 0] = np.eye(s.nx + s.nu)[rows.index[rows.kind == 0]]
    point = Point(p.dx * x, p.du * u, cost * p.mult_u / u, cost * p.mult / row)
    scaled = dataclasses.replace(
        qp, S=qp.S * x[:, None] / z, b=qp.b * x, Q=cost * qp.Q / np.outer(z, z), Q_N=cost * qp.Q_N / np.outer(x, x),
        g=cost * qp.g / z, g_N=cost * qp.g_N / x, C=C, C0=C0, c=qp.c * row, x=qp.x * x, u=qp.u * u,
        dx0=point.dx[0].copy(), unit_x=x, unit_u=u, optimum=point,
    )  # fmt: skip
    return _meet(scaled, qp, row)


def _meet(scaled: StageQP, plain: StageQP, row: Array) -> StageQP:
    """Return the bounds in the new units."""
    p, old = scaled.optimum, plain.optimum
    assert p is not None
    assert old is not None

    def move(bound: Array, before: Array, after: Array, unit: Array) -> Array:
        return np.where(bound == before, after, bound * unit)

    value, new = row_values(plain, old.dx, old.du), row_values(scaled, p.dx, p.du)
    at, new_at = plain.u + old.du, scaled.u + p.du
    return dataclasses.replace(
        scaled,
        lower=move(plain.lower, value, new, row),
        upper=move(plain.upper, value, new, row),
        lower_u=move(plain.lower_u, at, new_at, scaled.unit_u),
        upper_u=move(plain.upper_u, at, new_at, scaled.unit_u),
    )


def condensed_rows(qp: StageQP) -> tuple[Array, Array]:
    """Return (A (ng, N nu), value at du = 0 (ng,)) of the rows as functions of du, with dx_0 given."""
    s, rows = qp.shape, qp.rows
    A, value = np.zeros((len(rows), s.N * s.nu)), qp.c + qp.C0 @ qp.dx0
    G, x = np.zeros((s.nx, s.N * s.nu)), qp.dx0
    for k in range(s.N + 1):
        here = rows.node == k
        A[here] = qp.C[here, : s.nx] @ G
        value[here] += qp.C[here, : s.nx] @ x
        if k == s.N:
            return A, value
        A[here, k * s.nu : (k + 1) * s.nu] += qp.C[here, s.nx :]
        x = qp.S[k, :, : s.nx] @ x + qp.b[k]
        G = qp.S[k, :, : s.nx] @ G
        G[:, k * s.nu : (k + 1) * s.nu] += qp.S[k, :, s.nx :]
    raise AssertionError


def _contradiction(draw: _Draw, qp: StageQP) -> StageQP:
    """Make one hard row require more than bounded controls and up to two other rows allow.

    a_m du = sum_j c_j a_j du + rest' du <= sum_j max(c_j lower_j, c_j upper_j) + sum_i max(rest_i du_i over its bounds)
    """
    s, rng, rows = qp.shape, draw.rng, qp.rows
    assert qp.optimum is not None
    A, value = condensed_rows(qp)
    hard = np.flatnonzero(np.isinf(rows.l1))
    moving = hard[np.max(np.abs(A[hard]), axis=1, initial=0.0) > 0]
    m = int(rng.choice(moving if len(moving) else hard))
    lower_u, upper_u = (
        np.where(np.isfinite(a), a, qp.u + side * draw.positive(s.N, s.nu) + side * np.abs(qp.optimum.du))
        for a, side in ((qp.lower_u, -1.0), (qp.upper_u, 1.0))
    )
    combined = np.zeros(len(rows))
    usable = [j for j in hard if j != m and np.isfinite(qp.lower[j]) and np.isfinite(qp.upper[j])]
    for j in rng.permutation(usable)[: rng.integers(0, 3)]:
        combined[int(j)] = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 1.0)
    rest = A[m] - combined @ A
    du = np.where(rest > 0, (upper_u - qp.u).ravel(), (lower_u - qp.u).ravel())
    others = np.where(combined > 0, qp.upper, np.where(combined < 0, qp.lower, 0.0)) - value
    terms = np.append(rest * du, (combined * others)[combined != 0])
    most = float(np.sum(terms)) + value[m]
    lower, upper = qp.lower.copy(), qp.upper.copy()
    lower[m] = most + (0.01 + rng.exponential()) * (1.0 + float(np.sum(np.abs(terms))) + abs(value[m]))
    upper[m] = lower[m] + rng.choice([0.0, 1.0, np.inf])
    combined[m] = -1.0
    return dataclasses.replace(
        qp, lower=lower, upper=upper, lower_u=lower_u, upper_u=upper_u, optimum=None,
        proof=(rest.reshape(s.N, s.nu), combined), unique=False,
    )  # fmt: skip
