"""The worst case that a report states bounds what is counted; a budget holds, and its plan recovers."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable

import numpy as np
import pytest
from conftest import require_tool

from benchmarks.lib.closed_loop import Scenario
from benchmarks.lib.robustness.work import Loop, count
from benchmarks.lib.robustness.worst import hostile, least_budget, outside, package_of, with_budget
from examples import crane
from nmpc_codegen import (
    OCP,
    DenseActiveSet,
    ExactHessian,
    OptionError,
    Options,
    Osqp,
    PartialCondensing,
    Project,
    RealTimeIteration,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    Status,
    build,
    generate,
)
from nmpc_codegen.bounds import package
from nmpc_codegen.compiler import compiled
from nmpc_codegen.components.base import QpSolver
from nmpc_codegen.runtime.package_description import PackageDescription
from tests import problems

SOLVERS: dict[str, QpSolver] = {
    "dense": DenseActiveSet(),
    "riccati": RiccatiActiveSet(),
    "riccati alone": RiccatiActiveSet(fallback=None),
    "interior point": RiccatiInteriorPoint(),
}


def _soft_crane() -> OCP:
    ocp = crane.build_ocp(False)
    ocp.subject_to(-0.3, ocp.x[1], 0.3, name="speed", soft=(10.0, 0.0))
    ocp.subject_to(-0.02, ocp.x[2], 0.02, name="angle", soft=(50.0, 10.0))
    return ocp


PROBLEMS: dict[str, Callable[[], OCP]] = {
    "boxes": lambda: crane.build_ocp(False),
    "terminal equality": crane.build_ocp,
    "soft rows": _soft_crane,
}


def loop_of(problem: str, solver: str, **more: object) -> Loop:
    options = dataclasses.replace(Options(qp=SOLVERS[solver]), **more)
    return Loop("crane", PROBLEMS[problem], options, Scenario((0.0,) * 4, 0.3, 20))


@pytest.mark.parametrize(
    ("problem", "solver"),
    [("boxes", "dense"), ("boxes", "riccati alone"), *itertools.product(("terminal equality", "soft rows"), SOLVERS)],
)
def test_no_sample_exceeds_the_worst_case(problem: str, solver: str) -> None:
    require_tool("cxx")
    loop = loop_of(problem, solver, algorithm=RealTimeIteration(relaxation=100.0))
    worst = package_of(loop).description.report.worst_operations
    assert worst["prepare"] + worst["feedback"] == worst["sample"]
    (found,) = count(loop, hostile(loop, 80), optimise=False)
    assert np.max(found.every) <= worst["sample"]
    assert np.min(found.every) > 0


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_cap_on_iterations_counts(solver: str) -> None:
    """With few iterations the worst case comes near what is provoked."""
    require_tool("cxx")
    few = dataclasses.replace(SOLVERS[solver], max_iterations=2)
    loop = loop_of("soft rows", solver, qp=few)
    stated = package_of(loop).description.report.worst_operations["sample"]
    more = package_of(loop_of("soft rows", solver)).description.report.worst_operations["sample"]
    (found,) = count(loop, hostile(loop, 80), optimise=False)
    assert np.max(found.every) <= stated < more


OTHERS = {
    "exact, reduced": Options(hessian=ExactHessian(Project(level="reduced"))),
    "exact, stage": Options(hessian=ExactHessian(Project(level="stage"))),
    "partial": Options(condensing=PartialCondensing(2)),
    "single": Options(precision="single"),
}


@pytest.mark.parametrize("case", OTHERS)
@pytest.mark.parametrize("make", [problems.scaled, problems.tiny, problems.dense_weight], ids=lambda m: m.__name__)
def test_every_package_states_its_worst_case(make: Callable[[], OCP], case: str) -> None:
    generated = generate(make(), OTHERS[case])
    text = next(text for path, text in generated.items() if path.endswith(".json"))
    description = PackageDescription.from_json(text)
    assert set(description.report.worst_operations) == {"prepare", "feedback", "sample"}
    assert PackageDescription.from_json(description.to_json()).report == description.report


@functools.cache
def least(problem: str, solver: str) -> int:
    return least_budget(loop_of(problem, solver))


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_budget_that_is_too_small_is_an_error(solver: str) -> None:
    needed = least("boxes", solver)
    with pytest.raises(OptionError, match=rf"budget: {needed - 1} operations; a sample needs up to {needed} "):
        package_of(with_budget(loop_of("boxes", solver), needed - 1))
    stated = package_of(with_budget(loop_of("boxes", solver), needed)).description.report
    assert stated.worst_operations == {"sample": needed}


@pytest.mark.parametrize("value", [0, -1, 1.5, "many", 2**31])
def test_a_budget_is_a_number_of_operations(value: object) -> None:
    with pytest.raises(OptionError, match="budget"):
        RealTimeIteration(budget=value)  # type: ignore[arg-type]


def test_equal_texts_with_other_data_have_bounds_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second package of the same text and data is not analysed again; one whose tables differ is."""
    analysed: list[str] = []
    real = package.WorstCase.operations

    def told(self: package.WorstCase, function: str) -> int:
        analysed.append(function)
        return real(self, function)

    monkeypatch.setattr(package.WorstCase, "operations", told)
    monkeypatch.setattr(package, "_KNOWN", {})

    def bounded_at(node: int) -> int:
        ocp = crane.build_ocp(False)
        ocp.subject_to(-1, ocp.x[0], 1, at=[node], name="wall")
        return compiled(ocp, Options()).description.report.worst_operations["sample"]

    first = bounded_at(3)
    count = len(analysed)
    assert bounded_at(3) == first
    assert len(analysed) == count > 0
    bounded_at(7)
    assert len(analysed) > count


