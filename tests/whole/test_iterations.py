"""Samples that hold: the residual of a plan, NOT_CONVERGED, iterations, relaxation in the scales of rows."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import quadrotor
from nmpc_codegen import (
    OCP,
    AugmentedLagrangian,
    ControllerError,
    ExactHessian,
    Options,
    RealTimeIteration,
    Status,
    build,
    generate,
    simulate,
    worst_case,
)
from nmpc_codegen.runtime.controller import Controller
from verification import problems
from verification.routes import OURS, PURE, on
from verification.strangers.problems import known

#: A direction of length 1 starts at 0, where the gradient of its length vanishes.
pytestmark = pytest.mark.filterwarnings("ignore:.*its gradient vanishes at the first plan")

N, DT = 12, 0.1
MEASURED = replace(PURE, tolerance=0.1)


def tilted(name: str = "tilted") -> OCP:
    """A thrust in a direction d with d'd = 1: the first QP takes a long vector for one of length 1."""
    ocp = OCP(name, T=N * DT, N=N)
    x, v = ocp.state("x", size=2), ocp.state("v", size=2)
    d = ocp.control("d", size=2)
    ocp.dynamics({x: v, v: 4 * d - 0.3 * v * ca.sumsqr(v)})
    ocp.least_squares(ca.vertcat(x - ca.DM([2, 1]), v, d - ca.DM([1, 0])), weight=[5, 5, 1, 1, 0.01, 0.01])
    ocp.terminal_least_squares(ca.vertcat(x - ca.DM([2, 1]), v), weight=[50, 50, 10, 10])
    ocp.subject_to(-3, d, 3)
    ocp.subject_to(1, ca.sumsqr(d), 1, name="length")
    return ocp


@cache
def _built(algorithm: RealTimeIteration, **more: Any) -> Controller:
    return build(tilted(), Options(algorithm=algorithm, **more), "test")


def made(algorithm: RealTimeIteration, **more: Any) -> Controller:
    """A fresh controller whose plan has the length that it should have."""
    c = _built(algorithm, **more).copy()
    c.u[...] = [1.0, 0.0]
    return c


# The residual ---------------------------------------------------------------------------------------------------------


def test_the_residual_of_a_preparation_is_that_of_the_plan_that_was_linearised() -> None:
    """Gaps in the scales of the states, and rows less what the last step predicted for them, recomputed in numpy."""
    c, xhat = made(MEASURED), np.array([0.1, -0.2, 0.3, 0.0])
    predicted, seen = None, set()
    declared, learnt = np.array(c.description.scales[:4]), np.zeros(4)  # sizes of the states, and what plans tell
    for _ in range(30):
        X, U = c.x.copy(), c.u.copy()
        ends = np.array([c.integrate(X[k], U[k], DT) for k in range(N)])
        present = np.minimum(np.max(np.abs(X), axis=0), np.where(learnt > 0, 10 * learnt, np.inf))
        size = np.max([0.1 * declared, present, np.abs(c.view("xhat"))], axis=0)
        residual = np.max(np.abs(ends - X[1:]) / size)
        if predicted is not None:  # 1 is the bound of the row and so its scale
            residual = max(residual, np.max(np.abs(np.sum(U**2, axis=1) - predicted)))
        assert c.prepare() is Status.OK
        assert c.stats.residual == pytest.approx(residual, rel=1e-9, abs=1e-13)
        c.feedback(xhat)
        assert c.status is (Status.NOT_CONVERGED if c.stats.residual > MEASURED.tolerance else Status.OK)
        seen.add(c.status)
        learnt = np.max(np.abs(c.x), axis=0) if c.status is Status.OK else learnt
        predicted = np.sum(U**2, axis=1) + np.sum(2 * U * c.view("step.du"), axis=1)
    assert seen == {Status.OK, Status.NOT_CONVERGED}


def test_after_a_step_that_is_not_trusted_the_residual_contains_that_of_the_kkt_conditions() -> None:
    c, xhat, judged = made(MEASURED), np.array([0.1, -0.2, 0.3, 0.0]), 0
    for _ in range(12):
        c.step(xhat)
        if not c.view("near.trusted"):
            judged += 1
            assert c.stats.residual >= c.kkt().relative * (1 - 1e-9)
    assert judged > 1
    for _ in range(10):
        c.step(xhat)
    assert c.view("near.trusted")
    assert c.kkt().relative < 1e-5


