"""A replay takes the samples of a target again on a computer, with the same bits, and adds names and plans."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.seal import package_of
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.open_folder import open_package
from nmpc_codegen.runtime.records.one_plan import take_plan

Array = NDArray[Any]

FORMAT = 1
HEAD = np.dtype(
    [("package", "S16"), *((name, "<u4") for name in ("format", "slots", "bytes", "samples", "hold", "next"))]
)
NOT_ENDED, NOT_READ = -1, -2


@dataclass(frozen=True, eq=False)
class ReplayedSample:
    """A replayed sample has the recorded and the repeated result.

    Attributes:
        number: number of the sample since init().
        status: status on the target, None if the sample was not finished; for the copy of a solver, its stored status,
            or that of its next sample.
        u: (nu,), control of the target; None if ``status`` is None.
        x: (nx,), the measured state; None if it is unknown.
        again: status of the replay; None if the sample was not replayed.
        same: True if status and controls are equal, to the bit; None: there is nothing to compare.
        difference: largest difference of the controls.
        controller: the controller after the sample.
    """

    number: int
    status: Status | None
    u: Array | None
    x: Array | None
    again: Status | None
    same: bool | None
    difference: float
    controller: Controller

    @property
    def row(self) -> str | None:
        """Return the name of the hard row that is violated most, after INFEASIBLE or RELAXED; else None."""
        return self.controller.stats.violated_row

    @property
    def node(self) -> int | None:
        """Return the node of the hard row that is violated most, or None."""
        return self.controller.stats.violated_node

    @property
    def wrong(self) -> bool:
        """Return True unless the status is OK."""
        return self.status is not Status.OK

    def __str__(self) -> str:
        place = "" if self.row is None else f", row {self.row!r} at node {self.node}"
        return f"sample {self.number}: {self.name}{place}{self._controls()}{self._comparison()}"

    @property
    def name(self) -> str:
        """Return the status in words."""
        return "the target did not end it" if self.status is None else self.status.name

    def _controls(self) -> str:
        if self.u is None:
            return ""
        named = zip(self.controller.names.controls, self.u, strict=True)
        return ", " + ", ".join(f"{name} = {value:.6g}" for name, value in named)

    def _comparison(self) -> str:
        if self.same is not None and self.again is not None:
            differs = f"the replay differs: {self.again.name}, controls by {self.difference:.1e}"
            return ", replayed to the bit" if self.same else f", {differs}"
        if self.status is None and self.x is None:
            return ", nor read its state"
        return f", replayed: {self.again.name}" if self.status is None and self.again is not None else ""


@dataclass(frozen=True, eq=False, repr=False)
class Replay:
    """A replay has the samples of a dump, the oldest one first.

    Attributes:
        name: name of the package.
        samples: all samples.
        status: status of ``sample``.
        row: row of ``sample``.
        node: node of ``sample``.
    """

    name: str
    samples: tuple[ReplayedSample, ...]

    @property
    def sample(self) -> ReplayedSample:
        """Return the last sample that was not OK, or the last one if all were."""
        return next((s for s in reversed(self.samples) if s.wrong), self.samples[-1])

    @property
    def status(self) -> Status | None:
        return self.sample.status

    @property
    def row(self) -> str | None:
        return self.sample.row

    @property
    def node(self) -> int | None:
        return self.sample.node

    @property
    def controller(self) -> Controller:
        """Return the controller after ``sample``; copy() it to continue from there."""
        return self.sample.controller

    @property
    def same(self) -> bool:
        """Return True if all samples that could be replayed had the same status and control, to the bit."""
        return all(sample.same is not False for sample in self.samples)

    def __str__(self) -> str:
        return "\n".join([f"{self.name}: {len(self.samples)} samples", *map(str, self.samples), self._why()])

    def _why(self) -> str:
        """Return the diagnosis of ``sample``, or where to look for a cause that diagnose() cannot see."""
        sample = self.sample
        if sample.status is None:
            ended = "the solver was not initialised" if sample.again is None else f"here it ends, {sample.again.name}"
            read = "its state was not read" if sample.x is None else ended
            where = "look at the pointers x and u, the stack, a watchdog, an interrupt that uses the solver"
            return f"of sample {sample.number}: {read}; on the target {where}"
        return f"of sample {sample.number}: {self.controller.diagnose()}"

    def __repr__(self) -> str:
        return f"<Replay of {self.name}: {len(self.samples)} samples; {self.sample.number}: {self.sample.name}>"

    def plot(self, number: int | None = None, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot the plan after a sample, with bounds and references.

        Args:
            number: number of the sample; None: ``sample``.
            file: file for the picture; None: only return the figure.

        Raises:
            ControllerError: there is no such sample.
            ExtraError: matplotlib is not installed.
        """
        chosen = {s.number: s for s in self.samples}.get(number) if number is not None else self.sample
        if chosen is None:
            known = ", ".join(str(s.number) for s in self.samples)
            raise ControllerError(f"plot(): there is no sample {number!r}; expected one of {known}")
        from nmpc_codegen.pictures.plans import draw_plan

        title = f"{self.name}: plan of sample {chosen.number}, {chosen.name}"
        return draw_plan(take_plan(chosen.controller), title, chosen.wrong, file)


