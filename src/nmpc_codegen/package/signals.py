"""Names of a problem and of its package are signals, rows, residuals and entry points, with their spellings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

RowKind = Literal["control", "state", "general", "coupled"]

#: Kinds of data that can be changed at run time; their storage is a table of declared values, one copy, or one per
#: node.
Kind = Literal["reference", "weight", "bounds", "parameter", "soft"]
Layout = Literal["fixed", "shared", "node"]
Layouts = Mapping[Kind, Layout]

#: Largest number of names in a list; of more, the first ones and the total number are shown.
LISTED = 12


@dataclass(frozen=True)
class Argument:
    """An argument of an entry point is an array, a number, or a pointer to a struct.

    ctype: "real", "int" or the name of a struct; shape: macros of its sizes without prefix, "" for an unspecified size.
    """

    name: str
    ctype: str
    shape: tuple[str, ...] = ()


@dataclass(frozen=True)
class EntryPoint:
    """The algorithm offers this function <prefix>_<name>(solver, inputs, outputs) -> status."""

    name: str
    doc: str
    inputs: tuple[Argument, ...] = ()
    outputs: tuple[Argument, ...] = ()


@dataclass(frozen=True)
class Signal:
    """A signal is a named scalar or vector among the states, controls or parameters.

    ``offset`` is the index of its first element in the stacked vector; ``value`` holds the initial value of a state
    (x_0 for --check, --simulate, main.c), the value of a parameter, and zeros for a control. ``scale`` holds declared
    scales of the elements, empty for none; ``low`` and ``high`` are bounds of a parameter, or of the initial values of
    a state, empty for none.
    """

    name: str
    size: int
    unit: str
    value: tuple[float, ...]
    offset: int
    scalar: bool  # declared without size=
    scale: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()

    @property
    def elements(self) -> tuple[str, ...]:
        """Return the names of the elements as the user reads them: ``v`` or ``r[0], r[1]``."""
        return (self.name,) if self.scalar else tuple(f"{self.name}[{i}]" for i in range(self.size))


@dataclass(frozen=True)
class Augmentation:
    """The augmented state has states and parameters that the compiler adds to the user's.

    With these a node knows the previous controls, and its time. The added states are, in this order, ``time`` of the
    node and ``previous``, controls whose values at the previous node are stored; their values at node 0 are known.

    The added parameters of the nodes are, in this order, flags for ``held``, controls with blocks of intervals, which
    are those of the previous node unless a block begins (1 where a block begins, else 0), and with ``interval`` the
    length of the previous interval. With ``idle``, the problem has no control; its package has an idle one, which
    stays 0.
    """

    previous: tuple[int, ...] = ()
    interval: bool = False
    time: bool = False
    held: tuple[int, ...] = ()
    idle: bool = False

    @property
    def count(self) -> int:
        """Return the number of added states."""
        return len(self.previous) + self.time

    @property
    def data(self) -> int:
        """Return the number of added parameters."""
        return len(self.held) + self.interval

    @property
    def places(self) -> dict[int, int]:
        """Return {control: index among the added states of its value at the previous node}."""
        return {j: i + self.time for i, j in enumerate(self.previous)}


#: The augmentation of a problem without added states and parameters.
NOT_AUGMENTED = Augmentation()


@dataclass(frozen=True)
class Soft:
    """A soft row has penalties, by side: a violation v >= 0 costs l1 v + l2/2 v^2.

    Args:
        lower: (l1, l2) below the lower bound, or l1. With an infinite l1 the side is hard now and may become soft at
            run time. None: always hard; in set_soft(): unchanged.
        upper: the same for the upper bound.
        scale_with_dt: True: multiply both by the length of the interval; at node N by that of the last interval.

    Examples:
        >>> from nmpc_codegen import Soft
        >>> penalties = Soft(lower=(100, 10), upper=50)
    """

    lower: tuple[float, float] | float | None = None
    upper: tuple[float, float] | float | None = None
    scale_with_dt: bool = False


@dataclass(frozen=True)
class Row:
    """A row lower <= value <= upper is imposed at ``nodes``, with its declared bounds.

    kind "control": value = u[index], a hard simple bound at every node 0..N-1;
    kind "state": value = x[index]; ``nodes`` is empty if an equality at the end replaces the whole row (N = 1);
    kind "general": value = h[index] of the path stage (nodes < N) and h[index_terminal] of the terminal stage (node N),
    -1 if the row does not hold there;
    kind "coupled": r[index](x_0, x_N), ``nodes`` is (0, N). Equality: lower == upper.

    ``soft`` holds (l1, l2) of the penalty l1 v + l2/2 v^2 of a violation v; an infinite l1 marks a hard row that may
    become soft, None a row that stays hard. With ``scaled`` the penalty is multiplied by the length of the interval, at
    node N by that of the last one. ``stated`` names the row of the user, if this is one ``side`` of it.
    """

    name: str
    kind: RowKind
    index: int
    index_terminal: int
    nodes: tuple[int, ...]
    lower: float
    upper: float
    soft: tuple[float, float] | None = None
    scaled: bool = False
    stated: str = ""
    side: Literal["", "lower", "upper"] = ""

    @property
    def hard(self) -> bool:
        """Return True if the row is hard, or may become hard at run time."""
        return self.soft is None or self.soft[0] == float("inf")

    @property
    def strictness(self) -> str:
        """Return "hard", "soft" or "hard or soft"."""
        return "hard" if self.soft is None else "hard or soft" if self.hard else "soft"

    @property
    def user_name(self) -> str:
        """Return the name of the row that the user stated."""
        return self.stated or self.name

    def penalty(self, node: int, dt: Sequence[float]) -> tuple[float, float] | None:
        """Return the declared (l1, l2) at a node; None where the row is hard."""
        if self.soft is None or self.hard:
            return None
        factor = dt[min(node, len(dt) - 1)] if self.scaled else 1.0
        return self.soft[0] * factor, self.soft[1] * factor

    @property
    def is_general(self) -> bool:
        return self.kind == "general"

    @property
    def is_coupled(self) -> bool:
        return self.kind == "coupled"

    @property
    def is_equation(self) -> bool:
        """Return True for a hard row with equal bounds."""
        return self.soft is None and self.lower >= self.upper

    def place(self, at_end: bool) -> int:
        """Return the row's index in x, u, the general rows of the path or (``at_end``) of the terminal stage, or r.

        -1 for none.
        """
        return self.index_terminal if self.is_general and at_end else self.index

    def of_kind(self, x: Any, u: Any, h: Any, r: Any) -> Any:
        """Return the argument for states, controls, general rows or coupled rows, by the kind of the row."""
        return {"control": u, "state": x, "general": h, "coupled": r}[self.kind]

    def value(self, x: Any, u: Any, h: Any, r: Any, at_end: bool = False) -> Any:
        """Return the row's entry of x, u, the general rows h of the stage, or the coupled rows r."""
        return self.of_kind(x, u, h, r)[self.place(at_end)]

    def variable(self, nx: int) -> int | None:
        """Return the index in (x, u) of the state or control that this row bounds; None for other rows."""
        return {"state": self.index, "control": nx + self.index}.get(self.kind)


