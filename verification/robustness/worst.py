"""Operations of samples are counted and compared with the worst case that worst_case() finds.

The loops are those of the part `work`. Each of them also gets measured states that are drawn at random, near and far,
one after the other without a plant, so that the solvers start from wrong working sets and plans.
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
    """Draw measured states at distances from 0.1 to 1000, and every fourth one at the start of the loop."""
    random, x0 = np.random.default_rng(2), np.array(loop.scenario.x0, dtype=float)
    states: list[tuple[Array | None, Array]] = []
    for k in range(samples):
        distance = 0.0 if k % 4 == 3 else 10.0 ** random.uniform(-1.0, FARTHEST)
        states.append((None, x0 + distance * random.standard_normal(x0.size)))
    return Recorded([], states, np.zeros((samples, 0)), np.zeros(samples, dtype=bool))


def package_of(loop: Loop) -> Sources:
    """Return the package of a loop."""
    return compile(loop.make(), loop.options)


def played(loop: Loop, scale: float) -> Counted:
    """Count the samples of the loop, then hostile ones."""
    parts = count(loop, record(loop, steps_of(loop, scale), []), hostile(loop, max(40, round(scale * HOSTILE))))
    return Counted(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Counted)))
