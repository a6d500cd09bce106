"""Previous controls, rates, move blocks, time and discrete states, against the same problems written by hand for IPOPT,
and in closed loops."""

from __future__ import annotations

import copy
import io
import pickle
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    ExactHessian,
    ExplicitRungeKutta,
    FullCondensing,
    GaussNewton,
    Midpoint,
    Online,
    Options,
    Osqp,
    RealTimeIteration,
    build,
    generate,
    simulate,
)
from nmpc_codegen.errors import ControllerError, OptionError
from nmpc_codegen.runtime.controller import Controller, Status
from verification.routes import OURS, PURE, ROUTES, on
from verification.tuned import PROBLEMS, Tuned, blocked_crane, dead_time, slewed_crane, timed_vessel

#: Time of the first sample of problems with time.
START = 1.3

#: Levels that are negative fall without limit.
pytestmark = pytest.mark.filterwarnings("ignore:.*is not accurate")


def prepared(tuned: Tuned, options: Options | None) -> tuple[Controller, float]:
    """A controller that knows the control before and the time, and this time."""
    ocp, _, _, previous = tuned
    options = options or Options()
    if ocp.dt is not None:
        options = replace(options, integrator=ExplicitRungeKutta())
    ctrl = build(ocp, options, profile="test")
    ctrl.set_previous(previous)
    time = START if ctrl.description.augmentation.time else 0.0
    if time:
        ctrl.set_time(time)
    return ctrl, time


def distance(tuned: Tuned, options: Options | None, tol: float | None, most: int = 100) -> float:
    """Largest distance of solve() from IPOPT's solution."""
    _, by_hand, x0, previous = tuned
    ctrl, time = prepared(tuned, options)
    x, u, cost = by_hand.solve(x0, previous, time)
    found = ctrl.solve(x0, tol, most)
    assert found.status == Status.OK, ctrl.diagnose()
    assert found.cost == pytest.approx(cost, rel=1e-3)
    np.testing.assert_array_equal(ctrl.previous, np.asarray(previous, ctrl.previous.dtype))
    return float(max(np.max(np.abs(found.x - x)), np.max(np.abs(found.u - u))))


@pytest.mark.few(6)
@pytest.mark.parametrize("route", [*OURS, "OSQP"])
@pytest.mark.parametrize("name", PROBLEMS)
def test_every_route_finds_the_optimum(name: str, route: str) -> None:
    exact = name == "graded tank"
    if exact and route == "OSQP":
        pytest.skip("general costs need another Hessian than OSQP takes")
    hessian = None if exact or route in ("dense", "interior") else GaussNewton()
    tol, most = (None, 1e-6) if route == "OSQP" else (1e-10, 1e-8)
    assert distance(PROBLEMS[name](), on(route, hessian=hessian), tol) <= most


@pytest.mark.few(2)
@pytest.mark.parametrize("target", ["portable", "native"])
@pytest.mark.parametrize("unroll", ["none", "all"])
def test_loops_and_lanes_have_the_same_derivatives(unroll: Any, target: str) -> None:
    """Samples linearise several nodes at once where there are vectors; solve() does not with the exact Hessian."""
    integrator = ExplicitRungeKutta(unroll=unroll)
    for hessian in (GaussNewton(), ExactHessian()):
        options = Options(integrator=integrator, hessian=hessian, target=target, algorithm=PURE)
        assert distance(timed_vessel(), options, 1e-10) <= 1e-8


# The control before ---------------------------------------------------------------------------------------------------


def test_step_keeps_the_control_that_it_returns_and_set_previous_says_what_was_applied() -> None:
    ctrl, _ = prepared(slewed_crane(), None)
    x0 = np.array([0.0, 0, 0.1, 0])
    first = ctrl.step(x0)
    np.testing.assert_array_equal(ctrl.previous, first)
    assert abs(first[0] - 0.4) <= 2.5 * 0.3 + 1e-12
    ctrl.set_previous([-3.0])
    second = ctrl.step(x0)
    assert -3.0 - 2 * 0.3 - 1e-9 <= second[0] <= -3.0 + 2.5 * 0.3 + 1e-9


def test_feedback_takes_a_control_that_is_set_after_prepare() -> None:
    ctrl, _ = prepared(slewed_crane(), Options(algorithm=RealTimeIteration(iterations=1, shift=None)))
    other = ctrl.copy()
    x0 = [0.0, 0, 0.1, 0]
    ctrl.prepare()
    ctrl.set_previous([0.9])
    other.set_previous([0.9])
    other.prepare()
    np.testing.assert_allclose(ctrl.feedback(x0), other.feedback(x0), atol=1e-9)


