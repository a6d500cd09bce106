"""Values that a caller gives are checked here: numbers, arrays of an expected shape, weights."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError, NmpcError
from nmpc_codegen.package.signals import Row, Soft, members

#: Asymmetry |W - W'| and negative eigenvalues up to this multiple of eps max|W| come from rounding in products A' Q A.
ROUNDING = 2.0**12


#: Times with a relative difference up to this value are equal.
SAME_TIME = 1e-9


def is_same_time(one: float, other: float) -> bool:
    """Return True if two times are equal up to rounding."""
    return math.isclose(one, other, rel_tol=SAME_TIME, abs_tol=0.0)


def checked_weight(
    W: NDArray[Any], what: str, error: type[NmpcError], eps: float = float(np.finfo(np.float64).eps)
) -> NDArray[np.float64]:
    """Return (W + W') / 2 of a finite square W that is symmetric positive semidefinite up to rounding.

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
    also: Callable[[], str] = str,
) -> NDArray[Any]:
    """Return ``value`` as an array of the given type and shape; ``also`` names other allowed shapes in the message.

    Raises:
        ControllerError: ``value`` is no such array, or, with ``finite``, it contains a NaN or an infinity.
    """
    try:
        given = np.asarray(value)
        if given.dtype.kind in "USO" and not all(isinstance(v, Real) for v in given.ravel()):
            raise ControllerError(f"{what} is no array of numbers; expected shape {shape}, got {value!r:.60}")
        if np.iscomplexobj(given):
            raise ControllerError(f"{what} is complex; expected real numbers of shape {shape}")
        array = given.astype(real, copy=False)
    except (TypeError, ValueError) as error:
        raise ControllerError(f"{what} is no array of numbers; expected shape {shape}: {error}") from error
    if array.shape != shape:
        others = also()
        raise ControllerError(f"{what} has shape {array.shape}; expected {shape}{f', or {others}' if others else ''}")
    if finite and not np.isfinite(array).all():
        raise ControllerError(f"{what} holds a NaN or an infinity: {array.tolist()}")
    return array


def weights(
    W: ArrayLike, what: str, real: np.dtype[Any], size: int, matrix: bool, lengths: Sequence[int] = ()
) -> NDArray[Any]:
    """Return checked weights in the form that a struct stores: diagonals (rows, size) or matrices (rows, size, size).

    Args:
        W: (size,) or (size, size), or one of these for each node; ``lengths`` holds the allowed numbers of nodes.
        what: name of the weight, for the message.
        real: type of the numbers.
        size: number of residuals.
        matrix: whether matrices are stored.
        lengths: numbers of nodes.

    Raises:
        ControllerError: the shape is wrong, or a weight is not symmetric positive semidefinite.
    """
    matrices = [(size, size), *((n, size, size) for n in lengths)]
    diagonals = [(size,), *((n, size) for n in lengths)]
    found = np.shape(W) if ndim(W) >= 0 else None
    first, second = (diagonals, matrices) if ndim(W) == 1 else (matrices, diagonals)
    shape = found if found in (*matrices, *diagonals) else first[0]
    array = checked_array(
        W, what, real, shape, also=lambda: ", or ".join(map(str, [second[0], *first[1:], *second[1:]]))
    )
    if shape not in matrices:
        checked = check_weights(array.reshape(-1, size), what, real)
        return np.einsum("ki,ij->kij", checked, np.eye(size, dtype=real)) if matrix else checked
    dense = check_weights(array.reshape(-1, size, size), what, real)
    diagonal: NDArray[Any] = np.einsum("kii->ki", dense)
    if matrix:
        return dense
    if np.count_nonzero(dense) > np.count_nonzero(diagonal):
        raise ControllerError(
            f"{what} has entries off its diagonal, which only Online(dense_weight=True) stores for this weight"
        )
    return diagonal


