"""Record a controller in a real loop: what it was told, what it did and when, with plans and data."""

from __future__ import annotations

import os
import struct
import weakref
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter_ns
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.given import is_integer
from nmpc_codegen.runtime.loops.sampling import interval_of
from nmpc_codegen.runtime.memory import OnFailure
from nmpc_codegen.runtime.package import open_package
from nmpc_codegen.runtime.pictures.times import NANOSECONDS
from nmpc_codegen.runtime.records import stream
from nmpc_codegen.runtime.records.log import Log
from nmpc_codegen.runtime.records.notes import Notes, spacing

Array = NDArray[Any]

STAMPS = struct.Struct("<qqq")  # number of the sample, when it began, how long it took (ns)
MEMORY = 2**26  # bytes of samples that are kept in memory
SECONDS = 4.0  # of a loop whose samples fit into memory before they are written
USUAL_SLOTS, LEAST_SLOTS = 256, 2
PADDING = 8  # bytes between two members of a struct, at most


class Layout:
    """The bytes of a sample: its stamps, the measured state, the control, and members of the solver struct.

    ``plan``, ``rest``: (first, last) bytes of the struct with the iterate, and with settings and results.
    """

    def __init__(self, ctrl: Controller) -> None:
        fields: Any = ctrl._struct.dtype.fields
        members = ctrl.description.members("solver")
        spans = {name: (fields[name][1], fields[name][1] + fields[name][0].itemsize) for name in members}
        of_roles = {name: spans[name] for name, member in members.items() if member.role in ("setting", "result")}
        self.plan = _join([spans[name] for name, member in members.items() if member.role == "iterate"])
        known = [spans["xhat"]] if "xhat" in spans and ctrl.description.inner.count else []
        self.rest = _join([*of_roles.values(), *known])
        if self.plan and self.rest and 0 <= self.rest[0][0] - self.plan[-1][1] <= PADDING:
            self.rest[0] = self.plan[-1][1], self.rest[0][1]  # so that both can be copied at once
        real = ctrl.description.real.itemsize
        self.x = STAMPS.size, STAMPS.size + real * ctrl.dims.nx
        self.u = self.x[1], self.x[1] + real * ctrl.dims.nu
        place, self.places = self.u[1], []
        for first, last in (*self.plan, *self.rest):
            self.places.append((place, place + last - first))
            place += last - first
        self.size = place


