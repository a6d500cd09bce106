"""Replay the memory of a target on a computer: the same samples, to the bit, with names and plans."""

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
from nmpc_codegen.runtime.package import open_package
from nmpc_codegen.runtime.pictures.plans import draw_plan
from nmpc_codegen.runtime.records.plan import take_plan

Array = NDArray[Any]

FORMAT = 1
HEAD = np.dtype([("package", "S16"), *((name, "<u4") for name in ("format", "slots", "bytes", "samples", "hold", "_"))])


@dataclass(frozen=True, eq=False)
class ReplayedSample:
    """One sample. ``status``, ``u``: of the target, of a solver alone those that it holds; ``x``: the measured state,
    None if it is not known; ``again``: status of the replay, None without a state; ``difference``: largest difference
    of the two controls; ``same``: equal status, and controls to the bit. ``controller``: as the sample left it."""

    number: int
    status: Status
    u: Array
    x: Array | None
    again: Status | None
    difference: float
    same: bool
    controller: Controller

    @property
    def row(self) -> str | None:
        """Name of the hard row that is violated most, after INFEASIBLE or RELAXED; else None."""
        return self.controller.stats.violated_row

    @property
    def node(self) -> int | None:
        """Its node."""
        return self.controller.stats.violated_node

    def __str__(self) -> str:
        place = "" if self.row is None else f", row {self.row!r} at node {self.node}"
        controls = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.controller.names.controls, self.u, strict=True))
        equal = "" if self.again is None else ", replayed to the bit" if self.same else f", replay {self._other()}"
        return f"sample {self.number}: {self.status.name}{place}, {controls}{equal}"

    def _other(self) -> str:
        assert self.again is not None
        return f"differs: {self.again.name}, controls by {self.difference:.1e}"


@dataclass(frozen=True, eq=False, repr=False)
class Replay:
    """The samples of a dump, the oldest one first; status, row, node and controller are those of ``sample``."""

    name: str
    samples: tuple[ReplayedSample, ...]

    @property
    def sample(self) -> ReplayedSample:
        """The last sample that was not OK, or the last one if all were."""
        return next((s for s in reversed(self.samples) if s.status != Status.OK), self.samples[-1])

    @property
    def status(self) -> Status:
        return self.sample.status

    @property
    def row(self) -> str | None:
        return self.sample.row

    @property
    def node(self) -> int | None:
        return self.sample.node

    @property
    def controller(self) -> Controller:
        """The controller as that sample left it; copy() it to go on from there."""
        return self.sample.controller

    @property
    def same(self) -> bool:
        """True if all samples that could be taken again had the same status and control, to the bit."""
        return all(sample.same for sample in self.samples)

    def __str__(self) -> str:
        return "\n".join([f"{self.name}: {len(self.samples)} samples", *map(str, self.samples), self._why()])

    def _why(self) -> str:
        """What diagnose() says of the sample."""
        return f"of sample {self.sample.number}: {self.controller.diagnose()}"

    def __repr__(self) -> str:
        return f"<Replay of {self.name}: {len(self.samples)} samples; {self.sample.number}: {self.status.name}>"

    def plot(self, number: int | None = None, file: str | os.PathLike[str] | None = None) -> Any:
        """Figure of the plan that a sample left, with bounds and references.

        Args:
            number: of the sample; None: ``sample``.
            file: file for the picture; None: only return the figure.

        Raises:
            ControllerError: there is no such sample.
            ExtraError: matplotlib is not installed.
        """
        chosen = {s.number: s for s in self.samples}.get(number) if number is not None else self.sample
        if chosen is None:
            known = ", ".join(str(s.number) for s in self.samples)
            raise ControllerError(f"plot(): there is no sample {number!r}; expected one of {known}")
        title = f"{self.name}: plan of sample {chosen.number}, {chosen.status.name}"
        return draw_plan(take_plan(chosen.controller), title, chosen.status != Status.OK, file)


