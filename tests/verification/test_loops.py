"""Loops that one full step per sample does not bring nearer: as good as solve() in every sample."""

from __future__ import annotations

import pytest

from verification.loops.flights import judge
from verification.loops.plants import DRAWS, PROBLEMS


@pytest.mark.slow
@pytest.mark.parametrize("draw", DRAWS)
def test_samples_fly_as_well_as_solve_in_every_sample(draw: str) -> None:
    counted = faulty = 0
    for number in range(0, PROBLEMS, 3):
        loops = judge(draw, number, 2).loops
        counted += sum(loop.counts for loop in loops)
        faulty += sum(bool(loop.faults) for loop in loops)
    assert counted > 14
    assert faulty <= 1


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("draw", "number"), [("lost slope", 1), ("lost slope", 28), ("dead points", 0), ("unstable", 4)]
)
def test_some_loops(draw: str, number: int) -> None:
    (loop,) = judge(draw, number, 1).loops
    assert loop.counts
    assert loop.faults == []
    assert loop.mine.iterations < 2
