"""What <name>.json says about a C package, as frozen values: sizes, names, rows and the layout of the solver struct.

Everything that runs a package reads it from here; parse.py makes it from the text. Nothing here needs CasADi or a
compiler.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

REAL: dict[str, type[np.floating[Any]]] = {"double": np.float64, "single": np.float32}
INTEGERS: dict[str, type[np.integer[Any]]] = {"int32": np.int32, "int64": np.int64}


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
    nr: int  # scalar rows the user stated


@dataclass(frozen=True)
class SignalInfo:
    """A named state, control or parameter; ``offset`` is the position of its first element in the stacked vector."""

    name: str
    size: int
    unit: str
    value: tuple[float, ...]
    offset: int
    scalar: bool

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the elements: ``v`` or ``r[0], r[1]``."""
        return (self.name,) if self.scalar else tuple(f"{self.name}[{i}]" for i in range(self.size))


@dataclass(frozen=True)
class RowInfo:
    """One scalar row lower <= value <= upper, with the bounds it was declared with."""

    name: str
    kind: str  # control | state | general | coupled
    index: int
    index_terminal: int
    nodes: tuple[int, ...]
    lower: float
    upper: float


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
class Member:
    """A member of a C struct: true ``shape``, and ``padded`` as C declares it."""

    name: str
    type: str  # real | int32 | int64 | name of a struct
    shape: tuple[int, ...]
    padded: tuple[int, ...]
    role: str
    doc: str


@dataclass(frozen=True)
class Description:
    """A whole package; ``structs`` maps a struct's name to its members, "solver" holds all others."""

    name: str
    precision: str
    dims: Dimensions
    sizes: Mapping[str, int]  # macro without prefix -> value
    structs: Mapping[str, tuple[Member, ...]]
    unions: frozenset[str]  # structs whose members share their memory
    states: tuple[SignalInfo, ...]
    controls: tuple[SignalInfo, ...]
    parameters: tuple[SignalInfo, ...]
    rows: tuple[RowInfo, ...]
    y_names: tuple[str, ...]
    y_names_N: tuple[str, ...]
    dt: tuple[float, ...]
    discrete: bool
    statuses: tuple[str, ...]
    online: Mapping[str, str]  # reference, weight, bounds, parameter -> fixed, shared, node
    options: str
    report: Mapping[str, Any]

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

    def dtype(self, struct: str = "solver") -> np.dtype[Any]:
        """Structured NumPy type of a C struct: members in order and aligned as in C; those of a union overlap."""
        members = [(m.name, self._member_type(m), m.padded) for m in self.structs[struct]]
        return union_dtype(members) if struct in self.unions else np.dtype(members, align=True)

    def _member_type(self, member: Member) -> np.dtype[Any]:
        if member.type == "real":
            return self.real
        if member.type in INTEGERS:
            return np.dtype(INTEGERS[member.type])
        return self.dtype(member.type)


def union_dtype(members: Sequence[tuple[str, np.dtype[Any], tuple[int, ...]]]) -> np.dtype[Any]:
    """Structured NumPy type of a C union: (name, type, shape) of every member, all at offset 0."""
    names, formats, shapes = zip(*members, strict=True)
    of_members = [np.dtype((f, shape)) for f, shape in zip(formats, shapes, strict=True)]
    layout = {"names": list(names), "formats": of_members, "offsets": [0] * len(names)}
    return np.dtype(layout, align=True)  # type: ignore[call-overload, no-any-return]


def _elements(signals: tuple[SignalInfo, ...]) -> tuple[str, ...]:
    return tuple(e for s in signals for e in s.elements)
