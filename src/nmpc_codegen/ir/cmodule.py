"""A CModule, the third intermediate representation, holds every size and every C name of a package, once.

Header, struct, initialisation, cffi declarations, README table and NumPy views are all derived from the same Field.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.ir.printing.c_style import CStyle, unit_style
from nmpc_codegen.ir.printing.constant_names import LocalNames
from nmpc_codegen.ir.stage_products import Products
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.signals import EntryPoint, Kind, Layouts
from nmpc_codegen.package.sources import folders_of
from nmpc_codegen.package.status import Status
from nmpc_codegen.package.struct_layout import Field, Precision, Size, Struct
from nmpc_codegen.targets import Target


@dataclass(frozen=True)
class Macro:
    """A macro is a size: ``#define <PREFIX>_<name> value`` in the header if ``public``, else ``#define <name> value``.

    ``shown`` is the number in the header if it differs from that of the unit, which also counts added states.
    """

    name: str
    value: int
    doc: str
    public: bool = False
    shown: int | None = None

    @property
    def stated(self) -> int:
        """Return the number in the header."""
        return self.value if self.shown is None else self.shown


@dataclass(frozen=True)
class Enum:
    """An anonymous enum of user names: constants <PREFIX>_<stem>_<NAME>, each with a note."""

    stem: str
    names: tuple[str, ...]
    doc: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table is a ``static const`` array in the .c; ``ctype`` is "real" or "int"."""

    name: str
    ctype: str
    values: tuple[float, ...]
    doc: str


@dataclass(frozen=True)
class Setting:
    """A setting is a member of the solver that init() fills from the table of declared values.

    The member holds ``copies`` blocks of ``entries`` numbers: 1 or N blocks for data of the path; 2 or N + 1 for data
    of all nodes, where the last one is terminal; 1 for data of the terminal node only.
    """

    field: Field
    table: str
    copies: Size
    entries: Size


@dataclass(frozen=True)
class Setter:
    """A setter is a group of functions that change one kind of data (a field of Online) at run time.

    ``nodes`` describes the allowed values of the node k besides ALL.
    """

    option: Kind
    nodes: str

    @property
    def template(self) -> str:
        """Return the template with the definitions of the functions."""
        return f"settings/{self.option}.c.jinja"

    @property
    def declarations(self) -> str:
        """Return the template with the prototypes of the functions."""
        return f"settings/{self.option}.h.jinja"


@dataclass(frozen=True)
class Section:
    """A section of the .c has a title, a template, an operation count (None: depends on data), and bytes of RAM."""

    title: str
    template: str
    count: OpCount | None
    bytes: int


@dataclass(frozen=True, eq=False)
class CModule:
    """A CModule is the content of the templates, which take no decisions."""

    description: PackageDescription
    target: Target
    macros: tuple[Macro, ...]
    enums: tuple[Enum, ...]
    tables: tuple[Table, ...]
    rows: tuple[tuple[int, int, int, int], ...]  # of the QP: node, kind, component of x, h or r, row of the user
    settings: tuple[Setting, ...]
    setters: tuple[Setter, ...]
    routines: tuple[Routine, ...]
    products: Products
    features: Features  # features that `#if` in the parts may test besides the sizes
    sections: tuple[Section, ...]
    signals: tuple[tuple[str, tuple[str, ...]], ...]  # kind -> element names, for comments
    names: LocalNames  # names of constants in kernels
    diagonal_weight: bool
    scaled_weight: bool
    diagonal_weight_N: bool
    hooked_parts: tuple[str, ...] = ()  # parts that run at hooks of the algorithm
    places: Mapping[str, str] = field(default_factory=dict)  # inputs and outputs that a node stores: name -> C text
    absent_members: frozenset[tuple[str, str]] = frozenset()  # (struct, member) of size 0, which its structs lack
    absent_kernels: tuple[str, ...] = ()  # kernels and products without anything to compute
    whole: bool = False  # True: no member and no part is left out
    one_step: Kernel | None = None  # an integration step with its Jacobian, for lanes
    jump_rows: Kernel | None = None  # the jump of discrete states after the last step
    foreign: Mapping[str, str] = field(default_factory=dict)  # path -> text, for code of other generators

    @property
    def name(self) -> str:
        """Return the prefix of functions and types, which is the stem of the files."""
        return self.description.name

    @property
    def precision(self) -> Precision:
        """Return the working precision."""
        return self.description.precision

    @property
    def style(self) -> CStyle:
        """Return the C style of the unit."""
        return unit_style(self.precision, self.features.own_math, self.names)

    @property
    def structs(self) -> tuple[Struct, ...]:
        """Return all structs; each one follows the structs that it contains, and "solver" is last."""
        return self.description.structs

    @property
    def called_products(self) -> tuple[LoopedRoutine, ...]:
        """Return the products with the stage matrices that the package may call."""
        if not self.features.products:
            return ()
        vectors = self.products.called_vectors(self.features)
        return (*vectors.values(), *self.products.panels.values())

    @property
    def stage_parts(self) -> tuple[str, ...]:
        """Return the title of the C file that interval functions call, if there is one."""
        called = any(isinstance(r, LoopedRoutine) and r.calls_parts for r in self.routines)
        return ("intervals",) if called else ()

    @property
    def entry_points(self) -> tuple[EntryPoint, ...]:
        """Return the C functions of the algorithm."""
        return self.description.entry_points

    @property
    def layouts(self) -> Layouts:
        """Return how the data that can be changed at run time are stored."""
        return self.description.online

    @property
    def ranges(self) -> tuple[Kind, ...]:
        """Return the kinds of data that can be set for a range of nodes at once."""
        ny = self.value("NY")
        return tuple(
            setter.option
            for setter in self.setters
            if self.layouts[setter.option] == "node" and (ny or setter.option not in ("reference", "weight"))
            if not (self.features.estimator and setter.option == "parameter")
        )

    @property
    def statuses(self) -> tuple[Status, ...]:
        """Return the status codes that the package's functions return, in the order of their values."""
        return tuple(Status)

    @property
    def macro(self) -> str:
        """Return the prefix of macros and enum constants."""
        return self.name.upper()

    @property
    def folders(self) -> tuple[str, ...]:
        """Return the folders of foreign code."""
        return folders_of(self.foreign)

    @property
    def libraries(self) -> tuple[str, ...]:
        """Return the libraries with which a program with the package is linked."""
        return () if self.features.own_math else ("m",)

    @property
    def public(self) -> tuple[Macro, ...]:
        """Return the macros of the header."""
        return tuple(macro for macro in self.macros if macro.public)

    def value(self, macro: str) -> int:
        """Return the value of a size macro."""
        return self.description.sizes[macro]

    def table(self, name: str) -> Table:
        """Return the table with the given name."""
        return next(t for t in self.tables if t.name == name)

    @property
    def sizes(self) -> Mapping[str, int]:
        """Return {name: value} for all names that `#if` in the parts may test: size macros and features."""
        return {**{m.name: m.value for m in self.macros}, **self.features.macros}

    @property
    def decided(self) -> Mapping[str, int] | None:
        """Return ``sizes``, or None if the package leaves `#if` to the compiler."""
        return None if self.whole else self.sizes

    @property
    def bytes(self) -> int:
        """Return sizeof the solver struct."""
        return self.description.report.ram_bytes


def check_prefix(name: str) -> None:
    """Raise ProblemError unless the package name is valid for files and in lower case."""
    check_package_name(name, "name")
    if name != name.lower():
        raise ProblemError(f"name {name!r}: expected a C identifier of lower-case letters, digits and underscores")
