"""Controllers in operation: u0 on every return, data that change during operation, closed loops, shifted plans."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, DenseActiveSet, GaussNewton, Options, build
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import solve_reference
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.controller import Controller
from verification import problems
from verification.routes import PURE

FAR = np.array([2.0, 0.0, 0.0, 0.0])  # feasible, six controls at bounds
INFEASIBLE = np.array([1.0, 0.0, 0.5, 0.0])


def assert_safe(c: Controller, u: Any) -> None:
    """Every control is finite and inside the present bounds."""
    rows = {row.index: i for i, row in enumerate(c.description.rows) if row.kind == "control"}
    for j, value in enumerate(u):
        assert np.isfinite(value)
        if j in rows:
            assert c.view("lower")[0, rows[j]] <= value <= c.view("upper")[0, rows[j]]


@cache
def _shifting(name: str) -> Controller:
    return build(problems.CASES[name].make(), Options(algorithm=replace(PURE, shift="repeat")), "test")


def shifting(name: str) -> Controller:
    """A fresh controller of a case with shift="repeat"."""
    fresh = _shifting(name).copy()
    problems.apply(fresh, problems.CASES[name].data)
    fresh.reset()
    return fresh


# u0 on every return ---------------------------------------------------------------------------------------------------


def started(name: str = "crane") -> Controller:
    """A controller that has run for two samples."""
    c = problems.controller(name)
    for _ in range(2):
        c.step(problems.CASES[name].x0, on_failure="raise")
    return c


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("component", range(4))
def test_state_not_finite(component: int, bad: float) -> None:
    """A safe control, and the next sample is solved as usual: bit for bit."""
    c, twin = started(), started()
    xhat = FAR.copy()
    xhat[component] = bad
    assert_safe(c, c.step(xhat))
    assert c.status == Status.NOT_FINITE
    np.testing.assert_array_equal(c.step(FAR), twin.step(FAR))
    assert c.status == Status.OK
    np.testing.assert_array_equal(c.x, twin.x)


def test_infeasible_state() -> None:
    """The plan is kept, its control is returned, and the next feasible sample is solved."""
    c = started()
    x, u = c.x.copy(), c.u.copy()
    assert_safe(c, c.step(INFEASIBLE))
    assert c.status == Status.INFEASIBLE
    np.testing.assert_array_equal(c.x, x)
    np.testing.assert_array_equal(c.u, u)
    for _ in range(6):
        c.step(FAR, on_failure="raise")
    np.testing.assert_allclose(c.u, problems.reference("crane").u, atol=1e-9)


def test_a_plan_that_has_nothing_to_do_with_the_plant_is_given_up() -> None:
    """Its QP is infeasible at a state from which a new controller finds a solution: the third sample does, too."""
    c = started()
    c.x[:, 2] = np.linspace(1.0, -1.4, len(c.x))  # the load is elsewhere, at angles that no plan has
    c.x[:, 3] = 40.0
    u = c.u.copy()
    for _ in range(2):
        assert_safe(c, c.step(FAR))
        assert c.status == Status.INFEASIBLE
        np.testing.assert_array_equal(c.u, u)
    np.testing.assert_array_equal(c.x, np.tile(FAR, (len(c.x), 1)))
    for _ in range(6):
        c.step(FAR, on_failure="raise")
    np.testing.assert_allclose(c.u, problems.reference("crane").u, atol=1e-9)


def test_iteration_cap_of_the_qp() -> None:
    c = build(problems.CASES["crane"].make(), Options(qp=DenseActiveSet(max_iterations=1), algorithm=PURE), "test")
    x = c.x.copy()
    assert_safe(c, c.step(FAR))
    assert c.status == Status.ITERATION_LIMIT
    assert c.stats.qp_iterations == 1
    np.testing.assert_array_equal(c.x, x)
    assert_safe(c, c.step(np.zeros(4)))


@pytest.mark.few(5)
@pytest.mark.parametrize(("which", "fails"), [("x", True), ("u", True), ("lam", False), ("mu_u", False)])
@pytest.mark.parametrize("name", ["crane", "path_rows"])
def test_iterate_overwritten_with_nan(name: str, which: str, fails: bool) -> None:
    """States and controls: one NUMERICAL_FAILURE, then the plan restarts at the measured state. Gauss-Newton does
    not read these multipliers. solve() repairs the plan before it starts; reset() repairs all data."""
    fresh = build(problems.CASES[name].make(), Options(hessian=GaussNewton(), algorithm=PURE), "test")
    problems.apply(fresh, problems.CASES[name].data)
    fresh.reset()
    c = fresh.copy()
    for _ in range(2):
        c.step(problems.CASES[name].x0, on_failure="raise")
    x0 = problems.CASES[name].x0
    c.view(which)[...] = np.nan
    assert_safe(c, c.step(x0))
    assert c.status == (Status.NUMERICAL_FAILURE if fails else Status.OK)
    assert_safe(c, c.step(x0))
    assert c.status == Status.OK
    c.view(which)[...] = np.nan
    assert c.solve(x0).status == Status.OK
    c.reset()
    np.testing.assert_array_equal(c.step(x0), fresh.step(x0))
    assert c.status == Status.OK
    np.testing.assert_array_equal(c.lam, fresh.lam)


def away_from_zero() -> OCP:
    ocp = OCP("away", T=1.0, N=4)
    x, u, v = ocp.state("x"), ocp.control("u"), ocp.control("v")
    ocp.dynamics({x: u - v})
    ocp.least_squares(ca.vertcat(x, u, v), weight=[1.0, 1.0, 1.0])
    ocp.subject_to(0.4, u, 2)
    ocp.subject_to(-3, v, -1.5)
    return ocp


def test_safe_control_where_zero_is_none() -> None:
    """Not initialised: 0 clipped to the declared bounds; initialised: the plan clipped to the present bounds."""
    c = build(away_from_zero(), Options(algorithm=PURE), profile="test")
    c.view("magic")[...] = 0
    np.testing.assert_array_equal(c.feedback([0.0]), [0.4, -1.5])
    assert int(c.view("magic")) == 0
    c = build(away_from_zero(), Options(algorithm=PURE), profile="test")
    np.testing.assert_array_equal(c.feedback([0.0]), [0.4, -1.5])
    c.set_bounds("u", 0.7, 0.9)
    c.u[:] = np.nan
    np.testing.assert_array_equal(c.step([0.0]), [0.7, -1.5])
    assert c.status == Status.NUMERICAL_FAILURE
    c.reset()
    assert_safe(c, c.step([1e3]))
    assert c.status == Status.OK


# Data that change while it runs ---------------------------------------------------------------------------------------


def test_bounds_between_prepare_and_feedback() -> None:
    late, early = started("crane_weight"), started("crane_weight")
    late.prepare()
    late.set_bounds("a", -0.9, 0.9)
    early.set_bounds("a", -0.9, 0.9)
    early.prepare()
    u = late.feedback(FAR, on_failure="raise")
    assert abs(u[0]) <= 0.9
    assert np.abs(late.u).max() == 0.9
    np.testing.assert_allclose(u, early.feedback(FAR), atol=1e-11)
    np.testing.assert_allclose(late.x, early.x, atol=1e-11)


def test_bounds_of_states_between_prepare_and_feedback() -> None:
    late, early = started("state_bounds"), started("state_bounds")
    late.prepare()
    for c in (late, early):
        c.set_bounds("w", -0.5, 0.4)
    early.prepare()
    x0 = problems.CASES["state_bounds"].x0
    np.testing.assert_allclose(late.feedback(x0, "raise"), early.feedback(x0, "raise"), atol=1e-11)
    assert late.x[:, 1].min() == pytest.approx(-0.5, abs=1e-12)


@pytest.mark.parametrize("what", ["path", "terminal"])
@pytest.mark.parametrize("name", ["references", "dense_changed", "parameters"])
def test_references_between_prepare_and_feedback(name: str, what: str) -> None:
    """Equal to setting them before prepare, with an effect on the result."""
    late, early, without = started(name), started(name), started(name)
    x0 = problems.CASES[name].x0
    rng = np.random.default_rng(1)
    yref = rng.uniform(-0.5, 0.5, (late.dims.N, late.dims.ny))
    yref_N = rng.uniform(-0.5, 0.5, late.dims.ny_N)
    late.prepare()
    for c in (late, early):
        if what == "path":
            c.set_reference(yref)
        else:
            c.set_terminal_reference(yref_N)
    for c in (early, without):
        c.prepare()
    for c in (late, early, without):
        c.feedback(x0, on_failure="raise")
    np.testing.assert_allclose(late.u, early.u, rtol=0, atol=1e-12)
    np.testing.assert_allclose(late.lam, early.lam, rtol=0, atol=1e-11)
    assert np.abs(late.u - without.u).max() > 1e-3


@pytest.mark.parametrize("what", ["weight", "terminal weight", "parameter"])
def test_weights_and_parameters_take_effect_in_the_next_prepare(what: str) -> None:
    def change(c: Controller) -> None:
        if what == "weight":
            c.set_weight([1.0, 1.0, 2.0, 2.0, 0.4, 0.2])
        elif what == "terminal weight":
            c.set_terminal_weight([1.0, 5.0])
        else:
            c.set_parameter("k", 2.0)

    late, without, early = started("parameters"), started("parameters"), started("parameters")
    x0 = problems.CASES["parameters"].x0
    late.prepare()
    without.prepare()
    change(late)
    np.testing.assert_array_equal(late.feedback(x0), without.feedback(x0))
    early.step(x0)
    change(early)
    np.testing.assert_array_equal(late.step(x0), early.step(x0))
    assert np.abs(late.u - without.u).max() < np.inf
    without.step(x0)
    assert np.abs(late.u - without.u).max() > 1e-4


def test_refused_data_change_nothing() -> None:
    c, twin = started("parameters"), started("parameters")
    for call, match in (
        (lambda: c.set_parameter("k", np.nan), "k"),
        (lambda: c.set_parameter("g", [0.0, np.inf], node=2), "g"),
        (lambda: c.set_reference(np.full(6, np.nan)), "reference"),
        (lambda: c.set_weight(-np.ones(6)), "weight"),
        (lambda: c.set_bounds("a", 1.0, -1.0), r"'a\[0\]'.*lower.*above upper"),
        (lambda: c.set_bounds("a", np.nan, 1.0), "a"),
        (lambda: c.set_bounds("mix", 0.0, 1.0, node=3), "mix"),
    ):
        with pytest.raises(ControllerError, match=match):
            call()
    np.testing.assert_array_equal(c.step((1.0, -0.5, 0, 0)), twin.step((1.0, -0.5, 0, 0)))


# Closed loops ---------------------------------------------------------------------------------------------------------


def loop(c: Controller, x0: Any, steps: int, dt: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """States and controls of the loop with the package's own model as plant."""
    x, xs, us = np.asarray(x0, dtype=float), [], []
    for _ in range(steps):
        u = c.step(x, on_failure="raise")
        for planned in c.u:
            assert_safe(c, planned)
        x = np.asarray(c.integrate(x, u, dt), dtype=float)
        xs.append(x)
        us.append(u)
    return np.array(xs), np.array(us)


