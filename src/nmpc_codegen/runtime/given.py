"""Checks of values that a caller gives: numbers, arrays of an expected shape, weights."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError, NmpcError

#: Asymmetry |W - W'| and negative eigenvalues up to this multiple of eps max|W| are rounding of products like A' Q A.
ROUNDING = 2.0**12


#: Relative difference of two times that is rounding.
SAME_TIME = 1e-9


def is_same_time(one: float, other: float) -> bool:
    """True if two times are equal up to rounding."""
    return math.isclose(one, other, rel_tol=SAME_TIME, abs_tol=0.0)


def checked_weight(
    W: NDArray[Any], what: str, error: type[NmpcError], eps: float = float(np.finfo(np.float64).eps)
) -> NDArray[np.float64]:
    """(W + W') / 2 of a finite square W that is symmetric positive semidefinite up to rounding.

    Args:
        W: (n, n).
        what: name of the weight, for the message.
        error: class of the error that is raised if W is not symmetric or has a negative eigenvalue.
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


def checked_array(
    value: ArrayLike,
    what: str,
    real: np.dtype[Any],
    shape: tuple[int, ...],
    finite: bool = True,
    also: str = "",
) -> NDArray[Any]:
    """``value`` as an array of the given type and shape; ``also``: other shapes that the caller takes.

    Raises:
        ControllerError: it is not such an array, or, with ``finite``, it contains a NaN or an infinity.
    """
    try:
        given = np.asarray(value)
        if np.iscomplexobj(given):
            raise ControllerError(f"{what} is complex; expected real numbers of shape {shape}")
        array = given.astype(real, copy=False)
    except (TypeError, ValueError) as error:
        raise ControllerError(f"{what} is no array of numbers; expected shape {shape}: {error}") from error
    if array.shape != shape:
        raise ControllerError(f"{what} has shape {array.shape}; expected {shape}{f', or {also}' if also else ''}")
    if finite and not np.all(np.isfinite(array)):
        raise ControllerError(f"{what} holds a NaN or an infinity: {array.tolist()}")
    return array


def stored_weight(W: ArrayLike, what: str, real: np.dtype[Any], size: int, matrix: bool) -> NDArray[Any]:
    """The checked weight in the form that a struct stores: diagonal (size,) or matrix (size, size)."""
    shapes = [(size,), (size, size)] if ndim(W) == 1 else [(size, size), (size,)]
    given = checked_array(W, what, real, shapes[0], also=f"{shapes[1]}")
    square = np.diag(given) if given.ndim == 1 else given
    dense = checked_weight(square, what, ControllerError, float(np.finfo(real).eps))
    diagonal = np.diag(dense)
    if matrix:
        return dense
    if np.any(dense != np.diag(diagonal)):
        raise ControllerError(
            f"{what} has entries off its diagonal, which only Online(dense_weight=True) stores for this weight"
        )
    return diagonal


def checked_bound(value: ArrayLike, what: str, real: np.dtype[Any], count: int) -> NDArray[np.float64]:
    """``count`` bounds, or one for all of them; they may be infinite."""
    expanded = np.broadcast_to(value, (count,)) if ndim(value) == 0 else value
    array = checked_array(expanded, what, real, (count,), finite=False)
    if np.any(np.isnan(array)):
        raise ControllerError(f"{what} is NaN")
    return array.astype(np.float64)


#: Levels of an iteration in the order of their numbers in C.
LEVELS = "ABCD"


def level_number(level: object) -> int:
    """Number of a level of an iteration; ControllerError if there is no such level."""
    if not isinstance(level, str) or len(level) != 1 or level not in LEVELS:
        raise ControllerError(f"level is {level!r}; allowed: {', '.join(map(repr, LEVELS))}")
    return LEVELS.index(level)


def is_positive(value: object) -> bool:
    """True for a finite positive number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    return math.isfinite(value) and bool(value > 0)


def by_node(
    value: ArrayLike, what: str, real: np.dtype[Any], size: int, nodes: int
) -> list[tuple[int | None, NDArray[Any]]]:
    """(None, array of ``size`` numbers) for all nodes, or (node, array) for each of ``nodes``; 0: only the former.

    One number is a row if ``size`` is 1.

    Raises:
        ControllerError: other shapes; the message lists all that are taken.
    """
    single: list[tuple[int, ...]] = [(size,), ()] if size == 1 else [(size,)]
    rows: list[tuple[int, ...]] = [(nodes, size)] if nodes else []
    if size == 1 and nodes > 1:
        rows.append((nodes,))
    taken = [*single, *rows]
    shape = next((s for s in taken if ndim(value) == len(s) and np.shape(value) == s), (size,))
    others = ["a number"] if size == 1 else []
    others += [f"one row per node, {' or '.join(map(str, rows))}"] if rows else []
    array = checked_array(value, what, real, shape, also=", or ".join(others))
    if shape in rows:
        return list(enumerate(array.reshape(nodes, size)))
    return [(None, array.reshape(size))]


def ndim(value: ArrayLike) -> int:
    """Number of dimensions; -1 if ``value`` is not an array, which the check of its shape then refuses."""
    try:
        return np.ndim(value)
    except ValueError:
        return -1


def is_integer(value: object) -> bool:
    """True for an integer of Python or NumPy."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