def test_reset_takes_the_reference_inside_the_bounds() -> None:
    ocp, _, _, _ = slewed_crane()
    F = ocp.u
    ocp.least_squares(F, 0.01, reference=7.0, names="effort")
    ctrl = build(ocp)
    np.testing.assert_array_equal(ctrl.previous, [5.0])
    ctrl.set_previous([1.0])
    ctrl.reset()
    np.testing.assert_array_equal(ctrl.previous, [5.0])


def test_the_control_before_is_part_of_every_copy() -> None:
    ctrl, _ = prepared(slewed_crane(), None)
    file = io.BytesIO()
    ctrl.save(file)
    file.seek(0)
    loaded = build(slewed_crane()[0])
    loaded.load(file)
    for twin in (ctrl.copy(), copy.deepcopy(ctrl), pickle.loads(pickle.dumps(ctrl)), loaded):
        np.testing.assert_array_equal(twin.previous, [0.4])
        twin.set_previous([0.2])
    np.testing.assert_array_equal(ctrl.previous, [0.4])


def test_a_failed_sample_keeps_the_control_that_was_returned() -> None:
    ctrl, _ = prepared(slewed_crane(), None)
    u = ctrl.step([np.nan, 0, 0, 0])
    assert ctrl.status == Status.NOT_FINITE
    np.testing.assert_array_equal(ctrl.previous, u)


@pytest.mark.parametrize("bad", [[np.nan], [0.0, 1.0], ["a"]])
def test_bad_controls_before_are_refused(bad: Any) -> None:
    ctrl, _ = prepared(slewed_crane(), None)
    with pytest.raises(ControllerError, match="previous control"):
        ctrl.set_previous(bad)
    np.testing.assert_array_equal(ctrl.previous, [0.4])


def test_a_problem_without_them_says_which_words_are_missing() -> None:
    ctrl, _ = prepared(slewed_crane(), None)
    with pytest.raises(ControllerError, match=r"no time: its problem does not contain ocp\.time"):
        ctrl.set_time(1.0)
    ocp = OCP("plain", T=1.0, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), 1.0)
    with pytest.raises(ControllerError, match=r"no previous control: .* ocp\.previous\(u\) or ocp\.rate\(u\)"):
        build(ocp).set_previous([0.0])


@pytest.mark.few(2)
@pytest.mark.parametrize("route", OURS)
def test_a_loop_never_exceeds_its_rate_limit(route: str) -> None:
    """Disturbed, with an actuator that now and then does something else, of which the controller is told."""
    ctrl = build(slewed_crane()[0], on(route), profile="test")
    random = np.random.default_rng(3)
    x, applied = np.zeros(4), 0.0
    for k in range(200):
        u = ctrl.step(x)
        assert ctrl.status.name in ("OK", "RELAXED", "NOT_CONVERGED"), ctrl.diagnose()
        assert -2 - 1e-9 <= (u[0] - applied) / 0.3 <= 2.5 + 1e-9
        applied = u[0]
        if k % 17 == 16:
            applied = float(np.clip(u[0] + random.normal(), -5, 5))
            ctrl.set_previous([applied])
        x = ctrl.integrate(x, [applied], 0.3) + 0.03 * random.standard_normal(4)
        if k % 50 == 49:
            x = np.array([random.uniform(-1, 2), 0, 0, 0])


def test_simulate_logs_rates_and_solves_every_sample_if_asked() -> None:
    ocp, by_hand, x0, _ = slewed_crane()
    ctrl = build(ocp)
    log = simulate(ctrl, x0, 20, law="solve")
    rate = np.diff(np.concatenate([[0.0], log.u[:, 0]])) / 0.3
    np.testing.assert_allclose(log.h[:, 0], rate, atol=1e-12)
    assert np.all(log.status == Status.OK)
    np.testing.assert_array_equal(ctrl.previous, log.u[-1])
    _, u, _ = by_hand.solve(log.x[7], log.u[6])
    np.testing.assert_allclose(log.u[7], u[0], atol=1e-7)
    with pytest.raises(ControllerError, match="law is 'bang'"):
        simulate(ctrl, x0, 2, law="bang")  # type: ignore[arg-type]


