"""Integer expressions over the slots of a function: its parameters, then the counters of its loops.

The value of an expression is an interval, and that of a pointer to constant integers the name of a table. Equal
expressions are one object (see made()), so that they are compared and hashed by identity.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Protocol, TypeVar, cast

from nmpc_codegen.bounds.intervals import COMPARISONS, Range, combined, entries, truth, union

#: Values of an integer, or the name of a constant table.
Value = Range | str


class Constants(Protocol):
    """What is known about the names of a unit that are no variables of a function."""

    tables: Mapping[str, Sequence[int]]
    ranges: Mapping[str, tuple[int, int]]

    def constant(self, name: str) -> Range:
        """Value of a size, or of a macro without parameters."""


@dataclass(frozen=True, eq=False)
class Expression:
    """Base class. ``slots``: those that it reads; ``calls``: it contains the value of a call, which needs its text."""

    slots: frozenset[int] = field(init=False, default=frozenset())
    calls: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "slots", frozenset().union(*(part.slots for part in self.parts)))
        object.__setattr__(self, "calls", any(part.calls for part in self.parts))

    @property
    def parts(self) -> tuple[Expression, ...]:
        """The expressions from which combine() computes the value."""
        return ()

    def value(self, slots: Sequence[Value], unit: Constants) -> Any:
        """The value for these values of the slots."""
        return self.combine([part.value(slots, unit) for part in self.parts], unit)

    def combine(self, values: Sequence[Any], unit: Constants) -> Any:
        """The value for these values of the parts."""
        raise NotImplementedError

    def given(self, arguments: Sequence[Expression]) -> Expression:
        """The same expression with these expressions in the place of the slots."""
        return self


_E = TypeVar("_E", bound=Expression)


@lru_cache(maxsize=2**16)
def _interned(kind: Callable[..., Expression], arguments: tuple[Hashable, ...]) -> Expression:
    return kind(*arguments)


def made(kind: Callable[..., _E], *arguments: Hashable) -> _E:
    """The expression of a kind with these parts: the same object for the same parts."""
    return cast(_E, _interned(kind, arguments))


@dataclass(frozen=True, eq=False)
class Known(Expression):
    """A number, an interval, or None: a value of which nothing is known."""

    known: Range

    def value(self, slots: Sequence[Value], unit: Constants) -> Range:
        return self.known


UNKNOWN = made(Known, None)


def number(value: int) -> Expression:
    """An integer."""
    return made(Known, (value, value))


@dataclass(frozen=True, eq=False)
class Slot(Expression):
    """A parameter, or the counter of a loop that is running."""

    index: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "slots", frozenset({self.index}))

    def value(self, slots: Sequence[Value], unit: Constants) -> Value:
        return slots[self.index]

    def given(self, arguments: Sequence[Expression]) -> Expression:
        return arguments[self.index]


@dataclass(frozen=True, eq=False)
class Named(Expression):
    """A size, or a macro without parameters."""

    name: str

    def value(self, slots: Sequence[Value], unit: Constants) -> Range:
        return unit.constant(self.name)


@dataclass(frozen=True, eq=False)
class Member(Expression):
    """A member of a struct."""

    name: str

    def value(self, slots: Sequence[Value], unit: Constants) -> Range:
        return unit.ranges.get(self.name)


@dataclass(frozen=True, eq=False)
class Table(Expression):
    """A pointer to the first entry of what may be a constant table of the unit."""

    name: str

    def value(self, slots: Sequence[Value], unit: Constants) -> Value:
        return self.name if self.name in unit.tables else None


@dataclass(frozen=True, eq=False)
class Entry(Expression):
    """An entry of a constant table."""

    table: Expression
    index: Expression

    @property
    def parts(self) -> tuple[Expression, ...]:
        return self.table, self.index

    def combine(self, values: Sequence[Any], unit: Constants) -> Range:
        table, index = values
        return None if table is None else entries(unit.tables[table], index)

    def given(self, arguments: Sequence[Expression]) -> Expression:
        return made(Entry, self.table.given(arguments), self.index.given(arguments)) if self.slots else self


@dataclass(frozen=True, eq=False)
class Combined(Expression):
    """``left op right``."""

    op: str
    left: Expression
    right: Expression

    @property
    def parts(self) -> tuple[Expression, ...]:
        return self.left, self.right

    def value(self, slots: Sequence[Value], unit: Constants) -> Range:
        return combined(self.op, self.left.value(slots, unit), self.right.value(slots, unit))

    def combine(self, values: Sequence[Any], unit: Constants) -> Range:
        return combined(self.op, *values)

    def given(self, arguments: Sequence[Expression]) -> Expression:
        return made(Combined, self.op, *(part.given(arguments) for part in self.parts)) if self.slots else self


def joined(op: str, left: Expression, right: Expression) -> Expression:
    """``left op right``; known if the operands are, and where nothing is known about one of them."""
    if isinstance(left, Known) and isinstance(right, Known):
        return made(Known, combined(op, left.known, right.known))
    if op not in ("&&", "||") and UNKNOWN in (left, right):
        return made(Known, (0, 1)) if op in COMPARISONS else UNKNOWN
    return made(Combined, op, left, right)


@dataclass(frozen=True, eq=False)
class Negation(Expression):
    """``!operand``."""

    operand: Expression

    @property
    def parts(self) -> tuple[Expression, ...]:
        return (self.operand,)

    def combine(self, values: Sequence[Any], unit: Constants) -> Range:
        holds = truth(values[0])
        return (0, 1) if holds is None else (int(not holds),) * 2

    def given(self, arguments: Sequence[Expression]) -> Expression:
        return made(Negation, self.operand.given(arguments)) if self.slots else self


@dataclass(frozen=True, eq=False)
class Either(Expression):
    """``condition ? then : other``."""

    condition: Expression
    then: Expression
    other: Expression

    @property
    def parts(self) -> tuple[Expression, ...]:
        return self.condition, self.then, self.other

    def combine(self, values: Sequence[Any], unit: Constants) -> Range:
        condition, then, other = values
        holds = truth(condition)
        return union([then, other]) if holds is None else then if holds else other

    def given(self, arguments: Sequence[Expression]) -> Expression:
        return made(Either, *(part.given(arguments) for part in self.parts)) if self.slots else self


@dataclass(frozen=True, eq=False)
class Between(Expression):
    """Values from the least one of ``least`` to the largest one of ``most``."""

    least: Expression
    most: Expression

    @property
    def parts(self) -> tuple[Expression, ...]:
        return self.least, self.most

    def combine(self, values: Sequence[Any], unit: Constants) -> Range:
        least, most = values
        return None if least is None or most is None else (least[0], most[1])

    def given(self, arguments: Sequence[Expression]) -> Expression:
        return made(Between, *(part.given(arguments) for part in self.parts)) if self.slots else self


@dataclass(frozen=True, eq=False)
class Called(Expression):
    """Value that a function of the unit returns; its parts are the arguments."""

    function: str
    arguments: tuple[Expression, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "calls", True)

    @property
    def parts(self) -> tuple[Expression, ...]:
        return self.arguments


@dataclass(frozen=True, eq=False)
class Passes(Expression):
    """Number of passes of a loop, or None: ``first``, ``first + step``, ... up or down to before the nearest limit."""

    first: Expression
    step: Expression
    up: bool
    limits: tuple[Expression, ...]

    @property
    def parts(self) -> tuple[Expression, ...]:
        return self.first, self.step, *self.limits

    def visited(self, values: Sequence[Range]) -> range | None:
        """Values of the counter for these values of the parts; None: unknown."""
        first, step, *limits = values
        known = [limit for limit in limits if limit is not None]
        if first is None or step is None or step[0] <= 0 or not known:
            return None
        if self.up:
            return range(first[0], min(high for _, high in known), step[0])
        return range(first[1], max(low for low, _ in known), -step[0])

    def combine(self, values: Sequence[Any], unit: Constants) -> Range:
        found = self.visited(values)
        return None if found is None else (len(found),) * 2

    def given(self, arguments: Sequence[Expression]) -> Expression:
        if not self.slots:
            return self
        first, step, *limits = (part.given(arguments) for part in self.parts)
        return made(Passes, first, step, self.up, tuple(limits))
