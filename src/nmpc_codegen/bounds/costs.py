"""Operations of a function as a function of its slots: what is left of its syntax tree once it is understood."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from nmpc_codegen.bounds.expressions import Expression, Known, Passes
from nmpc_codegen.bounds.intervals import truth


@dataclass(frozen=True, eq=False)
class Cost:
    """Base class of operations that depend on the slots, on the unit, or have side effects."""


#: A number of operations, or what determines it.
Operations = int | Cost


@dataclass(frozen=True, eq=False)
class Sum(Cost):
    """Operations one after the other."""

    fixed: int
    parts: tuple[Cost, ...]


@dataclass(frozen=True, eq=False)
class Branch(Cost):
    """``if (condition) then else other``, and ``rest`` after a branch that does not leave the block."""

    condition: Expression
    branches: tuple[Operations, Operations]
    leaves: tuple[bool, bool] = (False, False)
    rest: Operations = 0


@dataclass(frozen=True, eq=False)
class Counted(Cost):
    """A call of a function whose operations are known."""

    function: str


@dataclass(frozen=True, eq=False)
class Call(Cost):
    """A call of a function of the unit."""

    function: str
    arguments: tuple[Expression, ...]


@dataclass(frozen=True, eq=False)
class Impossible(Cost):
    """What cannot be bounded, and why."""

    why: str


@dataclass(frozen=True, eq=False)
class Return(Cost):
    """The returned value of an integer function."""

    value: Expression


@dataclass(frozen=True, eq=False)
class Expected(Cost):
    """An expression that must be known."""

    value: Expression
    otherwise: str


@dataclass(frozen=True, eq=False)
class Stated:
    """Most passes of a loop as its first line states them: in one run, or in one run of ``function``."""

    passes: Expression
    text: str
    function: str


@dataclass(frozen=True, eq=False)
class Loop(Cost):
    """A loop over the values of ``slot``, or one whose passes are stated.

    ``function``: where it stands; ``test``: operations before every pass and once more; ``body``: those of a pass.
    """

    function: str
    slot: int | None
    passes: Passes | None
    test: Operations
    body: Operations
    stated: Stated | None


def total(parts: Iterable[Operations]) -> Operations:
    """All of these operations."""
    fixed = 0
    more: list[Cost] = []
    for part in parts:
        if isinstance(part, int):
            fixed += part
        elif isinstance(part, Sum):
            fixed += part.fixed
            more += part.parts
        else:
            more.append(part)
    if not more:
        return fixed
    return more[0] if fixed == 0 and len(more) == 1 else Sum(fixed, tuple(more))


def branched(
    condition: Expression,
    branches: tuple[Operations, Operations],
    leaves: tuple[bool, bool] = (False, False),
    rest: Operations = 0,
) -> Operations:
    """A branch, or its operations if the condition does not matter for them."""
    if isinstance(condition, Known) and (holds := truth(condition.known)) is not None:
        taken = 0 if holds else 1
        return branches[taken] if leaves[taken] else total((branches[taken], rest))
    then, other = branches
    if isinstance(then, int) and isinstance(other, int):
        if leaves == (False, False) and then == other:
            return total((then, rest))
        if isinstance(rest, int):
            costs = [cost + (0 if leave else rest) for cost, leave in zip((then, other), leaves, strict=True)]
            if costs[0] == costs[1] or isinstance(condition, Known):
                return max(costs)
    return Branch(condition, branches, leaves, rest)
