"""Where members stand in their structs: vectors whose size is a multiple of a cache line first.

What has such a size leaves the alignment of what follows as it is, so that vector registers are not loaded across cache
lines (2 % of a step of the crane, 10 % of the quadrotor). The memory as a whole is the caller's; a static object or one
of Controller is aligned.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from nmpc_codegen.ir.cmodule import PURPOSES, WORK, Field, Struct, struct_layout

#: Sizes (bytes) in the order of preference: a cache line, and what it is made of.
UNITS = (64, 32, 16)

#: Members of the solver by what they are for: first what is computed with.
ORDER = (WORK, PURPOSES["iterate"], PURPOSES["setting"], PURPOSES["result"])


def placed(structs: Iterable[Struct], precision: str) -> tuple[Struct, ...]:
    """The structs with their members in a good order; a struct stands after those that it holds."""
    known: list[Struct] = []
    for struct in structs:
        layout = struct_layout(known, precision)
        bytes_of = {name: size for name, (size, _) in layout.items()}
        known.append(struct if struct.union else replace(struct, fields=_ordered(struct, bytes_of, precision)))
    return tuple(known)


def _ordered(struct: Struct, bytes_of: dict[str, int], precision: str) -> tuple[Field, ...]:
    elements = bytes_of | {"real": 8 if precision == "double" else 4, "int32": 4, "int64": 8}

    def rank(member: Field) -> tuple[int, int]:
        size = elements[member.ctype] * math.prod(member.padded)
        purpose = ORDER.index(PURPOSES.get(member.role, WORK)) if struct.name == "solver" else 0
        return purpose, next((i for i, unit in enumerate(UNITS) if size % unit == 0), len(UNITS))

    return tuple(sorted(struct.fields, key=rank))
