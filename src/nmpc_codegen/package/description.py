"""A PackageDescription holds sizes, names, rows, the layout of the solver struct, and the report of a C package.

Lowering creates it, to_json() writes it to <name>.json, and from_json() reads it wherever a package is run. Nothing
here needs CasADi or a compiler.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.estimation import Estimation, kind_of
from nmpc_codegen.package.kinds import Kind
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.program import Program
from nmpc_codegen.package.signals import (
    NOT_AUGMENTED,
    Augmentation,
    EntryPoint,
    Layouts,
    Names,
    Residual,
    Row,
    Signal,
    c_constants,
)
from nmpc_codegen.package.struct_layout import INTEGERS, REAL, Field, Precision, Size, Struct

#: Sizes of the interface, which every header defines.
INTERFACE_SIZES = ("N", "NX", "NU", "NP", "NY", "NY_N", "NW", "NW_N", "NR")

#: Version of the layout of <name>.json; keys in it that differ from the names of the fields.
FORMAT, KEYS = 11, {"augmentation": "inner"}

DIMENSIONS = ("N", "NX", "NU", "NP", "NY", "NY_N", "NH", "NH_N", "NR")


@dataclass(frozen=True)
class Dimensions:
    """The sizes of a controller have the notation of the project."""

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
class Report:
    """A report tells what the compiler has found about a package.

    ram_bytes: size of the solver struct; ram_bytes_by_struct: sizes of the structs in it; operations: of one call of
    every C function, unless they depend on data; linearization_operations: of all nodes together; choices: the chosen
    components with reasons; warnings: likely causes of poor results; looped: functions with loops instead of
    straight-line code.
    """

    ram_bytes: int = 0
    ram_bytes_by_struct: Mapping[str, int] = field(default_factory=dict)
    operations: Mapping[str, OpCount] = field(default_factory=dict)
    linearization_operations: int = 0
    choices: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    looped: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the report as dictionaries, lists and numbers, as in <name>.json."""
        return {
            "ram_bytes": self.ram_bytes,
            "ram_bytes_by_struct": dict(self.ram_bytes_by_struct),
            "operations": {name: count.as_dict() for name, count in self.operations.items()},
            "linearization_operations": self.linearization_operations,
            "choices": list(self.choices),
            "warnings": list(self.warnings),
            "looped": list(self.looped),
        }


