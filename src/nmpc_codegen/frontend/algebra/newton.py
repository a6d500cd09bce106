"""Newton's method for equations at a point, in NumPy; templates/integrators/implicit/algebraic.c does the same in C."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Steps at most, the length of the shortest one, and a step that is rounding, relative to the size of a variable.
STEPS, SHORTEST, ROUNDING = 50, 1e-4, 1e-13


def solve(evaluate: Callable[[Array], tuple[Array, Array]], start: Array, size: Array) -> Array:
    """v where r(v) = 0, by steps that are halved until the next one with the same Jacobian is shorter; NaN if they lead
    nowhere. ``evaluate``: v -> r, dr/dv; ``size``: of the variables."""
    v = start
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            r, J = evaluate(v)
            if not (np.all(np.isfinite(r)) and np.all(np.isfinite(J)) and np.linalg.det(J)):
                break
            step = np.linalg.solve(J, r)
            change = _largest(step, v, size)
            if change <= ROUNDING:
                return np.asarray(v - step)
            length = 1.0
            while length > SHORTEST:
                rest = np.linalg.solve(J, evaluate(v - length * step)[0])
                if _largest(rest, v, size) <= (1 - length / 2) * change:
                    break
                length /= 2
            v = v - length * step
    return np.full(len(start), np.nan)


def _largest(step: NDArray[Any], v: Array, size: Array) -> float:
    return float(np.max(np.abs(step) / (size + np.abs(v)), initial=0.0))
