"""The memory of a package consists of sizes, members and structs of the C code, laid out by the rules of C.

The members of a struct are ordered: those whose size is a multiple of a cache line come first, then the largest other.
A member of such a size preserves the alignment of the next one, so that vector registers are not loaded or stored
across cache lines (this saves 8 % of a step of the crane, 10 % of the quadrotor). The largest other member, in the
solver the QP, has the most arrays and comes next, while the alignment still holds. The caller provides the memory of
the whole struct; static objects and the memory of Controller are aligned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np

from nmpc_codegen.package.features import Features

#: A function that tells if a package with these features has a member or a struct.
Only = Callable[[Features], object]

Precision = Literal["double", "single"]
#: Precision -> distance of 1 to the next number.
EPS: Mapping[str, float] = {"double": 2.0**-52, "single": 2.0**-23}
Role = Literal["setting", "data", "iterate", "result", "keep", "scratch"]

REAL: dict[str, type[np.floating[Any]]] = {"double": np.float64, "single": np.float32}
INTEGERS: dict[str, type[np.integer[Any]]] = {"int32": np.int32, "int64": np.int64}

#: Role -> purpose of the members of the solver struct.
WORK = "work"
PURPOSES: Mapping[Role, str] = {
    "iterate": "plan",
    "setting": "settings",
    "result": "results of the last call",
}

# Bytes of the C types; "real" depends on the precision.
REAL_BYTES = {"double": 8, "single": 4}


class Size(int):
    """A size is a compile-time number that C prints as an expression in the package's macros, e.g. ("N + 1", 11).

    ``text`` names macros without prefix, ``c(prefix)`` writes them with it, and ``doc`` is their meaning. Two sizes are
    equal if their values are equal.
    """

    text: str
    doc: str

    def __new__(cls, text: str, value: int, doc: str = "") -> Size:
        """Create the number ``value`` with this text."""
        size = super().__new__(cls, value)
        size.text, size.doc = text, doc
        return size

    def __getnewargs__(self) -> tuple[str, int, str]:  # type: ignore[override]
        return self.text, int(self), self.doc

    def __str__(self) -> str:
        return self.text

    def c(self, macro: str) -> str:
        """Return the C text with every identifier prefixed, e.g. ``CRANE_N + 1``."""
        words = (f"{macro}_{w}" if w[0].isalpha() else w for w in self.text.split())
        return " ".join(words)


@dataclass(frozen=True)
class Field:
    """A field is a member of a C struct; only whole packages have members of size 0 (GNU C).

    ``only`` tells if a package has it, as in ``only=lambda f: f.solve``; lowering removes other members, and members of
    size 0.
    """

    name: str
    shape: tuple[Size, ...]
    doc: str
    role: Role
    ctype: str = "real"  # "real", "int32", "int64" or the name of a struct
    only: Only | None = None

    @property
    def values(self) -> tuple[int, ...]:
        """Return the true shape in numbers."""
        return tuple(map(int, self.shape))

    @property
    def first(self) -> str:
        """Return the C text of the member's first number."""
        return self.name + "[0]" * len(self.shape)

    @property
    def padded(self) -> tuple[int, ...]:
        """Return the shape of the C array: every size is at least 1."""
        return tuple(max(1, int(s)) for s in self.shape)


@dataclass(frozen=True)
class Struct:
    """A struct is the C type <prefix>_<name>_t, and a member ``name`` of the solver with this type and the given shape.

    The solver itself is the struct "solver"; a component adds members to it with a Struct of that name. A struct that
    is a member of another one is not a member of the solver. ``only`` tells if a package has it. The members of a
    ``union`` share memory, for phases that do not overlap; all components that define a union of the same name add
    their members to it.
    """

    name: str
    doc: str
    fields: tuple[Field, ...]
    shape: tuple[Size, ...] = ()
    only: Only | None = None
    union: bool = False

    @property
    def count(self) -> int:
        """Return the number of these structs in the solver."""
        return math.prod(self.shape)


Stated = TypeVar("Stated", Field, Struct)


def only_if(present: object, *entries: Stated) -> tuple[Stated, ...]:
    """Return members or structs that a package lacks unless ``present``; its parts may name them in any case."""
    return entries if present else tuple(replace(entry, only=lambda _: False) for entry in entries)


def struct_layout(structs: Iterable[Struct], precision: str) -> dict[str, tuple[int, int]]:
    """Return (size, alignment) in bytes of every struct by the usual C rules, members in order."""
    types = {"real": (REAL_BYTES[precision],) * 2, "int32": (4, 4)}
    layout: dict[str, tuple[int, int]] = {}
    for struct in structs:
        size, alignment = 0, 1
        for member in struct.fields:
            element, align = layout[member.ctype] if member.ctype in layout else types[member.ctype]
            end = element * math.prod(member.values)
            size = max(size, end) if struct.union else -(-size // align) * align + end
            alignment = max(alignment, align)
        layout[struct.name] = (-(-size // alignment) * alignment, alignment)
    return layout


#: Sizes (bytes) in the order of preference: a cache line, and fractions of it.
UNITS = (64, 32, 16)

#: Purposes of the members of the solver in their order: working data first.
ORDER = (WORK, PURPOSES["iterate"], PURPOSES["setting"], PURPOSES["result"])


def place(structs: Iterable[Struct], precision: str) -> tuple[tuple[Struct, ...], dict[str, tuple[int, int]]]:
    """Return the structs with their members reordered, and their layout; each struct follows those that it contains."""
    known: list[Struct] = []
    for struct in structs:
        layout = struct_layout(known, precision)
        bytes_of = {name: size for name, (size, _) in layout.items()}
        known.append(struct if struct.union else replace(struct, fields=_order(struct, bytes_of, precision)))
    return tuple(known), struct_layout(known, precision)


def _order(struct: Struct, bytes_of: dict[str, int], precision: str) -> tuple[Field, ...]:
    elements = bytes_of | {"real": 8 if precision == "double" else 4, "int32": 4, "int64": 8}

    def size(member: Field) -> int:
        return elements[member.ctype] * math.prod(member.values)

    def purpose(member: Field) -> int:
        return ORDER.index(PURPOSES.get(member.role, WORK)) if struct.name == "solver" else 0

    uneven = [member for member in struct.fields if purpose(member) == 0 and size(member) % UNITS[0] > 0]
    largest = max(uneven, key=size, default=None)

    def rank(member: Field) -> tuple[int, int, int, int]:
        unit = next((i for i, unit in enumerate(UNITS) if size(member) % unit == 0), len(UNITS))
        return purpose(member), min(unit, 1), 0 if member is largest else unit, size(member) % 8

    return tuple(sorted(struct.fields, key=rank))
