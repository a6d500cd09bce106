"""Instructions in the spelling of ``objdump -d`` are read for their effect on the stack, and for calls.

stack.py needs this for functions of libraries, whose frames are not listed elsewhere.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Protocol

from nmpc_codegen.errors import BuildError
from nmpc_codegen.targets import Target

_PLACE = re.compile(r"\b([0-9a-f]+) <([^>+]+)")


class MachineCode(Protocol):
    """A family of processors shares an instruction set."""

    def operands(self, text: str) -> str:
        """Return the operands without the comment of the disassembler."""
        ...

    def ends(self, operation: str, operands: str) -> bool:
        """Return True if a function does not continue after the instruction."""
        ...

    def decrement(self, operation: str, operands: str, name: str) -> int:
        """Return the bytes by which the instruction lowers the stack pointer.

        Raise BuildError if it subtracts a register.
        """
        ...

    def callee(self, operation: str, operands: str, name: str) -> str | None:
        """Return the function to which the instruction may jump; raise BuildError if it calls through a register."""
        ...


class Arm:
    """The instruction sets are ARM and Thumb."""

    _PUSHES = re.compile(r"\{([^}]*)\}")
    _IMMEDIATE = re.compile(r"#(\d+)")
    _PREDECREMENT = re.compile(r"\[sp, #-(\d+)\]!")
    _CONDITION = r"(?:eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?"
    _BRANCH = re.compile(rf"^(bl|b|blx|bx)({_CONDITION})(?:\.[nw])?$")
    _BYTES: Mapping[str, int] = {"r": 4, "s": 4, "d": 8}

    def operands(self, text: str) -> str:
        return text.partition("@")[0].strip()

    def ends(self, operation: str, operands: str) -> bool:
        branch = self._BRANCH.match(operation)
        if branch and branch[1] in ("b", "bx") and not branch[2]:
            return True
        leaves = operation.startswith(("pop", "ldr", "ldm")) and re.search(r"\bpc\b", operands)
        return bool(leaves) or operation in ("udf", "bkpt")

    def decrement(self, operation: str, operands: str, name: str) -> int:
        stem = operation.partition(".")[0]
        if stem.startswith(("push", "vpush")) or (re.match(r"v?stmdb", stem) and operands.startswith("sp!")):
            return sum(self._registers(part) for part in self._PUSHES.findall(operands)[0].split(","))
        if before := self._PREDECREMENT.search(operands):
            return int(before[1])
        if re.match(r"subs?w?", stem) and operands.startswith("sp,"):
            amount = self._IMMEDIATE.search(operands)
            if amount is None:
                raise _lowered_by_a_register(name)
            return int(amount[1])
        return 0

    def _registers(self, part: str) -> int:
        """Return the bytes of a register, or of a range such as d8-d15."""
        first, _, last = part.strip().partition("-")
        size = self._BYTES.get(first[0], 4)
        return size * (int(last[1:]) - int(first[1:]) + 1 if last else 1)

    def callee(self, operation: str, operands: str, name: str) -> str | None:
        if operation.startswith(("cbz", "cbnz")):
            return None
        branch = self._BRANCH.match(operation)
        if branch is None:
            return None
        if branch[1] in ("bx", "blx") and not _PLACE.search(operands):
            if branch[1] == "bx" and operands in ("lr", "ip", "r3"):
                return None
            raise _call_register(name, operands)
        found = _PLACE.search(operands)
        return found[2] if found else None


class RiscV:
    """The instruction set is RISC-V.

    Functions __riscv_save_<n> of libgcc return with a lower stack pointer, so that calls of them count as decrements.
    """

    #: Largest number of bytes that __riscv_save_<n> reserves: 13 registers, rounded up to 16 bytes.
    _SAVED = 64
    _SAVE = "__riscv_save_"
    _JUMPS = frozenset({"jal", "j", "jalr", "jr", "tail", "call"})

    def operands(self, text: str) -> str:
        return text.strip()

    def ends(self, operation: str, operands: str) -> bool:
        return operation in ("ret", "j", "jr", "tail", "unimp", "ebreak")

    def decrement(self, operation: str, operands: str, name: str) -> int:
        if operation == "jal" and self._SAVE in operands:
            return self._SAVED
        if name.startswith(self._SAVE):
            return 0
        if operation in ("add", "addi", "sub") and operands.startswith("sp,sp,"):
            amount = operands.removeprefix("sp,sp,").partition("#")[0].strip()
            if operation == "sub" or not re.fullmatch(r"-?\d+", amount):
                raise _lowered_by_a_register(name)
            return max(0, -int(amount))
        return 0

    def callee(self, operation: str, operands: str, name: str) -> str | None:
        if operation not in self._JUMPS and not operation.startswith("b"):
            return None
        found = _PLACE.search(operands)
        if found is not None:
            return None if found[2].startswith(self._SAVE) else found[2]
        if operation == "jr" or operation not in self._JUMPS:  # a return, or a jump through the table of a switch
            return None
        raise _call_register(name, operands)


#: Prefix of a cross compiler -> its instruction set.
_FAMILIES: Mapping[str, MachineCode] = {"arm-none-eabi-": Arm(), "riscv64-unknown-elf-": RiscV()}


def machine_code(target: Target) -> MachineCode:
    """Return the instruction set of a microcontroller."""
    return _FAMILIES[target.compiler]


def _lowered_by_a_register(name: str) -> BuildError:
    return BuildError(f"{name} lowers the stack pointer by a register: its stack is unknown")


def _call_register(name: str, operands: str) -> BuildError:
    return BuildError(f"{name} calls a function through {operands}: its stack is unknown")
