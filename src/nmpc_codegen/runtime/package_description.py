"""Description of a C package: sizes, names, rows, the layout of the solver struct, the report.

Lowering creates a PackageDescription, and to_json() yields the text of <name>.json; from_json() reads it wherever a
package is run. Nothing here needs CasADi or a compiler.
"""

from __future__ import annotations

import json
import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.diagnosis.program import Program

Precision = Literal["double", "single"]
Role = Literal["setting", "data", "iterate", "result", "keep", "scratch"]
RowKind = Literal["control", "state", "general", "coupled"]

#: Data that can be changed at run time, and how they are stored: as a table of declared values, once, or once per node.
Kind = Literal["reference", "weight", "bounds", "parameter"]
Layout = Literal["fixed", "shared", "node"]
Layouts = Mapping[Kind, Layout]

REAL: dict[str, type[np.floating[Any]]] = {"double": np.float64, "single": np.float32}
INTEGERS: dict[str, type[np.integer[Any]]] = {"int32": np.int32, "int64": np.int64}

#: Version of the layout of <name>.json.
FORMAT = 3

DIMENSIONS = ("N", "NX", "NU", "NP", "NY", "NY_N", "NH", "NH_N", "NR")


@dataclass(frozen=True)
class OpCount:
    """Floating-point operations by class, counted from the instructions that are printed.

    add: + and -; mul; div; sqrt; call: other functions of math.h; other: negation, absolute value, floor and ceil,
    comparison, selection.
    """

    add: int = 0
    mul: int = 0
    div: int = 0
    sqrt: int = 0
    call: int = 0
    other: int = 0

    def __add__(self, o: OpCount) -> OpCount:
        return OpCount(*map(operator.add, vars(self).values(), vars(o).values()))

    def __mul__(self, times: int) -> OpCount:
        return OpCount(*(count * times for count in vars(self).values()))

    @property
    def total(self) -> int:
        """All operations, every class counted once."""
        return sum(vars(self).values())

    def as_dict(self) -> dict[str, int]:
        return dict(vars(self))


def c_identifier(name: str) -> str:
    """C spelling of an element name: ``r[0]`` becomes ``r_0``."""
    return name.replace("[", "_").replace("]", "")


def c_constants(names: Sequence[str]) -> tuple[str, ...]:
    """Last words of the C constants of user names: upper case; names that differ by case alone keep their spelling."""
    spelled = [c_identifier(name) for name in names]
    upper = [name.upper() for name in spelled]
    return tuple(big if upper.count(big) == 1 else name for name, big in zip(spelled, upper, strict=True))


@dataclass(frozen=True)
class Dimensions:
    """Sizes of a controller, in the notation of the project."""

    N: int
    nx: int
    nu: int
    np: int
    ny: int
    ny_N: int
    nh: int
    nh_N: int
    nr: int  # scalar rows that the user stated


@dataclass(frozen=True)
class Size:
    """A compile-time size: a C expression in the package's macros and its value, e.g. ("N + 1", 11).

    ``text`` names macros without prefix; ``c(prefix)`` writes them with it. Two sizes are equal if their values are.
    """

    text: str = field(compare=False)
    value: int

    def c(self, macro: str) -> str:
        """C text with every identifier prefixed, e.g. ``CRANE_N + 1``."""
        words = (f"{macro}_{w}" if w[0].isalpha() else w for w in self.text.split())
        return " ".join(words)


@dataclass(frozen=True)
class Field:
    """A member of a C struct. A description may contain members of size 0, which are padded to 1 in C.

    ``only``: name of a switch; if it is 0, lowering drops the member, as it does with members of size 0.
    """

    name: str
    shape: tuple[Size, ...]
    doc: str
    role: Role
    ctype: str = "real"  # "real", "int32", "int64" or the name of a struct
    only: str = ""

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
    """A C struct <prefix>_<name>_t, and the member ``name`` of the solver with this type and the given shape.

    The solver itself is the struct "solver"; a component adds members to it with a Struct of that name. A struct that
    is a member of another one is not a member of the solver. ``only``: name of a switch; if it is 0, the struct does
    not exist. ``union``: its members share memory, for phases that do not overlap; all components that define a union
    of the same name add their members to it.
    """

    name: str
    doc: str
    fields: tuple[Field, ...]
    shape: tuple[Size, ...] = ()
    only: str = ""
    union: bool = False

    @property
    def count(self) -> int:
        """Number of these structs in the solver."""
        return math.prod(size.value for size in self.shape)


@dataclass(frozen=True)
class Argument:
    """An argument of an entry point: an array of the sizes that ``shape`` names, or a number."""

    name: str
    ctype: Literal["real", "int"]
    shape: tuple[str, ...] = ()  # macros without prefix


@dataclass(frozen=True)
class EntryPoint:
    """A function <prefix>_<name>(solver, inputs, outputs) -> status that the algorithm offers."""

    name: str
    doc: str
    inputs: tuple[Argument, ...] = ()
    outputs: tuple[Argument, ...] = ()


