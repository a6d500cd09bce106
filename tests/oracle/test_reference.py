"""The oracle against closed forms, published figures, and independent computations."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.reference import (
    CLASSICAL,
    Data,
    Point,
    Reference,
    Tableau,
    evaluate_cost,
    interval_map,
    kkt_residuals,
    node_data,
    solve_reference,
)

EULER = Tableau(((0.0,),), (1.0,))
HEUN = Tableau(((0.0, 0.0), (1.0, 0.0)), (0.5, 0.5))
EXAMPLES = Path(__file__).parents[2] / "examples"


def crane(terminal_constraint: bool = True) -> Problem:
    spec = importlib.util.spec_from_file_location("crane_example", EXAMPLES / "crane.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return classify(module.build_ocp(terminal_constraint))


# Published and measured figures --------------------------------------------------------------------------------------


def test_crane_has_six_controls_at_their_bounds() -> None:
    problem = crane()
    solution = solve_reference(problem, x0=[2, 0, 0, 0])
    assert solution.success
    assert solution.residuals.worst < 1e-10
    at_bounds = np.abs(np.abs(solution.u[:, 0]) - 1) < 1e-8
    assert at_bounds.sum() == 6
    np.testing.assert_array_equal(np.abs(solution.mu_u[:, 0]) > 1e-6, at_bounds)  # strict complementarity
    np.testing.assert_array_equal(np.sign(solution.mu_u[at_bounds]), np.sign(solution.u[at_bounds]))
    np.testing.assert_allclose(solution.x[-1], 0, atol=1e-12)


@pytest.mark.parametrize("x0", [(1, 0, 0.5, 0), (0, 0, 1, 0)])
def test_crane_is_infeasible_from_a_large_swing(x0: tuple[float, ...]) -> None:
    solution = solve_reference(crane(), x0=x0)
    assert not solution.success
    assert max(solution.residuals.equality, solution.residuals.inequality) > 1e-4


def test_crane_without_terminal_constraint() -> None:
    solution = solve_reference(crane(terminal_constraint=False), x0=[1, 0, 0.5, 0])
    assert solution.success
    assert solution.residuals.worst < 1e-10


def cart_pole() -> Problem:
    M, m, length, g = 1.0, 0.1, 0.8, 9.81
    ocp = OCP("cart_pole", T=1.0, N=20)
    p, th = ocp.state("p"), ocp.state("th", initial=np.pi)
    v, w = ocp.state("v"), ocp.state("w")
    F = ocp.control("F")
    s, c = ca.sin(th), ca.cos(th)
    D = M + m - m * c**2
    ocp.dynamics(
        {
            p: v,
            th: w,
            v: (-m * length * s * w**2 + m * g * c * s + F) / D,
            w: (-m * length * c * s * w**2 + F * c + (M + m) * g * s) / (length * D),
        }
    )
    ocp.least_squares(ca.vertcat(ocp.x, F), [1e3, 1e3, 0.01, 0.01, 0.01])
    ocp.terminal_least_squares(ocp.x, [1e3, 1e3, 0.01, 0.01])
    ocp.subject_to(-80, F, 80)
    return classify(ocp)


def test_cart_pole_swing_up() -> None:
    solution = solve_reference(cart_pole())
    assert solution.success
    assert solution.cost == pytest.approx(22417.4595, abs=6e-5)


def cstr() -> Problem:
    """Klatt and Engell's reactor with set point 1."""
    ocp = OCP("cstr", T=1500.0, N=10)
    cA, cB = ocp.state("cA", initial=1.0), ocp.state("cB", initial=0.5)
    th, thK = ocp.state("th", initial=100.0), ocp.state("thK", initial=100.0)
    u1, u2 = ocp.control("u1"), ocp.control("u2")
    k1, k2 = (1.287e12 * ca.exp(-9758.3 / (273.15 + th)) for _ in range(2))
    k3 = 9.043e9 * ca.exp(-8560 / (273.15 + th))
    rho_cp, exchange = 0.9342 * 3.01, 4032 * 0.215
    heat = k1 * cA * 4.2 - k2 * cB * 11 - k3 * cA**2 * 41.85
    per_hour = ca.vertcat(
        u1 * (5.1 - cA) - k1 * cA - k3 * cA**2,
        -u1 * cB + k1 * cA - k2 * cB,
        u1 * (104.9 - th) + exchange / (rho_cp * 10) * (thK - th) - heat / rho_cp,
        (u2 + exchange * (th - thK)) / (5 * 2),
    )
    ocp.dynamics(per_hour / 3600)
    Q = np.array([0.2, 1.0, 0.5, 0.2])
    ocp.least_squares(ca.vertcat(ocp.x, ocp.u), [*Q, 0.5, 5e-7], reference=[*STEADY_X, *STEADY_U])
    ocp.terminal_least_squares(ocp.x, 10 * Q, reference=STEADY_X)
    ocp.subject_to([3, -9000], ocp.u, [35, 0])
    ocp.subject_to([98, 92], ca.vertcat(th, thK), np.inf)
    return classify(ocp)


