"""AugmentedLagrangian: solutions of IPOPT, closed loops, the failure contract, and what it refuses."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import bioreactor, cart_pole, crane, cstr
from nmpc_codegen import (
    OCP,
    RK4,
    AugmentedLagrangian,
    Controller,
    DenseActiveSet,
    EconomicGaussNewton,
    ExactHessian,
    ExplicitRungeKutta,
    OptionError,
    Options,
    Status,
    build,
    generate,
)
from nmpc_codegen.components.algorithms.row_scales import cost_magnitude
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, node_data
from verification import problems, samples
from verification.robustness import cold

THREE_STEPS = ExplicitRungeKutta(RK4, steps=3)


def options(**more: Any) -> Options:
    return Options(algorithm=AugmentedLagrangian(), **more)


def options_with(hessian_exact: bool = False, **algorithm: Any) -> Options:
    hessian = ExactHessian(regularization=None) if hessian_exact else None
    return Options(hessian=hessian, algorithm=AugmentedLagrangian(**algorithm))


def loop_options(**algorithm: Any) -> Options:
    return Options(integrator=THREE_STEPS, algorithm=AugmentedLagrangian(shift="periodic", **algorithm))


def goal_out_of_reach() -> OCP:
    """A hard row at the end that no control satisfies."""
    ocp = OCP("far", T=1.0, N=4)
    x, u = ocp.state("x", initial=0.0), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(5, x + 0.1 * x**2, 6, at="end", name="goal")
    return ocp


# solve() against IPOPT ------------------------------------------------------------------------------------------------


def assert_solves(ocp: OCP, given: Options, x0: np.ndarray, atol: float) -> Controller:
    """solve() converges to a point with the multipliers, the cost and the controls of IPOPT."""
    problem, controller = classify(ocp), build(ocp, given, "test")
    solution = controller.solve(x0, tol=1e-9, max_iterations=300)
    tableau = CLASSICAL
    if isinstance(given.integrator, ExplicitRungeKutta):
        tableau = replace(CLASSICAL, steps=given.integrator.steps)
    found = Reference(problem, tableau).solve(node_data(problem, x0=x0))
    assert solution.status is Status.OK
    assert solution.kkt.relative <= 1e-9
    assert found.success
    np.testing.assert_allclose(solution.u, found.u, atol=atol)
    np.testing.assert_allclose(solution.x, found.x, atol=atol)
    assert solution.cost == pytest.approx(found.cost, rel=1e-6, abs=1e-9)
    return controller


@pytest.mark.parametrize("penalty", [(0.05, 0.0), (0.05, 0.2), (50.0, 0.0)])
def test_soft_rows_that_are_violated(penalty: tuple[float, float]) -> None:
    """Multipliers at the weight of the row, beyond it with a quadratic penalty, and below it (an exact penalty)."""
    ocp = samples.controls()
    ocp.subject_to(-0.3, ocp.x[1], 0.3, soft=penalty)
    controller = assert_solves(ocp, options(), np.array([0.5, 0.6]), 2e-6)
    largest = np.abs(controller.mu_x).max()
    if penalty[0] == 50.0:
        assert 0.05 < largest < 50.0
    elif penalty[1]:
        assert largest > penalty[0] * (1 + 1e-3)
    else:
        assert largest == pytest.approx(penalty[0], rel=1e-9)


def test_soft_coupled_rows() -> None:
    """r(xhat, x_N) instead of r(x_0, x_N): the solution and its KKT residuals are those of the problem."""
    ocp = bioreactor.build_ocp(soft=True)
    problem, controller = classify(ocp), build(ocp, loop_options(), "test")
    bioreactor.guess(controller)
    x0 = np.append(controller.x[0, :3] * 1.02, [0.0, 0.0])
    solution = controller.solve(x0, tol=1e-8, max_iterations=500)
    assert solution.status is Status.OK
    found = Reference(problem, replace(CLASSICAL, steps=3)).solve(node_data(problem, x0=x0))
    assert solution.cost <= found.cost + 1e-6 * abs(found.cost)  # the problem has several local solutions
    assert np.abs(solution.eta).max() <= 1 + 1e-9


# Trust region ---------------------------------------------------------------------------------------------------------


def test_negative_curvature_is_met_and_survived() -> None:
    """A saddle: the cost is concave in x, and at the start all first derivatives vanish but that of the control."""
    controller = assert_solves(problems.saddle(), options(), np.array([0.1]), 1e-5)
    assert controller.stats.negative_curvature > 0
    assert controller.stats.shifts > 0
    assert controller.x[-1, 0] > 1  # a minimum, not the saddle x = 0


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_iterate_leaves_the_box_and_the_model_decreases(seed: int) -> None:
    random = np.random.default_rng(seed)
    ocp = samples.states()
    controller = _states_controller(ocp)
    controller.reset()
    controller.x[...] += random.uniform(-2, 2, controller.x.shape)
    controller.u[...] += random.uniform(-2, 2, controller.u.shape)
    controller.lam[...] = random.uniform(-1, 1, controller.lam.shape)
    for _ in range(3):
        controller.step(random.uniform(-1, 1, 2), on_failure="raise")
        assert np.all(np.abs(controller.x[1:, 1]) <= 0.6)
        assert abs(controller.x[-1, 0]) <= 1
        assert float(controller.view("auglag.predicted")) >= 0
        assert controller.stats.faces <= 3 * 5


_BUILT: dict[str, Controller] = {}


def _states_controller(ocp: OCP) -> Controller:
    return _BUILT.setdefault(ocp.name, build(ocp, options(), "test"))


# Closed loops ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_bioreactor_stays_on_its_orbit_after_a_jump() -> None:
    """Productivity and mean feed over the last 48 h (Hours, Shukla and Jones, section V), with S + 20 % on the way."""
    ocp = bioreactor.build_ocp(soft=True)
    controller = build(ocp, loop_options(), "test")
    plant = build(ocp, replace(bioreactor.options(), integrator=ExplicitRungeKutta(RK4, steps=20)), "test")
    bioreactor.guess(controller)
    x, states, feeds = controller.x[0].copy(), [], []
    for n in range(160):
        x[1] *= 1.2 if n == 80 else 1.0
        x[3:] = 0.0
        u = controller.step(x, on_failure="raise")
        states.append(x.copy())
        feeds.append(u.copy())
        x = np.asarray(plant.integrate(x, u, bioreactor.SAMPLING))
    log: Any = type("Loop", (), {"x": np.array(states), "u": np.array(feeds)})
    assert bioreactor.productivity(log, 140, 160) == pytest.approx(3.0548, rel=0.01)
    assert np.mean(log.u[140:]) == pytest.approx(32.9, abs=0.1)


@pytest.mark.few(2)
@pytest.mark.parametrize("case", cold.cases(), ids=lambda case: case.name)
def test_cold_plans_converge_in_closed_loop(case: cold.Case) -> None:
    """Within a hundredth of the cost of converged plans; never OK with a large gap."""
    good, loops = cold.judge(case, 2)
    assert all(good)
    assert sum(loop.far for loop in loops) == 0


def test_a_fresh_plan_starts_where_it_is_measured() -> None:
    """An untouched plan restarts at the first state; one that was written is kept."""
    ocp = cart_pole.build_ocp()
    fresh, written = (build(ocp, Options(algorithm=AugmentedLagrangian(repair=3)), "test") for _ in range(2))
    x0 = np.array([0.1, 0.1, 0.0, 0.0])
    fresh.step(x0, on_failure="raise")
    assert np.abs(fresh.x[:, 1]).max() < 0.2  # the plan that hangs, at pi, is forgotten
    written.x[1:] = [0.0, 2 * np.pi, 0.0, 0.0]
    written.step(x0)
    assert np.abs(written.x[1:-1, 1]).max() > 1.0


def test_the_default_penalty_follows_the_cost() -> None:
    """In the scales of states and controls; its rule is in the report."""
    tables = []
    for factor in (1.0, 1e3):
        ocp = OCP("scaled", T=1.0, N=4)
        x, u = ocp.state("x", initial=2.0), ocp.control("u")
        ocp.dynamics({x: u})
        ocp.least_squares(ca.vertcat(x, u), weight=[factor * 5.0, factor * 0.1])
        ocp.subject_to(-10, u, 10)
        controller = build(ocp, options(), "test")
        tables.append(float(controller.view("auglag.penalty")))
        # the first penalty of a plan is a tenth of that of later samples
        assert tables[-1] == pytest.approx(0.1 * 3e3 * factor * max(5.0 * 4, 0.1 * 100), rel=1e-12)
        choices = controller.description.report.choices
        assert any(f"penalty: {3e3 * factor * 20:.4g}" in choice for choice in choices)
    assert cost_magnitude(classify(bioreactor.build_ocp(soft=True)), np.ones(6)) == pytest.approx(20 * 0.15 / 20)
    given = build(crane.build_ocp(), options_with(penalty=7.0), "test")
    assert not any("penalty" in choice for choice in given.description.report.choices)


# Updates of the multipliers -------------------------------------------------------------------------------------------


def test_multipliers_wait_for_the_violation_to_fall() -> None:
    """A measurement that no plan can reach leaves them as they are, and the penalty grows; it returns later."""
    c = build(cold.van_der_pol(), options_with(shift=None, repair=0), "test")
    x0 = [1.0, 0.5]
    for _ in range(20):
        clean = c.step(x0, on_failure="raise")
    assert c.status is Status.OK
    before, penalty = c.lam.copy(), float(c.view("auglag.penalty"))
    c.step([1000.0, 0.5])
    assert c.status is Status.NOT_CONVERGED
    assert c.stats.violation > 100
    np.testing.assert_array_equal(c.lam, before)
    assert float(c.view("auglag.penalty")) > penalty
    for _ in range(20):
        u0 = c.step(x0)
    assert c.status is Status.OK
    np.testing.assert_allclose(u0, clean, atol=1e-6)
    assert float(c.view("auglag.penalty")) == penalty


def test_multipliers_are_bounded_where_rows_contradict() -> None:
    c = build(goal_out_of_reach(), options(), "test")
    largest = []
    for _ in range(400):
        c.step([0.0])
        assert c.status is Status.NOT_CONVERGED
        largest.append(max(np.abs(c.lam).max(), np.abs(c.mu_N).max()))
    assert max(largest[200:]) <= max(largest[:200])


@pytest.mark.parametrize("shift", [None, "repeat"])
def test_one_bad_measurement_is_forgotten(shift: str | None) -> None:
    """Against a loop that never saw it; the oscillator moves meanwhile."""
    told, spared = (build(cold.van_der_pol(), options_with(shift=shift), "test") for _ in range(2))
    x, y, statuses = np.array([1.0, 0.5]), np.array([1.0, 0.5]), []
    for k in range(120):
        u = told.step([1000.0, 0.5] if k == 40 else x)
        x = np.asarray(told.integrate(x, u, told.description.dt[0]))
        y = np.asarray(spared.integrate(y, spared.step(y), told.description.dt[0]))
        statuses.append(told.status)
    assert statuses[40] is Status.NOT_CONVERGED
    assert Status.OK in statuses[41:61]
    assert set(statuses[61:]) == {Status.OK}
    np.testing.assert_allclose(x, y, atol=1e-3)
    assert np.abs(told.lam).max() < 1e3


@pytest.mark.parametrize(
    "bad", [[1e3, 0.0, 0.0], [1e3, 1e3, 1e3], [0.0, 1e3, 0.0], [1e9, 1e9, 1e9], [1e30, 1e30, 1e30]]
)
def test_a_moving_car_forgets_a_bad_measurement(bad: list[float]) -> None:
    """Before the spoilt plan steers it away: a plan farther from the model than a fresh one is given up at once."""
    ocp = OCP("lane", T=3.0, N=30)
    y, psi, delta, rate = ocp.state("y"), ocp.state("psi"), ocp.state("delta"), ocp.control("rate")
    ocp.dynamics({y: 20 * ca.sin(psi), psi: 20 / 2.7 * ca.tan(delta), delta: rate})
    ocp.least_squares(ca.vertcat(y - 3.5, psi, delta, rate), weight=[1, 5, 10, 1])
    ocp.terminal_least_squares(ca.vertcat(y - 3.5, psi), weight=[10, 50])
    ocp.subject_to(-0.5, rate, 0.5)
    ocp.subject_to(-0.3, delta, 0.3)
    c, x, away, statuses = build(ocp, options(), "test"), np.zeros(3), 0.0, []
    for k in range(60):
        u = c.step(np.array(bad) if k == 30 else x)
        x = np.asarray(c.integrate(x, u, 0.1))
        statuses.append(c.status)
        away = max(away, abs(x[0] - 3.5)) if k > 30 else 0.0
    assert statuses[30] is Status.NOT_CONVERGED
    assert statuses[33:] == [Status.OK] * 27
    assert away < 0.3


def test_multipliers_of_bounds_belong_to_the_plan() -> None:
    """Also where the step is refused: those of the controls are minus the gradient of the augmented Lagrangian."""
    c = build(cold.van_der_pol(), options_with(iterations=1, repair=0, penalty=1e6, hessian_exact=True), "test")
    refused = 0
    for x0 in ([2.0, 3.0], [-2.0, -3.0], [2.5, -3.0], [3.0, 3.0], [-3.0, 2.0], [50.0, 0.0], [2.0, 3.0]):
        c.step(x0)
        if not c.stats.accepted:
            refused += 1
            slope = -c.view("auglag.g")[:-1, 2]
            wrong = (c.mu_u[:, 0] != 0) & ~np.isclose(c.mu_u[:, 0], slope, rtol=1e-12)
            assert not wrong.any()
    assert refused > 0


# Failure contract -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [1e-5, 1e3])
def test_a_plan_that_is_far_from_the_model_is_not_converged(tolerance: float) -> None:
    """By its largest gap in the scale of a state, recomputed in numpy."""
    c = build(bioreactor.build_ocp(soft=True), loop_options(tolerance=tolerance), "test")
    xhat = np.array(c.description.x_initial) * 1.1
    c.step(xhat)
    X, U = c.x, c.u
    xhat[list(classify(bioreactor.build_ocp(soft=True)).accumulators)] = 0.0
    ends = [c.integrate(x, u, dt) for x, u, dt in zip(X[:-1], U, c.description.dt, strict=True)]
    size = np.max(np.abs(X), axis=0)
    residual = np.max(np.abs(np.vstack([xhat - X[0], np.array(ends) - X[1:]])) / size)
    assert c.stats.residual == pytest.approx(residual, rel=1e-6)
    assert c.status is (Status.NOT_CONVERGED if residual > tolerance else Status.OK)
    assert (residual > tolerance) == (tolerance < 1)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_nothing_stays_in_the_work_arrays(number: float) -> None:
    """Numbers of an earlier sample that are not finite, also those in the padding of rows, change nothing later."""
    first = build(cstr.build_ocp(), options(), "test")
    assert first.view("auglag.g").shape[1] > first.x.shape[1] + first.u.shape[1]  # rows have padding
    x0 = np.array(classify(cstr.build_ocp()).x_initial)
    first.step(x0)
    second = first.copy()
    scratch = ("H", "B", "L", "W", "g", "lower", "upper", "open", "d", "Hd", "w", "Hw", "residual", "p", "Hp")
    for name in (*scratch, "kept_x", "kept_u", "kept_gap"):
        second.view(f"auglag.{name}")[...] = number
    for _ in range(2):
        np.testing.assert_array_equal(second.step(x0), first.step(x0))
        assert not second.status.is_failure


def test_a_goal_out_of_reach() -> None:
    """Hard rows that no control satisfies: controls inside their bounds, the violation in the statistics."""
    controller = build(goal_out_of_reach(), options(), "test")
    for _ in range(30):
        u0 = controller.step([0.0])
        assert np.all(np.abs(u0) <= 1)
        assert controller.stats.violation > 0.1
    np.testing.assert_allclose(controller.u, 1.0, atol=1e-6)  # as near to the goal as possible
    assert controller.solve([0.0], max_iterations=100).status is Status.ITERATION_LIMIT
    assert np.all(np.abs(controller.step([0.0])) <= 1)


def test_data_that_change_after_prepare_act_in_the_feedback() -> None:
    ocp = samples.controls()
    first, second = build(ocp, options(), "test"), build(ocp, options(), "test")
    for controller in (first, second):
        controller.step([0.5, 0.1], on_failure="raise")
        assert controller.status is Status.OK
    first.prepare()
    for controller in (first, second):
        controller.set_reference([0.2, 0.0, 0.1])
    late = first.feedback([0.5, 0.1])
    np.testing.assert_allclose(second.step([0.5, 0.1]), late, rtol=0, atol=1e-12)


def test_a_second_prepare_changes_nothing() -> None:
    first = build(bioreactor.build_ocp(soft=True), loop_options(), "test")
    bioreactor.guess(first)
    x = first.x[0].copy()
    first.step(x)
    second = first.copy()
    for controller in (first, second):
        controller.prepare()
    second.prepare()
    np.testing.assert_allclose(second.feedback(x), first.feedback(x), rtol=0, atol=1e-9)
    np.testing.assert_allclose(second.lam, first.lam, rtol=0, atol=1e-9)


# What a package contains and what is refused --------------------------------------------------------------------------


def test_a_package_has_neither_condensing_nor_qp() -> None:
    sources = generate(crane.build_ocp(), options())
    for file in ("crane_nmpc.h", "README.md", "main.c") if "crane_nmpc.h" in sources else ("crane.h", "README.md"):
        assert not re.findall(r"(?i)\b(?:\w*condens\w*|qp_?\w*|\w*riccati\w*|working_set)\b", sources[file])


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(OptionError, match=r"clashes with a regularisation .*regularization=None"):
        generate(crane.build_ocp(), options(hessian=ExactHessian()))
    with pytest.raises(OptionError, match=r"qp .* clashes with algorithm AugmentedLagrangian"):
        options(qp=DenseActiveSet())
    with pytest.raises(OptionError, match="computed off line"):
        generate(samples.tuned(), options(hessian=EconomicGaussNewton(np.eye(3), np.eye(2))))
    with pytest.raises(OptionError, match="couple x_N with free components of x_0"):
        generate(samples.cycle(), options())
    with pytest.raises(OptionError, match="sampling_time"):
        AugmentedLagrangian(shift="resample")
    for wrong in ({"iterations": 0}, {"penalty": 0.0}, {"proximal": -1.0}):
        with pytest.raises(OptionError):
            AugmentedLagrangian(**wrong)  # type: ignore[arg-type]
