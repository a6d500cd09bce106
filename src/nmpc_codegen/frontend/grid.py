"""The grid of the horizon consists of N intervals with their lengths."""

from __future__ import annotations

from typing import Any

import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import integer, numbers, quote

#: Maximum number of intervals, for which the tables of one row at every node take a megabyte of C source, and a
#: solution takes milliseconds.
MAX_INTERVALS = 10_000
#: Allowed lengths of an interval: dt^2 and 1 / dt^2 are normal numbers even in single precision.
SHORTEST, LONGEST = 1e-15, 1e15
#: Maximum ratio of the longest to the shortest interval: products of two lengths, which occur together in a Hessian,
#: then differ by a factor less than 1 / eps.
MAX_RATIO = 1e6


def grid(name: str, T: Any, N: Any, intervals: Any, unit: str) -> tuple[int, tuple[float, ...] | None]:
    """Return the number of intervals and their lengths in ``unit``; the lengths are None if only N was given."""
    what = f"OCP '{name}'"
    if intervals is not None:
        return _grid_of_intervals(what, T, N, intervals, unit)
    if N is None:
        raise ProblemError(f"{what}: give T and N, or intervals, or N for a discrete map")
    count = integer(N, f"{what}: N", 1, MAX_INTERVALS)
    if T is None:
        return count, None
    length = numbers(T, f"{what}: T")
    if length.ndim != 0 or not np.isfinite(length) or not length > 0:
        raise ProblemError(f"{what}: T must be a positive length in {unit}, got {quote(T)}")
    dt = float(length) / count
    _check_length(dt, f"{what}: T / N", unit)
    return count, (dt,) * count


def _grid_of_intervals(what: str, T: Any, N: Any, intervals: Any, unit: str) -> tuple[int, tuple[float, ...]]:
    """Return the grid that intervals= states."""
    if T is not None:
        raise ProblemError(f"{what}: give T or intervals, not both")
    dt = numbers(intervals, f"{what}: intervals")
    if dt.ndim != 1 or dt.size < 1 or not np.isfinite(dt).all() or (dt <= 0).any():
        raise ProblemError(f"{what}: intervals must be positive lengths in {unit}, got {quote(intervals)}")
    integer(dt.size, f"{what}: number of intervals", 1, MAX_INTERVALS)
    if N is not None and integer(N, f"{what}: N", 1) != dt.size:
        raise ProblemError(f"{what}: N = {N}, but {dt.size} intervals are given")
    for k, length in enumerate(dt):
        _check_length(float(length), f"{what}: interval {k}", unit)
    if dt.max() / dt.min() > MAX_RATIO:
        raise ProblemError(
            f"{what}: interval {dt.argmax()} of {dt.max():g} {unit} is more than {MAX_RATIO:g} times as long as "
            f"interval {dt.argmin()} of {dt.min():g} {unit}"
        )
    return dt.size, tuple(float(d) for d in dt)


def _check_length(dt: float, what: str, unit: str) -> None:
    if not SHORTEST <= dt <= LONGEST:
        raise ProblemError(f"{what} is {dt:g} {unit}, expected a length between {SHORTEST:g} and {LONGEST:g} {unit}")
