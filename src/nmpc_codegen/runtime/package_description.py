"""Description of a C package: sizes, names, rows, the layout of the solver struct, the report.

Lowering creates a PackageDescription, and to_json() yields the text of <name>.json; from_json() reads it wherever a
package is run. Nothing here needs CasADi or a compiler.
"""

from __future__ import annotations

import json
import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.runtime.parse import FORMAT, MAX_INTEGER, Entry, read

Precision = Literal["double", "single"]
Role = Literal["setting", "data", "iterate", "result", "keep", "scratch"]
RowKind = Literal["control", "state", "general", "coupled"]

#: Data that can be changed at run time, and how they are stored: as a table of declared values, once, or once per node.
Kind = Literal["reference", "weight", "bounds", "parameter"]
Layout = Literal["fixed", "shared", "node"]
Layouts = Mapping[Kind, Layout]

REAL: dict[str, type[np.floating[Any]]] = {"double": np.float64, "single": np.float32}
INTEGERS: dict[str, type[np.integer[Any]]] = {"int32": np.int32, "int64": np.int64}

#: Largest number of operations that is accepted.
MAX_COUNT = 2**63 - 1

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
    that calls both, or of the sample alone if it has a budget; empty if unknown; ``choices``: the chosen components and
    the reasons; ``looped``: functions with loops instead of straight-line code.
    """

    ram_bytes: int = 0
    ram_bytes_by_struct: Mapping[str, int] = field(default_factory=dict)
    operations: Mapping[str, OpCount] = field(default_factory=dict)
    linearization_operations: int = 0
    worst_operations: Mapping[str, int] = field(default_factory=dict)
    choices: tuple[str, ...] = ()
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
    y_names: tuple[str, ...]
    y_names_N: tuple[str, ...]
    dt: tuple[float, ...]
    discrete: bool
    statuses: tuple[str, ...]
    shift: str | None
    entry_points: tuple[EntryPoint, ...]
    online: Layouts
    options: str
    report: Report

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
            y=self.y_names,
            y_N=self.y_names_N,
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
        }
        for kind in ("states", "controls", "parameters"):
            entries[kind] = [vars(s) for s in entries[kind]]
        return json.dumps(entries, indent=1, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> PackageDescription:
        """Read the text of <name>.json. As its origin is unknown, type, range and consistency of all entries are
        checked here; compiled.py also compares them with the compiled code.

        Raises:
            ControllerError: the text is not a package description, has another format, or contradicts itself.
        """
        raw = read(text).members(("format", *(f.name for f in fields(cls))), ("seal",))
        sizes = raw["sizes"].members(DIMENSIONS, raw["sizes"].object())
        dims = _dimensions(sizes)
        return cls(
            name=raw["name"].identifier(),
            precision=raw["precision"].word(get_args(Precision)),
            sizes={name: size.integer(-MAX_INTEGER) for name, size in sizes.items()},
            structs=_structs(raw["structs"]),
            states=_signals(raw["states"], dims.nx),
            controls=_signals(raw["controls"], dims.nu),
            parameters=_signals(raw["parameters"], dims.np),
            rows=_rows(raw["rows"], dims),
            y_names=tuple(name.text() for name in raw["y_names"].items(dims.ny)),
            y_names_N=tuple(name.text() for name in raw["y_names_N"].items(dims.ny_N)),
            dt=tuple(_interval(dt) for dt in raw["dt"].items(dims.N)),
            discrete=raw["discrete"].flag(),
            statuses=_unique(raw["statuses"], Entry.identifier),
            shift=None if raw["shift"].value is None else raw["shift"].text(),
            entry_points=tuple(_entry_point(entry, sizes) for entry in raw["entry_points"].items()),
            online=_layouts(raw["online"]),
            options=raw["options"].text(),
            report=_report(raw["report"]),
        )


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


def _dimensions(sizes: Mapping[str, Entry]) -> Dimensions:
    return Dimensions(
        N=sizes["N"].integer(1),
        nx=sizes["NX"].integer(1),
        nu=sizes["NU"].integer(),
        np=sizes["NP"].integer(),
        ny=sizes["NY"].integer(),
        ny_N=sizes["NY_N"].integer(),
        nh=sizes["NH"].integer(),
        nh_N=sizes["NH_N"].integer(),
        nr=sizes["NR"].integer(),
    )


def _interval(entry: Entry) -> float:
    dt = entry.number()
    return dt if dt > 0 else entry.fail("a positive number")


def _unique(entry: Entry, read: Callable[[Entry], str], count: int | None = None) -> tuple[str, ...]:
    """The names in a list, which must be distinct."""
    names: dict[str, None] = {}
    for item in entry.items(count):
        if read(item) in names:
            item.fail("a name that no other entry has")
        names[read(item)] = None
    return tuple(names)


def _structs(entry: Entry) -> tuple[Struct, ...]:
    """The structs. The type of a member must be defined before, so that no struct contains itself; the shape of a
    struct is that of its member in the solver."""
    structs: dict[str, Struct] = {}
    for item in entry.items():
        raw = item.members(("name", "doc", "fields"), ("union",))
        name = raw["name"].identifier()
        if name in structs or name in ("real", *INTEGERS):
            raw["name"].fail("a name that no other type has")
        types = ("real", *INTEGERS, *structs)
        members = tuple(_member(item, types) for item in raw["fields"].items())
        if len({member.name for member in members}) != len(members):
            raw["fields"].fail("members of different names")
        union = "union" in raw and raw["union"].flag()
        structs[name] = Struct(name, raw["doc"].text(), members, union=union)
    if "solver" not in structs:
        entry.fail("a struct solver among them")
    shapes = {member.ctype: member.shape for member in structs["solver"].fields}
    return tuple(replace(s, shape=shapes.get(s.name, ())) for s in structs.values())


def _member(entry: Entry, types: Iterable[str]) -> Field:
    raw = entry.members(("name", "type", "shape", "padded", "role", "doc"))
    shape = tuple(size.integer() for size in raw["shape"].items())
    padded = tuple(size.integer(1) for size in raw["padded"].items(len(shape)))
    if padded != tuple(max(1, size) for size in shape):
        raw["padded"].fail(f"the shape {list(shape)} with 1 for 0")
    return Field(
        ctype=raw["type"].word(tuple(types)),
        name=raw["name"].identifier(),
        shape=tuple(Size(str(size), size) for size in shape),
        doc=raw["doc"].text(),
        role=raw["role"].word(get_args(Role)),
    )


def _signals(entry: Entry, total: int) -> tuple[Signal, ...]:
    """Signals that fill a vector of ``total`` elements one after the other."""
    signals: list[Signal] = []
    offset = 0
    for item in entry.items():
        raw = item.members(("name", "size", "unit", "value", "offset", "scalar"))
        size, scalar = raw["size"].integer(1), raw["scalar"].flag()
        if scalar and size != 1:
            raw["size"].fail("1, as it is a scalar")
        if raw["offset"].integer() != offset:
            raw["offset"].fail(f"{offset}, where the previous signal ends")
        if any(s.name == raw["name"].identifier() for s in signals):
            raw["name"].fail("a name that no other one has")
        value = tuple(v.number() for v in raw["value"].items(size))
        signals.append(Signal(raw["name"].identifier(), size, raw["unit"].text(), value, offset, scalar))
        offset += size
    if offset != total:
        entry.fail(f"{total} elements in all, not {offset}")
    return tuple(signals)


def _rows(entry: Entry, dims: Dimensions) -> tuple[Row, ...]:
    rows = tuple(_row(item, dims) for item in entry.items(dims.nr))
    if len({row.name for row in rows}) != len(rows):
        entry.fail("rows of different names")
    return rows


def _row(entry: Entry, dims: Dimensions) -> Row:
    raw = entry.members(("name", "kind", "index", "index_terminal", "nodes", "lower", "upper"), ("soft",))
    kind = raw["kind"].word(get_args(RowKind))
    limits: dict[RowKind, int] = {"control": dims.nu, "state": dims.nx, "general": dims.nh, "coupled": dims.nr}
    limit_N = {"general": dims.nh_N, "state": dims.nx}.get(kind, 0)
    lower, upper = raw["lower"].bound(), raw["upper"].bound()
    if lower > upper:
        raw["lower"].fail(f"at most the upper bound {upper}")
    return Row(
        name=raw["name"].element(),
        kind=kind,
        index=raw["index"].integer(-1 if kind == "general" else 0, limits[kind] - 1),
        index_terminal=raw["index_terminal"].integer(-1, limit_N - 1),
        nodes=_nodes(raw["nodes"], kind, dims.N),
        lower=lower,
        upper=upper,
        soft=_penalties(raw["soft"]) if "soft" in raw and raw["soft"].value is not None else None,
    )


def _penalties(entry: Entry) -> tuple[float, float]:
    l1, l2 = (penalty.bound() for penalty in entry.items(2))
    return l1, l2


def _nodes(entry: Entry, kind: str, N: int) -> tuple[int, ...]:
    """Nodes of a row; the kinds "control" and "coupled" determine them."""
    nodes = tuple(node.integer(0, N) for node in entry.items())
    expected = {"control": tuple(range(N)), "coupled": (0, N)}.get(kind, tuple(sorted(set(nodes))))
    if nodes != expected:
        entry.fail(
            "all nodes but the last for a control, the first and the last for a coupled row, else ascending ones"
        )
    return nodes


def _entry_point(entry: Entry, sizes: Mapping[str, Entry]) -> EntryPoint:
    raw = entry.members(("name", "doc", "inputs", "outputs"))
    inputs, outputs = (tuple(_argument(item, sizes) for item in raw[side].items()) for side in ("inputs", "outputs"))
    return EntryPoint(raw["name"].identifier(), raw["doc"].text(), inputs, outputs)


def _argument(entry: Entry, sizes: Mapping[str, Entry]) -> Argument:
    raw = entry.members(("name", "ctype", "shape"))
    shape = tuple(size.word(tuple(sizes)) for size in raw["shape"].items())
    return Argument(raw["name"].identifier(), raw["ctype"].word(("real", "int")), shape)


def _layouts(entry: Entry) -> Layouts:
    raw, kinds = entry.members(get_args(Kind)), get_args(Kind)
    return {kind: raw[kind].word(get_args(Layout)) for kind in kinds}


def _report(entry: Entry) -> Report:
    """The report; the description of a hand-written package may leave out any of its entries."""
    raw = entry.members((), [f.name for f in fields(Report)])
    empty = Entry("", {})
    sizes = raw.get("ram_bytes_by_struct", empty).object()
    operations = raw.get("operations", empty).object()
    total = raw.get("linearization_operations", Entry("", 0))
    worst = raw.get("worst_operations", empty).object()
    return Report(
        ram_bytes=raw.get("ram_bytes", Entry("", 0)).integer(),
        ram_bytes_by_struct={name: size.integer() for name, size in sizes.items()},
        operations={name: _operations(count) for name, count in operations.items()},
        linearization_operations=total.integer(high=MAX_COUNT),
        worst_operations={phase: count.integer(high=MAX_COUNT) for phase, count in worst.items()},
        choices=tuple(choice.text() for choice in raw.get("choices", Entry("", [])).items()),
        looped=tuple(name.identifier() for name in raw.get("looped", Entry("", [])).items()),
    )


def _operations(entry: Entry) -> OpCount:
    raw = entry.members([f.name for f in fields(OpCount)])
    return OpCount(**{name: count.integer(high=MAX_COUNT) for name, count in raw.items()})