@pytest.mark.parametrize("name", ["crane", "crane_weight", "crane_looped"])
def test_crane_comes_to_rest(name: str) -> None:
    xs, us = loop(problems.controller(name), FAR, 50)
    assert np.abs(us).max() == 1.0
    assert np.abs(xs[-1]).max() < 1e-3
    assert np.abs(us[-1]).max() < 1e-3


@pytest.mark.parametrize("name", ["crane", "crane_weight"])
def test_real_time_iterates_approach_the_optimum(name: str) -> None:
    """Distance of the applied control from the optimal one for the same state: it decreases to rounding level."""
    c, x, distance = problems.controller(name), FAR, []
    for _ in range(40):
        u = c.step(x, on_failure="raise")
        optimal = c.copy().solve(x, tol=1e-10)
        assert optimal.status == Status.OK
        distance.append(abs(u[0] - optimal.u[0, 0]))
        x = np.asarray(c.integrate(x, u, 0.3))
    assert max(distance[:5]) > 1e-4
    assert max(distance[-5:]) < 1e-2 * max(distance[:10])
    assert max(distance[-5:]) < 1e-5


def test_profiles_agree() -> None:
    loops = [loop(problems.controller("crane", profile), FAR, 50) for profile in ("fast", "test", "verify")]
    for xs, us in loops[1:]:
        np.testing.assert_allclose(xs, loops[0][0], rtol=0, atol=1e-10)
        np.testing.assert_allclose(us, loops[0][1], rtol=0, atol=1e-9)


