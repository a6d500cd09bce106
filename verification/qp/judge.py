"""A point is judged by the promise of OK: every hard row holds, and the Lagrangian is stationary.

Residuals are relative to the terms whose sum they are. A row sums c, C_i z_i and its bound, and what it sums of a state
is what the dynamics sum up for it; the largest of a component over the horizon counts, because rounding travels along
it. A component of the gradient is relative to the largest sum of its terms over the horizon. A variable counts as no
smaller than its unit, so that a solution at zero is not judged by its own rounding. So no figure depends on the units
of a state, a control, a row or the cost.

Multipliers count only where they may: > 0 at an upper bound, < 0 at a lower one, 0 elsewhere. What a solver states
beyond that is left out before the gradient is summed up, so that complementarity is judged as stationarity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from verification.oracles.stage_qp import Array, Point, StageQP, cost_gradient, row_values, stacked

#: Residual above which an answer is wrong, by precision.
LIMITS = {"double": 1e-8, "single": 1e-3}


@dataclass(frozen=True)
class Verdict:
    """A verdict has relative residuals, infinite where a number is not finite, and the index ``where`` of the worst."""

    violation: float
    stationarity: float
    where: str

    def wrong(self, limit: float) -> bool:
        """Return True if a residual is above the limit."""
        return not (self.violation <= limit and self.stationarity <= limit)


def judge(qp: StageQP, point: Point, lam: Array, limit: float) -> Verdict:
    """Return the residuals of a point; a bound counts as met within ``limit`` times the terms of its row."""
    parts = (point.dx, point.du, point.mult, point.mult_u, lam)
    if not all(np.all(np.isfinite(a)) for a in parts):
        return Verdict(np.inf, np.inf, "not finite")
    sizes = _component_sizes(qp, point)
    violation, where = _violation(qp, point, sizes)
    stationarity, component = _stationarity(qp, point, _admissible(qp, point, sizes, limit), lam)
    return Verdict(violation, stationarity, where if violation >= stationarity else component)


def _ratio(a: Array, b: Array) -> Array:
    """Return a / b, 0 where a is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(a == 0.0, 0.0, a / b)


def _component_sizes(qp: StageQP, p: Point) -> tuple[Array, Array]:
    """Return the magnitudes of states and controls over the horizon, which scale tolerances.

    The magnitude of a state is its largest sum of absolute terms in the dynamics; each one is at least the unit.
    """
    z = np.abs(stacked(p.dx, p.du)[:-1])
    terms = np.einsum("kij,kj->ki", np.abs(qp.S), z) + np.abs(qp.b)
    x = np.max(np.vstack([terms, np.abs(p.dx), np.abs(qp.dx0)[None], qp.unit_x[None]]), axis=0)
    return x, np.max(np.vstack([np.abs(p.du), qp.unit_u[None]]), axis=0)


def _rows(qp: StageQP, p: Point, sizes: tuple[Array, Array]) -> tuple[Array, Array, Array, Array]:
    """Return (value, size without the bound, lower, upper) of control bounds and rows."""
    x, u = sizes
    value = np.concatenate([p.du.ravel(), row_values(qp, p.dx, p.du)])
    of_rows = np.abs(qp.c) + np.abs(qp.C) @ np.concatenate([x, u])
    size = np.concatenate([np.tile(u, qp.shape.N), of_rows])
    return value, size, np.append(qp.lower_u.ravel(), qp.lower), np.append(qp.upper_u.ravel(), qp.upper)


def _violation(qp: StageQP, p: Point, sizes: tuple[Array, Array]) -> tuple[float, str]:
    """Return the largest violation of rows, control bounds and gaps of the dynamics."""
    value, size, lower, upper = _rows(qp, p, sizes)
    with np.errstate(invalid="ignore"):
        over = np.where(value > upper, _ratio(value - upper, size + np.abs(upper)), 0.0)
        under = np.where(value < lower, _ratio(lower - value, size + np.abs(lower)), 0.0)
    of_rows = np.maximum(over, under)
    z = stacked(p.dx, p.du)[:-1]
    gap = np.abs(p.dx[1:] - np.einsum("kij,kj->ki", qp.S, z) - qp.b)
    gaps = _ratio(np.vstack([np.abs(p.dx[0] - qp.dx0)[None], gap]), sizes[0][None])
    worst, widest = int(np.argmax(of_rows)), int(np.argmax(gaps))
    if gaps.flat[widest] > of_rows[worst]:
        return float(gaps.flat[widest]), f"gap of state {widest % qp.shape.nx} at node {widest // qp.shape.nx}"
    controls = p.du.size
    if worst < controls:
        return float(of_rows[worst]), f"bound of control {worst % qp.shape.nu} at node {worst // qp.shape.nu}"
    m = worst - controls
    kind = ("bound of state", "row")[int(qp.rows.kind[m])]
    return float(of_rows[worst]), f"{kind} {qp.rows.index[m]} at node {qp.rows.node[m]}"


def _admissible(qp: StageQP, p: Point, sizes: tuple[Array, Array], limit: float) -> Point:
    """Return the point with only those multipliers that its rows may have."""
    value, size, lower, upper = _rows(qp, p, sizes)
    with np.errstate(invalid="ignore"):
        at_upper = np.isfinite(upper) & (upper - value <= limit * (size + np.abs(upper)))
        at_lower = np.isfinite(lower) & (value - lower <= limit * (size + np.abs(lower)))
    mult = np.append(p.mult_u.ravel(), p.mult)
    allowed = np.where(mult > 0, at_upper, at_lower)
    mult = np.where(allowed, mult, 0.0)
    n = p.mult_u.size
    return replace(p, mult_u=mult[:n].reshape(p.mult_u.shape), mult=mult[n:])


def _stationarity(qp: StageQP, stated: Point, p: Point, lam: Array) -> tuple[float, str]:
    """Return the gradient with the multipliers of ``p`` over the terms of the stated ones."""
    nx, N = qp.shape.nx, qp.shape.N
    G, G_N = cost_gradient(qp, p)
    G = G + np.einsum("kji,kj->ki", qp.S, lam[1:])
    G[:, :nx] -= lam[:N]
    T, T_N = cost_gradient(qp, stated, absolute=True)
    T = T + np.einsum("kji,kj->ki", np.abs(qp.S), np.abs(lam[1:]))
    T[:, :nx] += np.abs(lam[:N])
    unit = np.concatenate([qp.unit_x, qp.unit_u])
    size = np.maximum(np.max(T, axis=0), np.max(np.abs(qp.Q) @ unit, axis=0))
    size[:nx] = np.maximum(np.maximum(size[:nx], T_N + np.abs(lam[N])), np.abs(qp.Q_N) @ qp.unit_x)
    residual = _ratio(np.abs(G), size[None])
    last = _ratio(np.abs(G_N - lam[N]), size[:nx])
    if np.max(last) > np.max(residual):
        return float(np.max(last)), f"gradient of x[{int(np.argmax(last))}] at node {N}"
    k, i = divmod(int(np.argmax(residual)), residual.shape[1])
    name = f"x[{i}]" if i < nx else f"u[{i - nx}]"
    return float(residual[k, i]), f"gradient of {name} at node {k}"