def replay(
    dump: bytes | str | os.PathLike[str] | Array, package: Controller | str | Path, xhat: ArrayLike | None = None
) -> Replay:
    """Take the samples of a dump again.

    Args:
        dump: the bytes, or a file with them, of a <name>_dumps_t, see export(..., dumps=), or of a <name>_solver_t.
        package: the folder of the package that ran on the target, or its controller. Of a folder it is compiled in the
            profile "verify", without contraction; a target that fuses a * b + c may differ in last bits.
        xhat: for the copy of a solver: the measured state (nx,) of the next sample, which is taken; None: the solver is
            only read.

    Raises:
        ControllerError: the bytes are no dump of this package.
        BuildError: the folder cannot be opened.
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


def _load(ctrl: Controller, solver: bytes) -> Controller:
    """A controller in the state of these bytes; ControllerError unless they are those of an initialised solver."""
    twin = ctrl.copy()
    twin.reset()
    magic = int(twin.view("magic")) if "magic" in ctrl.description.members("solver") else 0
    twin._memory[:] = np.frombuffer(solver, np.uint8)
    if magic and int(twin.view("magic")) != magic:
        raise ControllerError(f"replay: the bytes are no initialised {ctrl.description.name}_solver_t of this package")
    if "xhat" in ctrl.description.members("solver"):
        twin._xhat[:] = twin.view("xhat")[: ctrl.dims.nx]
    return twin


def _read_solver(ctrl: Controller, data: bytes, xhat: ArrayLike | None) -> ReplayedSample:
    """The solver as it is, or after the sample that xhat begins."""
    twin = _load(ctrl, data)
    if xhat is None:
        return ReplayedSample(0, twin.status, np.array(twin.u[0]), None, None, 0.0, True, twin)
    u = twin.step(xhat)
    return ReplayedSample(0, twin.status, u, np.array(xhat, dtype=np.float64), twin.status, 0.0, True, twin)


def _read_ring(ctrl: Controller, data: bytes) -> Iterator[ReplayedSample]:
    """The samples of a ring, each taken again."""
    described, d = ctrl.description, ctrl.dims
    layout = [("before", ctrl._struct.dtype), ("x", described.real, (d.nx,)), ("u", described.real, (d.nu,))]
    slot = np.dtype([*layout, ("status", "<i4"), ("sample", "<u4")], align=True)
    if len(data) < HEAD.itemsize:
        raise ControllerError(f"replay: {len(data)} bytes are no dump; a {described.name}_solver_t has {ctrl.nbytes}")
    head = np.frombuffer(data, HEAD, 1)[0]
    ours = package_of(ctrl._package.files[f"{described.name}.c"])
    theirs = bytes(head["package"]).decode("ascii", "replace")
    if int(head["format"]) != FORMAT or int(head["bytes"]) != slot.itemsize or theirs != ours:
        raise ControllerError(
            f"replay: the {len(data)} bytes are no {described.name}_dumps_t of this package ({ours}; the dump says "
            f"{theirs!r}), and a {described.name}_solver_t has {ctrl.nbytes}"
        )
    count = int(head["slots"])
    if len(data) < HEAD.itemsize + count * slot.itemsize:
        raise ControllerError(f"replay: the dump is cut: {len(data)} bytes of {HEAD.itemsize + count * slot.itemsize}")
    slots = np.frombuffer(data, slot, count, HEAD.itemsize)
    kept = sorted((entry for entry in slots if entry["sample"]), key=lambda entry: int(entry["sample"]))
    if not kept:
        raise ControllerError("replay: the dump holds no sample")
    for entry in kept:
        twin = _load(ctrl, entry["before"].tobytes())
        u = twin.step(entry["x"])
        status, bits = Status(int(entry["status"])), u.astype(described.real).tobytes() == entry["u"].tobytes()
        difference = float(np.max(np.abs(u - entry["u"]), initial=0.0))
        same = bits and twin.status == status
        x, recorded = np.array(entry["x"], dtype=np.float64), np.array(entry["u"])
        yield ReplayedSample(int(entry["sample"]), status, recorded, x, twin.status, difference, same, twin)
