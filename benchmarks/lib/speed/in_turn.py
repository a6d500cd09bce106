"""Closed loops of several programs in the same run: each round runs all of them once."""

from __future__ import annotations

from pathlib import Path

from verification.closed_loop import Scenario, Timing, run_driver


def in_turn(programs: list[Path], scenario: Scenario, runs: int, steps: int) -> list[list[Timing]]:
    """Timings of every program; each round runs all of them once, in alternating order."""
    times: list[list[Timing]] = [[] for _ in programs]
    for k in range(runs):
        order = range(len(programs)) if k % 2 == 0 else reversed(range(len(programs)))
        for i in order:
            times[i].append(run_driver(programs[i], scenario, runs=1, steps=steps))
    return times
