"""Controls whose slope vanishes where they stand: u^2 at 0, u |u| at 0, a product of two at 0."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    AdjointShooting,
    AugmentedLagrangian,
    ExactHessian,
    Options,
    RealTimeIteration,
    Status,
    batch,
    build,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.saddles import IDLE, Saddles, find_saddles
from nmpc_codegen.frontend.completion.scales import scales
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.reference import solve_reference
from nmpc_codegen.runtime.controller import Controller
from verification.saddles import delayed, drone, heater, lagging, motor, vehicle, warm

#: Laws of real thrusters are n |n|.
pytestmark = pytest.mark.filterwarnings("ignore:dynamics of 'v' contain fabs")

DT = 0.2


OPTIONS = {
    "default": Options(),
    "exact": Options(hessian=ExactHessian()),
    "one iteration": Options(algorithm=RealTimeIteration(iterations=1)),
    "size": Options(goal="size", solve=False),
    "augmented Lagrangian": Options(algorithm=AugmentedLagrangian()),
    "adjoint shooting": Options(algorithm=AdjointShooting()),
}


@cache
def _built(make: Callable[[], OCP], options: str) -> Controller:
    return build(make(), OPTIONS[options], "test")


def made(make: Callable[[], OCP], options: str = "default") -> Controller:
    return _built(make, options).copy()


def fly(c: Controller, x: np.ndarray, samples: int, law: str = "step") -> tuple[np.ndarray, int]:
    """The last state and the samples that were OK."""
    ok, dt = 0, float(np.ravel(c.description.dt)[0])
    for _ in range(samples):
        u = c.step(x) if law == "step" else c.solve(x).u[0]
        ok += c.status is Status.OK
        x = np.ravel(c.integrate(x, u, dt))
    return x, ok


@pytest.mark.few(3)
@pytest.mark.parametrize("options", OPTIONS)
def test_a_heater_heats_whatever_came_before(options: str) -> None:
    """After a set point below the ambient temperature the voltage is 0, where its slope vanishes."""
    c, x = made(heater, options), np.array([20.0])
    for target in (60.0, 15.0, 60.0):
        c.set_reference({"to_T": target})
        x, ok = fly(c, x, 40)
        assert abs(x[0] - max(target, 20.0)) < 1
        assert ok >= 10 or options == "augmented Lagrangian"


@pytest.mark.few(3)
@pytest.mark.parametrize("options", OPTIONS)
def test_a_vehicle_that_has_arrived_leaves_again(options: str) -> None:
    c, x = made(vehicle, options), np.zeros(2)
    for target in (2.0, -1.0, 3.0):
        c.set_reference({"to_p": target})
        x, _ = fly(c, x, 60)
        assert abs(x[0] - target) < 0.05


@pytest.mark.few(3)
@pytest.mark.parametrize("options", OPTIONS)
def test_a_lag_or_a_delay_before_the_square_is_no_way_to_stand_still(options: str) -> None:
    """The control moves its state, and the state at rest moves nothing."""
    c, x = made(lagging, options), np.zeros(3)
    for target in (2.0, -1.0, 3.0):
        c.set_reference({"to_p": target})
        c.set_terminal_reference({"end_p": target})
        x, _ = fly(c, x, 60)
        assert abs(x[0] - target) < 0.05
    c, x = made(delayed, options), np.array([20.0])
    for target in (60.0, 15.0, 60.0):
        c.set_reference({"to_T": target})
        x, _ = fly(c, x, 40)
        assert abs(x[0] - max(target, 20.0)) < 1


@pytest.mark.few(3)
@pytest.mark.parametrize("options", OPTIONS)
def test_a_product_of_controls_starts_from_rest(options: str) -> None:
    c, x = made(motor, options), np.zeros(1)
    for target in (1.0, 0.0, -1.0):
        c.set_reference({"to_w": target})
        x, _ = fly(c, x, 50)
        assert abs(x[0] - target) < 0.05


@pytest.mark.parametrize("law", ["step", "solve"])
def test_a_drone_takes_off_by_itself(law: str) -> None:
    """A probe of the rotors alone turns the drone over: the others follow in the search of solve()."""
    c, x = made(drone), np.zeros(6)
    for target in ((1.0, 1.0), (0.0, 0.5)):
        c.set_reference({"to_x": target[0], "to_z": target[1]})
        c.set_terminal_reference({"end_x": target[0], "end_z": target[1]})
        x, ok = fly(c, x, 40, law)
        assert np.abs(x[:2] - target).max() < 0.05
        assert ok >= 38


@pytest.mark.parametrize("make", [heater, vehicle, motor])
def test_solve_finds_what_ipopt_finds_from_elsewhere(make: Callable[[], OCP]) -> None:
    """IPOPT starts with the controls in the middle of their ranges, as it stays at the saddle as well."""
    c, problem = made(make), classify(make())
    reference = {heater: [60.0, 0.0], vehicle: [2.0, 0.0, 0.0], motor: [1.0, 0.0, 0.0]}[make]
    c.set_reference(np.array(reference))
    x0 = np.array(problem.x_initial)
    found = c.solve(x0)
    assert found.status is Status.OK
    guess = np.full((problem.N, problem.nu), 0.3 * problem_range(problem))
    optimum = solve_reference(problem, x0=x0, yref=np.tile(reference, (problem.N, 1)), u_guess=guess)
    assert found.cost <= optimum.cost * (1 + 1e-3)


def problem_range(problem: Problem) -> float:
    """The largest upper bound of a control."""
    return max(row.upper for row in problem.rows if row.kind == "control")


@pytest.mark.few(6)
@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("make", [heater, vehicle, motor])
def test_a_plant_at_its_reference_stays_at_rest(make: Callable[[], OCP], options: str) -> None:
    c = made(make, options)
    at = np.array(classify(make()).x_initial)
    if make is heater:
        c.set_reference({"to_T": 20.0})
    for _ in range(10):
        assert np.abs(c.step(at)).max() < 1e-9
        assert c.status is Status.OK


def test_a_reference_that_cannot_be_reached_leaves_the_heater_off() -> None:
    c = made(heater)
    c.set_reference({"to_T": 10.0})
    for _ in range(10):
        assert c.step([20.0])[0] == 0.0
        assert c.status is Status.OK


def test_one_iteration_says_that_its_plan_has_left_a_saddle() -> None:
    """Nothing but its cost is known of the plan after the probe."""
    c = made(heater, "one iteration")
    c.set_reference({"to_T": 60.0})
    assert c.step([20.0])[0] > 1.0
    assert c.status is Status.NOT_CONVERGED


def test_hard_rows_call_for_idle_controls_too() -> None:
    """The cost wants the heater off, the row T >= 30 does not: the first QP is infeasible, as no voltage heats."""
    c = build(warm(), profile="test")
    x, _ = fly(c, np.array([25.0]), 30)
    assert x[0] >= 30 - 0.1
    assert c.status is Status.OK


def test_batches_leave_saddles_as_single_controllers_do(compiler: None) -> None:
    c = made(heater)
    many = batch(heater(), 3)
    for each in (c, many):
        each.set_reference({"to_T": 60.0})
    U, _ = many.step(np.full((3, 1), 20.0))
    np.testing.assert_array_equal(U, np.tile(c.step([20.0]), (3, 1)))
    assert U[0, 0] > 10.0


def test_which_variables_and_slopes_are_meant() -> None:
    """Of u |u| the slope 2 c |u| dt, whose largest is that at the bound, vanishes at 0; a force does not."""
    found = saddles_of(vehicle())
    assert (found.controls, found.states, found.partners, found.drivers) == ((0,), (), (-1,), (False,))
    slopes = np.array(found.slopes).reshape(2, 3)
    np.testing.assert_array_equal(slopes[:, :2], -1.0)
    np.testing.assert_allclose(slopes[:, 2], [np.inf, IDLE * 2 * 0.002 * 50 * DT])
    assert saddles_of(motor()).partners == (1, 0)
    found = saddles_of(lagging())
    assert (found.controls, found.states, found.drivers) == ((), (2,), (True,))
    ocp = OCP("cart", T=1, N=5)
    v, force = ocp.state("v"), ocp.control("force")
    ocp.dynamics({v: force - v**3})
    ocp.least_squares(ca.vertcat(v, force), weight=1)
    assert not any(saddles_of(ocp).controls + saddles_of(ocp).states)


def saddles_of(ocp: OCP) -> Saddles:
    problem = classify(ocp)
    return find_saddles(problem, scales(problem).z)


def test_the_report_names_them_in_the_place_of_a_warning() -> None:
    report = made(heater).description.report
    assert any("the slope of V vanishes somewhere" in line for line in report.choices)
    assert not report.warnings