def check_weights(
    W: NDArray[Any], what: str, real: np.dtype[Any], row: Callable[[int], str] = "node {}".format
) -> NDArray[Any]:
    """Return checked weights (rows, size, size), or diagonals (rows, size); a ControllerError names the wrong row.

    ``row`` returns the name of a row for the message.
    """
    names = (what if len(W) == 1 else f"{what} of {row(k)}" for k in range(len(W)))
    if W.ndim == 2 and (W < 0).any():
        name, least = next((n, w.min()) for n, w in zip(names, W, strict=True) if (w < 0).any())
        raise ControllerError(f"{name} must be positive semidefinite, but has the eigenvalue {least:g}")
    if W.ndim == 2:
        return W
    eps = float(np.finfo(real).eps)
    return np.array([checked_weight(w, name, ControllerError, eps) for w, name in zip(W, names, strict=True)])


def pair(value: Any, what: str) -> tuple[Any, Any]:
    """Return both values of a pair, or raise ControllerError."""
    if not isinstance(value, (tuple, list, np.ndarray)) or len(value) != 2 or any(side is None for side in value):
        raise ControllerError(f"{what} is {value!r}; expected (lower, upper), where -inf and inf are no bound")
    return value[0], value[1]


def check_range(values: NDArray[Any], low: Sequence[float], high: Sequence[float], what: str) -> None:
    """Raise ControllerError if one of the rows is outside the limits of its elements."""
    outside = (values < np.array(low, values.dtype)) | (values > np.array(high, values.dtype))
    if outside.any():
        place = np.unravel_index(outside.argmax(), outside.shape)
        i = int(place[-1])
        raise ControllerError(
            f"{what}: {values[place]:g} is outside of {low[i]:g} .. {high[i]:g}, its bounds as declared in the OCP"
        )


