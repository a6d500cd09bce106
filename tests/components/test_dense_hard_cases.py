"""QPs that the dense active-set solver has answered wrongly or given up: its answers judged in NumPy.

All have the dimensions of one package, which is built once for each precision.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from conftest import require_tool

from nmpc_codegen import Controller, Status, build
from verification.oracles.stage_qp import Shape, distance
from verification.oracles.stage_qp_random import random_qp
from verification.qp.draw import SHAPES, draw
from verification.qp.stage_package import options, stage_ocp
from verification.qp.stage_solvers import StageSolver, solvers
from verification.qp.verdicts import solve, verdict_of

SHAPE = SHAPES[2]

#: (class, numbers, precision) of feasible QPs.
CASES = (
    ("semidefinite", (8, 20, 44), "double"),  # singular: every pivot after the last positive one is rounding
    ("semidefinite", (8, 14, 20), "single"),
    ("uncontrolled", (2, 8, 14), "double"),  # rows of A are zero, and their bounds are met up to rounding
    ("uncontrolled", (2, 8, 14), "single"),
    ("equalities in excess", (9, 37), "double"),  # 28 equations in 16 variables
    ("equalities in excess", (17, 133), "single"),
    ("thin", (20, 56), "single"),  # a row that nearly depends on the working set is violated
)


@functools.cache
def controller(precision: str) -> Controller:
    require_tool("cc")
    return build(stage_ocp(SHAPE), options("dense", precision), profile="test")


@pytest.mark.parametrize(("kind", "numbers", "precision"), CASES)
def test_feasible_problems_are_solved(kind: str, numbers: tuple[int, ...], precision: str) -> None:
    for number in numbers:
        qp = draw(kind, number)
        assert qp.shape == SHAPE
        found = solve(controller(precision), qp, precision)
        assert found.status == Status.OK, (kind, number)
        assert verdict_of(qp, found, precision) is None, (kind, number)


@pytest.mark.parametrize("number", range(2, 62, 6))
def test_wrong_answers_are_not_called_ok(number: int) -> None:
    """A Hessian that vanishes in single precision compared with the gradient: solved, or a failure is reported."""
    qp = draw("nearly linear", number)
    with np.errstate(all="ignore"):
        found = solve(controller("single"), qp, "single")
        assert verdict_of(qp, found, "single") is None
    assert found.status in (Status.OK, Status.NUMERICAL_FAILURE)


@pytest.mark.parametrize(("kind", "number"), [("semidefinite", 172), ("uncontrolled", 450)])
def test_condensing_that_loses_the_digits(kind: str, number: int) -> None:
    """A bound met up to the rounding of a large sum; dynamics that grow by 850 in 6 intervals: right, or not OK."""
    require_tool("cc")
    qp = draw(kind, number)
    found = solve(build(stage_ocp(qp.shape), options("dense", "single"), profile="test"), qp, "single")
    assert verdict_of(qp, found, "single") is None


def test_a_feasible_problem_with_a_coupled_and_a_soft_row() -> None:
    shape = Shape(3, 1, 7, path=2, coupled=1, soft=(2,))
    qp = random_qp(shape, "plain", 10, radius=0.9, active=0.3, digits=1)
    solver = StageSolver(shape, solvers()["full+dense_active_set"])
    assert solver.solve(qp) == Status.OK
    assert distance(qp, solver.point) < 1e-8
