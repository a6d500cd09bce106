"""A Recorder records a controller in a real loop: measurements, controls, times, plans and data."""

from __future__ import annotations

import math
import os
import struct
import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace
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
from nmpc_codegen.runtime.open_folder import open_package
from nmpc_codegen.runtime.records import stream
from nmpc_codegen.runtime.records.log import Log
from nmpc_codegen.runtime.records.notes import Notes, spacing
from nmpc_codegen.runtime.records.timing import LATE, NANOSECONDS

Array = NDArray[Any]

STAMPS = struct.Struct("<qqq")  # number of the sample, its begin (ns), its computing time (ns)
MEMORY = 2**26  # largest number of bytes of samples in memory
SECONDS = 4.0  # length of a loop that the memory can hold until samples are written
USUAL_SLOTS, LEAST_SLOTS = 256, 2
PADDING = 8  # largest number of bytes between two members of a struct


class Layout:
    """A recorded sample has stamps, measured state, control, and members of the solver struct.

    ``plan`` and ``rest`` are ranges (first, last) of bytes of the struct: the iterate; settings and results.
    """

    def __init__(self, ctrl: Controller) -> None:
        members, spans = ctrl.description.members("solver"), _places(ctrl)
        of_roles = {name: spans[name] for name, member in members.items() if member.role in ("setting", "result")}
        self.plan = _join([spans[name] for name, member in members.items() if member.role == "iterate"])
        known = [spans["xhat"]] if "xhat" in spans and ctrl.description.augmentation.count else []
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


def _places(ctrl: Controller) -> dict[str, tuple[int, int]]:
    """Return the first byte of every member of the solver struct, and the byte after it."""
    fields: Any = ctrl._struct.dtype.fields
    return {name: (entry[1], entry[1] + entry[0].itemsize) for name, entry in fields.items()}


