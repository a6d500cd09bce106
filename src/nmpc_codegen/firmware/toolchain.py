"""The cross compiler of a target and its emulator are found on the path and run in a folder, with helpful errors."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from nmpc_codegen.errors import BuildError
from nmpc_codegen.package.struct_layout import Precision
from nmpc_codegen.targets import Target

Level = Literal["O2", "Os"]
LEVELS: tuple[Level, ...] = ("O2", "Os")

#: Flags of floating-point arithmetic; contraction is off, so that host and target round alike.
ROUNDING = ("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off")
#: Flags of arithmetic and language for microcontrollers.
ARITHMETIC = ("-std=c99", *ROUNDING)
SECTIONS = ("-ffunction-sections", "-fdata-sections")

SHOWN_LINES = 20

#: Programs of a cross compiler that a certificate needs.
TOOLS = ("gcc", "nm", "size", "objdump")

#: Prefix of a program -> Debian packages that contain it and its dependencies.
_PACKAGES = {
    "arm-none-eabi-": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "riscv64-unknown-elf-": "gcc-riscv64-unknown-elf picolibc-riscv64-unknown-elf",
    "aarch64-linux-gnu-": "gcc-aarch64-linux-gnu libc6-dev-arm64-cross",
    "x86_64-linux-gnu-": "gcc-x86-64-linux-gnu libc6-dev-amd64-cross",
    "qemu-system-arm": "qemu-system-arm",
    "qemu-system-": "qemu-system-misc",
    "qemu-": "qemu-user",
}


def compile_flags(target: Target, level: Level) -> tuple[str, ...]:
    """Return all flags with which a package is compiled for a microcontroller."""
    return (*target.flags, f"-{level}", *ARITHMETIC, *SECTIONS)


def in_hardware(target: Target, precision: Precision) -> bool:
    """Return True if the floating-point unit of the target computes in this precision."""
    unit = "double" if target.board is None else target.board.unit
    return unit in ("double", precision)


def find(program: str) -> str:
    """Return the path of a program.

    Raises:
        BuildError: the program is not on the path; the message says what to install.
    """
    path = shutil.which(program)
    if path is None:
        flag = "--verify" if program.startswith("qemu-") else "--target"
        packages = next((names for start, names in _PACKAGES.items() if program.startswith(start)), program)
        raise BuildError(
            f"there is no program {program} on the path, which {flag} needs: install it, e.g. with "
            f"'apt install {packages}'"
        )
    return path


def require(target: Target, emulator: bool) -> None:
    """Check that every program for a microcontroller is installed, and its emulator if ``emulator`` is true.

    Raises:
        BuildError: a program is missing; the message says what to install.
    """
    for tool in TOOLS:
        find(f"{target.compiler}{tool}")
    if emulator:
        find(target.emulator[0])


def version(program: str) -> str:
    """Return the first line of a program's version."""
    return run([program, "--version"], Path.cwd()).splitlines()[0]


def run(command: Sequence[str], folder: Path, seconds: float | None = None) -> str:
    """Run a program in a folder and return its output.

    Raises:
        BuildError: there is no such program, it fails, or it takes longer than ``seconds``.
    """
    try:
        done = subprocess.run(
            [find(command[0]), *command[1:]],
            cwd=folder,
            env={**os.environ, "LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        raise BuildError(f"{command[0]} has not finished after {seconds:g} s: {' '.join(command)}") from None
    if done.returncode != 0:
        lines = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()
        raise BuildError(
            f"{' '.join(command)} failed with status {done.returncode}:\n" + "\n".join(lines[:SHOWN_LINES])
        )
    return done.stdout


def cross(target: Target, tool: str, folder: Path, *arguments: str) -> str:
    """Run a program of the cross compiler of a target."""
    return run([f"{target.compiler}{tool}", *arguments], folder)
