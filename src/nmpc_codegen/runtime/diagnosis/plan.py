"""The plan of a controller with the values, bounds and multipliers of its rows."""

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

#: Near its bound is a row within this part of its size: of the bound, or of the scale of the row.
NEAR = 1e-2


@dataclass(frozen=True, eq=False)
class PlanData:
    """What a plan is evaluated from: states with those behind the user's, controls, parameters with those behind the
    user's, algebraic variables, bounds and multipliers of all rows at all nodes."""

    x: Array
    u: Array
    p: Array
    z: Array
    lower: Array
    upper: Array
    multiplier: Array


@dataclass(frozen=True, eq=False)
class RowsOfPlans:
    """Rows of n plans, (n, N+1, number of rows): values, NaN where a row does not hold, distances to the nearer bound,
    multipliers, and where they are active; ``rounding`` (number of rows,): violations that are none."""

    values: Array
    distance: Array
    multiplier: Array
    active: NDArray[np.bool_]
    rounding: Array


class PlanReader:
    """Copies plans of the controllers of one package, and evaluates their rows, many plans at once."""

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
        """Present lower and upper bounds of all rows at all nodes, (N+1, number of rows)."""
        if self._described.online["bounds"] == "fixed":
            return self._declared[0], self._declared[1]
        return by_node(ctrl.view("lower"), self._N), by_node(ctrl.view("upper"), self._N)

    def copy(self, ctrl: Memory, bounds: tuple[Array, Array]) -> PlanData:
        """The present plan; ``bounds``: the present ones."""
        parts = ctrl.whole_x, ctrl.u, whole_parameters(ctrl), ctrl.z
        x, u, p, z = (np.array(part, dtype=np.float64) for part in parts)
        return PlanData(x, u, p, z, *bounds, self._multipliers(ctrl))

    def _multipliers(self, ctrl: Memory) -> Array:
        """Multipliers of all rows, (N+1, number of rows), NaN if the algorithm keeps none."""
        members = self._described.members("solver")
        found = np.full(self._holds.shape, 0.0 if "mu_u" in members else np.nan)
        if "mu_u" in members:
            found[self._imposed] = ctrl.member("mult")
            for i, j in self._of_controls:
                found[:-1, i] = ctrl.mu_u[:, j]
        return found

    def evaluate(self, ctrl: Memory, plans: Sequence[PlanData]) -> RowsOfPlans:
        """The rows of all plans."""
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
    """Where rows are active: near their bound, and equations; or with a multiplier, if a method leaves others at 0; or,
    where it leaves small ones everywhere, as interior points do, relatively nearer to their bound than their multiplier
    is to 0. Without multipliers, at their bound."""
    near, weight = np.isfinite(distance) & (distance <= NEAR * size), np.abs(multiplier)
    largest = np.max(np.nan_to_num(weight), axis=(1, 2), keepdims=True, initial=0.0)
    exact = np.any(np.isfinite(distance) & (weight == 0.0), axis=(1, 2), keepdims=True)
    with np.errstate(invalid="ignore"):  # infinite times 0
        relatively = distance * largest < size * weight
    by_multiplier = np.where(exact, weight > 0.0, relatively)
    return np.asarray(near & (equal | np.where(np.isnan(weight), distance <= rounding, by_multiplier)))