def broadcast_rows(one: NDArray[Any], other: NDArray[Any], what: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return both arrays with the same number of rows, or raise ControllerError if that is impossible."""
    if one.shape == other.shape:
        return one, other
    try:
        one, other = np.broadcast_arrays(one, other)
    except ValueError:
        raise ControllerError(f"{what}: {len(one)} and {len(other)} rows; expected as many of both, or one") from None
    return one, other


def check_bounds(low: NDArray[Any], high: NDArray[Any], row: Row) -> None:
    """Raise ControllerError if bounds are NaN or crossed.

    If there is a pair for each node, only nodes where the row holds are checked.
    """
    imposed = [k for k in row.nodes if k < len(low)] if len(low) > 1 else [0]
    for which, bound in (("lower", low), ("upper", high)):
        if np.any(np.isnan(bound[imposed])):
            raise ControllerError(f"{which} bound of {row.user_name!r} is NaN")
    if np.any(low[imposed] > high[imposed]):
        raise ControllerError(f"bounds of {row.user_name!r}: lower {low.tolist()} above upper {high.tolist()}")
    if np.any(low[imposed] == np.inf) or np.any(high[imposed] == -np.inf):
        raise ControllerError(f"bounds of {row.user_name!r}: nothing is above inf or below -inf")


def penalty_of_row(soft: Any, row: Row, what: str) -> tuple[Any, Any] | None:
    """Return the penalty (l1, l2) of a row, or of one side of it; None leaves it unchanged.

    Raises:
        ControllerError: ``soft`` is no penalty, or the sides of a row with a single penalty would differ.
    """
    if isinstance(soft, Soft):
        if soft.scale_with_dt:
            raise ControllerError(f"{what}: scale_with_dt is declared, subject_to(..., soft=Soft(...)), and stays")
        if soft.lower is None and soft.upper is None:
            raise ControllerError(f"{what}: Soft() names no side; expected lower=(l1, l2), upper=(l1, l2) or both")
        if not row.side and not _same(soft.lower, soft.upper):
            raise ControllerError(
                f"{what} is the same on both sides, as it was declared; state the row with different ones, "
                "soft=Soft(lower=(l1, l2), upper=(l1, l2)), to change them one by one"
            )
        chosen = soft.upper if row.side == "upper" else soft.lower
        return None if chosen is None else penalty_of_row(chosen, row, what)
    if isinstance(soft, int | float | np.number) and not isinstance(soft, bool):
        return float(soft), 0.0
    if not isinstance(soft, tuple | list | np.ndarray) or len(soft) != 2:
        raise ControllerError(f"{what} is {soft!r}; expected (l1, l2), l1, or Soft(lower=(l1, l2), upper=(l1, l2))")
    return soft[0], soft[1]


def _same(one: Any, other: Any) -> bool:
    """Return True if two penalties are given and equal."""
    if one is None or other is None:
        return False
    first, second = (value if isinstance(value, tuple | list) else (value, 0.0) for value in (one, other))
    return len(first) == len(second) and all(map(np.array_equal, first, second))


def check_penalties(l1: NDArray[Any], l2: NDArray[Any], declared: tuple[float, float], what: str) -> None:
    """Raise ControllerError unless penalties are nonnegative.

    A penalty may be infinite, or positive, only if it was declared so.
    """
    least, infinite = min(l1.min(), l2.min()), bool(np.isinf(l1).any())
    if not least >= 0.0 or np.isnan(l1).any() or not np.isfinite(l2).all():
        raise ControllerError(f"{what} is {l1.tolist()}, {l2.tolist()}; expected numbers >= 0, l2 finite")
    if infinite and not math.isinf(declared[0]):
        raise ControllerError(f"{what} is infinite, but was declared {declared[0]:g}; state it with soft=(inf, l2)")
    if (l2 > 0).any() != (l2 > 0).all() or bool((l2 > 0).all()) != (declared[1] > 0):
        expected = "a positive l2" if declared[1] > 0 else "l2 = 0"
        raise ControllerError(f"{what} has l2 = {l2.tolist()}; expected {expected}, as declared")
    if not declared[1] and not (l1 > 0).all():
        raise ControllerError(f"{what} is 0; expected a positive l1")


def require_time(dt: object) -> None:
    """Raise ControllerError unless ``dt`` is a finite number >= 0."""
    if not is_positive(dt) and not (isinstance(dt, int | float | np.integer | np.floating) and dt == 0):
        raise ControllerError(f"dt is {dt!r}; expected a finite number >= 0")


def is_positive(value: object) -> bool:
    """Return True for a finite positive number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    return math.isfinite(value) and bool(value > 0)


def rows(
    value: ArrayLike,
    what: str,
    real: np.dtype[Any],
    size: int,
    lengths: Sequence[int] = (),
    finite: bool = True,
    spread: bool = True,
) -> NDArray[Any]:
    """Return an array (1, size) for all nodes, or (n, size) with one row per node; ``lengths`` holds the allowed n.

    If ``size`` is 1, (n,) are rows. With ``spread``, a single number is used for all elements of a row.

    Raises:
        ControllerError: the shape is wrong; the message lists the allowed ones.
    """
    shape = np.shape(value) if ndim(value) >= 0 else None
    flat = shape is not None and size == 1 and len(shape) == 1 and shape[0] in lengths
    by_node = shape is not None and len(shape) == 2 and shape[1] == size and shape[0] in lengths
    taken = flat or by_node or shape == (size,) or (shape == () and (spread or size == 1))
    expected = shape if taken and shape is not None else (size,)
    array = checked_array(value, what, real, expected, finite, also=_accepted_shapes(size, lengths, spread))
    return array.reshape(-1, size) if array.ndim else np.full((1, size), array)


def fill_by_name(
    into: NDArray[Any], values: Mapping[str, ArrayLike], names: Sequence[str], what: str, finite: bool = True
) -> None:
    """Write {name of a state or of a vector of them: value} to ``into``, whose elements are called ``names``.

    Raises:
        ControllerError: there is no such state; see also rows().
    """
    for name, value in values.items():
        places = members(name, names)
        if not places:
            raise ControllerError(f"{what}: no state {name!r}; those that exist: {', '.join(map(repr, names))}")
        into[places] = rows(value, f"{what}: {name!r}", into.dtype, len(places), finite=finite)[0]


def _accepted_shapes(size: int, lengths: Sequence[int], spread: bool) -> Callable[[], str]:
    """Return a function that lists the shapes which rows() accepts besides (size,)."""

    def say() -> str:
        shapes = [f"({n},)" if size == 1 else f"({n}, {size})" for n in lengths]
        found = ["a number"] if spread or size == 1 else []
        return ", or ".join([*found, *([f"one row per node, {' or '.join(shapes)}"] if shapes else [])])

    return say


def ndim(value: ArrayLike) -> int:
    """Return the number of dimensions, or -1 if ``value`` is no array; the check of its shape then refuses it."""
    try:
        return np.ndim(value)
    except ValueError:
        return -1


def is_integer(value: object) -> bool:
    """Return True for an integer of Python or NumPy."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
