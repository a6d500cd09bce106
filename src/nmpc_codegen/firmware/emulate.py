"""An image runs on an emulated board, and its output is read.

With -icount every instruction takes the same emulated time. The board's timer therefore counts instructions, exactly
and repeatably, but not the cycles of a chip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import BuildError
from nmpc_codegen.firmware.image import ELF, Image, board_of
from nmpc_codegen.firmware.toolchain import run
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.targets import ICOUNT_SHIFT

OUTPUT = "uart.txt"
SECONDS = 600.0  # longest time of an emulation

#: Entry points that replay.c calls once at the end, in the order of their numbers.
OTHERS = ("step", "cost", "integrate", "shift", "kkt", "reset", "solve", "covariance")


@dataclass(frozen=True, eq=False)
class Outcome:
    """The target as a process returns controls and statuses, to be compared with portable C on the host."""

    against: ClassVar[str] = "portable C on the host"

    u: NDArray[np.floating[Any]]  # (samples, nu), in the package's precision
    status: NDArray[np.int64]  # (samples,)

    @property
    def measured(self) -> Mapping[str, object]:
        """Return further results of the run as a JSON object."""
        return {}

    @property
    def sentence(self) -> str:
        """Return further results of the run in words."""
        return ""


@dataclass(frozen=True, eq=False)
class Run(Outcome):
    """A run has controls and statuses of a board, their comparison with the host, instructions and stack of calls."""

    against: ClassVar[str] = "the host"

    prepare: NDArray[np.int64]  # instructions, (samples,)
    feedback: NDArray[np.int64]
    instructions: dict[str, int]  # of other entry points, called once
    stack: dict[str, int]

    @property
    def sample(self) -> NDArray[np.int64]:
        """Return the instructions of prepare() and feedback() together."""
        return self.prepare + self.feedback

    @property
    def median(self) -> int:
        """Return the median of the instructions of a sample."""
        return int(np.median(self.sample))

    @property
    def worst(self) -> int:
        """Return the largest number of instructions of a sample."""
        return int(self.sample.max())

    @property
    def measured(self) -> Mapping[str, object]:
        """Return instructions of a sample, and the stack."""
        return {
            "instructions_median": self.median,
            "instructions_worst": self.worst,
            "painted_stack_bytes": dict(self.stack),
        }

    @property
    def sentence(self) -> str:
        """Return instructions and stack in words."""
        return (
            f"Emulated instructions per sample (not cycles; -icount shift={ICOUNT_SHIFT}): median {self.median:,}, "
            f"worst {self.worst:,}. Painted stack of the run: "
            + ", ".join(f"{entry} {used:,}" for entry, used in self.stack.items())
            + " bytes."
        )


def emulate(image: Image, description: PackageDescription, samples: int) -> Run:
    """Run the image on its emulated board.

    Raises:
        BuildError: there is no emulator, the program does not end, or its output is incomplete.
    """
    command = [*image.target.emulator, "-kernel", ELF, "-display", "none", "-monitor", "none"]
    command += ["-serial", f"file:{OUTPUT}", "-icount", f"shift={ICOUNT_SHIFT}"]
    command += ["-semihosting-config", "enable=on,target=native"]
    (image.folder / OUTPUT).write_text("", encoding="utf-8")
    try:
        run(command, image.folder, SECONDS)
    except BuildError as error:
        raise BuildError(f"{error}\nthe board's last words: {_tail(image)}") from None
    text = (image.folder / OUTPUT).read_text(encoding="ascii", errors="replace")
    return _parse(text.splitlines(), description, samples, board_of(image.target).instructions_per_tick)


def _tail(image: Image) -> str:
    lines = (image.folder / OUTPUT).read_text(encoding="ascii", errors="replace").splitlines()
    return lines[-1] if lines else "none"


def _parse(lines: Sequence[str], description: PackageDescription, samples: int, per_tick: float) -> Run:
    """Parse the lines of replay.c, which documents their formats."""
    words: dict[str, list[list[int]]] = {letter: [] for letter in "EISO"}
    for line in lines:
        letter, *numbers = line.split() or [""]
        if letter in words:
            words[letter].append([int(number, 16) for number in numbers])
    if len(words["E"]) != 1 or len(words["I"]) != 1 or len(words["S"]) != samples:
        raise BuildError(f"the emulated board reported {len(words['S'])} of {samples} samples")
    empty: int = words["E"][0][0]

    def instructions(ticks: int) -> int:
        counted: int = round((ticks - empty) * per_tick)
        return counted

    table = np.array([sample[:6] for sample in words["S"]], dtype=np.int64).reshape(samples, 6)
    bits = np.array([sample[6:] for sample in words["S"]], dtype=np.uint32)
    u = np.ascontiguousarray(bits).view(description.real).reshape(samples, len(description.outputs))
    whole = description.kind.law
    used = (("prepare", 1), ("feedback", 4)) if description.has_phases else ((whole, 4),)
    stack = {"init": words["I"][0][1], **{name: int(table[:, column].max()) for name, column in used}}
    names = (whole, *OTHERS[1:])
    others = {names[number]: (ticks, used) for number, ticks, used in words["O"]}
    return Run(
        u=u,
        status=np.where(table[:, 2] != 0, table[:, 2], table[:, 5]),
        prepare=np.array([instructions(t) for t in table[:, 0]]),
        feedback=np.array([instructions(t) for t in table[:, 3]]),
        instructions={"init": instructions(words["I"][0][0])} | {n: instructions(t) for n, (t, _) in others.items()},
        stack=stack | {name: max(bytes_, stack.get(name, 0)) for name, (_, bytes_) in others.items()},
    )