class ImposedRow(NamedTuple):
    """A row is imposed at one of its nodes.

    kind 0: bound of a state, 1: general row, 2: coupled row; ``component`` is its index in x, h or r, ``row`` its index
    among all rows.
    """

    node: int
    kind: int
    component: int
    row: int


#: Kinds of rows that are imposed node by node, in the order of their numbers.
IMPOSED_KINDS = ("state", "general", "coupled")


def imposed_rows(rows: Sequence[Row], N: int) -> tuple[ImposedRow, ...]:
    """Return one entry per node for every row that is no control bound, sorted by node.

    Coupled rows belong to node N.
    """
    found = []
    for i, row in enumerate(rows):
        if row.kind in IMPOSED_KINDS:
            for k in (N,) if row.is_coupled else row.nodes:
                found.append(ImposedRow(k, IMPOSED_KINDS.index(row.kind), row.place(k == N), i))
    return tuple(sorted(found))


@dataclass(frozen=True)
class Residual:
    """A residual of the least-squares cost has a name, a declared reference, and the state or control that it equals.

    ``signal`` is "" for another expression.
    """

    name: str
    reference: float
    signal: str


@dataclass(frozen=True)
class Names:
    """The names are those of all elements, in the order of the vectors that hold them."""

    states: tuple[str, ...]
    controls: tuple[str, ...]
    parameters: tuple[str, ...]
    rows: tuple[str, ...]
    y: tuple[str, ...]
    y_N: tuple[str, ...]
    algebraic: tuple[str, ...] = ()


def members(name: str, known: Sequence[str]) -> list[int]:
    """Return the index of the element with that name, or of all elements name[i]; empty if there is none."""
    if name in known:
        return [known.index(name)]
    return [i for i, element in enumerate(known) if name and element.rpartition("[")[0] == name]


def units(*groups: Iterable[Signal]) -> dict[str, str]:
    """Return {name of an element: its unit}."""
    return {name: signal.unit for signals in groups for signal in signals for name in signal.elements}


# -- how they are written ---------------------------------------------------------------------------------------------


def c_identifier(name: str) -> str:
    """Return the C spelling of an element name: ``r[0]`` becomes ``r_0``."""
    return name.replace("[", "_").replace("]", "")


def c_constants(names: Sequence[str]) -> tuple[str, ...]:
    """Return user names as C constants in upper case; names that differ only by case keep their spelling."""
    spelled = [c_identifier(name) for name in names]
    upper = [name.upper() for name in spelled]
    return tuple(big if upper.count(big) == 1 else name for name, big in zip(spelled, upper, strict=True))


def list_some(names: Sequence[object]) -> str:
    """Return names separated by commas; of more than LISTED names the first ones and the total number."""
    shown = ", ".join(map(str, names[:LISTED]))
    return shown if len(names) <= LISTED else f"{shown}, ... ({len(names)} in all)"


def horizon(dt: Sequence[float], unit: str, discrete: bool) -> str:
    """Return the grid in words: "10 intervals over 3 s", with the least and the largest length if they differ."""
    if discrete:
        return f"{len(dt)} intervals of a discrete map"
    uneven = "" if len(set(dt)) == 1 else f" of {min(dt):g} to {max(dt):g} {unit}"
    return f"{len(dt)} intervals{uneven} over {sum(dt):g} {unit}"


def nodes(which: Sequence[int]) -> str:
    """Return nodes in ascending order as text: "0..9" if they are consecutive, else "0, 5, 10"."""
    consecutive = len(which) > 2 and which[-1] - which[0] == len(which) - 1
    return f"{which[0]}..{which[-1]}" if consecutive else list_some(which)