def test_the_tail_of_a_shift_does_not_count() -> None:
    """The crane with x_N = 0: the shifted plan misses its terminal row, and is OK."""
    c = build(problems.CASES["crane"].make(), Options(algorithm=replace(MEASURED, shift="repeat")), "test")
    log = simulate(c, [2.0, 0.0, 0.0, 0.0], 20)
    assert np.all(log.status[2:] == Status.OK)


def test_not_converged_is_no_failure() -> None:
    """It raises nothing, no plan is given up, and the diagnosis and the summary explain it."""
    c, x = made(MEASURED), np.zeros(4)
    c.step(x)
    for _ in range(4):
        u = c.step(x, on_failure="raise")
        if c.status is Status.NOT_CONVERGED:
            break
    assert c.status is Status.NOT_CONVERGED
    assert np.all(np.isfinite(u))
    assert not c.status.is_failure
    assert int(c.view("failures")) == 0
    text = c.diagnose()
    assert "residual of the plan" in text
    assert "RealTimeIteration(iterations=10)" in text
    summary = simulate(made(MEASURED), x, 4).summary()
    assert "NOT_CONVERGED" in summary
    assert "first NOT_CONVERGED: sample 0" in summary


def test_stats_after_a_step_are_those_of_the_plan() -> None:
    c = made(RealTimeIteration())
    c.step(np.zeros(4))
    assert c.stats.kkt == c.kkt()
    assert c.stats.kkt.stationarity > 0
    assert "residual" in str(c.stats)


# Iterations -----------------------------------------------------------------------------------------------------------


def test_a_sample_goes_on_until_its_plan_is_near() -> None:
    """From random plans: NOT_CONVERGED only after all iterations, and OK only near a solution."""
    random, several = np.random.default_rng(3), 0
    for _ in range(20):
        c = made(RealTimeIteration(shift=None))
        c.x[...] += random.normal(size=c.x.shape)
        u = c.step([0.4, 0.0, 0.1, 0.0])
        assert np.sum(u**2) == pytest.approx(1.0, abs=1e-9)
        assert 1 <= c.stats.iterations <= 10
        several += c.stats.iterations > 1
        if c.status is Status.OK:
            assert c.kkt().relative <= 0.1
            np.testing.assert_allclose(c.x[0], [0.4, 0.0, 0.1, 0.0], atol=1e-12)
        else:
            assert c.status is Status.NOT_CONVERGED
            assert c.stats.iterations == 10
    assert several == 20


def test_a_caller_may_limit_a_sample() -> None:
    """At most that many QPs, the rest in the next samples; without a limit again afterwards."""
    c, whole = made(RealTimeIteration(shift=None)), made(RealTimeIteration(shift=None))
    random = np.random.default_rng(5)
    c.x[...] += random.normal(size=c.x.shape)
    whole.x[...] = c.x
    x = [0.4, 0.0, 0.1, 0.0]
    whole.step(x)
    assert whole.stats.iterations > 3
    c.step(x, iterations=2)
    assert c.stats.iterations == 2
    assert c.status is Status.NOT_CONVERGED
    c.prepare()
    c.feedback(x, iterations=1)
    assert c.stats.iterations == 1
    assert int(c.view("most_iterations")) == 10
    for _ in range(10):
        c.step(x, iterations=3)
    assert c.status is Status.OK
    assert c.kkt().relative < 0.1
    for wrong in (0, -1, 1.5, True):
        with pytest.raises(ControllerError, match="iterations is"):
            c.step(x, iterations=wrong)
    with pytest.raises(ControllerError, match="RealTimeIteration"):
        build(tilted(), Options(algorithm=AugmentedLagrangian()), "test").step(x, iterations=2)


