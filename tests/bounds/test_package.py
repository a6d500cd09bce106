"""The worst case that a report states bounds what is counted."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
import pytest
from conftest import require_tool

from examples import crane
from nmpc_codegen import (
    OCP,
    ExactHessian,
    Options,
    PartialCondensing,
    Project,
    RealTimeIteration,
    RiccatiActiveSet,
    generate,
)
from nmpc_codegen.bounds import package
from nmpc_codegen.compiler import compiled
from nmpc_codegen.runtime.package_description import PackageDescription
from verification import problems
from verification.closed_loop import Scenario
from verification.robustness.work import Loop, count
from verification.robustness.worst import hostile, package_of
from verification.routes import ROUTES

SOLVERS = {name: ROUTES[name][1] for name in ("dense", "riccati", "interior")}
SOLVERS["riccati alone"] = RiccatiActiveSet(fallback=None)


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


@pytest.mark.few(3)
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


@pytest.mark.few(2)
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


@pytest.mark.few(5)
@pytest.mark.parametrize("case", OTHERS)
@pytest.mark.parametrize("make", [problems.scaled, problems.tiny, problems.dense_weight], ids=lambda m: m.__name__)
def test_every_package_states_its_worst_case(make: Callable[[], OCP], case: str) -> None:
    generated = generate(make(), OTHERS[case])
    text = next(text for path, text in generated.items() if path.endswith(".json"))
    description = PackageDescription.from_json(text)
    assert set(description.report.worst_operations) == {"prepare", "feedback", "sample"}
    assert PackageDescription.from_json(description.to_json()).report == description.report


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
