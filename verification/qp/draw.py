"""Stage QPs of 13 classes are drawn backwards from a KKT point, and infeasible ones with a known contradiction.

    b_k = dx_{k+1} - S_k z_k,   g_k = -(Q_k z_k + S_k' lam_{k+1} - (lam_k, 0) + rows' mult),   bounds around the values

A QP is known by its class and a number; every number is drawn from a generator of its own.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from verification.oracles.stage_qp import (
    Array,
    Point,
    Rows,
    Shape,
    StageQP,
    cost_gradient,
    recover_lam,
    row_values,
    rows_of,
)
from verification.oracles.stage_qp_random import EQUAL, FREE, LOWER, UPPER

#: The shapes have few variables with few rows, many rows, a long horizon, many controls, a single interval.
SHAPES = (
    Shape(2, 1, 6, states=1, path=1, end=2),
    Shape(4, 2, 8, states=2, path=1, end=2),
    Shape(4, 2, 8, states=4, path=3, end=4),
    Shape(3, 1, 20, states=3, path=1, end=3),
    Shape(6, 3, 10, states=2, path=2, end=3),
    Shape(1, 1, 1, states=1, path=2, end=1),
)
#: Shapes that have more general rows than controls.
CROWDED = tuple(s for s in SHAPES if s.path * s.N + s.end > s.N * s.nu)

RADIUS = 1.05  # largest spectral radius of A


@dataclasses.dataclass
class Draft:
    """A draft holds choices that are made before the point determines offsets, gradients and bounds.

    ``integers``: all numbers are small integers. ``share``: fraction of bounds and rows that are candidates for active
    ones; ``equal``: fraction of these that are equations; ``independent``: up to any node there are no more active ones
    than controls; ``degenerate``: fraction of zero multipliers among the active ones; ``idle``: fraction of met bounds
    among the others; ``boxes``: all bounds of controls are finite. Units are those of states, controls, rows and cost.
    """

    rng: np.random.Generator
    shape: Shape
    rows: Rows
    S: Array
    Q: Array
    Q_N: Array
    C: Array
    c: Array
    integers: bool = False
    share: float = 0.4
    equal: float = 0.1
    independent: bool = True
    degenerate: float = 0.0
    idle: float = 0.0
    boxes: bool = False
    unit_x: Array = dataclasses.field(default_factory=lambda: np.ones(1))
    unit_u: Array = dataclasses.field(default_factory=lambda: np.ones(1))
    unit_row: Array = dataclasses.field(default_factory=lambda: np.ones(1))
    unit_cost: float = 1.0

    def numbers(self, *size: int) -> Array:
        """Draw normal numbers, or integers -3 .. 3."""
        return self.rng.integers(-3, 4, size).astype(float) if self.integers else self.rng.normal(size=size)

    def positive(self, *size: int) -> Array:
        """Draw exponential numbers of at least 0.1, or integers 1 .. 3."""
        return self.rng.integers(1, 4, size).astype(float) if self.integers else self.rng.exponential(size=size) + 0.1


def shapes_of(kind: str) -> tuple[Shape, ...]:
    """Return the shapes of a class: QP number n has shape n modulo their number."""
    return CROWDED if kind == "equalities in excess" else SHAPES


def draw(kind: str, number: int) -> StageQP:
    """Return the QP of a class with this number."""
    shapes = shapes_of(kind)
    rng = np.random.default_rng([zlib.crc32(kind.encode()), number])
    qp = CLASSES[kind](rng, shapes[number % len(shapes)])
    return dataclasses.replace(qp, kind=kind, seed=number)


# Matrices -------------------------------------------------------------------------------------------------------------


def _draft(rng: np.random.Generator, shape: Shape, **more: Any) -> Draft:
    """Return a draft with dense and well-conditioned matrices."""
    rows, nz = rows_of(shape), shape.nx + shape.nu
    C = rng.normal(size=(len(rows), nz))
    c = rng.normal(size=len(rows)) * (rng.random() < 0.5)
    d = Draft(rng, shape, rows, _dynamics(rng, shape), *_weights(rng, shape), C, c, **more)
    return _as_rows(d)


def _as_rows(d: Draft) -> Draft:
    """Give state bounds unit gradients, and rows at the end no gradient of controls."""
    nx, state = d.shape.nx, d.rows.kind == 0
    d.C[d.rows.node == d.shape.N, nx:] = 0.0
    d.C[state] = np.eye(d.C.shape[1])[d.rows.index[state]]
    d.c[state] = 0.0
    return d


def _dynamics(rng: np.random.Generator, shape: Shape) -> Array:
    """Draw A_k whose products grow no faster than powers of one matrix, and B_k that differ from node to node."""
    nx, nu, N = shape.nx, shape.nu, shape.N
    A = rng.normal(size=(nx, nx))
    A *= rng.uniform(0.3, RADIUS) / max(np.max(np.abs(np.linalg.eigvals(A))), 1e-3)
    S = np.empty((N, nx, nx + nu))
    S[:, :, :nx] = rng.uniform(0.8, 1.0, (N, 1, 1)) * A
    S[:, :, nx:] = rng.normal(size=(N, nx, nu))
    return S


def _weights(rng: np.random.Generator, shape: Shape) -> tuple[Array, Array]:
    nx, nz = shape.nx, shape.nx + shape.nu
    F, F_N = rng.normal(size=(shape.N, nz, nz)), rng.normal(size=(nx, nx))
    Q = F @ F.transpose(0, 2, 1) / nz
    Q[:, nx:, nx:] += 0.25 * np.eye(shape.nu)
    return Q, F_N @ F_N.T / nx


def _low_rank(rng: np.random.Generator, N: int, n: int, highest: int) -> Array:
    """Draw N matrices of ranks 0 .. highest."""
    F = rng.normal(size=(N, n, highest)) * (np.arange(highest) < rng.integers(0, highest + 1, (N, 1)))[:, None, :]
    found: Array = F @ F.transpose(0, 2, 1)
    return found


def _with_condition(rng: np.random.Generator, N: int, n: int, condition: float) -> Array:
    """Draw N matrices with eigenvalues 1 .. 1 / condition."""
    V, _ = np.linalg.qr(rng.normal(size=(N, n, n)))
    found: Array = (V * np.geomspace(1.0, 1.0 / condition, n)) @ V.transpose(0, 2, 1)
    return np.asarray((found + found.transpose(0, 2, 1)) / 2)


# Active bounds and rows -----------------------------------------------------------------------------------------------


def _states(d: Draft) -> tuple[Array, Array]:
    """Choose the state of every control bound (N, nu) and every row at the point."""
    s, rng, rows = d.shape, d.rng, d.rows
    n = s.N * s.nu
    state = np.zeros(n + len(rows), int)
    wanted = rng.permutation(len(state))[: round(d.share * len(state))]
    sides = np.where(rng.random(len(wanted)) < d.equal, EQUAL, rng.choice([LOWER, UPPER], len(wanted)))
    room = [s.nu * k for k in range(s.N + 1)]  # controls that node k can see, less the active ones before it
    for i, side in zip(wanted.tolist(), sides.tolist(), strict=True):
        if i < n:
            sees = i // s.nu + 1
        else:
            k = int(rows.node[i - n])
            sees = k + int(rows.kind[i - n] == 1 and k < s.N)
        if not d.independent or all(left > 0 for left in room[sees:]):
            state[i] = side
            room[sees:] = [left - 1 for left in room[sees:]]
    return state[:n].reshape(s.N, s.nu), state[n:]


def _bounds(d: Draft, value: Array, state: Array, unit: Array, boxes: bool) -> tuple[Array, Array, Array]:
    """Return bounds and multipliers of rows with these values and states."""
    rng, shape = d.rng, value.shape
    sign = np.where(state == LOWER, -1.0, 1.0)
    sign = np.where(state == EQUAL, rng.choice([-1.0, 1.0], shape), sign)
    size = d.positive(*shape) * (rng.random(shape) >= d.degenerate)
    mult = np.where(state == FREE, 0.0, sign * size) * d.unit_cost / unit
    margin = d.positive(2, *shape) * unit * (rng.random((2, *shape)) >= d.idle)
    if not boxes:
        margin[rng.random((2, *shape)) < 0.15] = np.inf
    lower = np.where((state == LOWER) | (state == EQUAL), value, value - margin[0])
    upper = np.where((state == UPPER) | (state == EQUAL), value, value + margin[1])
    return lower, upper, mult


def _around_point(d: Draft) -> StageQP:
    """Return gaps, gradients and bounds that make a random point the optimum."""
    s, rows = d.shape, d.rows
    nx, nz = s.nx, s.nx + s.nu
    x, u = np.broadcast_to(d.unit_x, nx), np.broadcast_to(d.unit_u, s.nu)
    dx, du, lam = d.numbers(s.N + 1, nx) * x, d.numbers(s.N, s.nu) * u, d.numbers(s.N + 1, nx) * d.unit_cost / x
    b = dx[1:] - np.einsum("kij,kj->ki", d.S, np.hstack([dx[:-1], du]))
    zero = np.zeros
    qp = StageQP(
        shape=s, rows=rows, S=d.S, b=b, Q=d.Q, Q_N=d.Q_N, g=zero((s.N, nz)), g_N=zero(nx), C=d.C,
        C0=zero((len(rows), nx)), c=d.c, lower=zero(len(rows)), upper=zero(len(rows)), lower_u=zero((s.N, s.nu)),
        upper_u=zero((s.N, s.nu)), x=zero((s.N + 1, nx)), u=zero((s.N, s.nu)), dx0=dx[0].copy(), optimum=None,
        proof=None, unit_x=x, unit_u=u,
    )  # fmt: skip
    state_u, state_r = _states(d)
    lower_u, upper_u, mult_u = _bounds(d, du, state_u, np.broadcast_to(u, du.shape), d.boxes)
    unit_row = np.broadcast_to(d.unit_row, len(rows))
    lower, upper, mult = _bounds(d, row_values(qp, dx, du), state_r, unit_row, False)
    point = Point(dx, du, mult_u, mult)
    g, g_N = cost_gradient(qp, point)
    g = g + np.einsum("kji,kj->ki", qp.S, lam[1:])
    g[:, :nx] -= lam[:-1]
    return dataclasses.replace(
        qp, g=-g, g_N=lam[-1] - g_N, lower=lower, upper=upper, lower_u=lower_u, upper_u=upper_u, optimum=point
    )


# Classes --------------------------------------------------------------------------------------------------------------


def _share(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.1, 0.6))


def plain(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw one well-conditioned minimiser with independent gradients of the active rows."""
    return _around_point(_draft(rng, shape, share=_share(rng)))


