"""A Loop states closed loops with all their data, which are checked once.

    u_k = step(x_k + noise_k),   x_{k+1} = plant(x_k, u_k, dt) + disturbance_k

simulate() runs one closed loop; Batch.simulate() and campaigns run many; a replay runs one of many again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.batch.random import DISTURBANCE, NOISE, Draws, Random, signal
from nmpc_codegen.runtime.batch.struct_block import Structs
from nmpc_codegen.runtime.given import is_same_time
from nmpc_codegen.runtime.loops.forecasts import (
    Bounds,
    SetterData,
    Tables,
    at_samples,
    bounds_at,
    bounds_data,
    in_c,
    parameter_data,
    reference_data,
    replace_in,
)
from nmpc_codegen.runtime.loops.judge import HeldData, Judge, Samples, held_data, judge_of
from nmpc_codegen.runtime.loops.sampling import integrations, interval_of, samples_ahead

Array = NDArray[Any]

#: Random numbers of the states: a distribution, or bare standard deviations, for all states or by name.
Drawn = Random | ArrayLike | Mapping[str, ArrayLike]

#: Bit mask of the statuses that are failures.
FAILURES = sum(1 << status for status in Status if status.is_failure)


@dataclass(frozen=True, eq=False)
class Loop:
    """A loop states closed loops with the same number of samples, which begin at ``starts`` (F, nx).

    Each controller has a struct of its own, or all flights begin with a copy of one struct.
    """

    batch: Structs
    plant: Structs | None  # None: each controller is its own plant
    plant_is_true: bool  # rows and costs are evaluated with the plant's parameters
    starts: Array
    steps: int
    interval: float
    data: list[SetterData]  # for the controllers, and for plants that are copies of them
    plant_data: list[SetterData]
    draws: Draws
    added: Array | None  # (1 or F, steps, nx)
    judge: Judge
    keep: list[Any]  # objects to which C points

    def in_c(self) -> Any:
        """Return a batch_flights_t without outputs."""
        batch, driver, described = self.batch, self.batch.driver, self.batch.description
        plant = self.batch if self.plant is None else self.plant
        ahead = samples_ahead(described, self.interval)
        c = driver.ffi.new("batch_flights_t *")
        c.nx, c.nu = self.batch.dims.nx, described.interface["NU"]
        c.step, c.integrate = driver.address("step"), driver.address("integrate", plant._package)
        c.algebraic_count = len(self.batch.names.algebraic)
        if c.algebraic_count:
            c.algebraic = driver.address("algebraic")
        self._place(c.controller, self.batch, self.data, ahead)
        if self.plant is not None:
            self._place(c.plant, self.plant, self.plant_data, np.zeros(self.plant.dims.N + 1, np.int64))
        c.steps, c.number, c.seed, c.failures = self.steps, self.draws.first, self.draws.seed, FAILURES
        c.pieces = integrations(plant.description, self.interval)
        c.dt = self.interval / c.pieces
        for random, drawn in ((c.disturbance, self.draws.disturbance), (c.noise, self.draws.noise)):
            if drawn is not None:
                random.size = driver.ffi.cast("double *", batch.reach(drawn.size, self.keep))
                random.uniform, random.stream = drawn.uniform, drawn.stream
        if self.tells_known:
            c.known, c.known_size = batch.place_of_known()
        c.plant_is_true, c.stop = self.plant_is_true, batch.stop
        if self.added is not None:
            c.given = driver.ffi.cast("double *", batch.reach(self.added, self.keep))
            c.given_step = 0 if len(self.added) == 1 else self.added.strides[0]
        c.x0 = driver.ffi.cast("double *", batch.reach(self.starts, self.keep))
        return c

    @property
    def tells_known(self) -> bool:
        """Return True if the plants are separate structs, which need the controller's previous control and time."""
        return self.plant is not None and self.plant._package is self.batch._package

    @property
    def rows(self) -> int:
        """Return the largest number of values that a setter is given."""
        most = max(structs.dims.N for structs in (self.batch, self.plant or self.batch))
        return (most + 2) * max((d.width for d in (*self.data, *self.plant_data)), default=0)

    def _place(self, c: Any, structs: Structs, data: list[SetterData], ahead: NDArray[np.int64]) -> None:
        driver = self.batch.driver
        c.memory, c.structs = driver.ffi.cast("char *", self.batch.address_of(structs, self.keep)), len(structs)
        c.stride, c.size = structs.stride if len(structs) > 1 else 0, structs._package.dtype.itemsize
        c.data, c.count = in_c(self.batch, structs, data, ahead, self.keep), len(data)

    def samples(self, block: slice) -> Samples:
        """Return the data of a block of flights: the tables where given, else the data stored before the flights."""
        described, count = self.batch.description, block.stop - block.start
        truth, data = (self.of_plant, self.plant_data) if self.plant_is_true else (self.before, self.data)

        def every(values: Array) -> Array:
            return np.broadcast_to(values, (count, *values.shape[1:]))

        def over(member: str, steps: int, known: HeldData, data: list[SetterData], declared: list[float]) -> Array:
            found = every(known.of(member, block, np.array(declared)))
            return at_samples([d for d in data if d.member == member], block, steps, found)

        weight, ny = np.array(described.program.weight), described.dims.ny
        lower, upper = (every(side)[:, None] for side in self.before.bounds(described, block))
        limits = [d for d in self.data if d.setter == "BOUNDS"]
        if limits:
            lower, upper = (bounds_at(limits, i, block, self.steps + 1, side) for i, side in enumerate((lower, upper)))
        return Samples(
            p=over("p", self.steps + 1, truth, data, [v for s in described.parameters for v in s.value]),
            yref=over("yref", self.steps, self.before, self.data, [r.reference for r in described.residuals]),
            W=every(self.before.of("W", block, weight if len(weight) == ny else weight.reshape(ny, ny))),
            lower=lower,
            upper=upper,
            time=every(self.before.whole("time", block)),
            previous=every(self.before.whole("previous", block)),
        )

    @cached_property
    def before(self) -> HeldData:
        """Return the data that the controllers hold."""
        return held_data(self.batch)

    @cached_property
    def of_plant(self) -> HeldData:
        """Return the data that the plants hold."""
        return held_data(self.batch if self.plant is None else self.plant)


