"""AdjointShooting: solutions of IPOPT, gradients of CasADi, and closed loops."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import crane, cstr
from nmpc_codegen import (
    OCP,
    RK4,
    AdjointShooting,
    ExplicitRungeKutta,
    Online,
    Options,
    Status,
    build,
    simulate,
)
from nmpc_codegen.compiler import model_of
from nmpc_codegen.components.algorithms import adjoint_shooting
from nmpc_codegen.components.integrators.explicit.directional import Directional
from nmpc_codegen.components.integrators.explicit.quadrature import Quadrature
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.sweep import Call, Slice, unroll
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, ReferenceSolution, interval_map, node_data
from verification import problems, samples
from verification.routes import shooting as options

TWO_STEPS = ExplicitRungeKutta(RK4, steps=2)
METHODS = ("gauss_newton", "quasi_newton")
X0 = np.array([2.0, 0.0, 0.0, 0.0])


def disturbed(ocp: OCP) -> np.ndarray:
    """A state near the declared one."""
    x = np.array(classify(ocp).x_initial, dtype=float)
    return x + 0.05 * np.where(x != 0, np.abs(x), 0.1) * np.random.default_rng(2).uniform(-1, 1, x.size)


def ipopt(ocp: OCP, x0: np.ndarray, steps: int = 2) -> ReferenceSolution:
    problem = classify(ocp)
    found = Reference(problem, replace(CLASSICAL, steps=steps)).solve(node_data(problem, x0=x0))
    assert found.success
    return found


# Derivatives ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tableau", [RK4, samples.LOOPED.tableau], ids=["rk4", "looped"])
@pytest.mark.parametrize("steps", [1, 3])
def test_the_sweeps_multiply_with_the_jacobian_of_the_interval(steps: int, tableau: Any) -> None:
    """[A B] d and [A B]' w are those of CasADi's Jacobian of an interval that was written independently."""
    problem = classify(cstr.build_ocp())
    sweeps = Directional(problem, tableau, steps)
    forward, adjoint = unroll(sweeps.forward()), unroll(sweeps.adjoint())
    x, u, p, dt = ca.MX.sym("x", 4), ca.MX.sym("u", 2), ca.MX.sym("p", 0), problem.dt[0]
    phi = interval_map(problem, replace(CLASSICAL, steps=steps))(x, u, p, dt)[0]
    J = np.asarray(ca.Function("J", [x, u], [ca.jacobian(phi, ca.vertcat(x, u))])(cstr.START, [14.0, -1000.0]))
    random = np.random.default_rng(steps)
    d, w = random.uniform(-1, 1, 6), random.uniform(-1, 1, 4)
    at = (cstr.START, [14.0, -1000.0], [], dt)
    np.testing.assert_allclose(np.asarray(forward(*at, d[:4], d[4:])).ravel(), J @ d, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(np.asarray(adjoint(*at, w)).ravel(), J.T @ w, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("method", METHODS)
def test_the_stationarity_is_the_gradient_of_casadi(method: str) -> None:
    """Without rows: max |dJ/du| of the simulated cost, from CasADi, at controls between the bounds."""
    ocp = cstr.build_ocp(state_bounds=False)
    problem, controller = classify(ocp), build(ocp, replace(options(method=method), integrator=TWO_STEPS), "test")
    u = ca.MX.sym("u", problem.N, 2)
    x, cost, r = ca.MX(cstr.START), ca.MX(0), cstr.SET_POINTS[0]
    step = interval_map(problem, CLASSICAL)
    Q, R = np.diag([0.2, 1.0, 0.5, 0.2]), np.diag([0.5, 5e-7])
    states = [x]
    for k in range(problem.N):
        e, v = x - r[:4], u[k, :].T - r[4:]
        cost += (e.T @ Q @ e + v.T @ R @ v) / 2
        x = step(x, u[k, :].T, ca.MX(0, 1), problem.dt[k])[0]
        states.append(x)
    cost += 5 * (x - r[:4]).T @ Q @ (x - r[:4])
    evaluate = ca.Function("gradient", [u], [ca.gradient(cost, u), ca.horzcat(*states).T])
    U = np.random.default_rng(1).uniform([5.0, -2000.0], [30.0, -500.0], (problem.N, 2))
    gradient, trajectory = (np.asarray(v) for v in evaluate(U))
    controller.u, controller.x = U, trajectory
    kkt = controller.kkt()
    assert kkt.stationarity == pytest.approx(np.abs(gradient).max(), rel=1e-11)
    assert kkt.equality <= 1e-11
    assert kkt.inequality == 0


# solve() against IPOPT ------------------------------------------------------------------------------------------------


def test_crane_with_terminal_equalities() -> None:
    """Six of ten controls are at their bounds; the multipliers are those of IPOPT."""
    ocp = crane.build_ocp()
    controller = build(ocp, options(), "test")
    solution, found = controller.solve(X0, tol=1e-9), ipopt(ocp, X0)
    assert solution.status is Status.OK
    assert solution.iterations <= 6
    np.testing.assert_allclose(solution.u, found.u, atol=1e-8)
    np.testing.assert_allclose(controller.view("row"), found.mu_x[-1], rtol=1e-5)
    assert controller.stats.cg_iterations <= 40


def test_the_multiplier_of_the_lumped_row_grows() -> None:
    """With a weight that no multiplier respects, the l1 penalty is not exact, but the lumped row is found to hold."""
    ocp = samples.final()
    x0 = disturbed(ocp)
    errors = {}
    for rows in ("smooth_l1", "lumped"):
        controller = build(ocp, options(rows=rows, penalty=1e-3), "test")
        solution = controller.solve(x0, tol=1e-7, max_iterations=1000)
        errors[rows] = np.abs(solution.u - ipopt(ocp, x0).u).max()
        assert (solution.status is Status.OK) == (rows == "lumped")
    assert errors["lumped"] <= 1e-5
    assert errors["smooth_l1"] > 1e-2


def test_a_sample_with_barriers_minimises_their_sum_with_the_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """min cost + sum_k -w log(0.7 - x_k) - w log(x_k + 0.7) - tilt x_k by IPOPT; the tilt makes the slope of the
    barriers vanish where the plan before the sample ended."""
    monkeypatch.setattr(adjoint_shooting, "FOLLOWED_TRIALS", 30)
    ocp = samples.controls()
    ocp.subject_to(-0.7, ocp.x[1], 0.7)
    problem, x0, weight = classify(ocp), np.array([0.5, 0.6]), 1e-3
    controller = build(ocp, options(rows="barrier", penalty=weight, iterations=30), "test")
    controller.step(x0)
    step, u = interval_map(problem, CLASSICAL), ca.MX.sym("u", problem.N)

    def rollout(u: Any) -> list[Any]:
        x = [ca.MX(x0)]
        for k in range(problem.N):
            x.append(step(x[-1], u[k], ca.MX(0, 1), problem.dt[k])[0])
        return x

    end = float(ca.evalf(rollout(ca.MX.zeros(problem.N))[-1][1]))
    tilt = weight * (1 / (0.7 - end) - 1 / (end + 0.7))
    np.testing.assert_allclose(controller.view("shooting.tilt"), tilt, rtol=1e-9)
    x = rollout(u)
    cost = sum(2 * x[k][0] ** 2 + 0.1 * x[k][1] ** 2 + 0.1 * u[k] ** 2 for k in range(problem.N)) / 2
    for node in x[1:]:
        cost -= weight * (ca.log(0.7 - node[1]) + ca.log(node[1] + 0.7)) + tilt * node[1]
    quiet = {"print_time": 0, "ipopt.print_level": 0, "ipopt.tol": 1e-12, "ipopt.bound_relax_factor": 0.0}
    exact = ca.nlpsol("exact", "ipopt", {"x": u, "f": cost}, quiet)(x0=0, lbx=-1, ubx=1)["x"]
    np.testing.assert_allclose(controller.u, np.asarray(exact), atol=1e-6)


def test_barriers_do_not_displace_the_rest() -> None:
    """The set point lies close to a bound: recentred barriers have no slope there."""
    ocp = samples.controls()
    ocp.subject_to(-0.02, ocp.x[0], 10.0)
    controller = build(ocp, options(rows="barrier", penalty=0.1, shift="repeat"), "test")
    log = simulate(controller, [0.5, 0.0], steps=200)
    assert np.abs(log.x[-1]).max() <= 1e-4
    assert log.x[:, 0].min() >= -0.02


@pytest.mark.parametrize("tolerance", [1e-6, 10.0])
def test_a_plan_that_violates_a_hard_row_is_not_converged(tolerance: float) -> None:
    ocp = samples.controls()
    ocp.subject_to(-0.02, ocp.x[0], 10.0, name="wall")
    controller = build(ocp, options(penalty=0.01, tolerance=tolerance), "test")
    controller.step([0.0, -1.0])
    assert 1e-6 < controller.stats.violation == controller.stats.residual < 10.0
    assert controller.status is (Status.OK if tolerance > 1 else Status.NOT_CONVERGED)


@pytest.mark.parametrize("rows", ["augmented_lagrangian", "smooth_l1"])
@pytest.mark.parametrize("penalty", [(0.05, 0.0), (0.05, 0.2), (50.0, 0.0)])
def test_soft_rows_that_are_violated(penalty: tuple[float, float], rows: str) -> None:
    """Multipliers at the weight of the row, beyond it with a quadratic penalty, and below it (an exact penalty)."""
    ocp = samples.controls()
    ocp.subject_to(-0.3, ocp.x[1], 0.3, soft=penalty)
    x0 = np.array([0.5, 0.6])
    controller = build(ocp, options(rows=rows), "test")
    solution, found = controller.solve(x0, tol=1e-8, max_iterations=1000), ipopt(ocp, x0)
    assert solution.status is Status.OK
    np.testing.assert_allclose(solution.u, found.u, atol=3e-6)
    largest = np.abs(controller.view("row")).max()
    if penalty[0] == 50.0:
        assert 0.05 < largest < 50.0
    elif penalty[1]:
        assert largest > penalty[0] * (1 + 1e-3)
    else:
        assert largest == pytest.approx(penalty[0], rel=1e-6)


@pytest.mark.parametrize("tableau", [RK4, samples.LOOPED.tableau], ids=["rk4", "looped"])
@pytest.mark.parametrize("steps", [1, 3])
def test_the_product_of_an_integrated_cost_is_that_of_gauss_newton(steps: int, tableau: Any) -> None:
    """sum_i h b_i V_i' rate_zz V_i d, V_i = d (X_i, u) / d (x, u), from CasADi's Jacobians of the stage points."""
    ocp = samples.economic()
    ocp.stage_cost(ca.exp(ocp.x[0]) + ca.sin(ocp.x[1] * ocp.u[0]) + ocp.x[0] ** 2 * ocp.u[0], integrate=True)
    problem = classify(ocp)
    nx, nu, dt = problem.nx, problem.nu, problem.dt[0]
    x, u, p, h = ca.MX.sym("x", nx), ca.MX.sym("u", nu), ca.MX.sym("p", problem.np), dt / steps
    z, at = ca.vertcat(x, u), problem.path
    bend = ca.Function("bend", [at.x, at.u, at.p], [ca.hessian(at.cost_rate, ca.vertcat(at.x, at.u))[0]])
    H, X = ca.MX(nx + nu, nx + nu), x
    for _ in range(steps):
        K: list[ca.MX] = []
        for row, weight in zip(tableau.a, tableau.b, strict=True):
            point = sum((h * float(a) * k for a, k in zip(row, K, strict=False)), X)
            V = ca.jacobian(ca.vertcat(point, u), z)
            H += h * float(weight) * V.T @ bend(point, u, p) @ V
            K.append(problem.dynamics(point, u, p))
        X = sum((h * float(b) * k for b, k in zip(tableau.b, K, strict=True)), X)
    random = np.random.default_rng(steps)
    here = random.uniform(-1, 1, nx), random.uniform(-1, 1, nu), problem.p_value
    d = random.uniform(-1, 1, nx + nu)
    clear = Call(ca.Function("clear", [], [ca.SX.zeros(nx + nu)]), (), (Slice("w", nx + nu),))
    sweep = Quadrature(problem, tableau, steps).product("product", "", clear, (Port("d", nx + nu),))
    found = np.asarray(unroll(sweep)(*here, dt, d)).ravel()
    np.testing.assert_allclose(found, np.asarray(ca.Function("H", [x, u, p], [H])(*here)) @ d, rtol=1e-12, atol=1e-13)


def test_negative_curvature_is_met_and_survived() -> None:
    """The cost is concave in x, and at the start all first derivatives are small."""
    controller = build(problems.saddle(), options(), "test")
    solution = controller.solve([0.1], tol=1e-8, max_iterations=300)
    assert solution.status is Status.OK
    assert controller.stats.negative_curvature > 0
    assert controller.x[-1, 0] > 1  # a minimum, not the saddle x = 0


# Samples --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("method", METHODS)
def test_the_crane_comes_to_rest(precision: Any, method: str) -> None:
    given = options(precision=precision, solve=False, shift="repeat", method=method)
    controller = build(crane.build_ocp(), given, "test")
    log = simulate(controller, X0, steps=40, dt=0.3)
    assert np.abs(log.x[-1]).max() < 5e-3
    assert np.abs(log.u).max() <= 1
    first = 1 if method == "quasi_newton" else 0  # whose ten steps from no plan leave x_N more than a tenth off
    assert not np.any(log.status[first:])
    assert set(log.status[:first]) <= {Status.NOT_CONVERGED}


@pytest.mark.few(4)
@pytest.mark.parametrize("p", [1.0, 1.8, 1.825, 1.85, 1.9, 1.95, 2.0])
def test_single_precision_meets_the_rows_that_double_precision_meets(p: float) -> None:
    """Near the largest distance from which the crane can stop, controls are at their bounds and the rows nearly
    dependent on the others: what the compliance of the rows leaves of them is no contradiction with the bounds."""
    controller = build(crane.build_ocp(), options(precision="single", shift="repeat"), "test")
    plant = build(crane.build_ocp(), options(shift="repeat"), "test")
    log = simulate(controller, [p, 0.0, 0.0, 0.0], steps=12, dt=0.3, plant=lambda x, u, dt: plant.integrate(x, u, dt))
    assert not np.any(log.status)
    solution = controller.solve([p, 0.0, 0.0, 0.0], tol=1e-4, max_iterations=20)
    assert solution.status is Status.OK
    np.testing.assert_allclose(solution.u, ipopt(crane.build_ocp(), np.array([p, 0.0, 0.0, 0.0])).u, atol=2e-3)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_an_infeasible_sample_leaves_no_trace(precision: Any) -> None:
    """The multipliers of rows that contradict one another are forgotten: the next feasible sample is solved."""
    controller = build(crane.build_ocp(), options(precision=precision), "test")
    controller.step([1.9, 0.2, 0.1, 0.2])
    assert controller.status is Status.INFEASIBLE
    assert controller.step([1.0, 0.0, 0.0, 0.0]).shape == (1,)
    assert controller.status is Status.OK


def test_the_plan_moves_by_default() -> None:
    """As that of other algorithms: by an interval, periodically where rows close the plan, or to a sampling time."""
    for make, sampling_time, expected in (
        (crane.build_ocp, None, "repeat"),
        (samples.closing, None, "periodic"),
        (cstr.build_ocp, 5.0, "resample"),
    ):
        model = model_of(classify(make()), Options(algorithm=AdjointShooting(sampling_time=sampling_time)))
        assert model.parts.algorithm.shift == expected
        assert any(f"shift: {expected}" in choice for choice in model.choices.reasons)


def test_the_work_of_a_sample_is_bounded() -> None:
    controller = build(crane.build_ocp(), options(shift="repeat", repair=0), "test")
    random = np.random.default_rng(3)
    for _ in range(30):
        controller.step(random.uniform(-3, 3, 4))
        assert 1 < controller.stats.simulations <= 4
        assert 0 < controller.stats.cg_iterations <= 12


def test_the_memory_of_the_crane() -> None:
    """What a microcontroller needs: the struct without solve() and with shared references."""
    bytes_of = {}
    for precision in ("double", "single"):
        given = options(Online(reference="shared"), precision=precision, solve=False, shift="repeat")
        bytes_of[precision] = build(crane.build_ocp(), given, "test").nbytes
    assert bytes_of["double"] <= 2048
    assert bytes_of["single"] <= 1040


def test_memory_grows_with_N_times_nx_plus_nu() -> None:
    def size(N: int) -> int:
        ocp = OCP("chain", T=0.1 * N, N=N)
        x, u = ocp.state("x", size=6), ocp.control("u", size=2)
        ocp.dynamics({x: ca.vertcat(x[1:], u[0] + u[1] * x[0])})
        ocp.least_squares(ca.vertcat(x, u), weight=np.eye(8))
        return build(ocp, options(Online(reference="shared"), solve=False), "test").nbytes

    per_interval = (size(40) - size(20)) / 20
    assert per_interval == (size(20) - size(10)) / 10
    assert per_interval <= 8 * (2 * 6 + 6 * 2)


def test_periodic_and_resampled_shifts() -> None:
    periodic = build(samples.closing(), options(shift="periodic"), "test")
    periodic.solve([0.5, 0.1])
    planned = periodic.u.copy()
    periodic.shift()
    np.testing.assert_array_equal(periodic.u, np.roll(planned, -1, axis=0))
    moved = build(samples.controls(), options(shift="resample", sampling_time=0.05), "test")
    x0 = disturbed(samples.controls())
    moved.solve(x0)
    before, u = moved.u.copy(), moved.u[0].copy()
    moved.shift()
    np.testing.assert_allclose(moved.x[0], moved.integrate(x0, u, 0.05), atol=1e-10)
    assert np.all(moved.u <= before.max() + 1e-12)
    assert np.all(moved.u >= before.min() - 1e-12)


def test_bounds_that_change_open_and_close_a_terminal_row() -> None:
    """A terminal equation becomes an inequality at run time, is inactive, and becomes an equation again."""
    ocp = samples.ends()
    controller, x0 = build(ocp, options(), "test"), disturbed(ocp)
    closed = controller.solve(x0, tol=1e-9).u.copy()
    controller.set_bounds("q_end", -10.0, 10.0)
    solution = controller.solve(x0, tol=1e-9)
    assert solution.status is Status.OK
    assert abs(controller.x[-1, 0] - 0.1) > 1e-3
    controller.set_bounds("q_end", 0.1, 0.1)
    np.testing.assert_allclose(controller.solve(x0, tol=1e-9).u, closed, atol=1e-6)
