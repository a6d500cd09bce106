"""Costs of closed loops and the largest violation of every row are computed from states, controls and data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.signals import Row
from nmpc_codegen.runtime.batch.struct_block import Structs
from nmpc_codegen.runtime.diagnosis.plan_rows import NEGLIGIBLE, append_solved

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Judge:
    """A judge evaluates samples of length ``dt``.

    The rows with the numbers in ``rows`` hold along the whole path.
    """

    description: PackageDescription
    rows: tuple[int, ...]
    dt: float

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the rows."""
        return tuple(self.description.rows[i].name for i in self.rows)

    @property
    def rounding(self) -> Array:
        """Return for each row the violation up to which it is rounding."""
        return NEGLIGIBLE * np.array([self.description.row_scales[i] for i in self.rows])

    @cached_property
    def _with_controls(self) -> list[bool]:
        """Return, for every step of the program, True if it depends on controls.

        Results of Newton's method depend on controls as well.
        """
        program, np_ = self.description.program, self.description.sizes["NP"]
        found: list[bool] = []
        for name, first, second, _ in program.steps:
            if name == "input":
                found.append(first == 1 or (first == 2 and second >= np_))
            else:
                found.append(name != "const" and (found[first] or found[second]))
        return found

    def judge(self, x: Array, u: Array, z: Array, data: Samples) -> tuple[Array, Array]:
        """Return the costs (flights,) and the largest violations (flights, rows), 0 where a row is satisfied.

        Args:
            x: states (flights, steps + 1, nx).
            u: controls (flights, steps, nu).
            z: algebraic variables (flights, steps, their number).
            data: data of the samples.

        Samples after the end of a flight do not count; NaN in any other sample makes the result NaN.
        """
        flights, steps, nu = u.shape
        if not steps or not flights:
            return np.zeros(flights), np.zeros((flights, len(self.rows)))
        n = flights * (steps + 1)
        held, z = np.append(u, u[:, -1:], axis=1), np.append(z, np.full_like(z[:, :1], np.nan), axis=1)
        xs = np.concatenate([x, self._added_states(u, data)], axis=2).reshape(n, -1)
        with np.errstate(all="ignore"):
            read = append_solved(self.description, data.p.reshape(n, -1), z.reshape(n, z.shape[2]))
            found = self.description.program.values(xs, held.reshape(n, nu), read)
        values = [np.broadcast_to(v, n).reshape(flights, steps + 1) for v in found]
        flown = np.asarray(np.isfinite(u).all(axis=2) if nu else np.isfinite(x[:, :-1]).all(axis=2))
        amounts = [self._violation(i, x, u, values, data, flown) for i in self.rows]
        with np.errstate(all="ignore"):
            cost = self._cost(values, data, flown)
        return cost, np.array(amounts).reshape(len(self.rows), flights).T

    def _added_states(self, u: Array, data: Samples) -> Array:
        """Return the states added to the user's at every sample: time, then the controls of the previous sample."""
        found = self.description.augmentation
        flights, steps, _ = u.shape
        parts = []
        if found.time:
            parts.append(data.time[:, :, None] + self.dt * np.arange(steps + 1)[None, :, None])
        if found.previous:
            before = np.concatenate([data.previous[:, None, :], u], axis=1)
            parts.append(before[..., list(found.previous)])
        return np.concatenate(parts, axis=2) if parts else np.zeros((flights, steps + 1, 0))

    def _cost(self, values: list[Array], data: Samples, flown: NDArray[np.bool_]) -> Array:
        """Sum 1/2 (y - yref)' W (y - yref) + the general cost + the integrated cost times dt over the samples."""
        program = self.description.program
        total = np.zeros(flown.shape)
        if program.residuals:
            error = np.stack([values[i][:, :-1] for i in program.residuals], axis=2) - data.yref
            error *= np.where(program.scaled, np.sqrt(self.dt), 1.0)
            weighted = data.W[:, None] * error if data.W.ndim == 2 else np.einsum("fij,fkj->fki", data.W, error)
            total += 0.5 * np.sum(error * weighted, axis=2)
        for step, factor in zip(program.costs, (1.0, self.dt), strict=True):
            if step >= 0:
                total += factor * values[step][:, :-1]
        return np.asarray(np.where(flown, total, 0.0).sum(axis=1))

    def _violation(
        self, i: int, x: Array, u: Array, values: list[Array], data: Samples, flown: NDArray[np.bool_]
    ) -> Array:
        """Return the largest violation (flights,) of a row.

        Without controls, the first state does not count, as it is given.
        """
        row, nx = self.description.rows[i], self.description.dims.nx
        place, step = row.variable(nx), self.description.program.rows[i][0]
        of_controls = place >= nx if place is not None else self._with_controls[step]
        if place is None:
            value = values[step][:, :-1] if of_controls else values[step][:, 1:]
        else:
            value = u[:, :, place - nx] if of_controls else x[:, 1:, place]
        after = slice(None, -1) if of_controls else slice(1, None)
        low, high = (side[:, after if side.shape[1] > 1 else slice(None), i] for side in (data.lower, data.upper))
        counted = flown if of_controls else flown & np.isfinite(x[:, 1:]).all(axis=2)
        with np.errstate(invalid="ignore"):
            amount = np.where(counted, np.maximum(value - high, low - value), 0.0)
        return np.asarray(np.maximum(amount, 0.0).max(axis=1))


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples are the data of flights.

    p: parameters with added ones (flights, steps + 1, np + added); yref: references (flights, steps, ny); W: weights
    (flights, ny) or (flights, ny, ny); lower, upper: bounds (flights, 1 or steps + 1, rows); time: that of the first
    sample (flights, 1); previous: controls before it (flights, nu).
    """

    p: Array
    yref: Array
    W: Array
    lower: Array
    upper: Array
    time: Array
    previous: Array


def judge_of(description: PackageDescription, dt: float) -> Judge:
    """Return the judge of a package for samples of length ``dt``."""
    resets, N = description.program.resets, description.dims.N
    rows = (i for i, row in enumerate(description.rows) if i not in resets and _is_of_path(row, N))
    return Judge(description, tuple(rows), dt)


def _is_of_path(row: Row, N: int) -> bool:
    """Return True if a row holds at all nodes of the path; the first node may be excepted, as its state is given."""
    if row.is_coupled or (row.is_general and row.index < 0):
        return False
    path = {k for k in row.nodes if k < N}
    return bool(path or row.kind == "state") and path >= set(range(1, N))


@dataclass(frozen=True, eq=False)
class HeldData:
    """Held data are the data that structs hold before the flights, as views by member.

    A flight changes only its own.
    """

    members: Mapping[str, Array]

    def of(self, name: str, flights: slice, declared: Array) -> Array:
        """Return a member at node 0 (flights, ...) or, if all flights share it, (1, ...).

        A member that the structs do not contain has the declared values.
        """
        found = self.members[name]
        if not found.size:
            return declared[None]
        return np.asarray((found if len(found) == 1 else found[flights])[:, 0], dtype=np.float64)

    def whole(self, name: str, flights: slice) -> Array:
        """Return a member of the struct as an array (F, size), or (1, size) if all flights share it."""
        found = self.members[name]
        rows = np.array(found if len(found) == 1 else found[flights], dtype=np.float64)
        return rows.reshape(len(rows), math.prod(rows.shape[1:]))

    def bounds(self, description: PackageDescription, flights: slice) -> tuple[Array, Array]:
        """Return the smallest lower and largest upper bounds (flights or 1, rows) over the nodes before the end."""
        rows, N = description.rows, description.dims.N
        if description.online["bounds"] == "fixed" or not rows:
            return np.array([[row.lower for row in rows]]), np.array([[row.upper for row in rows]])
        found = []
        for name, pick in (("lower", np.min), ("upper", np.max)):
            every = self.members[name]
            every = np.asarray(every if len(every) == 1 else every[flights], dtype=np.float64)
            path = [[k for k in row.nodes if k < N] or [N] for row in rows]
            nodes = [[0]] * len(rows) if every.shape[1] <= N else path
            found.append(np.array([pick(every[:, nodes[i], i], axis=1) for i in range(len(rows))]).T)
        return found[0], found[1]


def held_data(structs: Structs) -> HeldData:
    """Return the members of structs that a summary needs."""
    names = ("p", "yref", "W", "lower", "upper", "time", "previous")
    return HeldData({name: structs.fetch(name) for name in names})