def test_the_model_of_a_dead_time_is_one_sample_late() -> None:
    ctrl, _ = prepared(dead_time(), None)
    log = simulate(ctrl, [2.0, 0.0], 12)
    a, b = log.u.T
    late = np.concatenate([[0.2], a[:-1]])
    x, y = log.x[:-1].T
    np.testing.assert_allclose(log.x[1:, 1], 0.9 * y - 0.1 * np.sin(x) + late + 0.1 * b, atol=1e-12)


def test_the_rate_of_a_sample_is_over_the_sampling_time() -> None:
    """The plan has intervals of 0.3, a sample comes every 0.1."""
    tuned = slewed_crane()
    ocp, by_hand, x0, previous = tuned
    ctrl = build(ocp, Options(algorithm=RealTimeIteration(sampling_time=0.1)))
    ctrl.set_previous(previous)
    found = ctrl.solve(x0, 1e-10)
    x, u, _ = by_hand.solve(x0, previous, period=0.1)
    np.testing.assert_allclose(found.u, u, atol=1e-8)
    np.testing.assert_allclose(found.x, x, atol=1e-8)
    applied, state = previous[0], np.array([-0.5, 0.0, 0.2, 0.0])
    for _ in range(30):
        now = ctrl.step(state)
        assert -2 - 1e-9 <= (now[0] - applied) / 0.1 <= 2.5 + 1e-9
        applied, state = now[0], ctrl.integrate(state, now, 0.1)


def test_diagnose_knows_the_states_behind_those_of_the_user() -> None:
    ocp = timed_vessel()[0]
    ctrl = build(ocp, Options(algorithm=RealTimeIteration(relaxation=None, iterations=1)))
    ctrl.step([5.0, 0.0, 0.0])
    assert "'wall'" in ctrl.diagnose()
    ctrl.solve([0.5, 0.0, 0.2], 1e-12, 1)
    known = ctrl.known.copy()
    assert ctrl.diagnose()
    np.testing.assert_array_equal(ctrl.known, known)
    assert repr(ctrl).startswith("<Controller vessel: N=8, nx=3, nu=1")


# Time -----------------------------------------------------------------------------------------------------------------


def test_time_moves_on_with_the_samples() -> None:
    ctrl, _ = prepared(timed_vessel(), None)
    ctrl.reset()
    assert ctrl.time == 0.0
    x = np.array([0.5, 0, 0.2])
    for k in range(4):
        assert ctrl.time == pytest.approx(0.5 * k)
        u = ctrl.step(x)
        after = ctrl.integrate(x, u, 0.5)
        np.testing.assert_allclose(after[2], 0.8 * x[2] + 0.1 * x[0] ** 2 + 0.05 * u[0])
        np.testing.assert_allclose(ctrl.whole_x[:, 3], 0.5 * (k + np.arange(9)))
        x = after
    ctrl.set_time(-2.0)
    ctrl.step(x)
    assert ctrl.time == pytest.approx(-1.5)


def test_a_long_loop_in_single_precision_keeps_its_time() -> None:
    """A million samples of 0.01 in a sum of floats would be off by a second in a hundred."""
    ocp = OCP("clock", T=0.04, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x - ca.sin(ocp.time), u), 1.0)
    ctrl = build(ocp, Options(precision="single", algorithm=RealTimeIteration(iterations=1), solve=False))
    for _ in range(50_000):
        ctrl.step([0.0])
    assert ctrl.time == pytest.approx(500.0, rel=1e-6)


def test_a_scheme_sees_the_time_inside_its_steps() -> None:
    """x' = cos(t) integrated by the midpoint rule: its order is 2, which it would not be with the time of the node."""
    errors = []
    for N in (4, 8, 16):
        ocp = OCP("order", T=1.0, N=N)
        x, u = ocp.state("x"), ocp.control("u")
        ocp.dynamics({x: ca.cos(ocp.time) + u})
        ocp.least_squares(u, 1.0)
        ctrl = build(ocp, Options(integrator=ExplicitRungeKutta(Midpoint, steps=1)))
        errors.append(abs(ctrl.solve([0.0]).x[-1, 0] - np.sin(1.0)))
    slopes = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(slopes, 2.0, atol=0.1)