def _join(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the ranges in order, with adjacent ones merged."""
    found: list[tuple[int, int]] = []
    for first, last in sorted(spans):
        if found and first - found[-1][1] <= PADDING:
            found[-1] = found[-1][0], last
        else:
            found.append((first, last))
    return found


@dataclass
class SampleCounts:
    """Numbers of samples that took too long, began late, or were left out, and the begin of the last sample."""

    missed: int = 0
    late: int = 0
    dropped: int = 0
    began: int = 0


def prepare_copy(
    ctrl: Controller,
    layout: Layout,
    ring: stream.Ring,
    counts: SampleCounts,
    writer: stream.Writer | None,
    limits: tuple[float, int],
) -> Callable[[int], None]:
    """Return the function that copies a sample, which began at a given time, into the ring.

    The function is made once, and all its data are local variables, which takes half the time of attributes.
    """
    memory, buffer, target = ctrl._memory.data, ring.buffer, memoryview(ring.buffer)
    measured, control = (memoryview(a.view(np.uint8).data) for a in (ctrl._xhat, ctrl._u0))
    place = _places(ctrl)["status"][0]
    status, pack, slots, size = memory[place : place + 4].cast("i"), STAMPS.pack_into, ring.slots, ring.size
    (x, u), (_, end) = layout.x, layout.u
    sources = [memory[first:last] for first, last in (*layout.plan, *layout.rest)]
    whole = [(*place, source) for place, source in zip(layout.places, sources, strict=True)]
    rest = whole[len(layout.plan) :]
    if len(sources) == 2 and layout.plan[0][1] == layout.rest[0][0]:
        whole = [(layout.places[0][0], layout.places[1][1], memory[layout.plan[0][0] : layout.rest[0][1]])]
    most = math.inf if writer is None else slots
    deadline, every = limits
    longest = LATE * deadline

    def copy(began: int) -> None:
        took, head = ctrl._prepare_ns + ctrl._feedback_ns, ring.head
        if took > deadline:
            counts.missed += 1
        if began - counts.began > longest and head:
            counts.late += 1
        counts.began = began
        if head - ring.tail >= most and writer is not None and not make_room(ring, writer, began, deadline):
            counts.dropped += 1
            return
        number, start = head + counts.dropped, head % slots * size
        planned = every == 1 or (every and number % every == 0) or status[0] != 0
        pack(buffer, start, number if planned else ~number, began, took)
        target[start + x : start + u] = measured
        target[start + u : start + end] = control
        for first, last, source in whole if planned else rest:
            target[start + first : start + last] = source
        ring.head = head + 1

    return copy


def make_room(ring: stream.Ring, writer: stream.Writer, began: int, deadline: float) -> bool:
    """Write samples to make room in the ring for a loop that runs faster than real time.

    Return False in a loop that must not wait, and if the samples cannot be written.
    """
    oldest = STAMPS.unpack_from(ring.buffer, ring.tail % ring.slots * ring.size)[1]
    if began - oldest > 0.5 * deadline * ring.slots:
        return False
    writer.flush()
    return ring.head - ring.tail < ring.slots


class Recorder:
    """A recorder keeps the samples of a controller: ``with Recorder(controller, file="run.rec") as r: u = r.step(x)``.

    Set data and read the plan at the controller itself. A sample takes about two microseconds longer. A thread writes
    to the file four times a second, so that a killed program loses less than a second. If the disk is too slow for
    several seconds, samples are left out rather than delayed.

    Args:
        controller: the controller; it may have taken samples before.
        dt: time between samples, which is also their deadline, in the problem's unit of time; None: that of the
            controller.
        file: path of a new file, which open_recording() reads; None: keep the last samples in memory.
        keep: number of samples that are kept without a file; None: as many as fit into 64 MiB.
        plans: number of samples from one recorded plan to the next; plans of samples that are not OK are always
            recorded; 0: only these. Every plan is recorded if only the plan holds the values of added states.

    Raises:
        ControllerError: an argument is wrong, or the file exists or cannot be written.

    Examples:
        >>> from nmpc_codegen import build
        >>> with Recorder(build(ocp), file="run.rec") as recorder:
        ...     q = recorder.step([0.3])
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
        if file is not None and keep is not None:
            raise ControllerError(
                f"Recorder: keep={keep!r} belongs to a recorder without a file, which keeps all samples"
            )
        self._ctrl, self._layout = controller, Layout(controller)
        self._file = None if file is None else Path(file).absolute()
        self.dt = interval_of(controller.description, dt)
        self._deadline = NANOSECONDS.get(controller.description.time_unit, 0.0) * self.dt
        needs_plan = controller.description.augmentation.count and "xhat" not in controller.description.members(
            "solver"
        )
        self._every = 1 if needs_plan else int(plans)
        self._counts = SampleCounts()
        slots = self._slots(keep)
        try:
            self._ring = stream.Ring(slots, self._layout.size)
        except (MemoryError, OverflowError) as error:
            size = slots * self._layout.size
            raise ControllerError(f"Recorder: {slots} samples take {size} bytes; expected fewer in keep=") from error
        self._writer = None if self._file is None else stream.Writer(self._file, self._ring, self._description())
        self._step: Callable[[ArrayLike], Array] = controller.step
        self._feedback: Callable[[ArrayLike], Array] = controller.feedback
        self._take = prepare_copy(controller, self._layout, self._ring, self._counts, self._writer, self._limits())
        self._finalize = weakref.finalize(self, _close, self._writer)

    def _slots(self, keep: int | None) -> int:
        most = max(LEAST_SLOTS, MEMORY // self._layout.size)
        if self._file is None:
            return most if keep is None else int(keep)
        return min(most, max(USUAL_SLOTS, int(SECONDS * 1e9 / self._deadline) if self._deadline else 0))

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

    def _limits(self) -> tuple[float, int]:
        """Return the deadline (ns), inf without one, and the number of samples from one recorded plan to the next."""
        return self._deadline or math.inf, self._every

    @property
    def samples(self) -> int:
        """Return the number of samples so far."""
        return self._ring.head + self._counts.dropped

    @property
    def missed(self) -> int:
        """Return the number of samples that took longer than ``dt``."""
        return self._counts.missed

    @property
    def late(self) -> int:
        """Return the number of samples that began more than 1.5 ``dt`` after the previous sample."""
        return self._counts.late

    @property
    def error(self) -> str:
        """Return why the last attempt to write samples failed, as on a full disk; "" if it succeeded."""
        return "" if self._writer is None or self._writer.error is None else str(self._writer.error)

    @property
    def dropped(self) -> int:
        """Return the number of samples that were left out because the disk was too slow."""
        return self._counts.dropped

    # -- samples ------------------------------------------------------------------------------------------------------

    def step(self, x: ArrayLike, on_failure: OnFailure = "status") -> Array:
        """Take a sample with Controller.step() and record it; a call that raises an error is not recorded.

        Args:
            x: measured state (nx,).
            on_failure: as in Controller.step().

        Returns:
            Control to apply (nu,).
        """
        began = perf_counter_ns()
        u = self._step(x)
        self._take(began)
        if on_failure != "status":
            self._ctrl._judge(self._ctrl.status, "step", on_failure)
        return u

    def feedback(self, x: ArrayLike, on_failure: OnFailure = "status") -> Array:
        """Run the feedback phase after the controller's prepare(), and record the sample.

        Args:
            x: measured state (nx,).
            on_failure: as in Controller.step().

        Returns:
            Control to apply (nu,).
        """
        began = perf_counter_ns()
        u = self._feedback(x)
        self._take(began)
        if on_failure != "status":
            self._ctrl._judge(self._ctrl.status, "feedback", on_failure)
        return u

    # -- what is recorded ---------------------------------------------------------------------------------------------

    def log(self) -> Log:
        """Return the samples so far; without a file, those that are still in memory."""
        if self._writer is not None and not self._writer.is_ours:
            raise ControllerError(f"log(): {self._file} belongs to the process from which this one was forked")
        if self._writer is not None:
            self._writer.flush()
        ring = self._ring
        first, last = max(ring.tail, ring.head - ring.slots), ring.head
        data = ring.bytes_of(first, last) if last > first else b""
        rest = np.frombuffer(data, np.uint8).reshape(-1, ring.size)
        if self._file is None:
            return log_of(self._ctrl, rest, self.dt)
        written = stream.read(self._file)[1]
        already = len(written) - first  # the thread may have written more since then
        return log_of(self._ctrl, np.concatenate([written, rest[max(0, already) :]]), self.dt)

    def close(self) -> None:
        """Write the remaining samples and close the file.

        Raises:
            ControllerError: samples could not be written; a second call raises it again.
        """
        self._step = self._feedback = _refuse
        if self._writer is None:
            return
        self._writer.close()
        self._finalize.detach()
        if (lost := self._ring.head - self._ring.tail) > 0:
            why = self._writer.error if self._writer.is_ours else "it belongs to another process"
            raise ControllerError(f"{self._file}: {lost + self.dropped} samples could not be written: {why}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self.close()
        except ControllerError as lost:
            if error is None:
                raise
            error.add_note(str(lost))

    def __repr__(self) -> str:
        where = "memory" if self._file is None else str(self._file)
        counts = f"{self.samples} samples, {self.missed} took too long, {self.late} began late, {self.dropped} left out"
        where += f", which cannot be written: {self.error}" if self.error else ""
        return f"<Recorder of {self._ctrl.description.name}: {counts}; {self._layout.size} bytes each, in {where}>"


def _refuse(x: ArrayLike) -> Array:
    """Raise ControllerError; it replaces step() after close()."""
    raise ControllerError("the recorder is closed; go on with the controller, or with a new recorder")


def _close(writer: stream.Writer | None) -> None:
    if writer is not None:
        writer.close()


def open_recording(file: str | os.PathLike[str], package: Controller | str | Path) -> Log:
    """Return the log of a recording; the program that wrote it may have been killed.

    ``x`` holds the states that the controller received; the one after the last sample is NaN. ``z`` belongs to them. If
    there are many plans, only some are logged, as in simulate(). ``cost`` is NaN where no plan was recorded.

    Args:
        file: path of the file that a Recorder has written.
        package: the controller, or the folder of its package, which is then compiled.

    Raises:
        ControllerError: the file is no recording, it belongs to another package, or it contains no complete sample.

    Examples:
        >>> from nmpc_codegen import build
        >>> controller = build(ocp)
        >>> with Recorder(controller, file="again.rec") as recorder:
        ...     q = recorder.step([0.3])
        >>> open_recording("again.rec", controller).u.shape
        (1, 1)
    """
    description, data, remarks = stream.read(file)
    ctrl = package if isinstance(package, Controller) else open_package(package)
    if description.get("package") != ctrl._package.fingerprint:
        name = description.get("name")
        raise ControllerError(
            f"{file} is a recording of {name!r}, of another package than this {ctrl.description.name}"
        )
    if description["size"] != Layout(ctrl).size:
        raise ControllerError(f"{file} is no recording of {ctrl.description.name}: its samples have another size")
    return log_of(ctrl, data, float(description["dt"]), remarks)


def log_of(ctrl: Controller, data: NDArray[np.uint8], dt: float, remarks: tuple[str, ...] = ()) -> Log:
    """Return the log of recorded samples ``data`` (n, size), made by restoring each one in a copy of the controller.

    ``remarks`` are remarks on the file, which the log keeps.
    """
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
    return replace(notes.finish(t=t, began_ns=stamps[:, 1].copy()), remarks=remarks)
