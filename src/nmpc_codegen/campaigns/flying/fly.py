"""A Job holds everything that the flights of a campaign share; a Flyer flies parts of it."""

from __future__ import annotations

import pickle
import threading
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.campaigns.stated.flight_statement import FlightData, FlightStatement, Given
from nmpc_codegen.runtime.batch.choose import make
from nmpc_codegen.runtime.batch.many import Batch
from nmpc_codegen.runtime.batch.struct_block import Structs, single
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.loops.flights import Flights
from nmpc_codegen.runtime.loops.flown import Flown, Labels
from nmpc_codegen.runtime.loops.flying import fly, judge_paths
from nmpc_codegen.runtime.loops.forecasts import at_samples, parameter_data, reference_data, replace_in
from nmpc_codegen.runtime.loops.judge import judge_of
from nmpc_codegen.runtime.loops.loop_data import Loop, state_loop
from nmpc_codegen.runtime.loops.one_loop import Conduct, run
from nmpc_codegen.runtime.records.log import Log
from nmpc_codegen.runtime.records.notes import spacing

Array = NDArray[np.float64]
Device = Literal["cpu", "cuda"]


@dataclass(frozen=True, eq=False)
class Job:
    """A job holds all data that the parts of a campaign share.

    ``plant=None`` stands for the controller's own integrator.
    """

    controller: Controller
    plant: Controller | None
    statement: FlightStatement
    device: Device = "cpu"

    @property
    def labels(self) -> Labels:
        """Return the names of the columns of the results."""
        described = self.controller.description
        return Labels(described.names.states, judge_of(described, self.statement.dt).names, self.statement.drawn)

    def loop(self, batch: Structs, plant: Structs | None, data: FlightData, first: int, steps: int) -> Loop:
        """Return the loop over the first ``steps`` samples of flights with these data, numbered from ``first`` on."""
        s, known, unknown = self.statement, data.tables["known"], data.tables["plant"]
        drawn, added = (s.disturbance, s.noise), None if data.added is None else data.added[..., :steps, :]
        of = batch, data.starts, plant, steps, s.dt, known or None, None, data.references
        found = state_loop(*of, drawn, added, unknown or None, s.seed, first)
        if plant is None:
            return found
        theirs = {*plant.names.parameters, *(signal.name for signal in plant.description.parameters)}
        shared = {name: table for name, table in known.items() if name in theirs}
        return replace(
            found, plant_data=replace_in(parameter_data(plant, shared, len(data.starts), "known"), found.plant_data)
        )

    def last_references(self, first: int, count: int) -> Array:
        """Return the references (F, ny) of the path residual after the last sample, for flights from ``first`` on."""
        s, described = self.statement, self.controller.description
        data = reference_data(self.controller, s.whole_data(first, count).references, count)
        path, declared = [d for d in data if d.member == "yref"], [r.reference for r in described.residuals]
        return at_samples(path, slice(0, count), s.steps + 1, np.tile(declared, (count, 1)))[:, -1]

    def fly_again(self, ctrl: Controller, number: int, conduct: Conduct, steps: int | None = None) -> Log:
        """Fly a flight, or its first samples, with ``ctrl``, a copy of the controller, and return the log."""
        data, count = self.statement.whole_data(number), self.statement.steps if steps is None else steps
        plant = None if self.plant is None else single(self.plant.copy())
        return run(self.loop(single(ctrl), plant, data, number, count), ctrl, conduct, spacing(ctrl, count))


class Flyer:
    """A flyer flies parts of a job with ``threads`` threads; None: with one for each core."""

    def __init__(self, job: Job, threads: int | None) -> None:
        self._job, self._labels = job, job.labels
        self._batch: Batch = make(job.controller, 1, job.device, threads)

    def fly(self, first: int, count: int, own: Given) -> Flown:
        """Fly the flights from ``first`` on; ``own`` holds the data given for each of them."""
        data = self._job.statement.data(first, count, own)
        return Flown(self._labels, **{**self.simulate(data, first).columns, "drawn": data.drawn})

    def simulate(self, data: FlightData, first: int, record: bool = False) -> Flights:
        """Fly the flights with these data."""
        return fly(self._loop(data, first), record)

    def judge(self, data: FlightData, first: int, paths: tuple[Array, Array, Array]) -> Array:
        """Return the costs (F,) of other paths with these data: states, controls, algebraic variables."""
        return judge_paths(self._loop(data, first), paths)[0]

    def _loop(self, data: FlightData, first: int) -> Loop:
        job = self._job
        plant = None if job.plant is None else self._batch.structs_of(job.plant)
        return job.loop(self._batch, plant, data, first, job.statement.steps)


@lru_cache(maxsize=64)
def _flyer(job: bytes, thread: int) -> Flyer:
    """Return the Flyer of a job for a thread of a worker; its package is compiled once."""
    return Flyer(pickle.loads(job), 1)


def fly_elsewhere(job: bytes, first: int, count: int, own: Given, attempt: int) -> Flown:
    """Fly a part of a pickled job with one thread of a worker; ``attempt`` makes a repeated call differ."""
    return _flyer(job, threading.get_ident()).fly(first, count, own)
