"""Counted operations of samples against the worst case that worst_case() finds.

The loops are those of the part `work`. Each of them also gets measured states that are drawn at random, near and far,
one after the other without a plant, so that the solvers start from working sets and plans that do not fit.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from nmpc_codegen.compiler import compile
from nmpc_codegen.package.sources import Sources
from verification.robustness.work import Counted, Loop, Recorded, count, record, steps_of

Array = np.ndarray
HOSTILE = 300  # samples per loop
FARTHEST = 3.0  # power of ten of the largest distance from the first state


def hostile(loop: Loop, samples: int) -> Recorded:
    """Measured states at distances from 0.1 to 1000, every fourth one where the loop starts."""
    random, x0 = np.random.default_rng(2), np.array(loop.scenario.x0, dtype=float)
    states: list[tuple[Array | None, Array]] = []
    for k in range(samples):
        distance = 0.0 if k % 4 == 3 else 10.0 ** random.uniform(-1.0, FARTHEST)
        states.append((None, x0 + distance * random.standard_normal(x0.size)))
    return Recorded([], states, np.zeros((samples, 0)), np.zeros(samples, dtype=bool))


def package_of(loop: Loop) -> Sources:
    """Its package."""
    return compile(loop.make(), loop.options)


def played(loop: Loop, scale: float) -> Counted:
    """The samples of the loop, then hostile ones, counted."""
    parts = count(loop, record(loop, steps_of(loop, scale), []), hostile(loop, max(40, round(scale * HOSTILE))))
    return Counted(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Counted)))
