"""The plan of a controller is read with the values, bounds and multipliers of its rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.signals import imposed_rows
from nmpc_codegen.runtime.diagnosis.plan_rows import (
    NEGLIGIBLE,
    by_node,
    imposed_nodes,
    values_at_nodes,
    whole_parameters,
)
from nmpc_codegen.runtime.memory import Memory

Array = NDArray[np.float64]

#: A row is near its bound within this fraction of its size, which is that of the bound or the scale of the row.
NEAR = 1e-2


@dataclass(frozen=True, eq=False)
class PlanData:
    """The rows of a plan are evaluated from these data.

    States and parameters include those that the compiler has added. Bounds and multipliers are those
    of all rows at all nodes.
    """

    x: Array
    u: Array
    p: Array
    z: Array
    lower: Array
    upper: Array
    multiplier: Array


@dataclass(frozen=True, eq=False)
class RowsOfPlans:
    """The rows of n plans have values, distances to the nearer bound, and multipliers, (n, N+1, number of rows) each.

    Values are NaN where a row does not hold. ``active`` marks active rows; violations up to ``rounding`` (number of
    rows,) are rounding errors.
    """

    values: Array
    distance: Array
    multiplier: Array
    active: NDArray[np.bool_]
    rounding: Array


class PlanReader:
    """A reader copies plans of the controllers of one package, and evaluates the rows of many plans at once."""

    def __init__(self, ctrl: Memory) -> None:
        self._described = described = ctrl.description
        rows, self._N = described.rows, ctrl.dims.N
        self._holds = np.zeros((self._N + 1, len(rows)), dtype=bool)
        for i, row in enumerate(rows):
            self._holds[[] if row.is_coupled else imposed_nodes(row), i] = True
        imposed = imposed_rows(rows, self._N)
        self._imposed = [entry.node for entry in imposed], [entry.row for entry in imposed]
        self._of_controls = [(i, row.index) for i, row in enumerate(rows) if row.kind == "control"]
        self._declared = [np.tile([getattr(r, side) for r in rows], (self._N + 1, 1)) for side in ("lower", "upper")]

    def bounds(self, ctrl: Memory) -> tuple[Array, Array]:
        """Return the present lower and upper bounds of all rows at all nodes, (N+1, number of rows)."""
        if self._described.online["bounds"] == "fixed":
            return self._declared[0], self._declared[1]
        return by_node(ctrl.view("lower"), self._N), by_node(ctrl.view("upper"), self._N)

    def copy(self, ctrl: Memory, bounds: tuple[Array, Array]) -> PlanData:
        """Copy the present plan; ``bounds`` are its present bounds."""
        parts = ctrl.whole_x, ctrl.u, whole_parameters(ctrl), ctrl.z
        x, u, p, z = (np.array(part, dtype=np.float64) for part in parts)
        return PlanData(x, u, p, z, *bounds, self._multipliers(ctrl))

    def _multipliers(self, ctrl: Memory) -> Array:
        """Return the multipliers of all rows, (N+1, number of rows), NaN if the algorithm keeps none."""
        members = self._described.members("solver")
        found = np.full(self._holds.shape, 0.0 if "mu_u" in members else np.nan)
        if "mu_u" in members:
            found[self._imposed] = ctrl.member("mult")
            for i, j in self._of_controls:
                found[:-1, i] = ctrl.mu_u[:, j]
        return found

    def evaluate(self, ctrl: Memory, plans: Sequence[PlanData]) -> RowsOfPlans:
        """Evaluate the rows of all plans."""
        x, u, p, z, lower, upper, multiplier = (
            np.stack([getattr(plan, part.name) for plan in plans]) for part in fields(PlanData)
        )
        values = np.where(self._holds, values_at_nodes(ctrl, x, u, p, z), np.nan)
        distance = np.minimum(values - lower, upper - values)
        bounds = [np.where(np.isfinite(side), np.abs(side), 0.0) for side in (lower, upper)]
        size = np.maximum(np.array(self._described.row_scales), np.maximum(*bounds))
        equal = lower >= upper
        rounding = max(NEGLIGIBLE, 100.0 * float(np.finfo(self._described.real).eps)) * size
        active = _find_active(distance, size, rounding, equal, multiplier)
        return RowsOfPlans(values, distance, multiplier, active, rounding.max(axis=(0, 1), initial=0.0))


def _find_active(
    distance: Array, size: Array, rounding: Array, equal: NDArray[np.bool_], multiplier: Array
) -> NDArray[np.bool_]:
    """Return where rows are active: near their bound, or with a multiplier; equations always.

    Active-set methods leave the multipliers of inactive rows at 0, so a multiplier shows activity. Interior points
    leave small ones everywhere: a row is active if it is relatively nearer to its bound than its multiplier is to 0.
    Without multipliers, only rows at their bound are active.
    """
    near, weight = np.isfinite(distance) & (distance <= NEAR * size), np.abs(multiplier)
    largest = np.max(np.nan_to_num(weight), axis=(1, 2), keepdims=True, initial=0.0)
    exact = np.any(np.isfinite(distance) & (weight == 0.0), axis=(1, 2), keepdims=True)
    with np.errstate(invalid="ignore"):  # infinite times 0
        relatively = distance * largest < size * weight
    by_multiplier = np.where(exact, weight > 0.0, relatively)
    return np.asarray(near & (equal | np.where(np.isnan(weight), distance <= rounding, by_multiplier)))
