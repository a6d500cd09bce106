"""Rolls are elements of an output that receive one expression of the elements of inputs, which a loop computes.

y[0] = x[0] + t K[0], y[1] = x[1] + t K[1], ...   is   for i: y[i] = x[i] + t K[i]
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import casadi as ca

from nmpc_codegen.ir.kernel import OPERATIONS, Instruction, Kernel, live

#: Rolls with fewer elements, copies of adjacent elements, or numbers are written one by one, because compilers
#: vectorise statements, but not all loops.
SHORTEST, SHORTEST_COPY, SHORTEST_OF_NUMBERS = 30, 4, 4

Store = tuple[int, int, int]
Fits = Callable[[int, int, int], bool]


@dataclass(frozen=True)
class Roll:
    """A roll has ``count`` elements of an output from ``first``, ``stride`` apart, that receive the same expression.

    ``value`` is the value of the first one; ``moving`` holds its loads (port, element) whose element moves along.
    """

    output: int
    first: int
    stride: int
    count: int
    value: int
    moving: frozenset[tuple[int, int]]

    def of_first(self, kernel: Kernel) -> Kernel:
        """Return the kernel of only the first element."""
        instructions, new = live(kernel.instructions, [self.value])
        stores = ((self.output, self.first, new[self.value]),)
        return replace(kernel, instructions=instructions, stores=stores, parts=())


class _Rolls:
    """The rolls of one output are searched; ``fits`` tests if (element, stride, count) stay in a row of its buffer."""

    def __init__(self, kernel: Kernel, output: int, strides: Sequence[int], fits: Fits) -> None:
        self.instructions, self.output, self.fits = kernel.instructions, output, fits
        self.strides = strides
        self.values = {e: v for o, e, v in kernel.stores if o == output}

    def find(self) -> tuple[list[Roll], list[Store]]:
        """Return the rolls, and the stores that are in none."""
        rolls: list[Roll] = []
        rest: list[Store] = []
        left = sorted(self.values)
        while left:
            roll = self._longest(left[0], set(left))
            if roll is None:
                rest.append((self.output, left[0], self.values[left[0]]))
                left = left[1:]
            else:
                rolls.append(roll)
                covered = {roll.first + n * roll.stride for n in range(roll.count)}
                left = [e for e in left if e not in covered]
        return rolls, rest

    def _longest(self, first: int, left: Collection[int]) -> Roll | None:
        """Return the longest roll from an element; None if it is too short."""
        found: Roll | None = None
        number = self.instructions[self.values[first]].opcode == ca.OP_CONST
        for stride in dict.fromkeys(self.strides if number else (1,)):
            loads, count = _Loads(), 1
            while (
                (e := first + count * stride) in left
                and self.fits(first, stride, count + 1)
                and (more := self._compare(self.values[first], self.values[e], count, loads)) is not None
            ):
                loads, count = more, count + 1
            if count >= max(self._shortest(first), found.count + 1 if found else 0):
                found = Roll(self.output, first, stride, count, self.values[first], frozenset(loads.moving))
        return found

    def _shortest(self, first: int) -> int:
        """Return the least length of a roll from an element."""
        opcode = self.instructions[self.values[first]].opcode
        return {ca.OP_CONST: SHORTEST_OF_NUMBERS, ca.OP_INPUT: SHORTEST_COPY}.get(opcode, SHORTEST)

    def _compare(self, first: int, other: int, distance: int, loads: _Loads) -> _Loads | None:
        """Return the loads, if the other value is the first one with some loads moved by the distance."""
        more = _Loads(set(loads.moving), set(loads.fixed))
        same = self._same(first, other, distance, {}, more)
        return more if same and more.moving.isdisjoint(more.fixed) else None

    def _same(self, a: int, b: int, distance: int, known: dict[tuple[int, int], bool], loads: _Loads) -> bool:
        if (a, b) in known:
            return known[a, b]
        one, two = self.instructions[a], self.instructions[b]
        if a == b:
            loads.fixed.update(find_loads(self.instructions, a))
            found = True
        elif one.opcode == ca.OP_INPUT == two.opcode:
            loads.moving.add((one.args[0], one.args[1]))
            found = one.args[0] == two.args[0] and two.args[1] - one.args[1] == distance
        elif one.opcode != two.opcode or one.opcode not in OPERATIONS or one.constant != two.constant:
            found = False
        else:
            pairs = zip(one.args, two.args, strict=True)
            found = all(self._same(x, y, distance, known, loads) for x, y in pairs)
        known[a, b] = found
        return found


@dataclass
class _Loads:
    """The loads (port, element) of a first element either move with the elements of a roll, or do not."""

    moving: set[tuple[int, int]] = field(default_factory=set)
    fixed: set[tuple[int, int]] = field(default_factory=set)


def find_loads(instructions: Sequence[Instruction], value: int) -> Iterator[tuple[int, int]]:
    """Yield (port, element) of the loads of a value."""
    waiting, seen = [value], set[int]()
    while waiting:
        ins = instructions[waiting.pop()]
        if ins.opcode == ca.OP_INPUT:
            yield ins.args[0], ins.args[1]
        elif ins.opcode in OPERATIONS:
            waiting += (a for a in dict.fromkeys(ins.args) if a not in seen)
            seen.update(ins.args)


def find_rolls(
    kernel: Kernel, strides: Sequence[Sequence[int]], fits: Callable[[int, int, int, int], bool]
) -> tuple[list[Roll], list[Store]]:
    """Return the rolls of a kernel, and the stores that are in none.

    Args:
        kernel: the kernel with these stores.
        strides: for every output, allowed distances of elements that receive one number; other elements are adjacent.
        fits: True if ``count`` elements of an ``output`` from ``first``, ``stride`` apart, are in one row of a buffer.
    """
    rolls: list[Roll] = []
    rest: list[Store] = []
    for output in range(len(kernel.outputs)):
        more, single = _Rolls(kernel, output, strides[output], partial(fits, output)).find()
        rolls, rest = [*rolls, *more], [*rest, *single]
    return rolls, rest
