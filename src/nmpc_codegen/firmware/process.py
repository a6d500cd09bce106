"""A recording is replayed by a process of an operating system, on this machine or in the emulator of the target."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from nmpc_codegen.errors import BuildError, OptionError
from nmpc_codegen.firmware.emulate import SECONDS, Outcome
from nmpc_codegen.firmware.image import write
from nmpc_codegen.firmware.recording import Recording
from nmpc_codegen.firmware.toolchain import ROUNDING, find, run
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.runtime.compilers import find_compiler
from nmpc_codegen.runtime.native import runs
from nmpc_codegen.targets import Target

PROGRAM = "process.c"


def emulator_command(target: Target) -> tuple[str, ...]:
    """Return the command that runs a program for the target; empty if this machine runs it without an emulator.

    Raises:
        OptionError: the target is portable C, which would be compared with itself.
        BuildError: the emulator is missing, or the target has none and differs from this machine.
    """
    if not target.defines:
        raise OptionError(f"--verify: the target {target.name} is every machine, so there is none to compare with")
    if target.emulator and (shutil.which(target.emulator[0]) or not runs(target)):
        find(target.emulator[0])
        return target.emulator
    if not runs(target):
        raise BuildError(
            f"--verify: there is no emulator of {target.machine}, and this machine is none: verify on one that is"
        )
    return ()


def compiler_for(target: Target) -> tuple[str, ...]:
    """Return the compiler of this machine if it runs the target, else the cross compiler with static linking."""
    return find_compiler() if runs(target) else (find(f"{target.compiler}gcc"), "-static")


def run_process(package: Mapping[str, str], name: str, recording: Recording, target: Target, folder: Path) -> Outcome:
    """Compile the package in a folder with the program that replays the recording, and run it.

    Raises:
        BuildError: a tool is missing or fails.
    """
    program = (template_directory() / "firmware" / PROGRAM).read_text(encoding="utf-8")
    write(package, name, {PROGRAM: program, "recording.h": recording.header}, folder)
    flags = (f"-std={target.standard}", "-O2", *ROUNDING, *target.flags)
    emulator = emulator_command(target)
    run([*compiler_for(target), *flags, f"{name}.c", PROGRAM, "-o", "replay", "-lm"], folder)
    return _parse(run([*emulator, str(folder / "replay")], folder, SECONDS), recording)


def _parse(text: str, recording: Recording) -> Outcome:
    """Parse the lines of process.c, which documents their format."""
    description, samples = recording.description, len(recording.x)
    table = [[int(word, 16) for word in line.split()] for line in text.splitlines()]
    if len(table) != samples:
        raise BuildError(f"the program reported {len(table)} of {samples} samples")
    bits = np.array([row[2:] for row in table], dtype=np.uint32)
    status = np.array([row[0] or row[1] for row in table], dtype=np.int64)
    return Outcome(np.ascontiguousarray(bits).view(description.real).reshape(samples, len(description.outputs)), status)
