"""When a matrix is a weight: the one check for what is stated and for what is set at run time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import NmpcError

#: Asymmetry |W - W'| and negative eigenvalues that are rounding of a product like A' Q A: multiples of eps max|W|.
ROUNDING = 2.0**12


def checked_weight(
    W: NDArray[Any], what: str, error: type[NmpcError], eps: float = float(np.finfo(np.float64).eps)
) -> NDArray[np.float64]:
    """(W + W') / 2 of a finite square W that is symmetric positive semidefinite up to rounding.

    Args:
        W: (n, n).
        what: what it is, for the message.
        error: what to raise if it is not symmetric or has a negative eigenvalue.
        eps: machine epsilon of the numbers that W was computed with.
    """
    array = W.astype(np.float64)
    scale = float(np.abs(array).max(initial=0.0))
    if scale == 0.0:
        return array
    unit = array / scale
    gap = np.abs(unit - unit.T)
    if gap.max() > ROUNDING * eps:
        i, j = np.unravel_index(gap.argmax(), gap.shape)
        raise error(
            f"{what} must be symmetric, but entry [{i}, {j}] is {array[i, j]:.12g} and [{j}, {i}] is "
            f"{array[j, i]:.12g}: a difference of {gap.max():.2g} of the largest entry is more than rounding "
            f"({ROUNDING * eps:.2g})"
        )
    unit = unit / 2 + unit.T / 2
    smallest = float(np.linalg.eigvalsh(unit).min())
    if smallest < -ROUNDING * eps:
        raise error(f"{what} must be positive semidefinite, but has the eigenvalue {smallest * scale:g}")
    return array if np.array_equal(array, array.T) else unit * scale
