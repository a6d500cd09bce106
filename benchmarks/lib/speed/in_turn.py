"""Closed loops of several programs run in turn: each round runs all of them once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from verification.closed_loop import Timing


def in_turn(
    programs: Sequence[Callable[[], Timing]], rounds: int, first: Callable[[], None] = lambda: None
) -> list[list[Timing]]:
    """Return the timings of every program; rounds alternate in their order and begin with ``first``."""
    times: list[list[Timing]] = [[] for _ in programs]
    for k in range(rounds):
        first()
        order = range(len(programs)) if k % 2 == 0 else reversed(range(len(programs)))
        for i in order:
            times[i].append(programs[i]())
    return times
