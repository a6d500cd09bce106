"""The default caps on iterations follow from what closed loops need; here the loop that needs most of each solver."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from nmpc_codegen import DenseActiveSet, RiccatiActiveSet, build
from nmpc_codegen.components.base import QpSolver
from nmpc_codegen.components.qp.dense_active_set import ITERATIONS_NEEDED
from nmpc_codegen.components.qp.riccati_active_set import MAX_ITERATIONS
from verification.strangers.problems import known
from verification.strangers.twin import Loop, Twin

#: Problem, solver, number of the loop; the cap that it needs, and one that is too low.
CASES = {
    "dense": ("seir", DenseActiveSet(), 1, math.ceil(ITERATIONS_NEEDED * (45 + 45)), 60),
    "riccati": ("arm", RiccatiActiveSet(fallback=None), 1, 2 * MAX_ITERATIONS // 3, 10),
}


def statuses(name: str, qp: QpSolver, number: int) -> list[str]:
    """Status of every sample of a loop of the stranger with this QP solver."""
    stranger = known(name)
    controller, twin = build(stranger.ocp(), replace(stranger.options(), qp=qp), "fast"), Twin(stranger)
    loop, found = Loop(twin, number), []
    controller.x[0] = loop.x
    for k in range(stranger.samples):
        u = controller.step(loop.x)
        found.append(controller.status.name)
        loop.apply(k, np.asarray(u, dtype=float))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_loop_that_needs_most_has_enough(case: str) -> None:
    name, default, number, needed, low = CASES[case]
    usual = statuses(name, default, number)
    assert "ITERATION_LIMIT" not in usual
    assert statuses(name, replace(default, max_iterations=needed), number) == usual
    assert "ITERATION_LIMIT" in statuses(name, replace(default, max_iterations=low), number)
