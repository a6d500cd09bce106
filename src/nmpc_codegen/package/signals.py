"""Names of a problem and of its package: signals, rows, residuals, entry points, and how they are written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

RowKind = Literal["control", "state", "general", "coupled"]

#: Data that can be changed at run time, and how they are stored: as a table of declared values, once, or once per node.
Kind = Literal["reference", "weight", "bounds", "parameter", "soft"]
Layout = Literal["fixed", "shared", "node"]
Layouts = Mapping[Kind, Layout]

#: Names of a list; of more, the first ones are shown and their number.
LISTED = 12


@dataclass(frozen=True)
class Argument:
    """An argument of an entry point: an array of the sizes that ``shape`` names, a number, or a pointer to a struct.

    ``ctype``: "real", "int" or the name of a struct; ``shape``: macros without prefix, "" for a size that is not told.
    """

    name: str
    ctype: str
    shape: tuple[str, ...] = ()


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
    state (x_0 for --check, --simulate, main.c), the value of a parameter, and zeros for a control. ``scale``: declared
    sizes of the elements; empty: none. ``low``, ``high``: bounds of a parameter, or between which the initial values of
    a state are expected; empty: none.
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
        """Names of the elements as the user reads them: ``v`` or ``r[0], r[1]``."""
        return (self.name,) if self.scalar else tuple(f"{self.name}[{i}]" for i in range(self.size))


@dataclass(frozen=True)
class Augmentation:
    """The augmented state: what the compiler adds behind the states and parameters of the user, so that a node knows
    the controls of the node before, and its time.

    States, whose values at node 0 are known: ``time`` of the node; ``previous``: controls whose values at the node
    before are remembered. In this order.

    Parameters of the nodes: ``held``: controls with blocks of intervals, which a node takes from the one before unless
    it begins a block; for each a number says so, 1 where a block begins, 0 elsewhere. ``interval``: the length of the
    interval before. In this order.

    ``idle``: the problem has no control; a package has one that acts on nothing and stays 0.
    """

    previous: tuple[int, ...] = ()
    interval: bool = False
    time: bool = False
    held: tuple[int, ...] = ()
    idle: bool = False

    @property
    def count(self) -> int:
        """Number of these states."""
        return len(self.previous) + self.time

    @property
    def data(self) -> int:
        """Number of these parameters."""
        return len(self.held) + self.interval

    @property
    def places(self) -> dict[int, int]:
        """Control -> place of its value at the node before among these states."""
        return {j: i + self.time for i, j in enumerate(self.previous)}


#: Of a problem without them.
NOT_AUGMENTED = Augmentation()


@dataclass(frozen=True)
class Soft:
    """Penalties of a soft row, by side: a violation v >= 0 costs l1 v + l2/2 v^2.

    Args:
        lower: (l1, l2) below the lower bound, or l1; an infinite l1 is hard now and may become finite at run time.
            None: hard for ever; in set_soft() as it was.
        upper: the same above the upper bound.
        scale_with_dt: multiply both by the length of the interval, at node N of the last one.

    Examples:
        >>> from nmpc_codegen import Soft
        >>> penalties = Soft(lower=(100, 10), upper=50)
    """

    lower: tuple[float, float] | float | None = None
    upper: tuple[float, float] | float | None = None
    scale_with_dt: bool = False


@dataclass(frozen=True)
class Row:
    """One scalar row lower <= value <= upper that holds at ``nodes``, with its declared bounds.

    kind "control": value = u[index], a hard simple bound at every node 0..N-1;
    kind "state": value = x[index]; ``nodes`` is empty if an equality at the end replaces the whole row (N = 1);
    kind "general": value = h[index] of the path stage (nodes < N) and h[index_terminal] of the terminal stage (node N),
    -1 if the row does not hold there;
    kind "coupled": r[index](x_0, x_N), ``nodes`` is (0, N). Equality: lower == upper.

    ``soft``: (l1, l2) of the penalty l1 v + l2/2 v^2 of a violation v, where an infinite l1 is a hard row that may
    become soft, or None for a row that stays hard; ``scaled``: it is multiplied by the length of the interval, at the
    end of the last one. ``stated``: the row of the user, if this is one ``side`` of it.
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
        """True if it is hard, or may become so at run time."""
        return self.soft is None or self.soft[0] == float("inf")

    @property
    def strictness(self) -> str:
        """Whether it is hard, in words."""
        return "hard" if self.soft is None else "hard or soft" if self.hard else "soft"

    @property
    def user_name(self) -> str:
        """The name of the row in the words of the user."""
        return self.stated or self.name

    def penalty(self, node: int, dt: Sequence[float]) -> tuple[float, float] | None:
        """Declared (l1, l2) at a node; None where the row is hard."""
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
        """True for a hard row with equal bounds."""
        return self.soft is None and self.lower >= self.upper

    def place(self, at_end: bool) -> int:
        """Its position in x, u, the general rows of the path or, at the end, of the terminal stage, or r; -1: none."""
        return self.index_terminal if self.is_general and at_end else self.index

    def of_kind(self, x: Any, u: Any, h: Any, r: Any) -> Any:
        """What belongs to states, controls, general rows or coupled rows, by its kind."""
        return {"control": u, "state": x, "general": h, "coupled": r}[self.kind]

    def value(self, x: Any, u: Any, h: Any, r: Any, at_end: bool = False) -> Any:
        """Its entry of x, u, the general rows h of the stage, or the coupled rows r."""
        return self.of_kind(x, u, h, r)[self.place(at_end)]

    def variable(self, nx: int) -> int | None:
        """Position in (x, u) of the state or control that it bounds; None for other rows."""
        return {"state": self.index, "control": nx + self.index}.get(self.kind)


