"""IR 3: the C nouns. Every size and every C name of a package is decided here, once.

Header, struct, initialisation, cffi declarations, README table and NumPy views all derive from the same Field.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.ir.stage_products import Products
from nmpc_codegen.ir.sweep import Routine

Role = Literal["setting", "data", "iterate", "result", "keep", "scratch"]

# Bytes of the C types; "real" depends on the precision.
REAL_BYTES = {"double": 8, "single": 4}


@dataclass(frozen=True)
class Size:
    """A compile-time size: a C expression in the package's macros and its value, e.g. ("N + 1", 11).

    ``text`` names macros without prefix; ``c(prefix)`` writes them with it.
    """

    text: str
    value: int

    def c(self, macro: str) -> str:
        """C text with every identifier prefixed, e.g. ``CRANE_N + 1``."""
        words = (f"{macro}_{w}" if w[0].isalpha() else w for w in self.text.split())
        return " ".join(words)


@dataclass(frozen=True)
class Field:
    """A member of a C struct. Zero sizes are padded to 1 in C; ``shape`` keeps the true ones."""

    name: str
    shape: tuple[Size, ...]
    doc: str
    role: Role
    ctype: str = "real"  # "real", "int32", or the name of a struct

    @property
    def values(self) -> tuple[int, ...]:
        """True shape in numbers."""
        return tuple(s.value for s in self.shape)

    @property
    def padded(self) -> tuple[int, ...]:
        """Shape of the C array: every size at least 1."""
        return tuple(max(1, s.value) for s in self.shape)


@dataclass(frozen=True)
class Struct:
    """A C struct <prefix>_<name>_t and the member ``name`` of the given shape that holds it in the solver.

    The solver itself is the struct "solver"; a component adds members to it by a Struct of that name. A struct that
    another one has as a member has none of its own in the solver. ``union``: its members share their memory, for
    phases that never overlap; every component that states a union of that name adds its members to it.
    """

    name: str
    doc: str
    fields: tuple[Field, ...]
    shape: tuple[Size, ...] = ()
    union: bool = False


@dataclass(frozen=True)
class Status:
    """A status value: macro name without prefix and what it means."""

    name: str
    text: str


STATUSES = (
    Status("OK", "ok"),
    Status("ITERATION_LIMIT", "iteration limit reached"),
    Status("INFEASIBLE", "the constraints cannot be met"),
    Status("RELAXED", "soft solution: rows were relaxed"),
    Status("NUMERICAL_FAILURE", "numerical failure: the Hessian is not positive definite or a number is not finite"),
    Status("NOT_FINITE", "the measured state is not finite"),
    Status("NOT_PREPARED", "feedback without prepare"),
    Status("NOT_INITIALIZED", "init was not called"),
    Status("BAD_INDEX", "no such node, row or parameter"),
    Status("BAD_BOUNDS", "lower bound above upper bound"),
    Status("BAD_ARGUMENT", "argument out of range or not finite"),
    Status("STALLED", "no further progress"),
)


@dataclass(frozen=True)
class Macro:
    """``#define <PREFIX>_<name> value``."""

    name: str
    value: int
    doc: str


@dataclass(frozen=True)
class Enum:
    """An anonymous enum of user names: constants <PREFIX>_<stem>_<NAME>."""

    stem: str
    names: tuple[str, ...]
    doc: str


@dataclass(frozen=True)
class Table:
    """``static const`` array in the .c; ``ctype`` "real" or "int"."""

    name: str
    ctype: str
    values: tuple[float, ...]
    doc: str


@dataclass(frozen=True)
class Setting:
    """Data that init() copies from the table of declared values into a member of the solver.

    ``copies`` of ``entries`` numbers each: 1 or N for data of the path; 2 or N + 1, the last one terminal, for data of
    all nodes; 1 for data of the terminal node alone.
    """

    field: Field
    table: str
    copies: Size
    entries: Size

    @property
    def first(self) -> str:
        """Address of the first number in the solver *s."""
        return f"&s->{self.field.name}{'[0]' * len(self.field.shape)}"


@dataclass(frozen=True)
class Setter:
    """Functions that change one kind of data (a word of Online) at run time; ``nodes``: what k may be besides ALL."""

    option: str
    nodes: str

    @property
    def template(self) -> str:
        """Their definitions."""
        return f"settings/{self.option}.c.jinja"

    @property
    def declarations(self) -> str:
        """Template of their prototypes."""
        return f"settings/{self.option}.h.jinja"


@dataclass(frozen=True)
class Section:
    """One section of the .c: its title, part, exact operation count (None: depends on data) and bytes of RAM."""

    title: str
    template: str
    count: OpCount | None
    bytes: int


@dataclass(frozen=True, eq=False)
class CModule:
    """Everything the templates print; no decision is left to them."""

    name: str
    precision: str
    macros: tuple[Macro, ...]
    enums: tuple[Enum, ...]
    structs: tuple[Struct, ...]  # "solver" last
    tables: tuple[Table, ...]
    settings: tuple[Setting, ...]
    setters: tuple[Setter, ...]
    layouts: Mapping[str, str]  # reference, weight, bounds, parameter -> fixed, shared, node
    routines: tuple[Routine, ...]
    products: Products
    switches: Mapping[str, int]  # what `#if` in the parts may test besides the sizes
    sections: tuple[Section, ...]
    statuses: tuple[Status, ...]
    signals: tuple[tuple[str, tuple[str, ...]], ...]  # kind -> element names, for comments
    diagonal_weight: bool
    diagonal_weight_N: bool
    metadata: Mapping[str, Any]
    foreign: tuple[str, ...] = ()  # folders of code that another generator writes

    @property
    def macro(self) -> str:
        """Prefix of macros and enum constants."""
        return self.name.upper()

    def value(self, macro: str) -> int:
        """Value of a size macro."""
        for m in self.macros:
            if m.name == macro:
                return m.value
        raise KeyError(macro)

    @property
    def bytes(self) -> int:
        """sizeof the solver struct."""
        return struct_layout(self.structs, self.precision)["solver"][0]


def struct_layout(structs: Iterable[Struct], precision: str) -> dict[str, tuple[int, int]]:
    """(size, alignment) in bytes of every struct by the usual C rules, members in order."""
    types = {"real": (REAL_BYTES[precision],) * 2, "int32": (4, 4)}
    layout: dict[str, tuple[int, int]] = {}
    for struct in structs:
        size, alignment = 0, 1
        for field in struct.fields:
            element, align = layout[field.ctype] if field.ctype in layout else types[field.ctype]
            end = element * math.prod(field.padded)
            size = max(size, end) if struct.union else -(-size // align) * align + end
            alignment = max(alignment, align)
        layout[struct.name] = (-(-size // alignment) * alignment, alignment)
    return layout


#: Prefixes whose API would bear the name of an internal function: integrator_step, path_cost, qp_init, ...
TAKEN_PREFIXES = (
    "adjoint",
    "algorithm",
    "condense",
    "integrator",
    "nodal",
    "path",
    "qp",
    "qp_conjugate",
    "state",
    "take",
    "terminal",
)


def check_prefix(name: str) -> None:
    """A package name is fit for files, in lower case, and no prefix of internal functions."""
    check_package_name(name, "name")
    if name in TAKEN_PREFIXES:
        raise ProblemError(f"name {name!r}: taken by functions of the package itself; choose another")
    if name != name.lower():
        raise ProblemError(f"name {name!r}: expected a C identifier of lower-case letters, digits and underscores")
