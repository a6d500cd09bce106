"""The worst case that a report states bounds what is counted."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import require_tool

from examples import crane
from nmpc_codegen import (
    OCP,
    AdjointShooting,
    AugmentedLagrangian,
    ExactHessian,
    OptionError,
    Options,
    Osqp,
    Project,
    RealTimeIteration,
    RiccatiActiveSet,
    generate,
)
from nmpc_codegen.analysis import worst_case
from nmpc_codegen.components.base import Algorithm
from verification import problems
from verification.closed_loop import Scenario
from verification.robustness.work import Loop, count
from verification.robustness.worst import hostile, package_of
from verification.routes import ROUTES

ROOT = Path(__file__).parents[2]
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


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("problem", "solver"),
    [("boxes", "dense"), ("boxes", "riccati alone"), *itertools.product(("terminal equality", "soft rows"), SOLVERS)],
)
def test_no_sample_exceeds_the_worst_case(problem: str, solver: str) -> None:
    require_tool("cxx")
    loop = loop_of(problem, solver, algorithm=RealTimeIteration())
    worst = worst_case(package_of(loop))
    assert worst["prepare"] + worst["feedback"] == worst["sample"]
    (found,) = count(loop, hostile(loop, 80), optimise=False)
    assert np.max(found.every) <= worst["sample"]
    assert np.min(found.every) > 0


@pytest.mark.few(2)
@pytest.mark.parametrize("problem", ["boxes", "soft rows"])
@pytest.mark.parametrize("algorithm", [AugmentedLagrangian(), AdjointShooting()], ids=lambda a: a.name)
def test_no_sample_without_a_qp_exceeds_it(problem: str, algorithm: Algorithm) -> None:
    require_tool("cxx")
    loop = Loop("crane", PROBLEMS[problem], Options(algorithm=algorithm), Scenario((0.0,) * 4, 0.3, 20))
    (found,) = count(loop, hostile(loop, 80), optimise=False)
    assert 0 < np.min(found.every) <= np.max(found.every) <= worst_case(package_of(loop))["sample"]


@pytest.mark.few(1)
@pytest.mark.parametrize("solver", SOLVERS)
def test_the_cap_on_iterations_counts(solver: str) -> None:
    """With few iterations the worst case comes near what is provoked."""
    require_tool("cxx")
    few = dataclasses.replace(SOLVERS[solver], max_iterations=2)
    loop = loop_of("soft rows", solver, qp=few)
    stated = worst_case(package_of(loop))["sample"]
    more = worst_case(package_of(loop_of("soft rows", solver)))["sample"]
    (found,) = count(loop, hostile(loop, 80), optimise=False)
    assert np.max(found.every) <= stated < more


OTHERS = {
    "exact, reduced": Options(hessian=ExactHessian(Project(level="reduced"))),
    "exact, stage": Options(hessian=ExactHessian(Project(level="stage"))),
    "single": Options(precision="single"),
}


@pytest.mark.few(5)
@pytest.mark.parametrize("case", OTHERS)
@pytest.mark.parametrize("make", [problems.scaled, problems.tiny, problems.dense_weight], ids=lambda m: m.__name__)
def test_every_package_has_a_worst_case(make: Callable[[], OCP], case: str) -> None:
    worst = worst_case(generate(make(), OTHERS[case]))
    assert set(worst) - {"one iteration"} == {"prepare", "feedback", "sample"}
    assert 0 < worst["feedback"] < worst["sample"]
    assert worst.get("one iteration", 0) <= worst["sample"]


def test_a_sample_in_one_call() -> None:
    assert set(worst_case(generate(crane.build_ocp(), Options(algorithm=AdjointShooting())))) == {"sample"}


def test_which_package_is_meant() -> None:
    """Other files beside the package do no harm; two packages, or none, are refused."""
    one, two = (generate(crane.build_ocp(), name=name) for name in ("one", "two"))
    assert worst_case({**one, "certificate.json": "{}", "main.c": ""}) == worst_case(two)
    for files, found in (({**one, **two}, "one, two"), ({}, "none")):
        with pytest.raises(OptionError, match=f"one package, found those of {found}"):
            worst_case(files)
    with pytest.raises(OptionError, match="PosixPath; expected path -> text"):
        worst_case(Path("out"))  # type: ignore[arg-type]


def test_foreign_code_is_not_bounded() -> None:
    with pytest.raises(OptionError, match=r"crane contains foreign code, .* choose another qp"):
        worst_case(generate(crane.build_ocp(False), Options(qp=Osqp())))
