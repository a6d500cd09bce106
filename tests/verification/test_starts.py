"""Results of IPOPT that are kept: they are IPOPT's, for every start, and a wrong solution does not count."""

from __future__ import annotations

import dataclasses
import math

import pytest

from nmpc_codegen import Controller, build
from verification.convergence import starts
from verification.convergence.problems import problems


def test_every_start_of_every_problem() -> None:
    found = starts.by_ipopt()
    assert list(found) == [problem.name for problem in problems()]
    assert all(len(attempts) == starts.STARTS for attempts in found.values())
    solved = [a for attempts in found.values() for a in attempts if a.solved]
    assert len(solved) > 0.95 * starts.STARTS * len(found)
    assert all(math.isfinite(a.cost) and a.iterations > 0 for a in solved)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [problem.name for problem in problems()])
def test_they_are_those_of_ipopt(name: str, compiler: None) -> None:
    numbers = (3, 71)
    for number, now in zip(numbers, starts.attempts_of_ipopt(name, numbers), strict=True):
        kept = starts.by_ipopt()[name][number]
        assert now.solved == kept.solved
        assert now.cost == pytest.approx(kept.cost, rel=1e-5, abs=1e-8)


class Boastful:
    """A controller that calls every plan a solution."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.reset = controller.reset

    def solve(self, x0: object) -> object:
        found = self.controller.solve(x0, max_iterations=1)
        return dataclasses.replace(found, status=type(found.status).OK)


def test_ok_without_a_solution_does_not_count(compiler: None) -> None:
    problem = starts.known("cart_pole")
    controller = build(problem.make(), problem.options(), profile="test")
    (good,) = starts.attempts("cart_pole", controller, [0])
    (bad,) = starts.attempts("cart_pole", Boastful(controller), [0])  # type: ignore[arg-type]
    assert good.solved
    assert bad.status == "OK"
    assert not bad.solved