STEADY_X = (2.1402105, 1.0903044, 114.1910844, 112.9065929)
STEADY_U = (14.19, -1113.5)


def test_cstr_steady_state_and_transition() -> None:
    problem = cstr()
    reference = Reference(problem)
    at_rest = reference.solve(node_data(problem, x0=STEADY_X))
    assert at_rest.success
    np.testing.assert_allclose(at_rest.x, np.tile(STEADY_X, (11, 1)), rtol=1e-6)
    np.testing.assert_allclose(at_rest.u, np.tile(STEADY_U, (10, 1)), rtol=1e-6)
    assert at_rest.cost < 1e-12
    moving = reference.solve(node_data(problem))
    assert moving.success
    assert np.abs(moving.mu_x).max() < 1e-6  # state bounds inactive
    # The state bounds become active and make set point 2 unreachable.
    x2, u2 = (3.51744722, 0.74003328, 87.00164887, 79.8045743), (8.256, -6239)
    second = reference.solve(node_data(problem, yref=[*x2, *u2], yref_N=x2))
    assert second.success
    assert second.mu_x.min() < -1e-3
    assert second.x[1:, 2].min() >= 98 - 1e-10


def bioreactor(equality: bool) -> Problem:
    """Periodic production, Quirynen et al.: free orbit, averages as states, integrated cost, coupled rows."""
    D, horizon = 0.15, 48.0
    ocp = OCP("bioreactor", T=horizon, N=20)
    X, S, P = ocp.state("X", initial=5.8), ocp.state("S", initial=18), ocp.state("P", initial=20.5)
    feed_average, X_average = ocp.state("feed_average"), ocp.state("X_average")
    u = ocp.control("u")
    mu = 0.48 * (1 - P / 50) * S / (1.2 + S + S**2 / 22)
    balances = [-D * X + mu * X, D * (u - S) - mu * X / 0.4, -D * P + (2.2 * mu + 0.2) * X]
    ocp.dynamics([*balances, u / horizon, X / horizon])
    ocp.stage_cost(-D * P / horizon, integrate=True)
    ocp.subject_to(28.7, u, 40)
    ocp.subject_to(32.9 if equality else -np.inf, feed_average, 32.9, at="end")
    ocp.subject_to(-np.inf, X_average, 5.8, at="end")
    orbit = ca.vertcat(X, S, P)
    ocp.boundary(0, ocp.at_start(orbit) - ocp.at_end(orbit), 0)
    ocp.free_initial(X, S, P)
    return classify(ocp)


def test_bioreactor_orbits() -> None:
    """Reading (b): 3.05485 g/(L h). Reading (a): D P_avg = (2.2 D + 0.2) X_avg exactly, here at X_avg = 5.8."""
    scheme = replace(CLASSICAL, steps=3)
    feed = np.where(np.arange(20) % 20 < 7, 40.0, 28.7)
    for equality, productivity in ((True, 3.05485), (False, (2.2 * 0.15 + 0.2) * 5.8)):
        problem = bioreactor(equality)
        Phi = interval_map(problem, scheme)
        x = [problem.x_initial]
        for k in range(20):
            x.append(np.asarray(Phi(x[-1], feed[k], [], 2.4)[0]).ravel())
        solution = solve_reference(problem, scheme, x_guess=x, u_guess=feed[:, None], x0=[*x[-1][:3], 0, 0], tol=1e-10)
        assert solution.success
        assert -solution.cost == pytest.approx(productivity, abs=1e-5)
        assert solution.residuals.worst < 1e-7


