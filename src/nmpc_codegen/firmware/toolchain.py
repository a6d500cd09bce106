"""The programs of the cross compiler and the emulator: found on the path, run in a folder, with errors that help."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from nmpc_codegen.errors import BuildError

PREFIX = "arm-none-eabi-"
EMULATOR = "qemu-system-arm"
SHOWN_LINES = 20

#: Program -> Debian packages that contain it and what it needs.
_PACKAGES = {
    f"{PREFIX}gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    f"{PREFIX}ld": "binutils-arm-none-eabi",
    f"{PREFIX}nm": "binutils-arm-none-eabi",
    f"{PREFIX}size": "binutils-arm-none-eabi",
    f"{PREFIX}objdump": "binutils-arm-none-eabi",
    EMULATOR: "qemu-system-arm",
}


def find(program: str) -> str:
    """Path of a program.

    Raises:
        BuildError: it is not on the path; the message says what to install.
    """
    path = shutil.which(program)
    if path is None:
        flag = "--verify" if program == EMULATOR else "--target"
        raise BuildError(
            f"there is no program {program} on the path, which {flag} needs: install it, e.g. with "
            f"'apt install {_PACKAGES[program]}'"
        )
    return path


def require(emulator: bool) -> None:
    """Look for every program that a target needs, before any work; with ``emulator`` for that, too.

    Raises:
        BuildError: one is missing; the message says what to install.
    """
    for program in _PACKAGES:
        if program != EMULATOR or emulator:
            find(program)


def version(program: str) -> str:
    """First line of what the program says about its version."""
    return run([program, "--version"], Path.cwd()).splitlines()[0]


def run(command: Sequence[str], folder: Path, seconds: float | None = None) -> str:
    """Run a program in a folder; return what it prints.

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


def gcc(arguments: Sequence[str], folder: Path) -> str:
    """Run the cross compiler."""
    return run([f"{PREFIX}gcc", *arguments], folder)