def _join(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Spans in order, those that touch each other in one."""
    found: list[tuple[int, int]] = []
    for first, last in sorted(spans):
        if found and first - found[-1][1] <= PADDING:
            found[-1] = found[-1][0], last
        else:
            found.append((first, last))
    return found


class Recorder:
    """Records the samples of a controller; ``with Recorder(controller, dt=0.01, file="run.rec") as r: u = r.step(x)``.

    Set data and read the plan at the controller itself. A sample takes about two microseconds more. A thread writes
    four times a second, so that a program that is killed loses less than a second. If the disk cannot follow for
    seconds, samples are left out rather than late: ``dropped``. ``missed``: samples that took longer than ``dt``.

    Args:
        controller: the controller; it may have taken samples before.
        dt: time between samples, in the unit of time of the problem, which is their deadline, too; None: that of the
            controller.
        file: a new file, which open_recording() reads; None: the last samples remain in memory.
        keep: without a file, how many samples; None: as many as 64 MiB hold.
        plans: the plan of every so many samples is recorded, and of those that are not OK; 0: only of the latter.

    Raises:
        ControllerError: an argument is wrong, or the file exists or cannot be written.
    """

    def __init__(
        self,
        controller: Controller,
        dt: float | None = None,
        file: str | os.PathLike[str] | None = None,
        *,
        keep: int | None = None,
        plans: int = 1,
    ) -> None:
        if not isinstance(controller, Controller):
            raise ControllerError(f"Recorder: {controller!r} is no controller; an estimator is not recorded")
        if file is not None and (not isinstance(file, str | os.PathLike) or not os.fspath(file)):
            raise ControllerError(f"Recorder: file is {file!r}; expected the path of a new file")
        for name, value, least in (("plans", plans, 0), ("keep", 1 if keep is None else keep, 1)):
            if not is_integer(value) or value < least:
                raise ControllerError(f"Recorder: {name} is {value!r}; expected an integer >= {least}")
        self._ctrl, self._layout, self._closed = controller, Layout(controller), False
        self._file = None if file is None else Path(file).absolute()
        self.dt = interval_of(controller.description, dt)
        self._deadline = NANOSECONDS.get(controller.description.time_unit, 0.0) * self.dt
        needs_plan = controller.description.inner.count and "xhat" not in controller.description.members("solver")
        self._every = 1 if needs_plan else int(plans)
        self.samples = self.missed = self.dropped = 0
        slots = self._slots(keep)
        try:
            self._ring = stream.Ring(slots, self._layout.size)
        except (MemoryError, OverflowError) as error:
            size = slots * self._layout.size
            raise ControllerError(f"Recorder: {slots} samples take {size} bytes; expected fewer in keep=") from error
        self._prepare_views()
        self._writer = None if self._file is None else stream.Writer(self._file, self._ring, self._description())
        self._finalize = weakref.finalize(self, _close, self._writer)

    def _slots(self, keep: int | None) -> int:
        most = max(LEAST_SLOTS, MEMORY // self._layout.size)
        if self._file is None:
            return most if keep is None else int(keep)
        return min(most, max(USUAL_SLOTS, int(SECONDS * 1e9 / self._deadline) if self._deadline else 0))

    def _prepare_views(self) -> None:
        """Views of the bytes that every sample copies, looked up once."""
        memory, layout, ctrl = self._ctrl._memory.data, self._layout, self._ctrl
        self._x, self._u = (memoryview(a.view(np.uint8).data) for a in (ctrl._xhat, ctrl._u0))
        sources = [memory[first:last] for first, last in (*layout.plan, *layout.rest)]
        self._of_all = [(*place, source) for place, source in zip(layout.places, sources, strict=True)]
        self._of_rest = self._of_all[len(layout.plan) :]
        if len(sources) == 2 and layout.plan[0][1] == layout.rest[0][0]:
            whole = memory[layout.plan[0][0] : layout.rest[0][1]]
            self._of_all = [(layout.places[0][0], layout.places[1][1], whole)]
        self._status = ctrl._struct["status"]
        self._target = memoryview(self._ring.buffer)

    def _description(self) -> dict[str, Any]:
        ctrl = self._ctrl
        return {
            "name": ctrl.description.name,
            "package": ctrl._package.fingerprint,
            "size": self._layout.size,
            "dt": self.dt,
            "plans": self._every,
            "began": datetime.now(UTC).isoformat(),
        }

    # -- samples ------------------------------------------------------------------------------------------------------

    def step(self, x: ArrayLike, on_failure: OnFailure = "status") -> Array:
        """A sample; see Controller.step()."""
        return self._record(self._ctrl.step, x, "step", on_failure)

    def feedback(self, x: ArrayLike, on_failure: OnFailure = "status") -> Array:
        """The second phase of a sample, after prepare() of the controller; see Controller.feedback()."""
        return self._record(self._ctrl.feedback, x, "feedback", on_failure)

    def _record(self, call: Callable[[ArrayLike], Array], x: ArrayLike, name: str, on_failure: OnFailure) -> Array:
        """Call the controller and copy what belongs to the sample; what the controller refuses is none."""
        if self._closed:
            raise ControllerError(f"{name}(): the recorder is closed; go on with the controller, or with a new one")
        began = perf_counter_ns()
        u = call(x)
        self._take(began)
        if on_failure != "status":
            self._ctrl._judge(self._ctrl.status, name, on_failure)
        return u

    def _take(self, began: int) -> None:
        ring, layout, target, number = self._ring, self._layout, self._target, self.samples
        took = self._ctrl._prepare_ns + self._ctrl._feedback_ns
        if took > self._deadline > 0.0:
            self.missed += 1
        if self._writer is not None and ring.head - ring.tail >= ring.slots and not self._make_room(began):
            self.dropped += 1
            self.samples = number + 1
            return
        start = ring.head % ring.slots * ring.size
        planned = (self._every and number % self._every == 0) or self._status[()] != 0
        STAMPS.pack_into(ring.buffer, start, number if planned else ~number, began, took)
        target[start + layout.x[0] : start + layout.x[1]] = self._x
        target[start + layout.u[0] : start + layout.u[1]] = self._u
        for first, last, source in self._of_all if planned else self._of_rest:
            target[start + first : start + last] = source
        self.samples = number + 1
        ring.head += 1

    def _make_room(self, began: int) -> bool:
        """Write the samples of a loop that runs faster than real time; False in a loop that must not wait, and where
        they cannot be written."""
        assert self._writer is not None
        ring = self._ring
        oldest = STAMPS.unpack_from(ring.buffer, ring.tail % ring.slots * ring.size)[1]
        if self._deadline and began - oldest > 0.5 * self._deadline * ring.slots:
            return False
        self._writer.flush()
        return ring.head - ring.tail < ring.slots

    # -- what is recorded ---------------------------------------------------------------------------------------------

    def log(self) -> Log:
        """The samples so far; without a file those that are kept."""
        ring = self._ring
        before = np.zeros((0, ring.size), np.uint8)
        if self._writer is not None and self._file is not None:
            self._writer.flush()
            before = stream.read(self._file)[1]
        first = max(ring.tail, ring.head - ring.slots)
        data = ring.bytes_of(first, ring.head) if ring.head > first else b""
        rest = np.frombuffer(data, np.uint8).reshape(-1, ring.size)
        return log_of(self._ctrl, np.concatenate([before, rest]), self.dt)

    def close(self) -> None:
        """Write the rest and close the file.

        Raises:
            ControllerError: samples could not be written; also when it is called again.
        """
        self._closed = True
        if self._writer is None:
            return
        self._writer.close()
        self._finalize.detach()
        if (lost := self._ring.head - self._ring.tail) > 0:
            why = "it belongs to another process" if self._writer.error is None else self._writer.error
            raise ControllerError(f"{self._file}: {lost + self.dropped} samples could not be written: {why}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def __repr__(self) -> str:
        where = "memory" if self._file is None else str(self._file)
        counts = f"{self.samples} samples, {self.missed} late, {self.dropped} left out"
        return f"<Recorder of {self._ctrl.description.name}: {counts}; {self._layout.size} bytes each, in {where}>"


def _close(writer: stream.Writer | None) -> None:
    if writer is not None:
        writer.close()


def open_recording(file: str | os.PathLike[str], package: Controller | str | Path) -> Log:
    """The log of a recording, also of a program that was killed.

    ``x`` are the states that the controller was told; that after the last sample is NaN. ``z`` belongs to them. Of many
    plans some are kept, as in simulate(). ``cost`` is NaN where no plan was recorded.

    Args:
        file: of a Recorder.
        package: the controller, or the folder of its package, which is compiled.

    Raises:
        ControllerError: the file is no recording, or one of another package.
    """
    description, data = stream.read(file)
    ctrl = package if isinstance(package, Controller) else open_package(package)
    if description.get("package") != ctrl._package.fingerprint:
        name = description.get("name")
        raise ControllerError(
            f"{file} is a recording of {name!r}, of another package than this {ctrl.description.name}"
        )
    if description["size"] != Layout(ctrl).size:
        raise ControllerError(f"{file} is no recording of {ctrl.description.name}: its samples have another size")
    return log_of(ctrl, data, float(description["dt"]))


def log_of(ctrl: Controller, data: NDArray[np.uint8], dt: float) -> Log:
    """The log of samples (n, size), each of which a copy of the controller is set to."""
    layout, twin, steps = Layout(ctrl), ctrl.copy(), len(data)
    stamps = data[:, : STAMPS.size].copy().view("<i8").reshape(steps, 3)
    numbers = np.where(stamps[:, 0] < 0, ~stamps[:, 0], stamps[:, 0])
    notes = Notes(twin, steps, dt, every=1)
    every = spacing(ctrl, int(np.sum(stamps[:, 0] >= 0)))
    real = ctrl.description.real
    notes.x[:-1] = data[:, slice(*layout.x)].copy().view(real).reshape(steps, ctrl.dims.nx)
    notes.x[-1] = np.nan
    controls = data[:, slice(*layout.u)].copy().view(real).reshape(steps, ctrl.dims.nu)
    spans = [*layout.plan, *layout.rest]
    count = 0
    for k in range(steps):
        planned = bool(stamps[k, 0] >= 0)
        count += planned
        for i, ((first, last), place) in enumerate(zip(spans, layout.places, strict=True)):
            if planned or i >= len(layout.plan):
                twin._memory[first:last] = data[k, slice(*place)]
        twin._xhat[:] = notes.x[k]
        notes.take(k, controls[k], int(stamps[k, 2]), planned, keep=planned and (count - 1) % every == 0)
    t = dt * np.append(numbers, numbers[-1:] + 1 if steps else 0)
    return notes.finish(t=t, began_ns=stamps[:, 1].copy())
