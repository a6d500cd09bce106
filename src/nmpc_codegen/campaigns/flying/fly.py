"""A part of a campaign: what a worker flies, here or elsewhere."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.campaigns.flying.flown import Flown, Labels
from nmpc_codegen.campaigns.stated.statement import Data, Given, Statement
from nmpc_codegen.runtime.batch.choose import make
from nmpc_codegen.runtime.batch.flights import Flights
from nmpc_codegen.runtime.batch.loop import Task, judge_paths
from nmpc_codegen.runtime.batch.many import Batch
from nmpc_codegen.runtime.batch.structs import single
from nmpc_codegen.runtime.batch.summary import judge_of
from nmpc_codegen.runtime.controller import Controller

Array = NDArray[np.float64]
Device = Literal["cpu", "cuda"]


@dataclass(frozen=True, eq=False)
class Job:
    """Everything that parts of a campaign share. ``plant``: None, the controller's own integrator."""

    controller: Controller
    plant: Controller | None
    statement: Statement
    device: Device = "cpu"

    @property
    def labels(self) -> Labels:
        """Names of what is kept."""
        described = self.controller.description
        return Labels(described.names.states, judge_of(described, self.statement.dt).names, self.statement.drawn)


def known_to(plant: Controller, tables: Mapping[str, Array]) -> dict[str, Array]:
    """Those tables of parameters that a plant has, too."""
    theirs = {*plant.names.parameters, *(signal.name for signal in plant.description.parameters)}
    return {name: table for name, table in tables.items() if name in theirs}


class Flyer:
    """Flies parts of a job with ``threads`` threads; None: all cores."""

    def __init__(self, job: Job, threads: int | None) -> None:
        self._job, self._labels = job, job.labels
        self._batch: Batch = make(job.controller, 1, job.device, threads)

    def fly(self, first: int, count: int, own: Given) -> Flown:
        """The flights from ``first`` on; ``own``: what is given for them."""
        data = self._job.statement.data(first, count, own)
        return Flown.of(self.simulate(data, first), first, data.drawn, data.starts, self._labels)

    def simulate(self, data: Data, first: int, record: bool = False) -> Flights:
        """The flights of these data."""
        return self._batch.simulate(data.starts, plant=self._job.plant, **self._words(data, first), record=record)

    def judge(self, data: Data, first: int, paths: tuple[Array, Array, Array]) -> Array:
        """Costs (F,) of paths of other loops with these data: states, controls, algebraic variables."""
        task = Task(**self._words(data, first), record=False)
        plant = None if self._job.plant is None else single(self._job.plant)
        return judge_paths(self._batch, data.starts, task, plant, paths)[0]

    def _words(self, data: Data, first: int) -> dict[str, Any]:
        """Arguments of Batch.simulate()."""
        job, s = self._job, self._job.statement
        unknown = dict(data.tables["plant"])
        if job.plant is not None:
            unknown = {**known_to(job.plant, data.tables["known"]), **unknown}
        return {
            "steps": s.steps,
            "dt": s.dt,
            "parameters": data.tables["known"] or None,
            "references": data.references,
            "disturbance": s.disturbance,
            "noise": s.noise,
            "added": data.added,
            "plant_parameters": unknown or None,
            "seed": s.seed,
            "first": first,
        }


@lru_cache(maxsize=64)
def _flyer(job: bytes, thread: int) -> Flyer:
    """What a thread of a worker keeps of a job: its package is compiled once."""
    return Flyer(pickle.loads(job), 1)


def fly_elsewhere(job: bytes, first: int, count: int, own: Given, attempt: int) -> Flown:
    """A part of a pickled job, by one thread of a worker. ``attempt``: a part that was lost is another call."""
    return _flyer(job, threading.get_ident()).fly(first, count, own)