# Closed forms --------------------------------------------------------------------------------------------------------


def integrator_map(N: int = 1) -> OCP:
    """x+ = x + u with cost 1/2 u^2."""
    ocp = OCP("sum", N=N)
    x, u = ocp.state("x", initial=3.0), ocp.control("u")
    ocp.dynamics({x: x + u}, discrete=True)
    ocp.least_squares(u, 1)
    return ocp


def test_linear_quadratic_regulator() -> None:
    """x_{k+1} = A x + B u: u_k = -K_k x_k and lam_k = P_k x_k from the Riccati recursion in NumPy."""
    A, B, Q, R, N = np.array([[1, 0.1], [-0.2, 0.9]]), np.array([[0.0], [0.3]]), np.diag([2.0, 1.0]), np.eye(1), 8
    ocp = OCP("lqr", N=N)
    x, u = ocp.state("x", size=2, initial=[1, -2]), ocp.control("u")
    ocp.dynamics({"x": A @ x + B @ u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), [2, 1, 1])
    ocp.terminal_least_squares(x, 3)
    solution = solve_reference(classify(ocp))
    P, gains = 3 * np.eye(2), []
    cost_to_go = [P]
    for _ in range(N):
        K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        P = Q + A.T @ P @ (A - B @ K)
        gains.insert(0, K)
        cost_to_go.insert(0, P)
    state = np.array([1.0, -2.0])
    assert solution.cost == pytest.approx(state @ cost_to_go[0] @ state / 2, rel=1e-12)
    for k in range(N):
        np.testing.assert_allclose(solution.x[k], state, atol=1e-11)
        np.testing.assert_allclose(solution.lam[k], cost_to_go[k] @ state, atol=1e-10)
        state = (A - B @ gains[k]) @ state


@pytest.mark.parametrize(("l1", "l2"), [(0.5, 1.0), (0.5, 0.0), (0.0, 4.0), (5.0, 1.0)])
@pytest.mark.parametrize("kind", ["state", "general", "coupled"])
def test_soft_row(l1: float, l2: float, kind: str) -> None:
    """min 1/2 u^2 + l1 s + l2/2 s^2, 3 + u <= s: s = max(0, 3 - l1)/(1 + l2), u = s - 3, multiplier 3 - s."""
    ocp = integrator_map()
    x = ocp.x
    if kind == "coupled":
        ocp.boundary(-np.inf, ocp.at_end(x), 0, soft=(l1, l2))
    elif kind == "general":
        ocp.subject_to(0, -x, np.inf, soft=(l1, l2))
    else:
        ocp.subject_to(-np.inf, x, 0, soft=(l1, l2))
    problem = classify(ocp)
    solution = solve_reference(problem)
    s = max(0.0, 3 - l1) / (1 + l2)
    assert solution.success
    assert solution.u[0, 0] == pytest.approx(s - 3, abs=1e-9)
    assert solution.cost == pytest.approx((3 - s) ** 2 / 2 + l1 * s + l2 / 2 * s**2, abs=1e-9)
    assert evaluate_cost(problem, solution.x, solution.u, node_data(problem)) == pytest.approx(solution.cost, abs=1e-9)
    multiplier = {"state": solution.mu_x[1], "general": -solution.mu_N, "coupled": solution.eta}[kind]
    assert multiplier[0] == pytest.approx(3 - s, abs=1e-8)
    assert solution.residuals.worst < 1e-8


def test_soft_equality_is_soft_on_both_sides() -> None:
    for target, sign in ((0.0, -1), (6.0, 1)):
        ocp = integrator_map()
        ocp.subject_to(target, ocp.x, target, at="end", soft=(1, 1))
        solution = solve_reference(classify(ocp))
        assert solution.u[0, 0] == pytest.approx(sign * 2.0, abs=1e-9)  # s = (3 - 1)/(1 + 1) = 1
        assert solution.mu_x[1, 0] == pytest.approx(-sign * 2.0, abs=1e-9)


