"""AdjointShooting: the failure contract, what a package contains, and what is refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from examples import adjoint_gradient, crane, cstr
from nmpc_codegen import (
    AdjointShooting,
    DenseActiveSet,
    GaussNewton,
    OptionError,
    Options,
    Status,
    build,
    generate,
)
from nmpc_codegen.components.algorithms import adjoint_shooting
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, node_data
from verification import problems, samples
from verification.routes import shooting as options

METHODS = ("gauss_newton", "quasi_newton")
X0 = np.array([2.0, 0.0, 0.0, 0.0])


# Failure contract -----------------------------------------------------------------------------------------------------


def test_a_plan_that_overflows_is_replaced_in_the_same_sample() -> None:
    controller = build(problems.explosive(), options(), "test")
    controller.u = np.full((8, 1), 5.0)
    control = controller.step([1.0])
    assert -8 <= control[0] <= 5
    assert controller.status in (Status.OK, Status.NUMERICAL_FAILURE)
    for _ in range(3):
        controller.step([0.1])
    assert controller.status is Status.OK


def test_rows_that_the_bounds_exclude() -> None:
    """(0, 0, 1, 0) is infeasible; the controls do what they can, and feasible samples are solved at once afterwards."""
    controller = build(crane.build_ocp(), options(), "test")
    assert controller.solve([0.0, 0.0, 1.0, 0.0], max_iterations=60).status is Status.INFEASIBLE
    for _ in range(4):
        u = controller.step([0.0, 0.0, 1.0, 0.0])
        assert controller.status in (Status.INFEASIBLE, Status.ITERATION_LIMIT)
        assert abs(u[0]) <= 1
    for _ in range(6):
        controller.step([0.3, 0.0, 0.0, 0.0])
    assert controller.status is Status.OK
    problem = classify(crane.build_ocp())
    found = Reference(problem, replace(CLASSICAL, steps=2)).solve(node_data(problem, x0=np.array([0.3, 0.0, 0.0, 0.0])))
    np.testing.assert_allclose(controller.u, found.u, atol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_a_failed_solve_leaves_no_multipliers(method: str) -> None:
    """Penalties grow to 1e9 where rows contradict one another; what they make of multipliers ends with solve()."""
    ocp = samples.controls()
    ocp.subject_to(-0.2, ocp.x[0], 0.2, name="wall")
    controller, fresh = (build(ocp, options(method=method), "test") for _ in range(2))
    assert controller.solve([2.0, 1.0], max_iterations=200).status is not Status.OK
    for _ in range(8):
        controller.step([0.1, 0.0])
        fresh.step([0.1, 0.0])
    assert controller.status is fresh.status is Status.OK
    np.testing.assert_allclose(controller.u, fresh.u, atol=1e-3)


def test_a_sample_whose_step_is_refused_is_not_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    """One trial: the map runs away along the step, which would move the first control by more than a tenth."""
    monkeypatch.setattr(adjoint_shooting, "TRIALS", 1)
    found = {}
    for repair in (0, 10):
        controller = build(adjoint_gradient.build_ocp(), options(repair=repair), "test")
        controller.set_parameter("k", np.arange(1.0, 12))
        controller.u = adjoint_gradient.stabilised(10)[1]
        controller.step([1.0, 1.0])
        found[repair] = controller.stats.newton_iterations
        if not repair:
            assert controller.status is Status.NOT_CONVERGED
            assert controller.stats.accepted == 0
            assert np.abs(controller.view("shooting.d")[0]).max() > 0.1
            assert "refused" in controller.diagnose()
    assert found[10] > found[0] == 1


def test_products_that_run_out_are_no_solution_and_no_contradiction(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two products minimise the model roughly: more steps follow, and terminal rows that are not met may well be."""
    monkeypatch.setattr(adjoint_shooting, "PRODUCTS", (2, 2))
    found = {}
    for repair in (0, 5):
        controller = build(cstr.build_ocp(1, state_bounds=False), options(repair=repair), "test")
        controller.step(cstr.START)
        found[repair] = controller.stats.newton_iterations
        assert controller.status is (Status.OK if repair else Status.NOT_CONVERGED)
    assert found[5] > found[0] == 1
    short = build(crane.build_ocp(), options(repair=0), "test")
    short.step(X0)
    assert short.status is Status.ITERATION_LIMIT


def test_a_bad_argument_of_solve_and_reset() -> None:
    controller = build(crane.build_ocp(), options(), "test")
    fresh = controller.u.copy()
    controller.step(X0)
    controller.reset()
    np.testing.assert_array_equal(controller.u, fresh)
    assert controller.call_solve(-1.0, 10) is Status.BAD_ARGUMENT


# What a package contains and what is refused --------------------------------------------------------------------------


def test_a_package_has_the_integrator_and_nothing_else() -> None:
    sources = generate(crane.build_ocp(), options())
    for file in ("crane.h", "crane.c", "README.md"):
        assert not re.findall(r"(?i)\b(?:\w*condens\w*|qp_?\w*|\w*riccati\w*|working_set)\b", sources[file])
    assert "integrator_interval(" not in sources["crane.c"]
    assert "crane_prepare" not in sources["crane.h"]


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(OptionError, match=r"hessian .* clashes with algorithm AdjointShooting"):
        Options(algorithm=AdjointShooting(), hessian=GaussNewton())
    with pytest.raises(OptionError, match=r"qp .* clashes with algorithm AdjointShooting"):
        Options(algorithm=AdjointShooting(), qp=DenseActiveSet())
    with pytest.raises(OptionError, match="free initial state"):
        generate(samples.arrival(), options())
    with pytest.raises(OptionError, match=r"hard row 'effort.*expected penalty="):
        generate(samples.path(), options(rows="smooth_l1"))
    with pytest.raises(OptionError, match=r'rows="lumped".*hard row'):
        generate(samples.path(), options(rows="lumped"))
    with pytest.raises(OptionError, match=r"no terms for the equation 'q_end'"):
        generate(samples.ends(), options(rows="barrier"))
    with pytest.raises(OptionError, match=r"no terms for the soft row"):
        generate(samples.soft_rows(), options(rows="barrier"))
    with pytest.raises(OptionError, match="sampling_time"):
        AdjointShooting(shift="resample")
    for wrong in ({"method": "newton"}, {"rows": "elastic"}, {"penalty": 0.0}, {"iterations": 0}):
        with pytest.raises(OptionError, match="expected"):
            AdjointShooting(**wrong)  # type: ignore[arg-type]