def test_an_integrated_cost_has_the_time_of_the_quadrature() -> None:
    """The integral of (u - t)^2 over an interval is least at the mean of t."""
    ocp = OCP("ramp", T=2.0, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.stage_cost((u - ocp.time) ** 2, integrate=True)
    ctrl = build(ocp)
    ctrl.set_time(3.0)
    np.testing.assert_allclose(ctrl.solve([0.0]).u[:, 0], 3.25 + 0.5 * np.arange(4), atol=1e-9)


# Problems without a control -------------------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize("route", ["dense", "riccati", "interior"])
def test_a_stiffness_is_identified_without_a_control(route: str) -> None:
    """A pendulum of unknown stiffness and start: what is measured without errors is found to all digits."""
    ocp = OCP("ident", T=2.0, N=20)
    q, w, k = ocp.state("q", initial=1.0), ocp.state("w"), ocp.state("k", initial=2.0)
    measured = ocp.parameter("measured")
    ocp.dynamics({q: w, w: -k * ca.sin(q) - 0.1 * w, k: 0})
    ocp.least_squares(q - measured, 1.0)
    ocp.terminal_least_squares(q - measured, 1.0)
    ocp.free_initial(q, w, k)
    ocp.subject_to(0.1, k, 10)
    ctrl = build(ocp, on(route))
    path = [np.array([0.7, 0.3, 3.0])]
    for _ in range(20):
        path.append(np.asarray(ctrl.integrate(path[-1], [], 0.1)))
    ctrl.set_parameter("measured", [x[0] for x in path])
    found = ctrl.solve([1.0, 0.0, 2.0], 1e-12)
    assert found.u.shape == (20, 0)
    np.testing.assert_allclose(found.x, path, atol=1e-8)
    ctrl.reset()
    for _ in range(6):
        assert ctrl.step([1.0, 0.0, 2.0]).shape == (0,)
    np.testing.assert_allclose(ctrl.x[0], path[0], atol=1e-6)
    assert simulate(ctrl, path[0], 3).u.shape == (3, 0)


# Move blocks ----------------------------------------------------------------------------------------------------------


def test_the_controls_of_a_block_are_equal_in_every_plan() -> None:
    ctrl, _ = prepared(blocked_crane(), None)
    x = np.array([0.0, 0, 0.1, 0])
    for _ in range(30):
        u = ctrl.step(x)
        assert ctrl.status == Status.OK, ctrl.diagnose()
        np.testing.assert_allclose(ctrl.u[2:4, 0], ctrl.u[2, 0], atol=1e-9)
        np.testing.assert_allclose(ctrl.u[4:8, 0], ctrl.u[4, 0], atol=1e-9)
        x = ctrl.integrate(x, u, 0.3)
    assert abs(x[0] - 1) < 0.1


@pytest.mark.parametrize("route", ["dense", "riccati"])
def test_a_block_has_the_bounds_of_its_first_node(route: str) -> None:
    tuned = blocked_crane()
    _, by_hand, x0, previous = tuned
    ctrl, _ = prepared(tuned, on(route, online=Online(bounds="node")))
    ctrl.set_bounds("F", -0.1, 0.1, node=3)  # inside the block of the nodes 2 and 3
    _, u, _ = by_hand.solve(x0, previous)
    np.testing.assert_allclose(ctrl.solve(x0, 1e-10).u, u, atol=1e-8)
    ctrl.set_bounds("F", 0.2, 0.3, node=2)
    found = ctrl.solve(x0)
    assert found.status == Status.OK
    np.testing.assert_allclose(found.u[2:4, 0], 0.2, atol=1e-9)


def test_the_report_says_how_a_plan_with_blocks_moves() -> None:
    ocp = blocked_crane()[0]
    assert any("shift: resample; blocks of controls" in line for line in generate(ocp).description.report.choices)
    with pytest.raises(OptionError, match=r'shift="repeat"\).*hold'):
        generate(ocp, options=Options(algorithm=RealTimeIteration(shift="repeat")))


def test_blocks_need_parameters_by_node() -> None:
    ocp = blocked_crane()[0]
    generate(ocp, options=Options(online=Online(parameter="fixed")))
    ocp.parameter("mass", value=1.0)
    with pytest.raises(OptionError, match=r'Online.parameter: "shared".*hold'):
        generate(ocp, options=Options(online=Online(parameter="shared")))


def test_osqp_refuses_what_it_cannot_regularise() -> None:
    with pytest.raises(OptionError, match="Osqp"):
        generate(slewed_crane()[0], options=Options(condensing=ROUTES["OSQP"][0], qp=Osqp(), hessian=ExactHessian()))


def test_condensing_has_a_variable_for_every_block() -> None:
    sources = generate(blocked_crane()[0], options=Options(condensing=FullCondensing()))
    assert sources.description.sizes["NV"] == 4 + 8
