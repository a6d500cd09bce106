"""Controller.diagnose(): every failure names a row, node, state or option."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, AugmentedLagrangian, GaussNewton, Options, RealTimeIteration, build
from nmpc_codegen.runtime.controller import Status
from verification import problems


def test_nothing_to_say() -> None:
    ctrl = problems.controller("crane")
    ctrl.step(problems.CASES["crane"].x0)
    assert ctrl.diagnose() == str(Status.OK)


def test_a_row_that_cannot_hold() -> None:
    ctrl = problems.controller("crane")
    ctrl.step([1.0, 0.0, 0.5, 0.0])
    assert ctrl.status == Status.INFEASIBLE
    assert f"row {ctrl.stats.violated_row!r} at node {ctrl.stats.violated_node}" in ctrl.diagnose()


def test_a_measurement_and_a_plan_that_are_not_finite() -> None:
    ctrl = problems.controller("crane")
    ctrl.step([np.nan, 0.0, 0.0, 0.0])
    assert f"measured {ctrl.names.states[0]} is not finite" in ctrl.diagnose()
    ctrl = problems.controller("crane")
    ctrl.x[3, 1] = np.inf
    ctrl.prepare()
    ctrl.feedback([0.1, 0.0, 0.0, 0.0])
    assert ctrl.status == Status.NUMERICAL_FAILURE
    ctrl.x[3, 1] = np.inf
    assert f"state {ctrl.names.states[1]} at node 3" in ctrl.diagnose()


def test_a_model_outside_its_domain() -> None:
    ocp = OCP("root", T=1.0, N=4)
    x, u = ocp.state("level", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u - ca.sqrt(x)})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ctrl = build(ocp, Options(algorithm=RealTimeIteration(iterations=1)), profile="test")
    ctrl.x[2] = -1.0
    ctrl.prepare()
    ctrl.feedback([1.0])
    assert ctrl.status == Status.NUMERICAL_FAILURE
    ctrl.x[2] = -1.0
    said = ctrl.diagnose()
    assert "the equation of level at node 2: sqrt(level) is not finite where its argument is -1; keep the plan" in said


def test_gauss_newton_that_needs_more_iterations() -> None:
    ctrl = build(problems.disc(), Options(hessian=GaussNewton()), profile="test")
    assert ctrl.solve([1.0, 0.0], max_iterations=3).status == Status.ITERATION_LIMIT
    assert "ExactHessian" in ctrl.diagnose()
    assert "the largest one is that of " in ctrl.diagnose()
    assert "solve(max_iterations=30)" in ctrl.diagnose()


@pytest.mark.parametrize("call", ["feedback"])
def test_a_phase_that_is_missing(call: str) -> None:
    ctrl = problems.controller("crane")
    getattr(ctrl, call)([0.0, 0.0, 0.0, 0.0])
    assert "prepare()" in ctrl.diagnose()


@pytest.mark.parametrize("hessian", [None, GaussNewton()])
def test_advice_fits_the_augmented_lagrangian(hessian: GaussNewton | None) -> None:
    """It refuses a regularisation, and has no QP: neither is proposed."""
    ctrl = build(problems.disc(), Options(hessian=hessian, algorithm=AugmentedLagrangian()), profile="test")
    for status in Status:
        for call in (lambda: ctrl.step([1.0, 0.0]), lambda: ctrl.solve([1.0, 0.0], max_iterations=1)):
            call()
            ctrl.view("status")[...] = status
            said = ctrl.diagnose()
            assert "Mirror" not in said
            assert "ExactHessian()" not in said
            assert "QP solver: " not in said


def wind() -> OCP:
    """A parameter that differs along the horizon."""
    ocp = OCP("wind", T=5.0, N=10)
    x, u, w = ocp.state("x"), ocp.control("u"), ocp.parameter("w")
    ocp.dynamics({x: u + w - 0.1 * x**2})
    ocp.least_squares(ca.vertcat(x - 1, u), weight=[1, 0.1])
    ocp.subject_to(-1, u, 1)
    return ocp


def test_gaps_belong_to_the_parameters_of_their_nodes() -> None:
    """No word of a gap that is rounding, the true place of one, and the parameters stay as they are."""
    ctrl, given = build(wind(), profile="test"), np.linspace(0, 2, 11)[:, None]
    ctrl.set_parameter("w", given)
    assert ctrl.solve([0.0]).status == Status.OK
    assert ctrl.solve([0.0], tol=1e-22).status != Status.OK
    assert "misses the model" not in ctrl.diagnose()
    ctrl.x[7] += 1e-3
    assert "the plan misses the model most in state x at node 7: by 0.001" in ctrl.diagnose()
    np.testing.assert_array_equal(ctrl.view("p"), given)


def test_rounding_of_a_row_is_no_violation() -> None:
    """A row at its bound 0, left by 1e-20 of its scale."""
    ocp = OCP("valve", T=2.0, N=5)
    q, d = ocp.state("q", scale=1.0), ocp.control("d")
    ocp.dynamics({q: d})
    ocp.least_squares(ca.vertcat(q + 1, d), weight=[1, 0.1])
    ocp.subject_to(0, q, np.inf)
    ocp.subject_to(-1, d, 1)
    ctrl = build(ocp, profile="test")
    ctrl.solve([0.0], tol=1e-30, max_iterations=2)
    ctrl.x[:] = -1e-20
    assert "is violated" not in ctrl.diagnose()
    ctrl.x[3] = -1e-3
    assert "row 'q' at node 3 is violated by 0.001" in ctrl.diagnose()


def test_no_advice_before_a_sample() -> None:
    """A plan that nobody has optimised says nothing of Gauss-Newton steps."""
    ctrl = build(wind(), profile="test")
    assert ctrl.diagnose() == str(Status.OK)
