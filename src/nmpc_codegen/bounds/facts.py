"""Facts that a result depends on, and results that are used again where the same facts hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

from nmpc_codegen.bounds.expressions import Constants, Expression, Slot, Value, made

#: Expressions over slots, and the values that they had.
Facts = dict[Expression, Value]

_R = TypeVar("_R")


class Results(Generic[_R]):
    """Results by the facts on which they depend."""

    def __init__(self, unit: Constants) -> None:
        self._unit = unit
        self._known: dict[tuple[Expression, ...], dict[tuple[Value, ...], _R]] = {}

    def keep(self, facts: Facts, result: _R) -> None:
        """Remember a result that depends on nothing but these facts."""
        self._known.setdefault(tuple(facts), {})[tuple(facts.values())] = result

    def find(self, slots: Sequence[Value]) -> _R | None:
        """The result whose facts hold for these values of the slots."""
        for questions, found in self._known.items():
            result = found.get(tuple([question.value(slots, self._unit) for question in questions]))
            if result is not None:
                return result
        return None


def without(slot: int, facts: Facts, slots: Sequence[Value]) -> Facts:
    """Facts that imply these ones and do not read a slot whose values they determine, the counter of a loop.

    A fact about this slot and others is replaced by the values of the others.
    """
    kept: Facts = {}
    for question, answer in facts.items():
        if slot not in question.slots:
            kept[question] = answer
        else:
            kept |= {made(Slot, other): slots[other] for other in question.slots if other != slot}
    return kept