def state_loop(
    batch: Structs,
    X0: ArrayLike,
    plant: Structs | None,
    steps: int,
    dt: float | None,
    parameters: Tables | None,
    bounds: Bounds | None,
    references: ArrayLike | Tables | None,
    drawn: tuple[Drawn | None, Drawn | None],
    added: ArrayLike | None,
    plant_parameters: Tables | None,
    seed: int | None,
    first: int = 0,
) -> Loop:
    """Check the arguments of Batch.simulate(); ``drawn`` holds disturbance and noise.

    Raises:
        ControllerError: a shape or a number is wrong, or the plant does not fit these controllers.
    """
    seed = 0 if seed is None and all(of is None for of in drawn) else seed
    numbers: dict[str, tuple[Any, int]] = {
        "steps": (steps, 2**31 - 1),
        "seed": (seed, 2**64 - 1),
        "first": (first, 2**62),
    }
    for name, (value, most) in numbers.items():
        if not given.is_integer(value) or not 0 <= value <= most:
            raise ControllerError(f"{name} is {value!r}; expected an integer between 0 and {most}")
    starts, names = _starts(X0, batch.dims.nx, len(batch)), batch.names.states
    interval, flights = interval_of(batch.description, dt), len(starts)
    of_controller = parameter_data(batch, parameters, flights, "parameters")
    if plant is not None:
        _check_plant(batch, plant, flights, interval)
    of_plant = parameter_data(plant or batch, plant_parameters, flights, "plant_parameters")
    true = plant is None and plant_parameters is not None
    if true:  # another copy of the controller
        plant, of_plant = batch, replace_in(of_controller, of_plant)
    if plant is not None and batch.shares(plant):
        plant = plant.twin()
    limits = bounds_data(batch, bounds, flights)
    signals = signal(drawn[0], "disturbance", names, DISTURBANCE), signal(drawn[1], "noise", names, NOISE)
    return Loop(
        batch,
        plant,
        true,
        starts,
        int(steps),
        interval,
        data=[*of_controller, *limits, *reference_data(batch, references, flights)],
        plant_data=of_plant,
        draws=Draws(int(cast("int", seed)), int(first), len(names), *signals),
        added=None if added is None else _disturbances(added, flights, int(steps), len(names)),
        judge=judge_of(batch.description, interval),
        keep=[],
    )


def _disturbances(value: ArrayLike, flights: int, steps: int, nx: int) -> Array:
    """Return the given disturbances as (1 or flights, steps, nx)."""
    shape = np.shape(value) if given.ndim(value) >= 0 else ()
    allowed = [(steps, nx), (1, steps, nx), (flights, steps, nx)]
    expected = shape if shape in allowed else allowed[-1]
    array = given.checked_array(value, "added", np.dtype(np.float64), expected, True, lambda: str(allowed[0]))
    return np.ascontiguousarray(array[None] if array.ndim == 2 else array)


def _check_plant(batch: Structs, plant: Structs, flights: int, interval: float) -> None:
    """Raise ControllerError unless the plant has the states, controls and samples of the controller."""
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
    """Return the initial states (F, nx): one for each controller, or any number if there is one controller."""
    many = "any number" if count == 1 else f"{count}"
    if given.ndim(X0) != 2 or np.shape(X0)[1] != nx or (count > 1 and len(np.asarray(X0)) != count):
        raise ControllerError(f"X0 has shape {np.shape(X0)}; expected ({many}, {nx}), a state for each flight")
    return np.ascontiguousarray(given.checked_array(X0, "X0", np.dtype(np.float64), np.shape(X0)))