def replay(
    dump: bytes | str | os.PathLike[str] | Array, package: Controller | str | Path, xhat: ArrayLike | None = None
) -> Replay:
    """Repeat the recorded samples of a dump with a controller, and compare the results.

    Args:
        dump: the bytes of a <name>_dumps_t (see export(..., dumps=)) or of a <name>_solver_t, or a file with these
            bytes.
        package: the folder of the package that ran on the target, or its controller. A folder is compiled in the
            profile "verify", without contraction; a target that fuses a * b + c may differ in the last bits.
        xhat: measured state (nx,) of the next sample, which the copy of a solver then takes; None: the copy is only
            read.

    Raises:
        ControllerError: the bytes are no dump of this package.
        BuildError: the folder cannot be opened.

    Examples:
        >>> from nmpc_codegen import build
        >>> controller = build(ocp)
        >>> q = controller.step([0.3])
        >>> replay(bytes(controller), controller, xhat=[0.31]).sample.status.name
        'OK'
    """
    ctrl = package if isinstance(package, Controller) else open_package(package, "verify")
    data = _bytes_of(dump)
    if len(data) == ctrl.nbytes:
        return Replay(ctrl.description.name, (_read_solver(ctrl, data, xhat),))
    if xhat is not None:
        raise ControllerError("replay: xhat belongs to the copy of a solver; a ring of dumps has its own")
    return Replay(ctrl.description.name, tuple(_read_ring(ctrl, data)))


def _bytes_of(dump: bytes | str | os.PathLike[str] | Array) -> bytes:
    if isinstance(dump, str | os.PathLike):
        return Path(dump).read_bytes()
    return np.ascontiguousarray(dump).tobytes() if isinstance(dump, np.ndarray) else bytes(dump)


def _load(ctrl: Controller, solver: bytes) -> tuple[Controller, bool]:
    """Return a controller in the state that the bytes hold, and True if they belong to an initialised solver."""
    twin, members = ctrl.copy(), ctrl.description.members("solver")
    twin.reset()
    magic = int(twin.view("magic")) if "magic" in members else 0
    twin._memory[:] = np.frombuffer(solver, np.uint8)
    if "xhat" in members:
        twin._xhat[:] = twin.view("xhat")[: ctrl.dims.nx]
    return twin, not magic or int(twin.view("magic")) == magic


def _read_solver(ctrl: Controller, data: bytes, xhat: ArrayLike | None) -> ReplayedSample:
    """Return the state of the solver, or the sample that it takes from xhat."""
    twin, ready = _load(ctrl, data)
    if not ready:
        raise ControllerError(f"replay: the bytes are no initialised {ctrl.description.name}_solver_t of this package")
    if xhat is None:
        return ReplayedSample(0, twin.status, np.array(twin.u[0]), None, None, None, 0.0, twin)
    u = twin.step(xhat)
    return ReplayedSample(0, twin.status, u, np.array(xhat, dtype=np.float64), twin.status, None, 0.0, twin)


def _read_ring(ctrl: Controller, data: bytes) -> Iterator[ReplayedSample]:
    """Take the samples of a ring again, from the oldest on."""
    described, d = ctrl.description, ctrl.dims
    layout = [("before", ctrl._struct.dtype), ("x", described.real, (d.nx,)), ("u", described.real, (d.nu,))]
    slot = np.dtype([*layout, ("status", "<i4"), ("sample", "<u4")], align=True)
    if len(data) < HEAD.itemsize:
        raise ControllerError(f"replay: {len(data)} bytes are no dump; a {described.name}_solver_t has {ctrl.nbytes}")
    head = np.frombuffer(data, HEAD, 1)[0]
    _check_head(ctrl, head, slot.itemsize, len(data))
    slots = np.frombuffer(data, slot, int(head["slots"]), HEAD.itemsize)
    kept = [entry for entry in np.roll(slots, -int(head["next"])) if entry["sample"]]
    if not kept:
        raise ControllerError("replay: the dump holds no sample")
    for entry in kept:
        yield _take_again(ctrl, entry)


def _check_head(ctrl: Controller, head: Any, slot: int, size: int) -> None:
    """Raise ControllerError unless a complete ring of this package follows."""
    name = ctrl.description.name
    ours = package_of(ctrl._package.files[f"{name}.c"])
    theirs = ascii(bytes(head["package"]).decode("latin-1"))
    if int(head["format"]) != FORMAT or theirs != repr(ours):
        raise ControllerError(
            f"replay: the {size} bytes are no {name}_dumps_t of this package, whose digest is {ours}; theirs is "
            f"{theirs} in format {int(head['format'])}. A {name}_solver_t has {ctrl.nbytes} bytes"
        )
    if int(head["bytes"]) != slot:
        theirs = str(int(head["bytes"]))
        raise ControllerError(f"replay: a slot of the dump has {theirs} bytes, here {slot}: another layout")
    whole = HEAD.itemsize + int(head["slots"]) * slot
    if size < whole or int(head["next"]) >= int(head["slots"]):
        raise ControllerError(f"replay: the dump is cut or damaged: {size} bytes of {whole}")


def _take_again(ctrl: Controller, entry: Any) -> ReplayedSample:
    """Take the sample of one slot again; if the solver was not initialised or its state not read, only read it."""
    twin, ready = _load(ctrl, entry["before"].tobytes())
    number, recorded = int(entry["sample"]), np.array(entry["u"])
    x: Array | None = np.array(entry["x"], dtype=np.float64)
    ended, unread = int(entry["status"]) not in (NOT_ENDED, NOT_READ), int(entry["status"]) == NOT_READ
    try:
        status = Status(int(entry["status"])) if ended else None
    except ValueError as error:
        raise ControllerError(f"replay: sample {number} of the dump is damaged: {error}") from error
    if not ready or unread:
        x = None if unread else x
        return ReplayedSample(number, status, recorded if ended else None, x, None, None, 0.0, twin)
    u = twin.step(entry["x"])
    if status is None:
        return ReplayedSample(number, None, None, x, twin.status, None, 0.0, twin)
    same = twin.status == status and u.astype(recorded.dtype).tobytes() == recorded.tobytes()
    difference = float(np.max(np.abs(u - recorded), initial=0.0))
    return ReplayedSample(number, status, recorded, x, twin.status, same, difference, twin)
