"""A flight again, sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.campaigns.flying.fly import Job, known_to
from nmpc_codegen.campaigns.stated.distributions import Kind
from nmpc_codegen.campaigns.stated.statement import Data
from nmpc_codegen.errors import warn
from nmpc_codegen.runtime.batch.flights import Draws
from nmpc_codegen.runtime.batch.random import DISTURBANCE, NOISE, signal
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.loops.forecast import Before, forecast
from nmpc_codegen.runtime.loops.sampling import own_plant
from nmpc_codegen.runtime.loops.simulate import Law, simulate
from nmpc_codegen.runtime.records.log import Log

Array = NDArray[np.float64]


def replay(job: Job, number: int, broken: int, last: Array, before: Before | None) -> Log:
    """The log of a flight. ``broken``: the sample after which its state was not finite, or -1; ``last``: its last state
    in the campaign, with which a warning compares that of the log."""
    log = Replay(job, number).simulate("step", job.statement.steps if broken < 0 else broken, before)
    if broken < 0 and not np.array_equal(log.x[-1], last):
        warn(
            f"flight {number} does not end where it ended in the campaign: it was flown by other machine code; "
            "build() for a processor has its instructions, the profile 'verify' has the same bits everywhere"
        )
    return log


class Replay:
    """A flight: its start, its data over the samples, its controller, its plant, which moves once in every sample."""

    def __init__(self, job: Job, number: int) -> None:
        s = job.statement
        data = s.whole_data(number)
        self.controller, self.start, self.steps, self.dt = job.controller.copy(), data.starts[0], s.steps, s.dt
        self.known, named = _tables(job, data, "known"), _tables(job, data, "reference")
        self.references: Any = named.get("", named or None)
        self._noise, gusts = _draws(job, number, NOISE), _draws(job, number, DISTURBANCE)
        added = data.added[0] if data.added is not None and data.added.ndim == 3 else data.added
        self.plant = _Plant(job, self, _tables(job, data, "plant"), [g for g in (gusts, added) if g is not None])

    def measure(self, k: int, x: Array) -> Array:
        """The state of sample k as the controller is told it."""
        return x if self._noise is None else x + self._noise[k]

    def simulate(self, law: Law, steps: int, before: Before | None = None) -> Log:
        """The log of its first samples."""
        noise = self._noise
        return simulate(
            self.controller,
            self.start,
            steps,
            self.dt,
            plant=self.plant,
            before=before,
            noise=None if noise is None else lambda k, _: noise[k],
            law=law,
            parameters=self.known or None,
            references=self.references,
        )


def _tables(job: Job, data: Data, kind: Kind) -> dict[str, Array]:
    """Tables over the samples of the only flight of these data."""
    shared = job.statement.tables.get(kind, {})
    return {n: np.atleast_1d(np.asarray(t if n in shared else t[0], float)) for n, t in data.tables[kind].items()}


def _draws(job: Job, number: int, stream: int) -> Array | None:
    """Random numbers (steps, nx) of a signal in this flight; None: there are none."""
    s = job.statement
    what = {DISTURBANCE: "disturbance", NOISE: "noise"}[stream]
    found = signal(getattr(s, what), what, s.states, stream)
    return None if found is None else Draws(s.seed, 0, len(s.states), None, None).of(found, number, s.steps)


class _Plant:
    """The plant of a flight; ``unknown``: parameters that the controller does not know, ``pushes`` (steps, nx): what is
    added to its state."""

    def __init__(self, job: Job, flight: Replay, unknown: dict[str, Array], pushes: list[Array]) -> None:
        self._controller, self._pushes, self._k = flight.controller, pushes, 0
        own = job.plant is None
        self._plant: Controller = self._controller
        if not own or unknown:
            self._plant = (job.plant or self._controller).copy()
            unknown = {**known_to(self._plant, flight.known), **unknown}
        self._tell = forecast(self._plant, job.statement.dt, unknown or None, None, None, None)
        self._is_told = self._plant is not self._controller and own and self._plant.known.size > 0
        self._integrate = own_plant(self._plant)

    def __call__(self, x: Array, u: Array, dt: float) -> Array:
        k, self._k = self._k, self._k + 1
        if self._plant is not self._controller:
            self._tell(k, self._plant)
        if self._is_told:
            self._plant.known[...] = self._controller.known
        moved = np.asarray(self._integrate(x, u, dt), dtype=np.float64)
        for push in self._pushes:
            moved = moved + push[k]
        return moved
