"""Look-up tables of one and two variables are expressions: data with a search, whatever their size."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import identifier, numbers, quote
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.ir.lookup_calls import look_up
from nmpc_codegen.package.lookup import Lookup

#: Kind of interpolation -> least number of points of an axis.
KINDS = {"linear": 2, "cubic": 4}
OUTSIDE = ("extrapolate", "clamp")

#: Largest number of entries whose indices are exact in single precision.
MOST_ENTRIES = 2**24

#: Number of coefficients of a cubic polynomial, and of splines that are not zero in an interval.
CUBIC = 4


def lookup_table(
    x: Any, grid: Any, values: Any, kind: str = "linear", *, outside: str = "extrapolate", name: str = ""
) -> Any:
    """Return the interpolation of a table, an SX or MX expression with exact first and second derivatives.

    In C the table is a constant array with a search of fixed length, so that time and text of an export depend little
    on the number of points.

    Args:
        x: a scalar expression, or a pair (x, y) for a table of two variables.
        grid: (n,), increasing; or a pair of these, (n,) and (m,). At least 2 points, for "cubic" 4.
        values: (n,), or (n, m).
        kind: "linear", whose slope jumps at the points, or "cubic", the spline with continuous second derivatives (the
            second and the last but one point are no knots, as in casadi.interpolant(..., "bspline", ...)). Newton-type
            iterations converge best with "cubic".
        outside: value outside of the grid: "extrapolate", the line with the slope at the end, or "clamp", the value at
            the end.
        name: name of the table in C; by default it is derived from the content.

    Raises:
        ProblemError: a part has a wrong shape, a grid does not increase, a number is not finite, or the table is too
            large.

    Examples:
        >>> speed, torque = [0, 100, 200, 300], [2.0, 1.9, 1.5, 0.8]
        >>> most = lookup_table(ocp.x, speed, torque, kind="cubic")
    """
    if kind not in KINDS:
        raise ProblemError(f"lookup_table: kind is {kind!r}; allowed: {', '.join(map(repr, KINDS))}")
    if outside not in OUTSIDE:
        raise ProblemError(f"lookup_table: outside is {outside!r}; allowed: {', '.join(map(repr, OUTSIDE))}")
    pair = isinstance(x, (tuple, list))
    axes = [_grid(g, KINDS[kind]) for g in (_pair(grid, "grid") if pair else [grid])]
    table = _finite(values, "values", tuple(map(len, axes)))
    points = [_scalar(v) for v in (_pair(x, "x") if pair else [x])]
    if len({isinstance(v, ca.MX) for v in points}) > 1:
        raise ProblemError("lookup_table: x mixes SX and MX")
    if name:
        identifier(name, "lookup_table: name")
    content = (kind, outside, [axis.tolist() for axis in axes], table.tolist())
    stem = name or f"table_{hashlib.sha256(repr(content).encode()).hexdigest()[:10]}"
    clamp = outside == "clamp"
    if kind == "linear":
        if clamp:
            axes, table = [_extend(axis) for axis in axes], np.pad(table, 1, mode="edge")
        return _line(points[0], axes[0], table, stem) if not pair else _bilinear(points, axes, table, stem)
    if pair:
        return _bicubic(points, axes, table, stem, clamp)
    return _cubic(points[0], axes[0], table, stem, clamp)


# -- what is given ----------------------------------------------------------------------------------------------------


def _pair(value: Any, what: str) -> Sequence[Any]:
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ProblemError(f"lookup_table: {what} must be a pair for a table of two variables, got {quote(value)}")
    return value


def _finite(value: Any, what: str, shape: tuple[int, ...]) -> Array:
    array = numbers(value, f"lookup_table: {what}")
    if array.shape != shape:
        raise ProblemError(f"lookup_table: {what} has shape {array.shape}, expected {shape}, as the grid")
    if not np.isfinite(array).all():
        raise ProblemError(f"lookup_table: {what} must be finite")
    return array


def _grid(value: Any, least: int) -> Array:
    grid = numbers(value, "lookup_table: grid")
    if grid.ndim != 1 or len(grid) < least:
        raise ProblemError(f"lookup_table: grid has shape {grid.shape}, expected at least {least} points")
    if not (np.isfinite(grid).all() and (np.diff(grid) > 0).all()):
        raise ProblemError(f"lookup_table: grid must be finite and increase, got {quote(grid)}")
    return grid


def _scalar(x: Any) -> Any:
    if not isinstance(x, (ca.SX, ca.MX)):
        x = ca.SX(float(numbers(x, "lookup_table: x")))
    if x.numel() != 1:
        raise ProblemError(f"lookup_table: x has shape {x.shape}, expected a scalar expression")
    return x


# -- tables -----------------------------------------------------------------------------------------------------------


class _Axis:
    """An axis is a sorted grid with the interval that contains x, and the distance of x from the left end of it."""

    def __init__(self, x: Any, grid: Array, name: str) -> None:
        points = tuple(map(float, grid))
        self.interval = look_up(Lookup(name, "interval", points), x)
        self.distance = x - look_up(Lookup(name, "entry", points), self.interval)


def _entries(name: str, values: Array, kinks: bool = False) -> Any:
    """Return a function i -> entry i of the flattened values, as an expression."""
    if values.size > MOST_ENTRIES:
        raise ProblemError(f"lookup_table: {values.size:,} entries; expected at most {MOST_ENTRIES:,}")
    table = Lookup(name, "entry", tuple(map(float, values.ravel())), kinks)
    return lambda i: look_up(table, i)


def _line(x: Any, grid: Array, values: Array, name: str) -> Any:
    """Return y_i + s_i (x - x_i)."""
    axis, slopes = _Axis(x, grid, f"{name}_x"), np.diff(values) / np.diff(grid)
    entry = _entries(name, np.column_stack([values[:-1], slopes]), kinks=True)
    return entry(2 * axis.interval) + axis.distance * entry(2 * axis.interval + 1)


def _bilinear(x: Sequence[Any], grids: Sequence[Array], values: Array, name: str) -> Any:
    """Interpolate linearly in each variable between four points."""
    axes = [_Axis(v, g, f"{name}_{letter}") for v, g, letter in zip(x, grids, "xy", strict=True)]
    u, v = (
        axis.distance * _entries(f"{name}_per_{letter}", 1.0 / np.diff(grid))(axis.interval)
        for axis, grid, letter in zip(axes, grids, "xy", strict=True)
    )
    entry, width = _entries(name, values, kinks=True), len(grids[1])
    first = width * axes[0].interval + axes[1].interval
    low, low_y, high, high_y = (entry(first + offset) for offset in (0, 1, width, width + 1))
    left, right = low + v * (low_y - low), high + v * (high_y - high)
    return left + u * (right - left)


def _power_sum(t: Any, entry: Any, first: Any, offset: int = 0) -> Any:
    """Return the cubic polynomial in t whose coefficients begin at entry first + offset."""
    c = [entry(first + (offset + i)) for i in range(CUBIC)]
    return c[0] + t * (c[1] + t * (c[2] + t * c[3]))


def _cubic(x: Any, grid: Array, values: Array, name: str, clamp: bool) -> Any:
    """Return the spline, one polynomial per interval."""
    spline = make_interp_spline(grid, values, k=CUBIC - 1)
    ends, pieces = _pieces(lambda order: spline(grid, nu=order), grid, clamp)
    axis = _Axis(x, ends, f"{name}_x")
    return _power_sum(axis.distance, _entries(name, pieces), CUBIC * axis.interval)


def _bicubic(x: Sequence[Any], grids: Sequence[Array], values: Array, name: str, clamp: bool) -> Any:
    """Return sum_ab B_a(x) B_b(y) C_ab over the four splines of each variable that are not zero there."""
    by_x = make_interp_spline(grids[0], values, k=CUBIC - 1, axis=0)
    by_y = make_interp_spline(grids[1], by_x.c.T, k=CUBIC - 1, axis=0)
    coefficient, count = _entries(name, by_y.c.T), len(grids[1])
    (first_x, basis_x), (first_y, basis_y) = (
        _basis(v, g, knots, f"{name}_{letter}", clamp)
        for v, g, knots, letter in zip(x, grids, (by_x.t, by_y.t), "xy", strict=True)
    )
    total: Any = 0
    for a in range(CUBIC):
        row = sum(basis_y[b] * coefficient((first_x + a) * count + first_y + b) for b in range(CUBIC))
        total = total + basis_x[a] * row
    return total


def _basis(x: Any, grid: Array, knots: Array, name: str, clamp: bool) -> tuple[Any, list[Any]]:
    """Return the number of the first spline that is not zero at x, and the values of four splines."""
    every = BSpline(knots, np.eye(len(grid)), CUBIC - 1)
    ends, pieces = _pieces(lambda order: every(grid, nu=order), grid, clamp)
    first = np.clip(np.searchsorted(knots, 0.5 * (ends[:-1] + ends[1:]), side="right") - CUBIC, 0, len(grid) - CUBIC)
    rows = [np.append(float(f), piece[f : f + CUBIC]) for f, piece in zip(first, pieces, strict=True)]
    entry, axis = _entries(f"{name}_splines", np.array(rows)), _Axis(x, ends, name)
    start = (1 + CUBIC * CUBIC) * axis.interval
    return entry(start), [_power_sum(axis.distance, entry, start, 1 + CUBIC * a) for a in range(CUBIC)]


def _pieces(derivative: Any, grid: Array, clamp: bool) -> tuple[Array, Array]:
    """Return (ends, coefficients) of polynomials in the distance from the left end of an interval, (intervals, ..., 4).

    ``derivative`` maps an order to the values of a derivative of piecewise cubic functions at the grid. An additional
    interval on either side continues the functions by their tangents, or with ``clamp`` by their values.
    """
    factorials = (1.0, 1.0, 2.0, 6.0)
    at_points = np.stack([np.asarray(derivative(k)) / factorials[k] for k in range(CUBIC)], axis=-1)
    ends, terms = _extend(grid), 1 if clamp else 2
    first, last = np.zeros_like(at_points[0]), np.zeros_like(at_points[-1])
    first[..., :terms], last[..., :terms] = at_points[0][..., :terms], at_points[-1][..., :terms]
    first[..., 0] -= first[..., 1] * (grid[0] - ends[0])
    return ends, np.concatenate([first[None], at_points[:-1], last[None]])


def _extend(grid: Array) -> Array:
    """Return the grid with an additional point on either side."""
    return np.concatenate([[2 * grid[0] - grid[1]], grid, [2 * grid[-1] - grid[-2]]])