@pytest.mark.parametrize("upper", [True, False])
def test_signs_of_multipliers(upper: bool) -> None:
    """min 1/2 (u - 5 s)^2, s = +-1, |u| <= 1: multiplier 4 s, positive at the upper bound; the general row likewise."""
    s = 1 if upper else -1
    for general in (False, True):
        ocp = OCP("signs", N=2)
        x, u = ocp.state("x"), ocp.control("u")
        ocp.dynamics({x: u}, discrete=True)
        ocp.least_squares(u, 1, reference=5 * s)
        ocp.subject_to(-2, 2 * u, 2) if general else ocp.subject_to(-1, u, 1)
        solution = solve_reference(classify(ocp))
        np.testing.assert_allclose(solution.mu if general else solution.mu_u, (2 if general else 4) * s, atol=1e-8)


def test_terminal_equality_and_dynamics_multipliers() -> None:
    """x_N = 0 from 3 in N = 3 steps: u = -1; u_k + lam_{k+1} = 0, and -lam_N + mu_x = 0 at the end."""
    N = 3
    ocp = integrator_map(N)
    ocp.subject_to(0, ocp.x, 0, at="end")
    solution = solve_reference(classify(ocp))
    np.testing.assert_allclose(solution.u, -1.0, atol=1e-10)
    np.testing.assert_allclose(solution.lam, 1.0, atol=1e-9)
    np.testing.assert_allclose(solution.mu_x[:, 0], [0, 0, 0, 1.0], atol=1e-9)


def test_free_initial_state_and_coupled_row() -> None:
    """min 1/2 (x_0 - 1)^2 + 1/2 u^2 with x_1 = x_0 + u, x_0 + x_1 = 0: x_0 = 1/5, u = -2/5, eta = 2/5."""
    ocp = integrator_map()
    x = ocp.x
    ocp.least_squares(x, 1, reference=1)
    ocp.boundary(0, ocp.at_start(x) + ocp.at_end(x), 0)
    ocp.free_initial(x)
    solution = solve_reference(classify(ocp))
    assert solution.x[0, 0] == pytest.approx(0.2, abs=1e-10)
    assert solution.u[0, 0] == pytest.approx(-0.4, abs=1e-10)
    assert solution.eta[0] == pytest.approx(0.4, abs=1e-10)
    assert solution.lam[0, 0] == 0


def test_accumulators_start_at_zero() -> None:
    ocp = integrator_map()
    ocp.accumulator("x")
    problem = classify(ocp)
    np.testing.assert_array_equal(node_data(problem, x0=[7.0]).x0, [0.0])


def test_cost_terms_and_their_scaling() -> None:
    """Every kind of term on a known trajectory, nonuniform grid: numbers computed by hand."""
    dt = (0.5, 2.0)
    ocp = OCP("costs", intervals=dt)
    x, u, q = ocp.state("x"), ocp.control("u"), ocp.parameter("q", value=3.0)
    ocp.dynamics({x: 0 * x})
    ocp.least_squares(x, 2, reference=1)
    ocp.least_squares(ca.vertcat(x, u), [[2, 1], [1, 2]], scale_with_dt=True)
    ocp.stage_cost(q * u)
    ocp.stage_cost(x, scale_with_dt=False)
    ocp.stage_cost(u**2, integrate=True)
    ocp.terminal_cost(q * x)
    ocp.terminal_least_squares(x, 4)
    problem = classify(ocp)
    X, U = np.array([[1.0], [2.0], [3.0]]), np.array([[5.0], [7.0]])
    expected = 3.0 * 3 + 4 * 9 / 2
    for k in range(2):
        xk, uk = X[k, 0], U[k, 0]
        expected += 2 * (xk - 1) ** 2 / 2 + dt[k] * (2 * xk**2 + 2 * xk * uk + 2 * uk**2) / 2
        expected += dt[k] * 3 * uk + xk + dt[k] * uk**2
    assert evaluate_cost(problem, X, U, node_data(problem)) == pytest.approx(expected, rel=1e-14)