# Shifted plans --------------------------------------------------------------------------------------------------------


def later_rows(name: str) -> list[int]:
    """Position in the QP of the same row one node later, or of the row itself if there is no later one."""
    rows = problems.problem(name).qp_rows
    position = {(k, identity): m for m, (k, _, _, identity) in enumerate(rows)}
    return [position.get((k + 1, identity), m) for m, (k, _, _, identity) in enumerate(rows)]


@pytest.mark.parametrize("name", ["crane", "path_rows", "parameters"])
def test_shift_moves_the_plan(name: str) -> None:
    """x_k <- x_{k+1}, u_k <- u_{k+1}, the last control repeated and the tail integrated: bit for bit in NumPy."""
    c = problems.controller(name)
    x0 = problems.CASES[name].x0
    c.set_parameter("k", 1.3) if name == "parameters" else None
    c.solve(x0, tol=1e-8)
    before = {which: c.view(which).copy() for which in ("x", "u", "lam", "mu_u", "mult", "qp.side")}
    N, nu, dt = c.dims.N, c.dims.nu, problems.problem(name).dt[0]
    nodal = c.description.parameters and c.view("p").copy()
    c.shift()
    for which in ("x", "lam"):
        np.testing.assert_array_equal(c.view(which)[:N], before[which][1:])
    np.testing.assert_array_equal(c.lam[N], before["lam"][N])
    for which in ("u", "mu_u"):
        np.testing.assert_array_equal(c.view(which)[: N - 1], before[which][1:])
        np.testing.assert_array_equal(c.view(which)[N - 1], before[which][N - 1])
    np.testing.assert_array_equal(c.view("mult"), before["mult"][later_rows(name)])
    side, old = c.view("qp.side"), before["qp.side"]
    np.testing.assert_array_equal(side[: (N - 1) * nu], old[nu : N * nu])
    np.testing.assert_array_equal(side[(N - 1) * nu : N * nu], old[(N - 1) * nu : N * nu])
    np.testing.assert_array_equal(side[N * nu :], [old[N * nu + m] for m in later_rows(name)])
    assert old.any()
    if len(nodal):
        np.testing.assert_array_equal(c.view("p"), nodal)
        c.view("p")[0] = nodal[N - 1]
    np.testing.assert_array_equal(c.x[N], c.integrate(c.x[N - 1], c.u[N - 1], dt))


