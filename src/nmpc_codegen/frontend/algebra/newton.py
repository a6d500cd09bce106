"""Newton's method solves equations at a point, as templates/integrators/implicit/algebraic.c, and as expressions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Largest number of steps; length of the shortest step; steps up to ROUNDING, relative to the size of a variable, are
#: rounding.
STEPS, SHORTEST, ROUNDING = 50, 1e-4, 1e-13

#: Highest order of derivatives that is needed, and number of steps with the same W that make them exact.
ORDERS = 2


def solve(evaluate: Callable[[Array], tuple[Array, Array]], start: Array, size: Array) -> Array:
    """Return v with r(v) = 0, or NaN if the steps do not converge.

    A step is halved until the next step with the same Jacobian is shorter. ``evaluate`` maps v to r and dr/dv; ``size``
    holds the sizes of the variables.
    """
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
    """Return the expressions z, z_1 = z + W r(z), z_2 = z_1 + W r(z_1).

    If z is the solution of r = 0 and W = -(dr/dz)^-1, the derivatives of z_i up to order i are those of the solution.
    ``inverse`` is 1 where W may be nonzero.
    """
    known, points = W * ca.sparsify(ca.DM(inverse)), [z]
    for _ in range(ORDERS):
        points.append(points[-1] + known @ residual(points[-1]))
    return points


def _largest(step: NDArray[Any], v: Array, size: Array) -> float:
    return float(np.max(np.abs(step) / (size + np.abs(v)), initial=0.0))
