"""Microcontrollers: flags of the cross compiler, and the board on which QEMU emulates them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from nmpc_codegen.components.allowed import shown
from nmpc_codegen.errors import OptionError
from nmpc_codegen.package.memory import Precision

Level = Literal["O2", "Os"]
LEVELS: tuple[Level, ...] = ("O2", "Os")

#: Flags of the language and of floating-point arithmetic. Contraction is off, so that host and target round alike.
ARITHMETIC = ("-std=c99", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off")
SECTIONS = ("-ffunction-sections", "-fdata-sections")

#: QEMU's -icount shift: an instruction takes 2^6 = 64 ns of emulated time, a tick of the boards' 25 MHz timer 40 ns.
ICOUNT_SHIFT = 6
INSTRUCTIONS_PER_TICK = 40 / 2**ICOUNT_SHIFT


@dataclass(frozen=True)
class Target:
    """A core, the compiler flags for it, the precision of its floating-point unit, and the emulated board."""

    name: str
    core: str
    flags: tuple[str, ...]
    unit: Precision | None  # widest arithmetic in hardware; None: all in software
    machine: str
    code_origin: int = 0x00000000
    code_bytes: int = 4 << 20
    ram_origin: int = 0x20000000
    ram_bytes: int = 4 << 20

    def in_hardware(self, precision: Precision) -> bool:
        """True if the floating-point unit computes in this precision."""
        return self.unit == "double" or self.unit == precision

    def compile_flags(self, level: Level) -> tuple[str, ...]:
        """All flags with which a package is compiled for this target."""
        return (*self.flags, f"-{level}", *ARITHMETIC, *SECTIONS)


TARGETS: Mapping[str, Target] = {
    target.name: target
    for target in (
        Target("cortex-m3", "Cortex-M3", ("-mcpu=cortex-m3", "-mthumb", "-mfloat-abi=soft"), None, "mps2-an385"),
        Target(
            "cortex-m4f",
            "Cortex-M4F",
            ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
            "single",
            "mps2-an386",
        ),
        Target(
            "cortex-m7",
            "Cortex-M7",
            ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16"),
            "double",
            "mps2-an500",
        ),
    )
}


def find_target(name: str) -> Target:
    """The target of that name.

    Raises:
        OptionError: there is none.
    """
    if name not in TARGETS:
        raise OptionError(f"there is no target {shown(name)}; there is {', '.join(TARGETS)} (--target NAME)")
    return TARGETS[name]
