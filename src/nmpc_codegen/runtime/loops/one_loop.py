"""One closed loop runs sample by sample and is logged: in compiled code, or in Python if Python functions take part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.batch.struct_block import Into
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.estimation.observer import Observer
from nmpc_codegen.runtime.estimation.sensing import Sensing
from nmpc_codegen.runtime.loops.loop_data import Loop
from nmpc_codegen.runtime.loops.progress import Progress
from nmpc_codegen.runtime.loops.sampling import Plant, own_plant
from nmpc_codegen.runtime.records.log import Log
from nmpc_codegen.runtime.records.notes import Notes

Array = NDArray[np.float64]
Before = Callable[[int, Controller], Any]
Disturbance = Callable[[int, Array], ArrayLike]
#: A function that takes a sample: (measured state, number) -> control, computing time (ns).
Sample = Callable[[Array, int], tuple[Array, int]]
Law = Literal["step", "solve"] | Sample


@dataclass(frozen=True, eq=False)
class Conduct:
    """The conduct of a loop is the Python functions that take part in it; see simulate()."""

    plant: Plant | None = None
    disturbance: Disturbance | None = None
    noise: Disturbance | None = None
    before: Before | None = None
    law: Law = "step"
    estimator: Observer | None = None
    seed: int | None = 0

    @property
    def is_compiled(self) -> bool:
        """Return True if no Python function takes part."""
        functions = (self.plant, self.disturbance, self.noise, self.before, self.estimator)
        return self.law == "step" and all(function is None for function in functions)


def run(loop: Loop, ctrl: Controller, conduct: Conduct, every: int, warm_start: bool = False) -> Log:
    """Run the only flight of a loop with ``ctrl``, whose struct the loop uses, and return the log.

    ``every`` is the number of samples from one logged plan to the next.
    """
    notes = Notes(ctrl, loop.steps, loop.interval, every)
    notes.x[0] = loop.starts[0]
    flight = (_Compiled if conduct.is_compiled else _InPython)(loop, ctrl, conduct, notes)
    if warm_start:
        flight.solve_first()
    with Progress(ctrl.description.name, loop.steps, "samples") as progress:
        for k in range(loop.steps):
            flight.take(k)
            progress.add()
    return notes.finish(flight.sensing.record() if flight.sensing else None)


class _Flight:
    """The base class has the compiled loop, whose outputs are the arrays of the log."""

    sensing: Sensing | None = None

    def __init__(self, loop: Loop, ctrl: Controller, conduct: Conduct, notes: Notes) -> None:
        self._loop, self._ctrl, self._conduct, self._notes = loop, ctrl, conduct, notes
        self._lib, steps = loop.batch.driver.lib, loop.steps
        self._u = np.zeros((steps, loop.batch.description.interface["NU"]))
        self._seconds, self._lost = np.zeros(2), np.full(1, -1, np.int64)
        z, status = np.zeros((steps, len(ctrl.names.algebraic))), np.zeros(steps, np.int8)
        into = Into(notes.x, self._u, z, status, np.full(1, -1, np.int64), self._lost, self._seconds)
        self._c, keep = loop.batch.aim(loop.in_c(), into, loop.rows)
        self._c.tells_all = conduct.before is not None
        self._keep = [into, *keep]

    def take(self, k: int) -> None:
        """Take sample k and log it."""
        raise NotImplementedError

    def solve_first(self) -> None:
        """Iterate to convergence with the data of the first sample.

        A plan that has not converged is a start as well. After prepare(), the first sample uses this plan for any
        measured state.
        """
        self._tell(0)
        self._ctrl.solve(self._notes.x[0])
        if self._ctrl.description.has_phases:
            self._ctrl.prepare()

    def _tell(self, k: int) -> None:
        """Set the tabulated data of sample k, then call the user's function."""
        self._accept(self._lib.batch_tell_sample(self._c, k))
        if self._conduct.before is not None:
            self._conduct.before(k, self._ctrl)

    def _accept(self, refused: int) -> None:
        """Raise ControllerError if a setter has refused data."""
        if refused:
            raise ControllerError(f"{self._ctrl.description.name}: data of the samples: {Status(refused)}")

    def _check_move(self, value: ArrayLike, k: int) -> Array:
        """Return the checked state after sample k; an error names the state and controls before it, and the reason."""
        notes, names = self._notes, self._ctrl.names

        def say() -> str:
            signals = zip((*names.states, *names.controls), (*notes.x[k], *notes.u[k]), strict=True)
            start = ", ".join(f"{name} = {number:.4g}" for name, number in signals)
            return (
                f"; it moved from {start}. The integrator of the package needs more steps there, or plant= another "
                f"one; the sample: {self._ctrl.diagnose()}"
            )

        return checked_state(value, notes.x.shape[1], f"the plant's state after sample {k}", say)