def test_data_of_every_node() -> None:
    """References, weights, parameters and bounds per node: min 1/2 W_k (u_k - yref_k)^2, lower <= p_k u_k <= upper."""
    ocp = OCP("data", N=3)
    x, u, q = ocp.state("x"), ocp.control("u"), ocp.parameter("q", value=1.0)
    ocp.dynamics({x: x + u}, discrete=True)
    ocp.least_squares(ca.vertcat(u, x), [1, 0])
    ocp.subject_to(-100, q * u, 100, name="row")
    problem = classify(ocp)
    W = np.array([np.diag([1.0, 0]), np.diag([2.0, 0]), np.diag([3.0, 0])])
    solution = solve_reference(
        problem,
        yref=[[5, 0], [6, 0], [7, 0]],
        W=W,
        p=[[2], [1], [1], [0]],
        bounds={"row": (-100, [1, 50, 2, 0])},
    )
    np.testing.assert_allclose(solution.u[:, 0], [0.5, 6, 2], atol=1e-9)
    np.testing.assert_allclose(solution.mu[:, 0], [4.5 / 2, 0, 3 * 5], atol=1e-8)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"x0": [1, 2]}, "x0 has shape"),
        ({"yref": [1, 2, 3]}, "yref has shape"),
        ({"W": np.eye(3)}, "W has shape"),
        ({"bounds": {"nope": (0, 1)}}, "no row is named 'nope'"),
        ({"p": {"nope": 1}}, "no parameter is named 'nope'"),
    ],
)
def test_wrong_data(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        node_data(classify(integrator_map()), **given)


# The integrator ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scheme", "order"), [(EULER, 1), (HEUN, 2), (CLASSICAL, 4)])
def test_order_of_convergence(scheme: Tableau, order: int) -> None:
    """x' = -x + u, integral of x^2: error of state and quadrature falls as h^order."""
    ocp = OCP("decay", T=1.0, N=1)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: -x + u})
    ocp.stage_cost(x**2, integrate=True)
    problem = classify(ocp)
    exact = np.array([0.5 + 1.5 * np.exp(-1), 0.25 + 1.5 * (1 - np.exp(-1)) + 2.25 / 2 * (1 - np.exp(-2))])
    errors = []
    for steps in (16, 32):
        value = interval_map(problem, replace(scheme, steps=steps))(2.0, 0.5, [], 1.0)
        errors.append(np.abs([float(v) for v in value] - exact))
    np.testing.assert_allclose(np.log2(errors[0] / errors[1]), order, atol=0.15)


# Residuals -----------------------------------------------------------------------------------------------------------


def everything() -> Problem:
    """A problem with every kind of row and cost."""
    ocp = OCP("everything", intervals=[0.2, 0.3, 0.1])
    x, v = ocp.state("x", initial=0.4), ocp.state("v")
    u, q = ocp.control("u"), ocp.parameter("q", value=1.5)
    ocp.dynamics({x: v, v: u - q * ca.sin(x)})
    ocp.least_squares(ca.vertcat(x * v, u), [1, 2], reference=[0.1, 0], scale_with_dt=True)
    ocp.stage_cost(ca.cosh(x) * q)
    ocp.stage_cost(v**2, integrate=True)
    ocp.terminal_least_squares(ca.vertcat(x, v), [[2, 1], [1, 2]])
    ocp.terminal_cost(ca.exp(x))
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-0.5, x, 0.5, soft=(1, 3))
    ocp.subject_to(-0.1, x * v + q * u, 0.4, name="mixed")
    ocp.subject_to(-0.4, x + v**2, 0.6, name="curved")
    ocp.boundary(-0.1, ocp.at_start(v) - ocp.at_end(v) * ocp.at_end(x), 0.1, soft=(2, 1))
    ocp.free_initial(v)
    return classify(ocp)


