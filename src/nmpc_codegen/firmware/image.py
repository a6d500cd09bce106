"""A bare-metal program that replays a recording: sources, compiled and linked for a target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from nmpc_codegen.firmware.targets import Level, Target
from nmpc_codegen.firmware.toolchain import gcc
from nmpc_codegen.lowering.parts import template_directory
from nmpc_codegen.lowering.render import environment

#: Stack of the program: that of the call that needs most, half as much again, so that an excess shows, and its own.
MOST_STACK = 32 << 10
OWN_STACK = 512
PROGRAM = ("start.c", "replay.c")
ELF = "image.elf"


@dataclass(frozen=True)
class Image:
    """A linked program in a folder."""

    folder: Path
    target: Target

    @property
    def path(self) -> Path:
        return self.folder / ELF


def sources(target: Target, recording: str, stack_bytes: int = MOST_STACK) -> dict[str, str]:
    """The files of the program besides the package: start-up code, replay, linker script, recording."""
    stack = (stack_bytes * 3 // 2 + OWN_STACK) & ~7
    folder = template_directory() / "firmware"
    files = {name: (folder / name).read_text(encoding="utf-8") for name in (*PROGRAM, "start.h")}
    script = environment().get_template("firmware/image.ld.jinja").render(target=target, stack_bytes=stack)
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
    """Compile and link the program in a folder; ``stack_bytes``: what a call of the package is expected to need.

    Raises:
        BuildError: there is no cross compiler, or it refuses the code.
    """
    write(package, name, sources(target, recording, stack_bytes), folder)
    gcc([*target.compile_flags(level), "-c", f"{name}.c", "-o", "package.o"], folder)
    for unit in PROGRAM:
        gcc([*target.compile_flags("O2"), "-c", unit, "-o", f"{unit}.o"], folder)
    objects = ("package.o", *(f"{unit}.o" for unit in PROGRAM))
    link = ("-nostartfiles", "--specs=nosys.specs", "-Wl,--gc-sections", "-Timage.ld")
    gcc([*target.flags, *link, *objects, "-lm", "-o", ELF], folder)
    return Image(folder, target)