@pytest.mark.parametrize("name", ["crane", "path_rows"])
def test_step_shifts_from_the_second_sample_on(name: str) -> None:
    """shift="repeat" is shift() before every prepare() but the first; afterwards x is the plan just computed."""
    automatic, by_hand = shifting(name), problems.controller(name, "test")
    x = np.asarray(problems.CASES[name].x0, dtype=float)
    for n in range(6):
        if n > 0:
            by_hand.shift()
        u = automatic.step(x, on_failure="raise")
        np.testing.assert_array_equal(u, by_hand.step(x, on_failure="raise"))
        np.testing.assert_array_equal(automatic.x, by_hand.x)
        np.testing.assert_array_equal(automatic.u, by_hand.u)
        np.testing.assert_allclose(automatic.x[0], x, atol=1e-12)
        x = np.asarray(automatic.integrate(x, u, problems.problem(name).dt[0]))


def test_shift_helps() -> None:
    """A reference that moves with time: the shifted plan starts closer to the optimum of the next sample."""

    def distance(c: Controller) -> float:
        x, total = np.array([0.9, 0.0]), 0.0
        times = 0.25 * np.arange(8)
        for n in range(20):
            c.set_reference(np.column_stack([0.9 * np.cos(1.5 * (times + 0.25 * n)), np.zeros(8), np.zeros(8)]))
            u = c.step(x, on_failure="raise")
            total += float(np.abs(c.u - c.copy().solve(x, tol=1e-9).u).max()) if n > 2 else 0.0
            x = np.asarray(c.integrate(x, u, 0.25))
        return total

    assert distance(shifting("references")) < 0.5 * distance(problems.controller("references"))


def explosive() -> OCP:
    """x' = x^3 + u escapes to infinity within the horizon if the control is kept."""
    ocp = OCP("explosive", T=2.0, N=4)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: x**3 + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
    return ocp


@pytest.mark.filterwarnings("ignore:.*is not accurate")
def test_shift_of_a_tail_that_explodes() -> None:
    """The new end of the plan is finite whatever the model does there: the controller remains usable."""
    c = build(explosive(), Options(algorithm=PURE), profile="test")
    c.x[:] = 1e60
    c.u[:] = 0.0
    c.shift()
    assert np.isfinite(c.x).all()


def test_texts_of_the_statuses() -> None:
    """Every status has a readable sentence of its own."""
    texts = [s.meaning for s in Status]
    assert len(set(texts)) == len(texts)
    assert all(re.fullmatch(r"[a-z].{5,}", text) for text in texts)


def shifted(shift: str, **options: float) -> Controller:
    """A pendulum whose last state counts time, prepared with a plan that is not constant."""
    ocp = OCP("shifted", T=1.0, N=5)
    phi, omega, time = ocp.state("phi", initial=0.5), ocp.state("omega"), ocp.state("time")
    u = ocp.control("u")
    ocp.dynamics({phi: omega, omega: -9.81 * ca.sin(phi) + u, time: 1 + 0.1 * phi})
    ocp.least_squares(ca.vertcat(phi, omega, u), weight=[1.0, 0.1, 0.1])
    ocp.terminal_least_squares(phi, weight=1.0)
    ocp.subject_to(-2, u, 2)
    c = build(ocp, Options(algorithm=replace(PURE, shift=shift, **options)), "test")
    assert c.solve((0.5, 0.0, 0.0)).status == Status.OK
    return c