@dataclass(frozen=True)
class PackageDescription:
    """A description holds all facts about a package.

    Each struct follows the structs that it contains, so that "solver" is last. ``ranges`` holds the least and the
    largest value of every integer member that limits a loop; the worst case of a sample follows from them.
    """

    name: str
    precision: Precision
    target: str  # name in targets.TARGETS
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
    time_unit: str  # unit of dt and sampling_time; "samples" for a discrete map
    statuses: tuple[str, ...]
    shift: str | None
    sampling_time: float | None  # sampling time for which the package is made; None: any
    entry_points: tuple[EntryPoint, ...]
    online: Layouts
    options: Mapping[str, Any]  # dotted name -> value; for a component its class
    report: Report
    scales: tuple[float, ...]  # scales of states and controls, (nx + nu,)
    row_scales: tuple[float, ...]  # sizes of the terms of the rows
    augmentation: Augmentation = NOT_AUGMENTED  # states added to the user's, only in the struct
    algebraic: tuple[Signal, ...] = ()
    newton: tuple[str, ...] = ()  # variables that Newton's method solves for, which may be derivatives of states
    estimation: Estimation | None = None  # of an estimator
    ranges: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    program: Program = field(default_factory=Program)

    @cached_property
    def dims(self) -> Dimensions:
        """Return the sizes in the notation of the project; nx counts the states of the user."""
        sizes = {n: value - (self.augmentation.idle if n == "NU" else 0) for n, value in self.interface.items()}
        return Dimensions(*(sizes[name] for name in DIMENSIONS))

    @cached_property
    def interface(self) -> Mapping[str, int]:
        """Return the sizes in the header: NX and NP count the states and parameters of the user."""
        measured = 0 if self.estimation is None else self.estimation.data
        behind = {"NX": self.augmentation.count, "NP": self.augmentation.data + measured}
        return {name: value - behind.get(name, 0) for name, value in self.sizes.items()}

    @property
    def kind(self) -> Kind:
        """Return the kind of the package."""
        return kind_of(self.estimation)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Return the names of the outputs of a sample: controls, or estimates."""
        return self.names.controls if self.estimation is None else self.names.states

    @property
    def real(self) -> np.dtype[Any]:
        """Return the NumPy type of <name>_real."""
        return np.dtype(REAL[self.precision])

    @property
    def row_constants(self) -> tuple[str, ...]:
        """Return the endings of the C constants of the rows, after <NAME>_ROW_."""
        return c_constants([row.name for row in self.rows])

    @property
    def parameter_constants(self) -> tuple[str, ...]:
        """Return the endings of the C constants of the parameters, after <NAME>_PARAM_."""
        return c_constants([signal.name for signal in self.parameters])

    @property
    def x_initial(self) -> NDArray[np.float64]:
        """Return the declared initial state, (nx,)."""
        return np.array([v for s in self.states for v in s.value], dtype=np.float64)

    @property
    def names(self) -> Names:
        """Return the element names of every vector."""
        return Names(
            states=_elements(self.states),
            controls=_elements(self.controls),
            parameters=_elements(self.parameters),
            algebraic=_elements(self.algebraic),
            rows=tuple(r.name for r in self.rows),
            y=tuple(r.name for r in self.residuals),
            y_N=tuple(r.name for r in self.residuals_N),
        )

    @property
    def has_phases(self) -> bool:
        """Return True if a sample consists of prepare() and feedback(), False if it is one call of step()."""
        return self.offers("prepare") and self.offers("feedback")

    def offers(self, name: str) -> bool:
        """Return True if the algorithm has an entry point with that name."""
        return any(entry.name == name for entry in self.entry_points)

    def members(self, struct: str) -> Mapping[str, Field]:
        """Return the members of a struct by name; empty if there is no such struct."""
        return self._members.get(struct, {})

    @cached_property
    def _members(self) -> Mapping[str, Mapping[str, Field]]:
        """Return {struct: {name of a member: member}}."""
        return {s.name: {f.name: f for f in s.fields} for s in self.structs}

    def dtype(self, struct: str = "solver") -> np.dtype[Any]:
        """Return the NumPy type of a C struct: members in order and aligned as in C; those of a union overlap."""
        members = [(f.name, self._member_type(f), f.values) for f in self.members(struct).values()]
        overlap = any(s.union for s in self.structs if s.name == struct)
        return union_dtype(members) if overlap else np.dtype(members, align=True)

    def _member_type(self, member: Field) -> np.dtype[Any]:
        if member.ctype == "real":
            return self.real
        if member.ctype in INTEGERS:
            return np.dtype(INTEGERS[member.ctype])
        return self.dtype(member.ctype)

    def to_json(self) -> str:
        """Return the text of <name>.json, from which from_json() restores an equal description."""
        entries: dict[str, Any] = {"format": FORMAT} | {
            KEYS.get(f.name, f.name): getattr(self, f.name) for f in fields(self)
        }
        entries |= {
            "structs": [_struct_entry(s) for s in self.structs],
            "rows": [_row_entry(r) for r in self.rows],
            "entry_points": [asdict(e) for e in self.entry_points],
            "report": self.report.as_dict(),
            "program": asdict(self.program),
            KEYS["augmentation"]: asdict(self.augmentation),
            "estimation": self.estimation and asdict(self.estimation),
        }
        for kind in ("states", "controls", "parameters", "algebraic", "residuals", "residuals_N"):
            entries[kind] = [_signal_entry(s) for s in entries[kind]]
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
                row["soft"] = row["soft"] and [float(value) for value in row["soft"]]
            for signal in (*raw["states"], *raw["controls"], *raw["parameters"], *raw["algebraic"]):
                signal |= {side: [float(value) for value in signal[side]] for side in ("low", "high")}
            raw |= {name: raw.pop(key) for name, key in KEYS.items()}
            described = msgspec.convert(raw, cls, dec_hook=_size)
            described.dims  # noqa: B018 - all sizes are there
            solver = {struct.name: struct for struct in described.structs}["solver"]
        except (msgspec.MsgspecError, TypeError, KeyError, ValueError, ArithmeticError, RecursionError) as error:
            what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise ControllerError(f"the package description is not one that export() writes: {what}") from error
        shapes = {member.ctype: member.shape for member in solver.fields}
        return replace(described, structs=tuple(replace(s, shape=shapes.get(s.name, ())) for s in described.structs))


def union_dtype(members: Sequence[tuple[str, np.dtype[Any], tuple[int, ...]]]) -> np.dtype[Any]:
    """Return the NumPy type of a C union from (name, type, shape) of every member, all at offset 0."""
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
    soft = None if row.soft is None else [_number(value) for value in row.soft]
    return vars(row) | {"lower": _number(row.lower), "upper": _number(row.upper), "soft": soft}


def _signal_entry(signal: Signal | Residual) -> dict[str, Any]:
    limits = {side: [_number(v) for v in getattr(signal, side)] for side in ("low", "high") if hasattr(signal, side)}
    return vars(signal) | limits


def _number(value: float) -> float | str:
    return float(value) if math.isfinite(value) else str(float(value))


# -- from JSON ---------------------------------------------------------------------------------------------------------


def _field_of(member: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a Field from its entry."""
    return {**member, "ctype": member["type"]}


def _size(wanted: type, value: Any) -> Size:
    """Return the size of a member from its number."""
    if wanted is not Size or type(value) is not int:
        raise ValueError(f"{value!r}; expected an integer")
    return Size(str(value), value)