@dataclass(frozen=True)
class Signal:
    """A named scalar or vector among the states, controls or parameters.

    ``offset`` is the position of its first element in the stacked vector; ``value`` holds the initial value of a
    state (x_0 for --check, --simulate, main.c), the value of a parameter, and zeros for a control.
    """

    name: str
    size: int
    unit: str
    value: tuple[float, ...]
    offset: int
    scalar: bool  # declared without size=

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the elements as the user reads them: ``v`` or ``r[0], r[1]``."""
        return (self.name,) if self.scalar else tuple(f"{self.name}[{i}]" for i in range(self.size))


@dataclass(frozen=True)
class Row:
    """One scalar row lower <= value <= upper that holds at ``nodes``, with its declared bounds.

    kind "control": value = u[index], a hard simple bound at every node 0..N-1;
    kind "state": value = x[index]; ``nodes`` is empty if an equality at the end replaces the whole row (N = 1);
    kind "general": value = h[index] of the path stage (nodes < N) and h[index_terminal] of the terminal stage (node N),
    -1 if the row does not hold there;
    kind "coupled": r[index](x_0, x_N), ``nodes`` is (0, N). ``soft`` is (l1, l2) or None. Equality: lower == upper.
    """

    name: str
    kind: RowKind
    index: int
    index_terminal: int
    nodes: tuple[int, ...]
    lower: float
    upper: float
    soft: tuple[float, float] | None = None


@dataclass(frozen=True)
class Residual:
    """One residual of the least-squares cost: its name, its declared reference, and the state or control that it is,
    "" if it is another expression."""

    name: str
    reference: float
    signal: str


@dataclass(frozen=True)
class Names:
    """Element names in the order of the vectors that hold them."""

    states: tuple[str, ...]
    controls: tuple[str, ...]
    parameters: tuple[str, ...]
    rows: tuple[str, ...]
    y: tuple[str, ...]
    y_N: tuple[str, ...]


@dataclass(frozen=True)
class Report:
    """The compiler's report on a package.

    ``ram_bytes``: size of the solver struct; ``ram_bytes_by_struct``: sizes of the structs in it; ``operations``: of
    one call of every C function for which they do not depend on data; ``linearization_operations``: of all nodes
    together; ``worst_operations``: at most, of "prepare" and "feedback" at the caps on iterations and of the "sample"
    that calls both; empty if unknown; ``choices``: the chosen components and the reasons; ``warnings``: what is likely
    to give poor results; ``looped``: functions with loops instead of straight-line code.
    """

    ram_bytes: int = 0
    ram_bytes_by_struct: Mapping[str, int] = field(default_factory=dict)
    operations: Mapping[str, OpCount] = field(default_factory=dict)
    linearization_operations: int = 0
    worst_operations: Mapping[str, int] = field(default_factory=dict)
    choices: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    looped: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The report as dictionaries, lists and numbers, as in <name>.json."""
        return {
            "ram_bytes": self.ram_bytes,
            "ram_bytes_by_struct": dict(self.ram_bytes_by_struct),
            "operations": {name: count.as_dict() for name, count in self.operations.items()},
            "linearization_operations": self.linearization_operations,
            "worst_operations": dict(self.worst_operations),
            "choices": list(self.choices),
            "warnings": list(self.warnings),
            "looped": list(self.looped),
        }


