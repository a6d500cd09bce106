"""A cost on x_0, which is free or measured, and what moves it: against IPOPT."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, Controller, ProblemError, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import ReferenceSolution, node_data, solve_reference
from nmpc_codegen.oracle.trajectory import kkt_residuals
from nmpc_codegen.runtime.solving import Solution
from verification.routes import on


def moving_prior() -> OCP:
    """A free state whose arrival cost has its centre in a parameter."""
    ocp = OCP("prior", T=1.0, N=4)
    x, u = ocp.state("x", initial=0.3), ocp.control("u")
    prior = ocp.parameter("prior", value=0.3)
    ocp.dynamics({x: -x + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.5])
    ocp.start_least_squares(x - prior, weight=4.0)
    ocp.free_initial(x)
    return ocp


def solved(ctrl: Controller, ocp: OCP) -> Solution:
    return ctrl.solve(classify(ocp).x_initial, tol=1e-10, max_iterations=100)


def assert_same(found: Solution, reference: ReferenceSolution) -> None:
    assert reference.success
    np.testing.assert_allclose(found.x, reference.x, atol=1e-7)
    np.testing.assert_allclose(found.u, reference.u, atol=1e-7)
    assert found.cost == pytest.approx(reference.cost, abs=1e-12, rel=1e-10)


@pytest.mark.parametrize("route", ["dense", "riccati"])
def test_its_parameter_moves_the_start(route: str) -> None:
    ocp = moving_prior()
    ctrl = build(ocp, on(route), "test")
    for prior in (0.3, -1.2):
        ctrl.set_parameter("prior", prior)
        assert_same(solved(ctrl, ocp), solve_reference(classify(ocp), p=[prior]))


def test_real_time_iterations_settle_at_the_solution() -> None:
    """The gradient is added once per sample, also if the reference has been changed after prepare()."""
    ocp = moving_prior()
    ctrl = build(ocp, profile="test")
    for _ in range(6):
        ctrl.prepare()
        ctrl.set_reference([0.7, 0.1])
        ctrl.feedback([0.3])
    reference = solve_reference(classify(ocp), yref=[0.7, 0.1])
    np.testing.assert_allclose(ctrl.x, reference.x, atol=1e-9)
    np.testing.assert_allclose(ctrl.u, reference.u, atol=1e-9)


def test_a_measured_start_pays_the_cost_and_nothing_else() -> None:
    ocp = moving_prior()
    ocp.free.clear()
    ctrl = build(ocp, profile="test")
    found, problem = solved(ctrl, ocp), classify(ocp)
    assert_same(found, solve_reference(problem))
    assert kkt_residuals(problem, found, node_data(problem)).worst <= 1e-9  # type: ignore[arg-type]


def test_it_reads_states_and_parameters_only() -> None:
    ocp = OCP("wrong", T=1.0, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    with pytest.raises(ProblemError, match=r"start_least_squares: expression.*'?u"):
        ocp.start_least_squares(ca.vertcat(x, u), weight=1)
    with pytest.raises(ProblemError, match="start_cost must be a scalar, got 2 elements"):
        ocp.start_cost(ca.vertcat(x, x))