def test_osqp_has_no_budget() -> None:
    options = Options(qp=Osqp(), algorithm=RealTimeIteration(budget=10**6))
    with pytest.raises(OptionError, match=r"budget=1000000.*osqp"):
        generate(crane.build_ocp(False), options)


@pytest.mark.parametrize("solver", SOLVERS)
def test_without_a_budget_there_is_no_trace_of_it(solver: str) -> None:
    sources = generate(crane.build_ocp(), Options(qp=SOLVERS[solver]))
    text = sources["crane.c"] + sources["crane.h"]
    assert not [word for word in ("afford", "allowance", "ALLOWANCE", "COST_", "MAX_OPERATIONS") if word in text]


@pytest.mark.parametrize(("problem", "solver"), [("boxes", "dense"), *itertools.product(["soft rows"], SOLVERS)])
def test_no_sample_exceeds_its_budget(problem: str, solver: str) -> None:
    require_tool("cxx")
    loop = with_budget(loop_of(problem, solver), 2 * least(problem, solver))
    module = package_of(loop)
    (found,) = count(loop, hostile(loop, 80), optimise=False)
    assert np.max(found.every) <= module.sizes["MAX_OPERATIONS"]
    assert np.any(found.status == Status.ITERATION_LIMIT)
    assert outside(module, found.u) == 0


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_budget_that_binds_ends_the_sample_and_the_plan_recovers(solver: str) -> None:
    """The control is that of the plan meanwhile; later it is the one of a controller without a budget."""
    loop = with_budget(loop_of("boxes", solver), 2 * least("boxes", solver))
    limited = build(PROBLEMS["boxes"](), loop.options, profile="test")
    free = build(PROBLEMS["boxes"](), Options(qp=SOLVERS[solver]), profile="test")
    rest = np.zeros(4)
    assert np.isfinite(limited.step(rest)).all()
    statuses = []
    for _ in range(6):
        plan = limited.u[0].copy()
        u0 = limited.step(np.array([40.0, -20.0, 2.0, 5.0]))
        statuses.append(limited.status)
        assert np.all(np.abs(u0) <= 1.0)
        if limited.status == Status.ITERATION_LIMIT:
            np.testing.assert_allclose(u0, np.clip(plan, -1.0, 1.0), rtol=0, atol=0)
    assert Status.ITERATION_LIMIT in statuses
    near = np.array([0.1, 0.0, 0.0, 0.0])
    for _ in range(60):
        limited.step(near)
        free.step(near)
    assert limited.status == free.status == Status.OK
    np.testing.assert_allclose(limited.u, free.u, rtol=0, atol=1e-6)


def test_solve_has_no_budget() -> None:
    loop = with_budget(loop_of("boxes", "dense"), least("boxes", "dense"))
    limited, free = (
        build(PROBLEMS["boxes"](), loop.options, profile="test"),
        build(PROBLEMS["boxes"](), Options(qp=DenseActiveSet()), profile="test"),
    )
    far = np.array([3.0, 0.0, 0.4, 0.0])
    ours, theirs = limited.solve(far), free.solve(far)
    assert ours.status == theirs.status == Status.OK
    np.testing.assert_allclose(ours.u, theirs.u, rtol=0, atol=1e-12)
