"""Newton's method for equations at a point, as templates/integrators/implicit/algebraic.c has it; expressions of z."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Steps at most, the length of the shortest one, and a step that is rounding, relative to the size of a variable.
STEPS, SHORTEST, ROUNDING = 50, 1e-4, 1e-13

#: Orders of derivatives that are needed, and steps with the same W that make them exact.
ORDERS = 2


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


def chord_steps(residual: Callable[[Any], Any], z: Any, W: Any, inverse: Array) -> list[Any]:
    """z, z_1 = z + W r(z), z_2 = z_1 + W r(z_1) as expressions: derivatives of z_i up to order i are those of the
    solution of r = 0, where z is the solution and W = -(dr/dz)^-1. ``inverse``: 1 where W may be other than 0."""
    known, points = W * ca.sparsify(ca.DM(inverse)), [z]
    for _ in range(ORDERS):
        points.append(points[-1] + known @ residual(points[-1]))
    return points


def _largest(step: NDArray[Any], v: Array, size: Array) -> float:
    return float(np.max(np.abs(step) / (size + np.abs(v)), initial=0.0))