class ImposedRow(NamedTuple):
    """A row at one of its nodes. kind 0: bound of a state, 1: general row, 2: coupled row; ``component``: its place
    in x, h or r; ``row``: its position among all rows."""

    node: int
    kind: int
    component: int
    row: int


#: Kinds of rows that are imposed node by node, in the order of their numbers.
IMPOSED_KINDS = ("state", "general", "coupled")


def imposed_rows(rows: Sequence[Row], N: int) -> tuple[ImposedRow, ...]:
    """Every row besides the control bounds at all of its nodes, sorted by node; a coupled row is at node N."""
    found = []
    for i, row in enumerate(rows):
        if row.kind in IMPOSED_KINDS:
            for k in (N,) if row.is_coupled else row.nodes:
                found.append(ImposedRow(k, IMPOSED_KINDS.index(row.kind), row.place(k == N), i))
    return tuple(sorted(found))


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
    algebraic: tuple[str, ...] = ()


def members(name: str, known: Sequence[str]) -> list[int]:
    """Places of the element of that name, or of all elements name[i]; empty if there is none."""
    if name in known:
        return [known.index(name)]
    return [i for i, element in enumerate(known) if name and element.rpartition("[")[0] == name]


def units(*groups: Iterable[Signal]) -> dict[str, str]:
    """Name of an element -> its unit."""
    return {name: signal.unit for signals in groups for signal in signals for name in signal.elements}


# -- how they are written ---------------------------------------------------------------------------------------------


def c_identifier(name: str) -> str:
    """C spelling of an element name: ``r[0]`` becomes ``r_0``."""
    return name.replace("[", "_").replace("]", "")


def c_constants(names: Sequence[str]) -> tuple[str, ...]:
    """Last words of the C constants of user names: upper case; names that differ by case alone keep their spelling."""
    spelled = [c_identifier(name) for name in names]
    upper = [name.upper() for name in spelled]
    return tuple(big if upper.count(big) == 1 else name for name, big in zip(spelled, upper, strict=True))


def list_some(names: Sequence[object]) -> str:
    """Names separated by commas; of more than LISTED the first ones and the number of all."""
    shown = ", ".join(map(str, names[:LISTED]))
    return shown if len(names) <= LISTED else f"{shown}, ... ({len(names)} in all)"


def horizon(dt: Sequence[float], unit: str, discrete: bool) -> str:
    """The grid: "10 intervals over 3 s", with the least and the largest length if they differ."""
    if discrete:
        return f"{len(dt)} intervals of a discrete map"
    uneven = "" if len(set(dt)) == 1 else f" of {min(dt):g} to {max(dt):g} {unit}"
    return f"{len(dt)} intervals{uneven} over {sum(dt):g} {unit}"


def nodes(which: Sequence[int]) -> str:
    """Nodes in ascending order: "0..9" if they follow one another, else "0, 5, 10"."""
    consecutive = len(which) > 2 and which[-1] - which[0] == len(which) - 1
    return f"{which[0]}..{which[-1]}" if consecutive else list_some(which)
