"""The macros that the compiler predefines tell which targets this machine runs, and which of them is the widest."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from functools import lru_cache

from nmpc_codegen.errors import BuildError
from nmpc_codegen.runtime.compilers import ask, find_compiler
from nmpc_codegen.targets import NATIVE, PORTABLE, TARGETS, Target

#: Names of ARM64 in the operating system.
ARM64 = ("aarch64", "arm64")

#: Flags for the processor at hand; for some architectures compilers do not know the first one.
_PROCESSOR = (("-march=native",), ("-mcpu=native",))

#: The first version of gcc with __builtin_shufflevector; all supported versions of clang have it.
_SHUFFLES = 12


def native() -> Target:
    """Return the target with the most lanes that this machine runs, by its compiler's macros; else "portable".

    Raises:
        BuildError: there is no compiler.
    """
    macros = macros_of(find_compiler(), flags_of_processor())
    if ("__aarch64__" in macros) != (platform.machine().lower() in ARM64):
        return PORTABLE  # a cross compiler
    fitting = (t for t in TARGETS.values() if t.defines and _knows_vectors(macros) and macros.keys() >= set(t.defines))
    return max(fitting, key=lambda target: target.lanes, default=PORTABLE)


def flags_of_processor() -> tuple[str, ...]:
    """Return the flags with which the compiler uses all instructions of the processor at hand.

    The result is empty if the compiler has no such flags, or if CC names a processor.

    Raises:
        BuildError: there is no compiler.
    """
    compiler = find_compiler()
    if any(word.startswith(("-march=", "-mcpu=")) for word in compiler):
        return ()
    return next((flags for flags in _PROCESSOR if macros_of(compiler, flags)), ())


def runs(target: Target) -> bool:
    """Return True if this machine runs code compiled for the target.

    Raises:
        BuildError: there is no compiler.
    """
    return set(native().defines) >= set(target.defines)


def check_target(name: str, target: Target) -> None:
    """Raise BuildError if this machine, or its compiler, cannot run the package.

    Raises:
        BuildError: there is no compiler, or the package is for another machine.
    """
    if not target.defines or runs(target):
        return
    compiler = find_compiler()
    reason = f"{compiler[0]} says that this machine runs {native().name}"
    if not _knows_vectors(macros_of(compiler)):
        reason = f"its vectors need gcc {_SHUFFLES} or clang, not {compiler[0]}"
    here = "; nmpc-export --verify runs it here in an emulator" if target.emulator else ""
    raise BuildError(
        f"{name} is written for {target.name} ({target.machine}), but {reason}: open it on such a machine{here}; with "
        f'Options(target="{PORTABLE.name}") or "{NATIVE}" this one runs it'
    )


def _knows_vectors(macros: Mapping[str, str]) -> bool:
    return "__clang__" in macros or int(macros.get("__GNUC__", "0")) >= _SHUFFLES


def macros_of(compiler: tuple[str, ...], flags: tuple[str, ...] = ()) -> Mapping[str, str]:
    """Return the compiler's predefined macros with these flags; empty if it refuses the flags."""
    return _macros(compiler, flags, os.environ.get("PATH", ""))


@lru_cache
def _macros(compiler: tuple[str, ...], flags: tuple[str, ...], path: str) -> Mapping[str, str]:
    """Ask the compiler for its predefined macros; ``path`` is only a key of lru_cache."""
    command = [*compiler, *flags, "-dM", "-E", "-x", "c", os.devnull]
    found = (line.split(None, 2) for line in ask(command).stdout.splitlines() if line.startswith("#define "))
    return {words[1]: words[2] if len(words) == 3 else "" for words in found}