@dataclass(frozen=True)
class PackageDescription:
    """Description of a whole package; each struct follows those that it contains, so that "solver" is last."""

    name: str
    precision: Precision
    sizes: Mapping[str, int]  # macro without prefix -> value
    structs: tuple[Struct, ...]
    states: tuple[Signal, ...]
    controls: tuple[Signal, ...]
    parameters: tuple[Signal, ...]
    rows: tuple[Row, ...]
    residuals: tuple[Residual, ...]
    residuals_N: tuple[Residual, ...]
    dt: tuple[float, ...]
    discrete: bool
    time_unit: str  # of dt and sampling_time; of a discrete map "samples"
    statuses: tuple[str, ...]
    shift: str | None
    sampling_time: float | None  # for which the package is made; None: any
    entry_points: tuple[EntryPoint, ...]
    online: Layouts
    options: str
    report: Report
    program: Program

    @property
    def dims(self) -> Dimensions:
        """Sizes in the notation of the project."""
        return Dimensions(*(self.sizes[name] for name in DIMENSIONS))

    @property
    def real(self) -> np.dtype[Any]:
        """NumPy type of <name>_real."""
        return np.dtype(REAL[self.precision])

    @property
    def x_initial(self) -> NDArray[np.float64]:
        """Declared initial state, shape (nx,)."""
        return np.array([v for s in self.states for v in s.value], dtype=np.float64)

    @property
    def names(self) -> Names:
        """Element names of every vector."""
        return Names(
            states=_elements(self.states),
            controls=_elements(self.controls),
            parameters=_elements(self.parameters),
            rows=tuple(r.name for r in self.rows),
            y=tuple(r.name for r in self.residuals),
            y_N=tuple(r.name for r in self.residuals_N),
        )

    @property
    def has_phases(self) -> bool:
        """True if a sample consists of prepare() and feedback(); else it is one call of step()."""
        return self.offers("prepare") and self.offers("feedback")

    def offers(self, name: str) -> bool:
        """True if the algorithm has an entry point of that name."""
        return any(entry.name == name for entry in self.entry_points)

    def members(self, struct: str) -> Mapping[str, Field]:
        """Members of a struct by name; none if there is no such struct."""
        return {f.name: f for s in self.structs if s.name == struct for f in s.fields}

    def dtype(self, struct: str = "solver") -> np.dtype[Any]:
        """Structured NumPy type of a C struct: members in order and aligned as in C; those of a union overlap."""
        members = [(f.name, self._member_type(f), f.padded) for f in self.members(struct).values()]
        overlap = any(s.union for s in self.structs if s.name == struct)
        return union_dtype(members) if overlap else np.dtype(members, align=True)

    def _member_type(self, member: Field) -> np.dtype[Any]:
        if member.ctype == "real":
            return self.real
        if member.ctype in INTEGERS:
            return np.dtype(INTEGERS[member.ctype])
        return self.dtype(member.ctype)

    def to_json(self) -> str:
        """The text of <name>.json, from which from_json() restores an equal description."""
        entries: dict[str, Any] = {"format": FORMAT} | {f.name: getattr(self, f.name) for f in fields(self)}
        entries |= {
            "structs": [_struct_entry(s) for s in self.structs],
            "rows": [_row_entry(r) for r in self.rows],
            "entry_points": [asdict(e) for e in self.entry_points],
            "report": self.report.as_dict(),
            "program": asdict(self.program),
        }
        for kind in ("states", "controls", "parameters", "residuals", "residuals_N"):
            entries[kind] = [vars(s) for s in entries[kind]]
        return json.dumps(entries, indent=1, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> PackageDescription:
        """Read the text of <name>.json; compiled.py compares the layout with that of the compiled code.

        Raises:
            ControllerError: the text is not a package description, or has another format.
        """
        try:
            raw = msgspec.json.decode(text)
            found = msgspec.convert({"format": None, **raw}["format"], int | None)
            if found != FORMAT:
                raise ControllerError(f"the package description has format {found}, not {FORMAT}: export it again")
            for struct in raw["structs"]:
                struct["fields"] = [_field_of(member) for member in struct["fields"]]
            for row in raw["rows"]:
                row |= {side: float(row[side]) for side in ("lower", "upper")}
            described = msgspec.convert(raw, cls)
            described.dims  # noqa: B018 - all sizes are there
            solver = {struct.name: struct for struct in described.structs}["solver"]
        except (msgspec.MsgspecError, TypeError, KeyError, ValueError, ArithmeticError, RecursionError) as error:
            what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise ControllerError(f"the package description is not one that export() writes: {what}") from error
        shapes = {member.ctype: member.shape for member in solver.fields}
        return replace(described, structs=tuple(replace(s, shape=shapes.get(s.name, ())) for s in described.structs))


def union_dtype(members: Sequence[tuple[str, np.dtype[Any], tuple[int, ...]]]) -> np.dtype[Any]:
    """Structured NumPy type of a C union: (name, type, shape) of every member, all at offset 0."""
    names, formats, shapes = zip(*members, strict=True)
    of_members = [np.dtype((f, shape)) for f, shape in zip(formats, shapes, strict=True)]
    layout = {"names": list(names), "formats": of_members, "offsets": [0] * len(names)}
    return np.dtype(layout, align=True)  # type: ignore[call-overload, no-any-return]


def _elements(signals: tuple[Signal, ...]) -> tuple[str, ...]:
    return tuple(e for s in signals for e in s.elements)


# -- to JSON -----------------------------------------------------------------------------------------------------------


def _struct_entry(struct: Struct) -> dict[str, Any]:
    entry = {"name": struct.name, "doc": struct.doc, "fields": [_field_entry(f) for f in struct.fields]}
    return entry | ({"union": True} if struct.union else {})


def _field_entry(member: Field) -> dict[str, Any]:
    return {
        "name": member.name,
        "type": member.ctype,
        "shape": list(member.values),
        "padded": list(member.padded),
        "role": member.role,
        "doc": member.doc,
    }


def _row_entry(row: Row) -> dict[str, Any]:
    return vars(row) | {"lower": _number(row.lower), "upper": _number(row.upper)}


def _number(value: float) -> float | str:
    return float(value) if math.isfinite(value) else str(float(value))


# -- from JSON ---------------------------------------------------------------------------------------------------------


def _field_of(member: Mapping[str, Any]) -> dict[str, Any]:
    """The members of a Field from those of its entry."""
    shape = [{"text": str(size), "value": size} for size in member["shape"]]
    return {**member, "ctype": member["type"], "shape": shape}