def test_shift_periodic() -> None:
    """u_{N-1} <- old u_0, and the states follow from x_1 by integration."""
    c = shifted("periodic")
    x, u = c.x.copy(), c.u.copy()
    c.shift()
    np.testing.assert_array_equal(c.u, np.vstack([u[1:], u[:1]]))
    np.testing.assert_array_equal(c.x[0], x[1])
    for k in range(5):
        np.testing.assert_allclose(c.x[k + 1], c.integrate(c.x[k], c.u[k], 0.2), atol=1e-14)


@pytest.mark.parametrize("sampling", [0.03, 0.2, 0.5, 1.7])
def test_shift_resample(sampling: float) -> None:
    """The old plan evaluated later: states integrated along it, controls averaged over the moved intervals."""
    c = shifted("resample", sampling_time=sampling)
    x, u, lam = c.x.copy(), c.u.copy(), c.lam.copy()
    c.shift()
    times = np.linspace(0, 1, 6)

    def state(t: float) -> np.ndarray:
        n = min(int(np.floor(t / 0.2 + 1e-9)), 4)
        return np.asarray(c.integrate(x[n], u[n], t - times[n]))

    def mean_control(a: float, b: float) -> float:
        grid = np.linspace(a, b, 20001)
        middle = (grid[1:] + grid[:-1]) / 2
        return float(np.mean(u[np.minimum((middle / 0.2).astype(int), 4), 0]))

    for k in range(6):
        np.testing.assert_allclose(c.x[k], state(times[k] + sampling), atol=1e-9)
        expected = [np.interp(times[k] + sampling, times, lam[:, i]) for i in range(3)]
        np.testing.assert_allclose(c.lam[k], expected, atol=1e-12)
    for k in range(5):
        np.testing.assert_allclose(c.u[k, 0], mean_control(times[k] + sampling, times[k + 1] + sampling), atol=1e-3)


def test_shift_resample_by_an_interval_is_repeat() -> None:
    resampled, repeated = shifted("resample", sampling_time=0.2), shifted("repeat")
    resampled.shift()
    repeated.shift()
    np.testing.assert_allclose(resampled.x, repeated.x, atol=1e-12)
    np.testing.assert_allclose(resampled.u, repeated.u, atol=1e-12)


def test_shift_resample_on_a_non_uniform_grid() -> None:
    """With the plan of an undisturbed plant, the resampled plan starts at the state of the plant."""
    ocp = OCP("grid", intervals=[0.1, 0.2, 0.4])
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -x + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
    c = build(ocp, Options(algorithm=replace(PURE, shift="resample", sampling_time=0.05)), "test")
    sol = c.solve((1.0,))
    plant = c.integrate(np.array([1.0]), sol.u[0], 0.05)
    c.shift()
    np.testing.assert_allclose(c.x[0], plant, atol=1e-12)
    assert sol.u[0, 0] != sol.u[1, 0]
    np.testing.assert_allclose(c.u[0], (sol.u[0] + sol.u[1]) / 2, atol=1e-12)


def test_accumulators_start_at_zero_at_every_sample() -> None:
    """A state that accumulates over the horizon, with a bound at the end; its measured value has no effect."""
    ocp = OCP("budget", T=1.0, N=5)
    x, spent = ocp.state("x", initial=1.0), ocp.state("spent")
    u = ocp.control("u")
    ocp.dynamics({x: u, spent: -u + 0.1 * ca.sin(x)})
    ocp.accumulator(spent)
    ocp.least_squares(ca.vertcat(x, u), weight=[10.0, 0.01])
    ocp.subject_to(-np.inf, spent, 0.5, at="end")
    problem = classify(ocp)
    reference = solve_reference(problem, x0=[1.0, 0.0])
    assert reference.x[-1, 1] == pytest.approx(0.5)
    for noise in (0.0, 7.0, np.nan):
        c = build(ocp, profile="test")
        solution = c.solve((1.0, noise), tol=1e-9)
        assert solution.status == Status.OK
        np.testing.assert_allclose(solution.u, reference.u, atol=1e-6)
        assert c.step((1.0, noise)) == pytest.approx(solution.u[0], abs=1e-6)
        assert c.x[0, 1] == 0.0
    assert c.solve((np.nan, 0.0)).status == Status.NOT_FINITE