def test_a_problem_whose_qp_is_exact_is_never_judged() -> None:
    """Linear dynamics, linear rows, quadratic cost: no search in the sample, any limit holds."""
    ocp = OCP("cart", T=2.0, N=10)
    x, v, u = ocp.state("x"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({x: v, v: u})
    ocp.least_squares(ca.vertcat(x, v, u), weight=[10, 1, 0.1])
    ocp.subject_to(-1, u, 1)
    c = build(ocp, None, "test")
    assert "near" not in c.description.members("solver")
    c.step([4.0, 0.0], iterations=1)
    assert c.status is Status.OK
    assert c.stats.iterations == 1


@pytest.mark.parametrize("route", OURS)
def test_the_same_inputs_give_the_same_bits(route: str) -> None:
    c = build(tilted(), on(route, algorithm=RealTimeIteration()), "test")
    twin, x = c.copy(), np.array([0.3, 0.1, -0.5, 0.0])
    for _ in range(8):
        u = c.step(x)
        np.testing.assert_array_equal(twin.step(x), u)
        x = c.integrate(x, u, DT)
    np.testing.assert_array_equal(c._memory, twin._memory)


def test_what_leaves_the_iterations_out() -> None:
    """A small package without solve(), and the report says so; targets do not."""
    module = generate(tilted(), Options(goal="size", solve=False))
    assert module.description.sizes["SAMPLE_ITERATIONS"] == 1
    assert "iterations: 1; " in module["tilted.json"]
    for more in ({}, {"solve": False}, {"target": "cortex-m4f"}, {"goal": "size"}):
        assert generate(tilted(), Options(**more)).description.sizes["SAMPLE_ITERATIONS"] == 10


def test_the_worst_case_is_stated_with_one_iteration_and_with_all() -> None:
    one, two, three = (
        worst_case(generate(tilted(), Options(algorithm=RealTimeIteration(iterations=n)))) for n in (1, 2, 3)
    )
    assert "one iteration" not in one
    assert one["sample"] <= two["one iteration"] < 1.1 * one["sample"]
    assert two["one iteration"] == three["one iteration"] < two["sample"] < three["sample"]


# Kinds of loops that one full step per sample loses -------------------------------------------------------------------


def reactor() -> OCP:
    """An exothermic tank at its unstable steady state."""
    ocp = OCP("reactor", T=3.0, N=20)
    c, T, Tc = ocp.state("c", initial=0.7), ocp.state("T", initial=330.0), ocp.control("Tc")
    k = 7.2e10 * ca.exp(-8750 / T)
    ocp.dynamics({c: 1 - c - k * c, T: 350 - T + 209.2 * k * c + 2.092 * (Tc - T)})
    ocp.least_squares(ca.vertcat(c, T, Tc), weight=[100, 0.01, 0.001], reference=[0.5, 350, 300])
    ocp.terminal_least_squares(ca.vertcat(c, T), weight=[75, 0.0075], reference=[0.5, 350])
    ocp.subject_to(280, Tc, 370)
    ocp.subject_to(300, T, 390)
    return ocp


def battery() -> OCP:
    """A battery that heats with the square of its current."""
    ocp = OCP("battery", T=600.0, N=20)
    soc, temp, i = ocp.state("soc", initial=0.8), ocp.state("temp", initial=25.0), ocp.control("i")
    ocp.dynamics({soc: -i / 3600, temp: (0.02 * i * i - 0.5 * (temp - 25)) / 40})
    ocp.least_squares(ca.vertcat(soc, i), weight=[2000, 1e-4], reference=[0.3, 0])
    ocp.terminal_least_squares(soc, weight=300000, reference=0.3)
    ocp.subject_to(-20, i, 60)
    ocp.subject_to(-20, temp, 40)
    return ocp


@pytest.mark.filterwarnings("ignore:.*is not accurate")  # where it has ignited
@pytest.mark.parametrize("start", [(0.7, 330.0), (0.5, 350.0), (0.6, 340.0)])
def test_an_unstable_reactor_stays_at_its_set_point(start: tuple[float, float]) -> None:
    log = simulate(build(reactor(), None, "test"), start, 60)
    assert log.x[:, 1].max() < 360
    np.testing.assert_allclose(log.x[-1], [0.5, 350], atol=0.1)


@pytest.mark.parametrize("more", [{}, {"solve": False}, {"target": "cortex-m7"}])
def test_a_board_keeps_the_limit_that_the_desk_keeps(more: dict[str, Any]) -> None:
    log = simulate(build(battery(), Options(**more), "test"), [0.8, 25.0], 40)
    assert log.x[:, 1].max() < 40.5
    assert np.all(log.status == Status.OK)


# Relaxation -----------------------------------------------------------------------------------------------------------


def stopped(unit: float, kind: str) -> OCP:
    """A cart that cannot stop before a wall and a speed limit, whose rows are stated in other units."""
    ocp = OCP("stopped", T=2.0, N=10)
    x, v, a = ocp.state("x"), ocp.state("v"), ocp.control("a")
    ocp.dynamics({x: v, v: a})
    ocp.least_squares(ca.vertcat(x, v, a), weight=[1.0, 1.0, 0.1])
    ocp.subject_to(-1, a, 1)
    if kind == "state":
        ocp.subject_to(-np.inf, x, 1.0, name="wall")
    elif kind == "general":
        ocp.subject_to(-np.inf, unit * (x + 0.1 * v), unit, name="wall")
    elif kind == "end":
        ocp.subject_to(-0.1 * unit, unit * (x + v**2), 0.1 * unit, at="end", name="wall")
    else:
        ocp.boundary(0, unit * (ocp.at_end(x) - 0.1 * ocp.at_start(x)), 0, name="wall")
    ocp.subject_to(-0.5, v, 0.5, soft=(10.0, 1.0), name="limit")
    return ocp


@pytest.mark.few(4)
@pytest.mark.parametrize("route", OURS)
@pytest.mark.parametrize("kind", ["state", "general", "end", "coupled"])
def test_hard_rows_give_way_in_their_own_units(route: str, kind: str) -> None:
    """Every kind of row beside a soft one: the controls do not depend on the unit in which a row is stated, and the
    violation is named."""
    found = []
    for unit in (1.0, 1e4):
        c = build(stopped(unit, kind), on(route, algorithm=replace(PURE, relaxation="auto")), "test")
        u = c.step([1.5, 2.0])
        assert c.status is Status.RELAXED
        assert c.stats.violated_row in ("wall", "wall_end")
        found.append((u, c.stats.violation / unit))
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=1e-5, atol=1e-6)
    if kind != "state":
        assert found[1][1] == pytest.approx(found[0][1], rel=1e-4)


