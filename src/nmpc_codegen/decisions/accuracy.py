"""The error of an explicit scheme at the end of an interval is measured at points where the loop may be.

    max_i |x_n(dt) - x(dt)|_i / max(scale_i, |x_i|)

The points (x, u) are those of the first plan, with its controls and with controls at their bounds, for all corners of
ranges, and random points inside the bounds of states and controls. x(dt) comes from RK4 with many steps. A state
without two finite bounds is drawn between its values in the first plan.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import casadi as ca
import numpy as np

from nmpc_codegen.components.integrators import RK4, ButcherTableau
from nmpc_codegen.frontend.completion.first_plan import first_plan, points
from nmpc_codegen.frontend.problem import Array, Problem

#: Largest error of an accurate interval; largest number of steps that is tried for it.
ACCURATE, MOST_ACCURATE = 1e-3, 10

#: FINE: steps of the comparison. DRAWN: number of random points. LOST: error of an interval for which only the
#: comparison has a finite end. ESCAPED: growth of the largest state over an interval that leaves the region of the
#: loop.
FINE, DRAWN, LOST, ESCAPED = 64, 64, 1e3, 10.0


def starts(problem: Problem) -> Iterator[tuple[Array, Array, Array]]:
    """Yield the points (x, u, p) of the first plan at all corners of ranges, also with controls at their bounds.

    The points of an estimator are at its initial state, because its references are measurements.
    """
    for _, corner in problem.corners:
        rows = [row for row in corner.rows if row.kind == "control"]
        for x, u in [first_plan(corner)] if problem.estimation else points(corner):
            yield x, u, corner.p_value
            for bounds in ([row.lower for row in rows], [row.upper for row in rows]):
                moved, at = u.copy(), [row.index for row in rows]
                moved[at] = np.where(np.isfinite(bounds), bounds, moved[at])
                yield x, moved, corner.p_value


def _inner_points(problem: Problem, x: Array, u: Array) -> Array:
    """Return random points (nx + nu, DRAWN) inside the bounds, or between the given points."""
    z, nx = np.vstack([x, u]), problem.nx
    low, high = np.min(z, axis=1), np.max(z, axis=1)
    for row in problem.rows:
        if row.kind in ("state", "control") and np.isfinite(row.lower) and np.isfinite(row.upper):
            i = row.index + (nx if row.kind == "control" else 0)
            low[i], high[i] = min(low[i], row.lower), max(high[i], row.upper)
    share = np.random.default_rng(0).uniform(size=(DRAWN, len(low)))
    found: Array = (low + (high - low) * share).T
    return found


class Flow:
    """The flow is the model over the longest interval from these points; ``scale`` (nx,) holds scales of the states."""

    def __init__(self, problem: Problem, scale: Array, fine: int = FINE) -> None:
        stage, found = problem.path, list(starts(problem))
        f = ca.densify(problem.dynamics(stage.x, stage.u, stage.p))
        self._f = ca.Function("f", [stage.x, stage.u, stage.p], [f])
        x, u, p = (np.array(each).T for each in zip(*found, strict=True))
        more = _inner_points(problem, x, u)
        self._x, self._u = np.hstack([x, more[: problem.nx]]), np.hstack([u, more[problem.nx :]])
        self._p = np.hstack([p, np.tile(problem.p_value, (DRAWN, 1)).T])
        self._dt = max(problem.dt)
        self._known: dict[tuple[ButcherTableau, int], Array] = {}
        end = self._end(RK4, fine)
        size = np.maximum(scale, np.max(np.abs(self._x), axis=1))[:, None]
        self._ended = np.all(np.abs(end) <= ESCAPED * size, axis=0)
        self._fine = end[:, self._ended]
        self._size = np.maximum(size, np.max(np.abs(self._fine), axis=1, initial=0.0)[:, None])

    def error(self, tableau: ButcherTableau, steps: int) -> float:
        """Return the largest integration error of ``steps`` steps over the tested intervals.

        The error is LOST if an integrated state is not finite.
        """
        return float(np.max(self._errors_of_steps(tableau, steps), initial=0.0))

    def worst(self, tableau: ButcherTableau, steps: int) -> Array:
        """Return the state (nx,) from which the error of an interval is largest."""
        found: Array = self._x[:, np.flatnonzero(self._ended)[np.argmax(self._errors_of_steps(tableau, steps))]]
        return found

    def _errors_of_steps(self, tableau: ButcherTableau, steps: int) -> Array:
        """Return the error of every interval with this number of steps."""
        if (tableau, steps) not in self._known:
            self._known[tableau, steps] = self._errors(self._end(tableau, steps)[:, self._ended], self._fine)
        return self._known[tableau, steps]

    def _errors(self, end: Array, fine: Array) -> Array:
        """Return the error of every interval."""
        with np.errstate(all="ignore"):
            errors = np.max(np.abs(end - fine) / self._size, axis=0)
            found: Array = np.where(errors < LOST, errors, LOST)
        return found

    def error_where_worst(
        self, tableau: ButcherTableau, steps: int, end: Callable[[Array, Array, Array], Array], count: int = 12
    ) -> float:
        """Return the largest error of another scheme at the points where these steps are worst.

        ``end`` maps (x, u, p) to the scheme's end of an interval.
        """
        worst = np.argsort(-self._errors_of_steps(tableau, steps))[:count]
        at = np.flatnonzero(self._ended)[worst]
        found = [end(self._x[:, i], self._u[:, i], self._p[:, i]) for i in at]
        return float(np.max(self._errors(np.array(found).T, self._fine[:, worst]), initial=0.0)) if found else 0.0

    def accurate_steps(self, tableau: ButcherTableau, tried: Iterable[int]) -> int | None:
        """Return the first of these numbers of steps that is accurate; None if none is."""
        return next((n for n in tried if self.error(tableau, n) <= ACCURATE), None)

    def _end(self, tableau: ButcherTableau, steps: int) -> Array:
        a, b, h, x = np.array(tableau.a, float), np.array(tableau.b, float), self._dt / steps, self._x
        with np.errstate(all="ignore"):
            for _ in range(steps):
                slopes: list[Array] = []
                for row in a:
                    at = x + h * sum((c * k for c, k in zip(row, slopes, strict=False)), np.zeros_like(x))
                    slopes.append(np.asarray(self._f(at, self._u, self._p), dtype=float))
                x = x + h * sum((c * k for c, k in zip(b, slopes, strict=True)), np.zeros_like(x))
        return x
