"""IR 3: the C nouns. Every size and every C name of a package is decided here, once.

Header, struct, initialisation, cffi declarations, README table and NumPy views all derive from the same Field.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.ir.stage_products import Products
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.runtime.package_description import EntryPoint, Kind, Layouts, PackageDescription, Precision, Role
from nmpc_codegen.runtime.package_description import Field as Field
from nmpc_codegen.runtime.package_description import Size as Size
from nmpc_codegen.runtime.package_description import Struct as Struct
from nmpc_codegen.runtime.status import Status

#: What members of the solver are for, by their role.
WORK = "work"
PURPOSES: Mapping[Role, str] = {
    "iterate": "plan",
    "setting": "settings",
    "result": "what the last call found",
}

# Bytes of the C types; "real" depends on the precision.
REAL_BYTES = {"double": 8, "single": 4}


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

    option: Kind
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

    description: PackageDescription
    macros: tuple[Macro, ...]
    enums: tuple[Enum, ...]
    tables: tuple[Table, ...]
    settings: tuple[Setting, ...]
    setters: tuple[Setter, ...]
    routines: tuple[Routine, ...]
    products: Products
    core_parts: tuple[str, ...]  # parts that the algorithm takes of the core
    switches: Mapping[str, int]  # what `#if` in the parts may test besides the sizes
    sections: tuple[Section, ...]
    signals: tuple[tuple[str, tuple[str, ...]], ...]  # kind -> element names, for comments
    diagonal_weight: bool
    diagonal_weight_N: bool
    foreign: Mapping[str, str] = field(default_factory=dict)  # path -> text of code that another generator writes

    @property
    def name(self) -> str:
        """Prefix of functions and types, stem of the files."""
        return self.description.name

    @property
    def precision(self) -> Precision:
        """Working precision."""
        return self.description.precision

    @property
    def structs(self) -> tuple[Struct, ...]:
        """A struct stands after those that it holds, "solver" last."""
        return self.description.structs

    @property
    def called_products(self) -> tuple[LoopedRoutine, ...]:
        """The products with the stage matrices that the package may call."""
        if not self.switches["PRODUCTS"]:
            return ()
        vectors = self.products.called_vectors(bool(self.switches["HAS_STATE_STEP"]))
        return (*vectors.values(), *self.products.panels.values())

    @property
    def core_products(self) -> tuple[str, ...]:
        """The generated file of the stage products, if the algorithm takes them."""
        return ("generated/products.c",) if self.switches["PRODUCTS"] else ()

    @property
    def entry_points(self) -> tuple[EntryPoint, ...]:
        """What the algorithm offers."""
        return self.description.entry_points

    @property
    def layouts(self) -> Layouts:
        """How what can be changed at run time is stored."""
        return self.description.online

    @property
    def statuses(self) -> tuple[Status, ...]:
        """What its functions return, in the order of their values."""
        return tuple(Status)

    @property
    def macro(self) -> str:
        """Prefix of macros and enum constants."""
        return self.name.upper()

    @property
    def folders(self) -> tuple[str, ...]:
        """Folders of foreign code."""
        return tuple(sorted({path.split("/")[0] for path in self.foreign}))

    def value(self, macro: str) -> int:
        """Value of a size macro."""
        return self.description.sizes[macro]

    def table(self, name: str) -> Table:
        """The table of that name."""
        return next(t for t in self.tables if t.name == name)

    @property
    def sizes(self) -> Mapping[str, int]:
        """What `#if` in the parts may test: the size macros and the switches."""
        return {**{m.name: m.value for m in self.macros}, **self.switches}

    @property
    def bytes(self) -> int:
        """sizeof the solver struct."""
        return self.description.report.ram_bytes


def struct_layout(structs: Iterable[Struct], precision: str) -> dict[str, tuple[int, int]]:
    """(size, alignment) in bytes of every struct by the usual C rules, members in order."""
    types = {"real": (REAL_BYTES[precision],) * 2, "int32": (4, 4)}
    layout: dict[str, tuple[int, int]] = {}
    for struct in structs:
        size, alignment = 0, 1
        for member in struct.fields:
            element, align = layout[member.ctype] if member.ctype in layout else types[member.ctype]
            end = element * math.prod(member.padded)
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
    "ipm",
    "ipm_adjoint",
    "ipm_damping",
    "ipm_inverse",
    "ipm_violation",
    "nodal",
    "path",
    "ql",
    "qp",
    "qp_conjugate",
    "qp_full",
    "riccati",
    "riccati_smallest",
    "start",
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