def test_without_a_relaxation_the_plan_stays() -> None:
    c = build(stopped(1.0, "state"), Options(algorithm=PURE), "test")
    plan = c.x.copy()
    c.step([1.5, 2.0])
    assert c.status is Status.INFEASIBLE
    np.testing.assert_array_equal(c.x, plan)


def test_multipliers_of_a_penalty_do_not_enter_an_exact_hessian() -> None:
    algorithm = replace(PURE, relaxation="auto")
    c = build(stopped(1.0, "end"), Options(hessian=ExactHessian(), algorithm=algorithm), "test")
    c.step([1.5, 2.0])
    assert c.status is Status.RELAXED
    assert not np.any(c.lam)


def test_a_step_of_which_no_part_helps_is_not_taken() -> None:
    """A residual that jumps up where the step begins: the plan stays where it was, exactly."""
    ocp = OCP("jump", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(0.1 * x, u + 0.02 * u**2 - 1 + 5 * (u > 0)), weight=[1, 1])
    c = build(ocp, profile="test")
    c.step([0.0])
    assert c.status is Status.NOT_CONVERGED
    assert not c.u.any()


def test_a_drone_commanded_by_a_quaternion_arrives() -> None:
    stranger = known("quaternion")
    c = build(stranger.ocp(), stranger.options(), "test")
    log = simulate(c, np.zeros(6), 60)
    assert np.linalg.norm(log.x[-1, :3] - [2, 1, 1]) < 0.05
    far = np.abs(np.sum(log.u[:, 1:] ** 2, axis=1) - 1) > 0.2
    assert np.sum(far & (log.status == Status.OK)) <= 1


def test_a_plan_that_iterations_do_not_bring_back_is_given_up() -> None:
    """A quadrotor after one sample with a reference far away: its plan leads nowhere, and the next ones start anew."""
    c = build(quadrotor.build_ocp(), replace(quadrotor.options(), algorithm=RealTimeIteration()), "test")
    rest = np.zeros(12)
    for _ in range(5):
        c.step(rest)
    c.x[1:, 6:9] = 1e3
    statuses = []
    for _ in range(30):
        c.step(rest)
        statuses.append(c.status)
    assert Status.NOT_CONVERGED in statuses
    assert statuses[-1] is Status.OK
    assert np.abs(c.x).max() < 1


def test_a_plan_that_escapes_is_not_measured_in_its_own_size() -> None:
    """After samples that were OK, a plan that is a thousand times as large, with a gap of half of it."""
    c = made(MEASURED)
    for _ in range(30):
        c.step([0.1, -0.2, 0.3, 0.0])
    assert c.status is Status.OK
    known = np.max(np.abs(c.x[:, 0]))
    c.x[5:, 0] = 1e3
    c.prepare()
    assert c.stats.residual > 0.9 * 1e3 / (10 * known)
