"""Floating-point operations are counted exactly."""

from __future__ import annotations

import operator
from dataclasses import dataclass


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
        """Return the number of all operations."""
        return sum(vars(self).values())

    def as_dict(self) -> dict[str, int]:
        return dict(vars(self))
