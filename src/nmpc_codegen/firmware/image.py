"""An image is a bare-metal program that replays a recording: sources, compiled and linked for a target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from nmpc_codegen.errors import OptionError
from nmpc_codegen.firmware.toolchain import Level, compile_flags, cross
from nmpc_codegen.lowering.templates import environment, template_directory
from nmpc_codegen.targets import Board, Target

#: Expected stack of a call. The program reserves half as much again, so that an excess is seen, and its own stack.
MOST_STACK = 32 << 10
OWN_STACK = 512
PROGRAM = ("start.c", "replay.c")
ELF = "image.elf"


@dataclass(frozen=True)
class Image:
    """An image is a linked program in a folder."""

    folder: Path
    target: Target

    @property
    def path(self) -> Path:
        return self.folder / ELF


def board_of(target: Target) -> Board:
    """Return the emulated board of a microcontroller.

    Raises:
        OptionError: the target is no microcontroller.
    """
    if target.board is None:
        raise OptionError(f"the target {target.name} is no microcontroller, which a bare-metal program needs")
    return target.board


def sources(target: Target, recording: str, stack_bytes: int = MOST_STACK) -> dict[str, str]:
    """Return the files of the program besides the package: start-up code, replay, linker script, recording."""
    stack = (stack_bytes * 3 // 2 + OWN_STACK) & ~7
    folder = template_directory() / "firmware"
    board = board_of(target)
    parts = {"start.c": board.start, "replay.c": "replay.c", "start.h": "start.h"}
    files = {name: (folder / part).read_text(encoding="utf-8") for name, part in parts.items()}
    script = environment().get_template("firmware/image.ld.jinja").render(board=board, stack_bytes=stack)
    return {**files, "image.ld": script, "recording.h": recording}


def write(package: Mapping[str, str], name: str, more: Mapping[str, str], folder: Path) -> None:
    """Write the C of the package, and other files, into a folder."""
    for path, text in ({f"{name}.{ext}": package[f"{name}.{ext}"] for ext in ("h", "c")} | dict(more)).items():
        (folder / path).write_text(text, encoding="utf-8")


def build(
    package: Mapping[str, str],
    name: str,
    recording: str,
    target: Target,
    level: Level,
    folder: Path,
    stack_bytes: int = MOST_STACK,
) -> Image:
    """Compile and link the program in a folder; ``stack_bytes`` is the expected stack of a call of the package.

    Raises:
        BuildError: there is no cross compiler, or it refuses the code.
    """
    write(package, name, sources(target, recording, stack_bytes), folder)
    cross(target, "gcc", folder, *compile_flags(target, level), "-c", f"{name}.c", "-o", "package.o")
    for unit in PROGRAM:
        cross(target, "gcc", folder, *compile_flags(target, "O2"), "-c", unit, "-o", f"{unit}.o")
    objects = ("package.o", *(f"{unit}.o" for unit in PROGRAM))
    link = ("-nostartfiles", *target.libraries, "-Wl,--gc-sections", "-Timage.ld")
    cross(target, "gcc", folder, *target.flags, *link, *objects, "-lm", "-o", ELF)
    return Image(folder, target)