class _Compiled(_Flight):
    """The loop runs in compiled code, as in a flight of a batch."""

    def take(self, k: int) -> None:
        self._seconds[:] = 0.0
        measured = self._loop.batch.driver.pointer(self._ctrl._xhat)
        self._accept(self._lib.batch_fly_sample(self._c, k, measured))
        u = self._u[k, : self._ctrl.dims.nu]
        self._ctrl.note_sample(u, round(1e9 * self._seconds[0]))
        self._notes.take(k, u, self._ctrl.time_ns)
        if self._lost[0] >= 0:  # possibly before the last integration of the sample
            end = self._notes.x[k + 1]
            self._check_move(np.full_like(end, np.nan) if np.isfinite(end).all() else end, k)


class _InPython(_Flight):
    """A loop runs in Python with the same samples, phase by phase."""

    def __init__(self, loop: Loop, ctrl: Controller, conduct: Conduct, notes: Notes) -> None:
        super().__init__(loop, ctrl, conduct, notes)
        other = loop.plant
        self._plant = ctrl if other is None else Controller(other._package, other.memory)
        self._move = conduct.plant or own_plant(self._plant)
        self._sample = self._sample_by(conduct.law)
        self._noise, gusts = (
            None if signal is None else loop.draws.of(signal, 0, loop.steps)
            for signal in (loop.draws.noise, loop.draws.disturbance)
        )
        self._pushes = [push for push in (gusts, None if loop.added is None else loop.added[0]) if push is not None]
        if conduct.estimator is not None:
            self.sensing = Sensing(ctrl, conduct.estimator, conduct.seed, loop.steps, loop.interval, self._plant)

    def take(self, k: int) -> None:
        x, notes, conduct = self._notes.x, self._notes, self._conduct
        self._tell(k)
        notes.take(k, *self._sample(self._look(k), k))
        if self._loop.tells_known:
            self._plant.known[...] = self._ctrl.known
        x[k + 1] = self._check_move(self._move(x[k].copy(), notes.u[k].copy(), self._loop.interval), k)
        for push in self._pushes:
            x[k + 1] += push[k]
        if conduct.disturbance is not None:
            x[k + 1] += checked_state(conduct.disturbance(k, x[k].copy()), x.shape[1], f"the disturbance of sample {k}")

    def _look(self, k: int) -> Array:
        """Return the state that the controller receives at sample k."""
        x, u = self._notes.x[k], self._notes.u
        if self.sensing is not None:
            return self.sensing.look(k, x, u[k - 1] if k else np.zeros(u.shape[1]))
        if self._conduct.noise is not None:
            return np.asarray(x + checked_state(self._conduct.noise(k, x.copy()), len(x), f"the noise of sample {k}"))
        return x if self._noise is None else np.asarray(x + self._noise[k])

    def _sample_by(self, law: Law) -> Sample:
        """Return the function that takes a sample.

        solve() does not shift the plan for the next sample, so this function does.
        """
        ctrl, added = self._ctrl, self._ctrl.description.augmentation

        def step(x: Array, k: int) -> tuple[Array, int]:
            return ctrl.step(x), ctrl.time_ns

        def solve(x: Array, k: int) -> tuple[Array, int]:
            if k > 0 and ctrl.description.shift is not None:
                ctrl.shift()
            found = ctrl.solve(x)
            if added.previous:
                ctrl.set_previous(found.u[0])
            if added.time:
                ctrl.set_time(ctrl.time + self._loop.interval)
            return found.u[0], found.time_ns

        if callable(law):
            return law
        if not isinstance(law, str) or law not in ("step", "solve"):
            raise ControllerError(f"law is {law!r}; allowed: 'step', 'solve'")
        return step if law == "step" else solve


def checked_state(value: ArrayLike, nx: int, what: str, say: Callable[[], str] = str) -> Array:
    """Return a finite state (nx,); ``say`` returns words to add to an error."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ControllerError(f"{what} is no array of numbers: {error}") from error
    if array.shape != (nx,):
        raise ControllerError(f"{what} has shape {array.shape}; expected ({nx},)")
    if not np.all(np.isfinite(array)):
        raise ControllerError(f"{what} is not finite: {array.tolist()}{say()}")
    return array
