"""Smooth penalty functions of the distance of a row from its bounds serve for costs that are integrated over time."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import vector
from nmpc_codegen.ir.casadi_types import Expression


def smooth_excess(lower: Any, expr: Any, upper: Any, width: Any) -> Expression:
    """Return max(0, lower - h, h - upper) for every element h of a column, rounded off over ``width``.

        s(lower - h) + s(h - upper),   s(e) = (e + sqrt(e^2 + width^2)) / 2

    s(0) = width / 2, s(e) = e + width^2 / (4 e) far outside and width^2 / (4 |e|) far inside; all derivatives exist.
    With ``ocp.stage_cost(weight * smooth_excess(-inf, h, 100, 0.01), integrate=True)`` the violation of a row is
    integrated over time, at all points of the integrator and not only at the nodes, as an l1 penalty. The row holds up
    to about ``width`` if ``weight`` exceeds its multiplier per unit of time.

    Args:
        lower: number, or one per element; -inf is allowed.
        expr: scalar or column of states, controls and parameters.
        upper: as ``lower``; inf is allowed.
        width: positive number in the unit of h, or an expression, such as a parameter that is decreased from one
            solve() to the next. A step that changes h by more than the width ignores the penalty: with one QP per
            sample, a tenth of the change that a disturbance causes is too small.

    Raises:
        ProblemError: sizes do not match, lower exceeds upper, or the width is not positive.

    Examples:
        >>> cost = 10 * smooth_excess(-inf, ocp.x, 0.9, width=0.01)
    """
    h = expr if isinstance(expr, (ca.SX, ca.MX)) else ca.SX(ca.DM(expr))
    n, what = h.numel(), "smooth_excess"
    low, high = (vector(v, n, f"{what}: {w}", finite=False) for v, w in ((lower, "lower"), (upper, "upper")))
    if not np.all(low <= high):
        raise ProblemError(f"{what}: lower {low.max():g} exceeds upper {high.min():g}")
    if not isinstance(width, (ca.SX, ca.MX)):
        (width,) = vector(width, 1, f"{what}: width")
        if not width > 0:
            raise ProblemError(f"{what}: width must be positive, got {width:g}")
    elif width.numel() != 1:
        raise ProblemError(f"{what}: width must be a scalar, got {width.numel()} elements")
    return ca.vertcat(
        *(_smooth(low[i] - h[i], low[i], width) + _smooth(h[i] - high[i], high[i], width) for i in range(n))
    )


def _smooth(e: Expression, bound: float, width: Any) -> Expression | float:
    """Return s(e), 0 without a bound."""
    return (e + ca.sqrt(e**2 + width**2)) / 2 if np.isfinite(bound) else 0.0
