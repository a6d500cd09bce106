"""Sizes of a package for every goal and optimisation level: what Options(goal) trades."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass

from nmpc_codegen.firmware.certificate import measure
from nmpc_codegen.firmware.toolchain import LEVELS, Level
from nmpc_codegen.targets import Target


@dataclass(frozen=True)
class Form:
    """Bytes of the solver struct, of code and constants, and of the stack of the entry point that needs most."""

    goal: str
    level: Level
    struct_bytes: int
    flash_bytes: int
    stack_bytes: int

    def as_dict(self) -> dict[str, object]:
        """As JSON."""
        return asdict(self)


def forms_of(packages: Mapping[str, Mapping[str, str]], name: str, target: Target) -> tuple[Form, ...]:
    """The forms of a package: ``packages`` holds its files for every goal.

    Raises:
        BuildError: a tool is missing or refuses the code.
    """
    return tuple(_measured(packages, name, target))


def _measured(packages: Mapping[str, Mapping[str, str]], name: str, target: Target) -> Iterator[Form]:
    for goal, package in packages.items():
        for level in LEVELS:
            found = measure(package, name, target, level)
            yield Form(goal, level, found.struct_bytes, found.flash_bytes, found.stack_worst)
