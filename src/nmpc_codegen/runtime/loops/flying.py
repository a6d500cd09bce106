"""Closed loops of many controllers: they are flown block by block in compiled code, and summed up."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import units
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.batch.structs import Into
from nmpc_codegen.runtime.loops.flights import Flights
from nmpc_codegen.runtime.loops.judge import Samples
from nmpc_codegen.runtime.loops.loop_data import Loop

Array = NDArray[Any]

#: Bytes of the samples of a flight at most.
MOST = 2**30


def fly(loop: Loop, record: bool = False) -> Flights:
    """Fly closed loops; see Batch.simulate()."""
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
    """Costs (F,) and largest violations (F, rows) of paths that something else has flown with these data: states
    (F, steps + 1, nx), controls (F, steps, nu) and algebraic variables (F, steps, their number)."""
    return loop.judge.judge(*paths, loop.samples(slice(0, len(loop.starts))))


class _Result:
    """The arrays that blocks of flights fill."""

    def __init__(self, loop: Loop, record: bool) -> None:
        self._loop = loop
        flights, steps = len(loop.starts), loop.steps
        nx, nu = loop.batch.dims.nx, loop.batch.description.interface["NU"]
        self._shapes = (steps + 1, nx), (steps, nu), (steps,)
        self._record = [_unflown((flights, *s), i == 2) for i, s in enumerate(self._shapes)] if record else None
        self._counts = np.zeros((flights, len(Status)), np.int64)
        self._failed, self._lost = np.full(flights, -1, np.int64), np.full(flights, -1, np.int64)
        self._ended, self._seconds = np.full(flights, -1, np.int8), np.zeros((flights, 2))
        self._cost, self._last = np.zeros(flights), np.zeros((flights, nx))
        self._violation = np.zeros((flights, len(loop.judge.rows)))

    def fly(self, shared: Any, block: slice) -> None:
        """Fly a block and keep what is asked for."""
        loop = self._loop
        samples, count = loop.samples(block), block.stop - block.start
        x, u, status = (
            [_unflown((count, *s), i == 2) for i, s in enumerate(self._shapes)]
            if self._record is None
            else [a[block] for a in self._record]
        )
        z = np.full((count, loop.steps, len(loop.batch.names.algebraic)), np.nan)
        into = Into(x, u, z, status, self._failed[block], self._lost[block], self._seconds[block])
        refused = loop.batch.fly(shared, block, into, loop.rows)
        if refused < 0:  # stopped, because of an error or interrupt that is raised
            return
        if refused:
            raise ControllerError(f"{loop.batch.description.name}: data of the samples: {Status(refused)}")
        self._keep(block, x, u[..., : loop.batch.dims.nu], z, status, samples)

    def _keep(self, block: slice, x: Array, u: Array, z: Array, status: Array, samples: Samples) -> None:
        for value in Status:
            self._counts[block, value] = np.sum(status == value, axis=1)
        flown = self._counts[block].sum(axis=1)
        self._last[block] = x[np.arange(len(x)), flown]
        if status.size:
            self._ended[block] = status[np.arange(len(x)), flown - 1]
        self._seconds[block, 0] /= np.maximum(1, flown)
        self._cost[block], self._violation[block] = self._loop.judge.judge(x, u, z, samples)

    def flights(self) -> Flights:
        """The result."""
        loop, described = self._loop, self._loop.batch.description
        x, u, status = self._record or (None, None, None)
        return Flights(
            described.name,
            loop.steps,
            loop.interval,
            described.time_unit,
            loop.batch.names.states,
            loop.batch.names.controls,
            loop.judge.names,
            np.array([described.rows[i].hard for i in loop.judge.rows], dtype=np.bool_),
            units(described.states, described.controls),
            *(self._counts, self._failed, self._lost, self._ended, self._cost, self._violation),
            *(loop.judge.rounding, self._last, self._seconds),
            *(x, None if u is None else u[..., : loop.batch.dims.nu], status),
            loop.draws,
        )


def _unflown(shape: tuple[int, ...], status: bool) -> Array:
    return np.full(shape, -1, np.int8) if status else np.full(shape, np.nan)
