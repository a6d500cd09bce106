"""Closed loops of many controllers: what the compiled loop is given, block by block, and what is kept of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import units
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.batch.flights import Draws, Flights
from nmpc_codegen.runtime.batch.random import DISTURBANCE, NOISE, Random, Signal, signal
from nmpc_codegen.runtime.batch.structs import Into, Structs
from nmpc_codegen.runtime.batch.summary import Before, Judge, Samples, before, judge_of
from nmpc_codegen.runtime.batch.tables import Data, Tables, at_samples, in_c, parameter_data, reference_data, replace_in
from nmpc_codegen.runtime.given import is_same_time
from nmpc_codegen.runtime.loops.sampling import integrations, interval_of, samples_ahead

Array = NDArray[Any]

#: Bytes of the samples of a flight at most.
MOST = 2**30

#: Bits of the statuses that are failures.
FAILURES = sum(1 << status for status in Status if status.is_failure)


@dataclass(frozen=True, eq=False)
class Task:
    """The arguments of Batch.simulate()."""

    steps: int
    dt: float | None
    parameters: Tables | None
    references: ArrayLike | Tables | None
    disturbance: Random | ArrayLike | Mapping[str, ArrayLike] | None
    noise: Random | ArrayLike | Mapping[str, ArrayLike] | None
    added: ArrayLike | None
    plant_parameters: Tables | None
    seed: int
    first: int
    record: bool

    def check(self) -> None:
        """ControllerError if a number is wrong."""
        for name, most in (("steps", 2**31 - 1), ("seed", 2**64 - 1), ("first", 2**62)):
            value = getattr(self, name)
            if not given.is_integer(value) or not 0 <= value <= most:
                raise ControllerError(f"{name} is {value!r}; expected an integer between 0 and {most}")


@dataclass(frozen=True, eq=False)
class Loop:
    """Everything that blocks of flights share."""

    batch: Structs
    plant: Structs | None
    plant_is_true: bool  # rows and costs are those of the plant's parameters
    starts: Array
    steps: int
    interval: float
    data: list[Data]  # of the controllers, and of plants that are theirs
    plant_data: list[Data]
    disturbance: Signal | None
    noise: Signal | None
    added: Array | None
    seed: int
    first: int
    judge: Judge
    keep: list[Any]  # what C points to

    def in_c(self) -> Any:
        """batch_flights_t without what a block writes to."""
        batch, driver, described = self.batch, self.batch.driver, self.batch.description
        plant = self.batch if self.plant is None else self.plant
        ahead = samples_ahead(described, self.interval)
        c = driver.ffi.new("batch_flights_t *")
        c.step, c.integrate = driver.address("step"), driver.address("integrate", plant._package)
        c.algebraic_count = len(self.batch.names.algebraic)
        if c.algebraic_count:
            c.algebraic = driver.address("algebraic")
        self._place(c.controller, self.batch, self.data, ahead)
        if self.plant is not None:
            self._place(c.plant, self.plant, self.plant_data, np.zeros(self.plant.dims.N + 1, np.int64))
        c.steps, c.number, c.seed, c.failures = self.steps, self.first, self.seed, FAILURES
        c.pieces = integrations(plant.description, self.interval)
        c.dt = self.interval / c.pieces
        for random, drawn in ((c.disturbance, self.disturbance), (c.noise, self.noise)):
            if drawn is not None:
                random.size = driver.ffi.cast("double *", batch.reach(drawn.size, self.keep))
                random.uniform, random.stream = drawn.uniform, drawn.stream
        if plant._package is batch._package and plant is not batch:
            c.known, c.known_size = batch.place_of_known()
        c.plant_is_true, c.stop = self.plant_is_true, batch.stop
        if self.added is not None:
            c.given = driver.ffi.cast("double *", batch.reach(self.added, self.keep))
            c.given_step = 0 if len(self.added) == 1 else self.added.strides[0]
        c.x0 = driver.ffi.cast("double *", batch.reach(self.starts, self.keep))
        return c

    @property
    def rows(self) -> int:
        """Numbers that a setter is given at most."""
        most = max(structs.dims.N for structs in (self.batch, self.plant or self.batch))
        return (most + 2) * max((d.width for d in (*self.data, *self.plant_data)), default=0)

    def _place(self, c: Any, structs: Structs, data: list[Data], ahead: NDArray[np.int64]) -> None:
        driver = self.batch.driver
        c.memory, c.structs = driver.ffi.cast("char *", self.batch.address_of(structs, self.keep)), len(structs)
        c.stride, c.size = structs.stride if len(structs) > 1 else 0, structs._package.dtype.itemsize
        c.data, c.count = in_c(self.batch, structs, data, ahead, self.keep), len(data)

    def samples(self, block: slice) -> Samples:
        """Data of a block as they are before the first sample, with those of the tables."""
        described, count = self.batch.description, block.stop - block.start
        truth, data = (self.of_plant, self.plant_data) if self.plant_is_true else (self.before, self.data)

        def every(values: Array) -> Array:
            return np.broadcast_to(values, (count, *values.shape[1:]))

        def over(member: str, steps: int, known: Before, data: list[Data], declared: list[float]) -> Array:
            found = every(known.of(member, block, np.array(declared)))
            return at_samples([d for d in data if d.member == member], block, steps, found)

        weight, ny = np.array(described.program.weight), described.dims.ny
        lower, upper = self.before.bounds(described, block)
        return Samples(
            p=over("p", self.steps + 1, truth, data, [v for s in described.parameters for v in s.value]),
            yref=over("yref", self.steps, self.before, self.data, [r.reference for r in described.residuals]),
            W=every(self.before.of("W", block, weight if len(weight) == ny else weight.reshape(ny, ny))),
            lower=every(lower),
            upper=every(upper),
            time=every(self.before.whole("time", block)),
            previous=every(self.before.whole("previous", block)),
        )

    @cached_property
    def before(self) -> Before:
        """What the controllers hold."""
        return before(self.batch)

    @cached_property
    def of_plant(self) -> Before:
        """What the plants hold."""
        return before(self.batch if self.plant is None else self.plant)


def simulate_all(batch: Structs, X0: ArrayLike, task: Task, plant: Structs | None) -> Flights:
    """Fly closed loops; see Batch.simulate()."""
    task.check()
    starts = _starts(X0, batch.dims.nx, len(batch))
    loop = _loop(batch, plant, starts, task)
    columns = sum((batch.dims.nx, batch.dims.nu, *(2 * n for n in (batch.dims.np, batch.dims.ny)), 2))
    bytes_of = 8 * columns * (loop.steps + 1)
    if bytes_of > MOST:
        raise ControllerError(f"steps is {loop.steps}; expected at most {MOST // (8 * columns) - 1}: flights in pieces")
    size = batch.block_size(len(starts), bytes_of)
    blocks = [slice(i, min(i + size, len(starts))) for i in range(0, len(starts), size)]
    result = _Result(loop, task.record)
    batch.driver.share(partial(result.fly, loop.in_c()), blocks, interruptible=True)
    return result.flights()


def judge_paths(
    batch: Structs, X0: ArrayLike, task: Task, plant: Structs | None, paths: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """Costs (F,) and largest violations (F, rows) of paths that something else has flown with the data of a task:
    states (F, steps + 1, nx), controls (F, steps, nu) and algebraic variables (F, steps, their number)."""
    task.check()
    loop = _loop(batch, plant, _starts(X0, batch.dims.nx, len(batch)), task)
    return loop.judge.judge(*paths, loop.samples(slice(0, len(loop.starts))))


def _loop(batch: Structs, plant: Structs | None, starts: Array, task: Task) -> Loop:
    """The checked arguments."""
    names, flights = batch.names.states, len(starts)
    interval = interval_of(batch.description, task.dt)
    parameters = parameter_data(batch, task.parameters, flights, "parameters")
    if plant is not None:
        _check_plant(batch, plant, flights, interval)
    of_plant = parameter_data(plant or batch, task.plant_parameters, flights, "plant_parameters")
    true = plant is None and task.plant_parameters is not None
    if true:  # another copy of the controller
        plant, of_plant = batch, replace_in(parameters, of_plant)
    if plant is not None and batch.shares(plant):
        plant = plant.twin()
    return Loop(
        batch,
        plant,
        true,
        starts,
        int(task.steps),
        interval,
        data=[*parameters, *reference_data(batch, task.references, flights)],
        plant_data=of_plant,
        disturbance=signal(task.disturbance, "disturbance", names, DISTURBANCE),
        noise=signal(task.noise, "noise", names, NOISE),
        added=None if task.added is None else _disturbances(task.added, flights, int(task.steps), len(names)),
        seed=int(task.seed),
        first=int(task.first),
        judge=judge_of(batch.description, interval),
        keep=[],
    )


def _disturbances(value: ArrayLike, flights: int, steps: int, nx: int) -> Array:
    """Given disturbances (1 or flights, steps, nx)."""
    shape = np.shape(value) if given.ndim(value) >= 0 else ()
    allowed = [(steps, nx), (1, steps, nx), (flights, steps, nx)]
    expected = shape if shape in allowed else allowed[-1]
    array = given.checked_array(value, "added", np.dtype(np.float64), expected, True, lambda: str(allowed[0]))
    return np.ascontiguousarray(array[None] if array.ndim == 2 else array)


def _check_plant(batch: Structs, plant: Structs, flights: int, interval: float) -> None:
    """ControllerError unless the plant has the states, controls and samples of the controller."""
    own, other = batch.description, plant.description
    for what in ("states", "controls"):
        ours, theirs = getattr(batch.names, what), getattr(plant.names, what)
        if ours != theirs:
            raise ControllerError(f"plant: {other.name} has the {what} {theirs}; expected {ours}")
    for what in ("precision",) if other.discrete or own.discrete else ("precision", "time_unit"):
        if getattr(own, what) != getattr(other, what):
            raise ControllerError(
                f"plant: {other.name} has the {what} {getattr(other, what)!r}, not that of {own.name}"
            )
    if other.discrete and not is_same_time(other.dt[0], interval):
        raise ControllerError(f"plant: {other.name} is a map of {other.dt[0]!r}, a sample takes {interval!r}")
    if other.augmentation.count and plant._package is not batch._package:
        raise ControllerError(
            f"plant: {other.name} knows time or previous controls, which no other controller tells it"
        )
    if len(plant) not in (1, flights):
        raise ControllerError(f"plant: a batch of {len(plant)}; expected one plant, or one for each of {flights}")


def _starts(X0: ArrayLike, nx: int, count: int) -> Array:
    """Initial states (F, nx): as many as controllers, or any number if there is one controller."""
    many = "any number" if count == 1 else f"{count}"
    if given.ndim(X0) != 2 or np.shape(X0)[1] != nx or (count > 1 and len(np.asarray(X0)) != count):
        raise ControllerError(f"X0 has shape {np.shape(X0)}; expected ({many}, {nx}), a state for each flight")
    return np.ascontiguousarray(given.checked_array(X0, "X0", np.dtype(np.float64), np.shape(X0)))


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
        draws = Draws(loop.seed, loop.first, loop.batch.dims.nx, loop.disturbance, loop.noise)
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
            draws,
        )


def _unflown(shape: tuple[int, ...], status: bool) -> Array:
    return np.full(shape, -1, np.int8) if status else np.full(shape, np.nan)
