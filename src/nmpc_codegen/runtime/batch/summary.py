"""What is left of a flight when its samples are forgotten: costs, and the largest violation of every row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.signals import Row
from nmpc_codegen.runtime.batch.structs import Structs
from nmpc_codegen.runtime.diagnosis.rows import NEGLIGIBLE, append_solved

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Judge:
    """Evaluates samples with the data of their controllers; rows at the end of the horizon alone have no samples."""

    description: PackageDescription
    rows: tuple[int, ...]
    dt: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the rows."""
        return tuple(self.description.rows[i].name for i in self.rows)

    @property
    def rounding(self) -> Array:
        """Violations of the rows up to which they are rounding."""
        return NEGLIGIBLE * np.array([self.description.row_scales[i] for i in self.rows])

    def judge(self, x: Array, u: Array, z: Array, data: Samples) -> tuple[Array, Array]:
        """Costs (flights,) and largest violations (flights, rows), 0 where a row is kept, of states x (flights, steps +
        1, nx), controls u (flights, steps, nu) and algebraic variables z (flights, steps, their number); samples after
        the end of a flight are NaN and do not count."""
        flights, steps, nu = u.shape
        if not steps:
            return np.zeros(flights), np.zeros((flights, len(self.rows)))
        inner = self._inner(u, data)
        xs = np.concatenate([x[:, :-1], inner], axis=2).reshape(flights * steps, -1)
        us = u.reshape(flights * steps, nu)
        with np.errstate(all="ignore"):
            read = append_solved(self.description, data.p.reshape(flights * steps, -1), z.reshape(flights * steps, -1))
            values = self.description.program.values(xs, us, read)
            cost = self._cost(values, data, (flights, steps))
        amounts = [self._violation(i, x, u, values, data) for i in self.rows]
        return cost, np.array(amounts).reshape(len(self.rows), flights).T

    def _inner(self, u: Array, data: Samples) -> Array:
        """States behind those of the user at every sample: time, then controls of the sample before."""
        found = self.description.inner
        flights, steps, _ = u.shape
        parts = []
        if found.time:
            parts.append(data.time[:, :, None] + self.dt * np.arange(steps)[None, :, None])
        if found.previous:
            before = np.concatenate([data.previous[:, None, :], u[:, :-1]], axis=1)
            parts.append(before[..., list(found.previous)])
        return np.concatenate(parts, axis=2) if parts else np.zeros((flights, steps, 0))

    def _cost(self, values: list[Any], data: Samples, shape: tuple[int, int]) -> Array:
        """Sum over the samples of 1/2 (y - yref)' W (y - yref) + the general cost + the integrated one times dt."""
        program, dt = self.description.program, self.description.dt[0]
        total = np.zeros(shape)
        if program.residuals:
            y = np.stack([np.broadcast_to(values[i], shape[0] * shape[1]) for i in program.residuals], axis=1)
            error = y.reshape(*shape, -1) - data.yref
            error *= np.where(program.scaled, np.sqrt(dt), 1.0)
            weighted = data.W[:, None] * error if data.W.ndim == 2 else np.einsum("fij,fkj->fki", data.W, error)
            total += 0.5 * np.sum(error * weighted, axis=2)
        for step, factor in zip(program.costs, (1.0, dt), strict=True):
            if step >= 0:
                total += factor * np.broadcast_to(values[step], shape[0] * shape[1]).reshape(shape)
        return np.asarray(np.nansum(total, axis=1))

    def _violation(self, i: int, x: Array, u: Array, values: list[Any], data: Samples) -> Array:
        """Largest violation (flights,) of a row. The first state is given, so that its bounds do not count."""
        row, program = self.description.rows[i], self.description.program
        flights, steps, _ = u.shape
        place = row.variable(self.description.dims.nx)
        if place is None:
            value = np.broadcast_to(values[program.rows[i][0]], flights * steps).reshape(flights, steps)
        else:
            value = x[:, 1:, place] if place < x.shape[2] else u[:, :, place - x.shape[2]]
        low, high = (side[:, i, None] for side in (data.lower, data.upper))
        return np.asarray(np.fmax.reduce(np.fmax(value - high, low - value), axis=1, initial=0.0))


@dataclass(frozen=True, eq=False)
class Samples:
    """Data of flights: parameters (flights, steps, np and those behind them), references (flights, steps, ny), weights
    (flights, ny) or (flights, ny, ny), bounds (flights, rows); time (flights, 1) of the first sample
    and controls (flights, nu) before it."""

    p: Array
    yref: Array
    W: Array
    lower: Array
    upper: Array
    time: Array
    previous: Array


def judge_of(description: PackageDescription, dt: float) -> Judge:
    """The judge of a package for samples of length dt."""
    rows = tuple(i for i, row in enumerate(description.rows) if _has_samples(row, description.dims.N))
    return Judge(description, rows, dt)


def _has_samples(row: Row, N: int) -> bool:
    """True if a row holds on the path: at node 0, or at several nodes before the end."""
    path = [k for k in row.nodes if k < N]
    if row.is_coupled or (row.is_general and row.index < 0):
        return False
    return row.kind == "control" or 0 in path or len(path) > 1


def data_before(batch: Structs, name: str, flights: slice, declared: Array, node: int = 0) -> Array:
    """Data of a node before the first sample, (flights or 1, ...); the declared ones if they are fixed or missing."""
    found = batch.fetch(name)
    if not found.size:
        return declared[None]
    return np.asarray((found if len(found) == 1 else found[flights])[:, node], dtype=np.float64)


def bounds_of(batch: Structs, flights: slice) -> tuple[Array, Array]:
    """Smallest lower and largest upper bounds (flights or 1, rows) over the nodes before the end."""
    rows, N = batch.description.rows, batch.dims.N
    low, high = (np.array([getattr(row, side) for row in rows]) for side in ("lower", "upper"))
    if batch.description.online["bounds"] == "fixed" or not rows:
        return low[None], high[None]
    found = []
    for name, pick in (("lower", np.min), ("upper", np.max)):
        every = batch.fetch(name)
        every = np.asarray(every if len(every) == 1 else every[flights], dtype=np.float64)
        shared = every.shape[1] <= N
        sides = [
            pick(every[:, [0] if shared else [k for k in row.nodes if k < N] or [N], i], axis=1)
            for i, row in enumerate(rows)
        ]
        found.append(np.array(sides).T)
    return found[0], found[1]