def lagrangian(problem: Problem, point: Point, data: Data) -> float:
    """The Lagrangian without slacks, summed node by node from evaluated functions only."""
    hard = replace(problem, rows=tuple(replace(r, soft=None) for r in problem.rows))
    total = evaluate_cost(hard, point.x, point.u, data)
    Phi = interval_map(problem)
    s, e = problem.path, problem.terminal
    h, h_N = ca.Function("h", [s.x, s.u, s.p], [s.h]), ca.Function("h", [e.x, e.p], [e.h])
    total += point.lam[0] @ (data.x0 - point.x[0]) + np.sum(point.mu_x * point.x) + np.sum(point.mu_u * point.u)
    for k in range(problem.N):
        end = np.asarray(Phi(point.x[k], point.u[k], data.p[k], problem.dt[k])[0]).ravel()
        total += point.lam[k + 1] @ (end - point.x[k + 1])
        total += point.mu[k] @ np.asarray(h(point.x[k], point.u[k], data.p[k])).ravel()
    total += point.mu_N @ np.asarray(h_N(point.x[-1], data.p[-1])).ravel()
    total += point.eta @ np.asarray(problem.coupled(point.x[0], point.x[-1])).ravel()
    return float(total)


def test_stationarity_against_differences_of_the_lagrangian() -> None:
    """At a random point with random multipliers, the largest gradient entry by central differences."""
    problem, rng = everything(), np.random.default_rng(3)
    data = node_data(problem)
    N, nx, nu = problem.N, problem.nx, problem.nu
    sizes = [
        (N + 1, nx),
        (N, nu),
        (N + 1, nx),
        (N + 1, nx),
        (N, nu),
        (N, problem.path.nh),
        (problem.terminal.nh,),
        (1,),
    ]
    point = Point(*(0.3 * rng.standard_normal(shape) for shape in sizes))
    point.lam[0, list(problem.free_initial)] = 0
    gradient = []
    for name in ("x", "u"):
        value = getattr(point, name)
        for index in np.ndindex(*value.shape):
            ends = []
            for step in (1e-5, -1e-5):
                moved = value.copy()
                moved[index] += step
                ends.append(lagrangian(problem, replace(point, **{name: moved}), data))
            gradient.append((ends[0] - ends[1]) / 2e-5)
    assert kkt_residuals(problem, point, data).stationarity == pytest.approx(np.abs(gradient).max(), rel=1e-7)


def test_everything_is_solved_and_every_residual_sees_its_disturbance() -> None:
    problem = everything()
    data = node_data(problem)
    solution = solve_reference(problem)
    assert solution.success
    assert solution.residuals.worst < 1e-9
    assert evaluate_cost(problem, solution.x, solution.u, data) == pytest.approx(solution.cost, abs=1e-9)
    for part, name in (
        ("lam", "stationarity"),
        ("mu_x", "stationarity"),
        ("mu_u", "stationarity"),
        ("mu", "stationarity"),
        ("mu_N", "stationarity"),
        ("eta", "stationarity"),
        ("x", "equality"),
        ("u", "equality"),
    ):
        disturbed = getattr(solution, part) + 1e-3
        residuals = kkt_residuals(problem, replace(solution, **{part: disturbed}), data)
        assert getattr(residuals, name) > 1e-5, part
    outside = replace(solution, u=np.full_like(solution.u, 1.5))
    assert kkt_residuals(problem, outside, data).inequality >= 0.5
    inside = replace(solution, mu_u=np.ones_like(solution.mu_u), u=np.zeros_like(solution.u))
    assert kkt_residuals(problem, inside, data).complementarity == pytest.approx(1.0, abs=0.2)


def test_ipopt_started_at_the_solution_returns_it() -> None:
    problem = everything()
    reference, data = Reference(problem), node_data(problem)
    first = reference.solve(data)
    again = reference.solve(data, x=first.x, u=first.u)
    np.testing.assert_allclose(again.x, first.x, atol=1e-9)
    np.testing.assert_allclose(again.u, first.u, atol=1e-9)


def test_no_solution_is_reported_as_success_when_nan() -> None:
    problem = classify(integrator_map())
    point = solve_reference(problem)
    bad = kkt_residuals(problem, replace(point, x=np.full_like(point.x, np.nan)), node_data(problem))
    assert np.isnan(bad.equality)
    assert not bad.worst <= 1.0
