"""The Riccati solvers on random QPs that leave little to hold on to, in both precisions, judged in NumPy.

A QP is drawn around a known solution (or around a contradiction) and goes through a whole controller, so that the
answer is what an application gets. OK must be true by residuals that the solver did not compute.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from nmpc_codegen import Controller, Status, build
from nmpc_codegen.lowering.tolerances import EPS, TOLERANCES, tolerance
from verification.oracles.stage_qp import Shape
from verification.qp.draw import SHAPES, draw
from verification.qp.judge import LIMITS, judge
from verification.qp.stage_package import Answer, answer, options, rounded, stage_ocp

#: The first two shapes; a QP has the shape of its number modulo the number of shapes.
NUMBERS = tuple(n for n in range(60) if n % len(SHAPES) < 2)
CLASSES = ("integer", "semidefinite", "nearly linear", "thin", "ill-conditioned")
SOLVERS = ("interior", "riccati")
#: QPs of NUMBERS that a solver may give up in single precision, where nothing is asked of some classes.
GIVEN_UP = {"double": 0, "single": 1}


@cache
def controller(shape: Shape, solver: str, precision: str) -> Controller:
    return build(stage_ocp(shape), options(solver, precision), profile="test")


def solved(kind: str, number: int, solver: str, precision: str) -> Answer:
    """The answer; the third QP of three starts from the solution of another one."""
    qp = draw(kind, number)
    chosen = controller(qp.shape, solver, precision)
    chosen.reset()
    if number % 3 == 2:
        answer(chosen, rounded(draw(kind, number + len(SHAPES)), precision))
    return answer(chosen, rounded(qp, precision))


def is_true(kind: str, number: int, found: Answer, precision: str) -> bool:
    qp = rounded(draw(kind, number), precision)
    return not judge(qp, found.point, found.lam, LIMITS[precision]).wrong(LIMITS[precision])


@pytest.mark.few(6)
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", CLASSES)
def test_hard_qps_are_solved_and_ok_is_true(kind: str, solver: str, precision: str) -> None:
    answers = {number: solved(kind, number, solver, precision) for number in NUMBERS}
    false = [n for n, a in answers.items() if a.status == Status.OK and not is_true(kind, n, a, precision)]
    given_up = {n: a.status.name for n, a in answers.items() if a.status != Status.OK}
    assert not false
    assert len(given_up) <= GIVEN_UP[precision], given_up
    assert "INFEASIBLE" not in given_up.values()


@pytest.mark.parametrize("kind", CLASSES)
def test_interior_point_needs_few_iterations(kind: str) -> None:
    """One that starts from nothing, in double precision."""
    iterations = [solved(kind, n, "interior", "double").iterations for n in NUMBERS if n % 3 != 2]
    assert np.median(iterations) <= 26
    assert np.max(iterations) <= 60


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_contradiction_beyond_rounding_is_never_ok(solver: str, precision: str) -> None:
    """In double precision every QP that is infeasible by 1e-6 or more is proved to be so."""
    answers = {number: solved("infeasible", number, solver, precision) for number in NUMBERS}
    false = [n for n, a in answers.items() if a.status == Status.OK and not is_true("infeasible", n, a, precision)]
    assert not false
    if precision == "double":
        assert {a.status for a in answers.values()} == {Status.INFEASIBLE}


@pytest.mark.parametrize("precision", ["double", "single"])
def test_what_is_called_ok_is_within_the_limits(precision: str) -> None:
    assert tolerance("qp_accepted", precision) <= 0.5 * LIMITS[precision]
    assert tolerance("qp_accepted", precision) >= TOLERANCES["qp_accepted"][0] * EPS[precision]