def integer(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw small integers, which cause no rounding and many ties."""
    d = _draft(rng, shape, integers=True, share=_share(rng), independent=bool(rng.random() < 0.5), degenerate=0.2)
    nx, nu, N, nz = shape.nx, shape.nu, shape.N, shape.nx + shape.nu
    A = np.eye(nx)[rng.permutation(nx)] * rng.choice([-1.0, 0.0, 1.0], nx, p=[0.4, 0.2, 0.4])
    d.S[:, :, :nx], d.S[:, :, nx:] = A, rng.integers(-1, 2, (N, nx, nu))
    d.C[:], d.c[:] = rng.integers(-1, 2, d.C.shape), rng.integers(-2, 3, d.c.shape)
    v = rng.integers(-1, 2, (N, nz)).astype(float)
    d.Q[:] = v[:, :, None] * v[:, None, :]
    d.Q[:, range(nz), range(nz)] += np.concatenate([rng.integers(0, 3, nx), rng.integers(1, 4, nu)])
    d.Q_N[:] = np.diag(rng.integers(0, 4, nx))
    d.idle = 0.2
    return _around_point(_as_rows(d))


def _repeat(d: Draft) -> None:
    """Replace general rows by multiples or sums of others, of the next state, of a control; or by zero."""
    rng, s, rows, nx = d.rng, d.shape, d.rows, d.shape.nx
    for m in np.flatnonzero(rows.kind == 1):
        k, choice = int(rows.node[m]), int(rng.integers(6))
        others = np.flatnonzero((rows.node == k) & (rows.kind == 1) & (np.arange(len(rows)) < m))
        if choice == 0 and len(others):
            d.C[m] = rng.choice([-2.0, -1.0, 0.5, 1.0, 3.0]) * d.C[rng.choice(others)]
        elif choice == 1 and len(others):
            d.C[m] = rng.normal(size=len(others)) @ d.C[others]
        elif choice == 2 and k < s.N:
            d.C[m] = d.S[k, rng.integers(nx)]
        elif choice == 3:
            d.C[m] = np.eye(nx + s.nu)[rng.integers(nx + s.nu if k < s.N else nx)]
        elif choice == 4 and rng.random() < 0.2:
            d.C[m] = 0.0


def redundant(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw active rows that depend on each other exactly."""
    d = _draft(rng, shape, share=_share(rng), independent=False, equal=0.3)
    _repeat(d)
    return _around_point(_as_rows(d))


def nearly_dependent(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw active rows that nearly depend on each other, up to 1e-10 to 1e-3 of themselves."""
    d = _draft(rng, shape, share=_share(rng), independent=False, equal=0.3)
    _repeat(d)
    d.C *= 1 + 10 ** rng.uniform(-10, -3) * rng.normal(size=d.C.shape)
    return _around_point(_as_rows(d))


def equalities_in_excess(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Make all general rows equations, more than there are controls."""
    qp = _around_point(_draft(rng, shape, share=_share(rng), equal=0.3))
    p = qp.optimum
    assert p is not None
    value, general = row_values(qp, p.dx, p.du), qp.rows.kind == 1
    return dataclasses.replace(qp, lower=np.where(general, value, qp.lower), upper=np.where(general, value, qp.upper))


def semidefinite(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw weights of rank 0 to 2, and boxes."""
    d = _draft(rng, shape, share=_share(rng), boxes=True)
    d.Q = _low_rank(rng, shape.N, shape.nx + shape.nu, 2)
    d.Q_N = _low_rank(rng, 1, shape.nx, 2)[0]
    return _around_point(d)


def nearly_linear(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw a Hessian of 1e-12 to 1e-6 of the gradient, with the minimiser near a vertex of the feasible set."""
    d = _draft(rng, shape, share=1.0 if rng.random() < 0.7 else 0.6, boxes=True)
    scale = 10 ** rng.uniform(-12, -6)
    d.Q, d.Q_N = scale * d.Q, scale * d.Q_N
    return _around_point(d)


def thin(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw bounds 1e-9 to 1e-3 apart where they are active, and sometimes where they are not."""
    qp = _around_point(_draft(rng, shape, share=_share(rng)))
    p = qp.optimum
    assert p is not None

    def narrow(value: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
        width = 10 ** rng.uniform(-9, -3, value.shape) * (1 + np.abs(value))
        at_lower, at_upper = value == lower, value == upper
        inside = ~at_lower & ~at_upper & (rng.random(value.shape) < 0.1)
        low, high = np.where(inside, value - width / 2, lower), np.where(inside, value + width / 2, upper)
        return np.where(at_upper & ~at_lower, value - width, low), np.where(at_lower & ~at_upper, value + width, high)

    lower_u, upper_u = narrow(p.du, qp.lower_u, qp.upper_u)
    lower, upper = narrow(row_values(qp, p.dx, p.du), qp.lower, qp.upper)
    return dataclasses.replace(qp, lower_u=lower_u, upper_u=upper_u, lower=lower, upper=upper)


def ill_conditioned(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw weights with eigenvalues from 1 down to 1e-4 .. 1e-10."""
    d = _draft(rng, shape, share=_share(rng))
    condition = 10 ** rng.uniform(4, 10)
    d.Q = _with_condition(rng, shape.N, shape.nx + shape.nu, condition)
    d.Q_N = _with_condition(rng, 1, shape.nx, condition)[0]
    return _around_point(d)


def badly_scaled(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw states, controls, rows and cost in units of 1e-6 to 1e6."""
    d = _draft(rng, shape, share=_share(rng))
    x, u, cost = 10 ** rng.uniform(-6, 6, shape.nx), 10 ** rng.uniform(-6, 6, shape.nu), 10 ** rng.uniform(-6, 6)
    z, row = np.append(x, u), (10 ** rng.uniform(-6, 6, shape.user_rows))[d.rows.user]
    row = np.where(d.rows.kind == 0, x[np.minimum(d.rows.index, shape.nx - 1)], row)
    d.S, d.Q, d.Q_N = d.S * x[:, None] / z, cost * d.Q / np.outer(z, z), cost * d.Q_N / np.outer(x, x)
    d.C, d.c = d.C * row[:, None] / z, d.c * row
    d.unit_x, d.unit_u, d.unit_row, d.unit_cost = x, u, row, cost
    return _around_point(_as_rows(d))


def degenerate(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw more active rows than controls, half of them without multiplier, others met by chance."""
    d = _draft(rng, shape, share=float(rng.uniform(0.4, 0.9)), independent=False, equal=0.05, degenerate=0.5, idle=0.1)
    return _around_point(d)


def uncontrolled(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Draw states that no control reaches, with rows and bounds that hold or are met, and controls without effect."""
    d = _draft(rng, shape, share=_share(rng), independent=False)
    nx, rows = shape.nx, d.rows
    lost = rng.random(nx) < 0.5
    lost[rng.integers(nx)] = True
    d.S[:, lost, nx:] = 0.0
    d.S[:, :, :nx][:, np.ix_(lost, ~lost)[0], np.ix_(lost, ~lost)[1]] = 0.0
    if shape.nu > 1 and rng.random() < 0.5:
        d.S[:, :, nx + rng.integers(shape.nu)] = 0.0
    fixed = (rows.kind == 1) & (rng.random(len(rows)) < 0.5)
    d.C[np.ix_(fixed, np.append(~lost, np.ones(shape.nu, bool)))] = 0.0
    return _around_point(_as_rows(d))


def infeasible(rng: np.random.Generator, shape: Shape) -> StageQP:
    """Require 1e-6 to 1e-3 more of a path row than controls, the next state and other rows of its node allow."""
    qp = _around_point(_draft(rng, shape, share=0.3, boxes=True))
    k = int(rng.integers(shape.N))
    rows = qp.rows
    here = np.flatnonzero((rows.node == k) & (rows.kind == 1))
    m, lower, upper = int(here[-1]), qp.lower.copy(), qp.upper.copy()
    lower_u, upper_u, C, c = qp.lower_u, qp.upper_u, qp.C.copy(), qp.c.copy()
    # (gradient in z_k, lower, upper) of what bounds the row
    members = [(np.eye(C.shape[1])[shape.nx + j], lower_u[k, j], upper_u[k, j]) for j in range(shape.nu)]
    next_states = np.flatnonzero((rows.node == k + 1) & (rows.kind == 0))
    for j in (*next_states, *here[:-1]):
        constant = -qp.b[k, rows.index[j]] if rows.kind[j] == 0 else -c[j]
        low, high = (0.0 if not np.isfinite(v) else v for v in (lower[j], upper[j]))
        lower[j], upper[j] = min(low, high), max(low, high)
        gradient = qp.S[k, rows.index[j]] if rows.kind[j] == 0 else C[j]
        members.append((gradient, lower[j] + constant, upper[j] + constant))
    chosen = rng.permutation(len(members))[: rng.integers(1, 4)]
    weight = rng.choice([-1.0, 1.0], len(chosen)) * rng.uniform(0.1, 1.0, len(chosen))
    terms = [max(w * members[j][1], w * members[j][2]) for w, j in zip(weight, chosen, strict=True)]
    C[m], c[m] = sum(w * members[j][0] for w, j in zip(weight, chosen, strict=True)), 0.0
    lower[m] = sum(terms) + 10 ** rng.uniform(-6, -3) * (1 + sum(map(abs, terms)))
    upper[m] = lower[m] + rng.choice([0.0, 1.0, np.inf])
    return dataclasses.replace(qp, C=C, c=c, lower=lower, upper=upper, optimum=None)


CLASSES: dict[str, Callable[[np.random.Generator, Shape], StageQP]] = {
    "plain": plain,
    "integer": integer,
    "redundant": redundant,
    "nearly dependent": nearly_dependent,
    "equalities in excess": equalities_in_excess,
    "semidefinite": semidefinite,
    "nearly linear": nearly_linear,
    "thin": thin,
    "ill-conditioned": ill_conditioned,
    "badly scaled": badly_scaled,
    "degenerate": degenerate,
    "uncontrolled": uncontrolled,
    "infeasible": infeasible,
}


def multipliers_of_dynamics(qp: StageQP) -> Array:
    """Return lam of the point around which a feasible QP was built."""
    assert qp.optimum is not None
    return recover_lam(qp, qp.optimum)
