"""Closed loops of many controllers run block by block in compiled code, and their results are summarised."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import units
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.batch.struct_block import Into
from nmpc_codegen.runtime.loops.flights import Flights
from nmpc_codegen.runtime.loops.flown import Flown, Labels
from nmpc_codegen.runtime.loops.judge import Samples
from nmpc_codegen.runtime.loops.loop_data import Loop

Array = NDArray[Any]

#: Largest number of bytes that the samples of a flight may take.
MOST = 2**30


def fly(loop: Loop, record: bool = False) -> Flights:
    """Run closed loops; see Batch.simulate()."""
    batch, starts = loop.batch, loop.starts
    columns = sum((batch.dims.nx, batch.dims.nu, *(2 * n for n in (batch.dims.np, batch.dims.ny)), 2))
    bytes_of = 8 * columns * (loop.steps + 1)
    if bytes_of > MOST:
        raise ControllerError(f"steps is {loop.steps}; expected at most {MOST // (8 * columns) - 1}: flights in pieces")
    size = batch.block_size(len(starts), bytes_of)
    blocks = [slice(i, min(i + size, len(starts))) for i in range(0, len(starts), size)]
    result = _Result(loop, record)
    batch.driver.share(partial(result.fly, loop.in_c()), blocks, interruptible=True)
    return result.flights()


def judge_paths(loop: Loop, paths: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Return the costs (F,) and largest violations (F, rows) of given paths with the data of this loop.

    The paths are states (F, steps + 1, nx), controls (F, steps, nu) and algebraic variables (F, steps, their number).
    """
    return loop.judge.judge(*paths, loop.samples(slice(0, len(loop.starts))))


class _Result:
    """Blocks of flights fill these arrays."""

    def __init__(self, loop: Loop, record: bool) -> None:
        self._loop = loop
        flights, steps, described = len(loop.starts), loop.steps, loop.batch.description
        nx, nu = loop.batch.dims.nx, described.interface["NU"]
        self._shapes = (steps + 1, nx), (steps, nu), (steps,)
        self._record = [_unflown((flights, *s), i == 2) for i, s in enumerate(self._shapes)] if record else None
        labels = Labels(described.names.states, loop.judge.names, ())
        self._flown = Flown.empty(labels, flights)
        self._flown.number[:] = loop.draws.first + np.arange(flights)
        self._flown.start[...] = loop.starts

    def fly(self, shared: Any, block: slice) -> None:
        """Run the flights of a block and store their results."""
        loop = self._loop
        samples, count = loop.samples(block), block.stop - block.start
        x, u, status = (
            [_unflown((count, *s), i == 2) for i, s in enumerate(self._shapes)]
            if self._record is None
            else [a[block] for a in self._record]
        )
        z = np.full((count, loop.steps, len(loop.batch.names.algebraic)), np.nan)
        failed, lost = np.full(count, -1, np.int64), np.full(count, -1, np.int64)
        into = Into(x, u, z, status, failed, lost, self._flown.seconds[block])
        refused = loop.batch.fly(shared, block, into, loop.rows)
        if refused < 0:  # stopped by an error or interrupt, which is raised
            return
        if refused:
            raise ControllerError(f"{loop.batch.description.name}: data of the samples: {Status(refused)}")
        self._flown.failed[block], self._flown.broken[block] = failed, lost
        self._keep(block, x, u[..., : loop.batch.dims.nu], z, status, samples)

    def _keep(self, block: slice, x: Array, u: Array, z: Array, status: Array, samples: Samples) -> None:
        found, every = self._flown, np.arange(len(x))
        for value in Status:
            found.samples[block, value] = np.sum(status == value, axis=1)
        flown = found.samples[block].sum(axis=1)
        found.last[block] = x[every, flown]
        found.ended[block] = status[every, flown - 1] if status.size else -1
        found.seconds[block, 0] /= np.maximum(1, flown)
        found.cost[block], found.violation[block] = self._loop.judge.judge(x, u, z, samples)

    def flights(self) -> Flights:
        """Return the results as Flights."""
        loop, described = self._loop, self._loop.batch.description
        x, u, status = self._record or (None, None, None)
        return Flights(
            self._flown.labels,
            **self._flown.columns,
            name=described.name,
            steps=loop.steps,
            dt=loop.interval,
            time_unit=described.time_unit,
            controls=loop.batch.names.controls,
            hard=np.array([described.rows[i].hard for i in loop.judge.rows], dtype=np.bool_),
            units=units(described.states, described.controls),
            rounding=loop.judge.rounding,
            x=x,
            u=None if u is None else u[..., : loop.batch.dims.nu],
            status=status,
            draws=loop.draws,
        )


def _unflown(shape: tuple[int, ...], status: bool) -> Array:
    return np.full(shape, -1, np.int8) if status else np.full(shape, np.nan)
