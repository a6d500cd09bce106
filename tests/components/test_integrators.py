"""Integrators: the compiled C against the NumPy twin, CasADi's derivatives and very accurate solutions."""

from __future__ import annotations

import functools
from dataclasses import replace
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nmpc_codegen import OCP, OptionError
from nmpc_codegen.components.integrators import TABLEAUS, ButcherTableau, Discrete, ExplicitRungeKutta
from nmpc_codegen.components.integrators.explicit.first_order import Sensitivities
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.ir.sweep import Call, LoopedRoutine, Slice, lift_straight
from verification.c_harness import Routines
from verification.models import GRID, LENGTH, discrete_map, problem_of
from verification.oracles.runge_kutta import MODELS, ORDERS, POINTS, SCHEMES, Array, complex_step, integrate

TOLERANCE = 1e-12
STEPS = (1, 3)  # of three steps one is neither the first nor the last
UNROLL = ("all", "none")


@functools.cache
def stated(model: str, uniform: bool) -> Problem:
    return classify(problem_of(model, uniform))


def normwise(value: Array, expected: Array) -> float:
    return float(np.max(np.abs(value - expected)) / np.max(np.abs(expected)))


Compiled = tuple[str, str, Routines]


@pytest.fixture(scope="module", params=[(m, s) for m in MODELS for s in SCHEMES], ids="-".join)
def compiled(request: pytest.FixtureRequest) -> Compiled:
    """Model, scheme, and routines interval_<unroll>_<steps>_<uniform> and step; pytest groups the tests by them."""
    model, scheme = request.param
    routines = {}
    for uniform in (True, False):
        for steps in STEPS:
            for unroll in UNROLL:
                component = ExplicitRungeKutta(TABLEAUS[scheme], steps, unroll)  # type: ignore[arg-type]
                functions = component.interval(stated(model, uniform))
                interval, step = functions.linearize, functions.step
                routines[f"interval_{unroll}_{steps}_{uniform}"] = interval
                routines["step"] = step
    return model, scheme, Routines(routines)


def test_the_schemes_are_registered() -> None:
    assert set(TABLEAUS) == set(SCHEMES) == set(ORDERS)
    assert {t.name: t.order for t in TABLEAUS.values()} == ORDERS


@pytest.mark.parametrize("model", MODELS)
def test_jacobians_of_the_twin(model: str) -> None:
    """The hand-written Jacobians against the complex step."""
    m, (x, u, p) = MODELS[model], POINTS[model]
    assert normwise(m.fx(x, u, p), complex_step(lambda z: m.f(z, u, p), x)) < 1e-15
    assert normwise(m.fu(x, u, p), complex_step(lambda z: m.f(x, z, p), u)) < 1e-15


@pytest.mark.few(8)
def test_sensitivities(compiled: Compiled) -> None:
    """x_next and S, straight-line and looped, 1 and 3 steps, both grids, against the twin."""
    model, scheme, routines = compiled
    point = POINTS[model]
    for uniform, lengths in ((True, [LENGTH]), (False, GRID)):
        for dt in lengths:
            for steps in STEPS:
                x_next, S = integrate(MODELS[model], scheme, steps, dt, *point)
                for unroll in UNROLL:
                    got_x, got_S = routines(f"interval_{unroll}_{steps}_{uniform}", *point, [dt])
                    assert normwise(got_x, x_next) <= TOLERANCE, (unroll, steps, dt)
                    assert normwise(got_S, S) <= TOLERANCE, (unroll, steps, dt)
    x_next, _ = integrate(MODELS[model], scheme, 1, 0.17, *point)
    assert normwise(routines("step", *point, [0.17])[0], x_next) <= TOLERANCE


def test_sensitivities_against_casadi(compiled: Compiled) -> None:
    """The same against ca.jacobian of the scheme written in CasADi."""
    model, scheme, routines = compiled
    problem, point = stated(model, False), POINTS[model]
    a, b = SCHEMES[scheme]
    x, u, p, dt = problem.path.x, problem.path.u, problem.path.p, ca.SX.sym("dt")
    state = x
    for steps in STEPS:
        state, h = x, dt / steps
        for _ in range(steps):
            K: list[ca.SX] = []
            for row in a:
                K.append(problem.dynamics(state + sum((h * c * k for c, k in zip(row, K, strict=False)), 0 * x), u, p))
            state = state + sum((h * w * k for w, k in zip(b, K, strict=True)), 0 * x)
        jacobian = ca.Function("J", [x, u, p, dt], [ca.jacobian(state, ca.vertcat(x, u))])
        expected = np.array(jacobian(*point, GRID[1]))
        for unroll in UNROLL:
            _, S = routines(f"interval_{unroll}_{steps}_False", *point, [GRID[1]])
            assert normwise(S, expected) <= TOLERANCE, (unroll, steps)


@pytest.mark.parametrize("model", MODELS)
def test_sensitivities_in_single_precision(model: str) -> None:
    """64 eps: S contains the rounding errors of about 30 stages."""
    point, routines = POINTS[model], {}
    for unroll in UNROLL:
        routines[unroll] = ExplicitRungeKutta(steps=2, unroll=unroll).interval(stated(model, False)).linearize
    compiled_single = Routines(routines, "single")
    x_next, S = integrate(MODELS[model], "RK4", 2, GRID[0], *point)
    for unroll in UNROLL:
        got_x, got_S = compiled_single(unroll, *point, [GRID[0]])
        assert normwise(got_x, x_next) <= 64 * 2.0**-23
        assert normwise(got_S, S) <= 64 * 2.0**-23


@functools.cache
def accurate(model: str, T: float) -> tuple[Array, Array]:
    """x(T) and S(T) by an embedded method of order 8 on the equation and its variational equation."""
    m, (x, u, p) = MODELS[model], POINTS[model]
    nx, nz = len(x), len(x) + len(u)

    def rhs(t: float, y: Array) -> Array:
        X, S = y[:nx], y[nx:].reshape(nx, nz)
        dS = m.fx(X, u, p) @ S + np.hstack([np.zeros((nx, nx)), m.fu(X, u, p)])
        return np.concatenate([m.f(X, u, p), dS.ravel()])

    start = np.concatenate([x, np.eye(nx, nz).ravel()])
    y = solve_ivp(rhs, (0, T), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return y[:nx], y[nx:].reshape(nx, nz)


def test_order_of_convergence(compiled: Compiled) -> None:
    """Slopes of log error over log h of x and of S within 0.1 of the order; one step per call of the C routine."""
    model, scheme, routines = compiled
    x0, u, p = POINTS[model]
    T, nx = 0.6, len(x0)
    exact_x, exact_S = accurate(model, T)
    counts = (32, 64, 128) if ORDERS[scheme] > 2 else (128, 256, 512)
    errors = []
    for n in counts:
        x, S = x0, np.eye(nx, nx + len(u))
        for _ in range(n):
            x, Z = routines("interval_all_1_False", x, u, p, [T / n])
            S = Z[:, :nx] @ S + np.hstack([np.zeros((nx, nx)), Z[:, nx:]])
        errors.append([normwise(x, exact_x), normwise(S, exact_S)])
    slopes = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, ORDERS[scheme], atol=0.1)


# Choice of the spelling --------------------------------------------------------------------------------------------


def test_unroll_decides_what_is_printed() -> None:
    problem = stated("crane", True)
    spelled = {unroll: ExplicitRungeKutta(unroll=unroll).interval(problem).linearize for unroll in UNROLL}
    assert isinstance(spelled["all"], Kernel)
    assert isinstance(spelled["none"], LoopedRoutine)
    assert "slope_0" in spelled["none"].leaves


def test_auto_prefers_straight_line_code_of_a_limited_size(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = stated("crane", True)
    whole = ExplicitRungeKutta(steps=3, unroll="all").interval(problem).linearize
    auto = ExplicitRungeKutta(steps=3, unroll="auto").interval(problem).linearize
    assert isinstance(auto, Kernel)
    assert vars(replace(auto)) == vars(replace(whole))
    limit = "nmpc_codegen.components.integrators.explicit_runge_kutta.AUTO_INSTRUCTIONS"
    monkeypatch.setattr(limit, len(whole.instructions) - 1)
    rolled = ExplicitRungeKutta(steps=3, unroll="auto").interval(problem).linearize
    assert isinstance(rolled, LoopedRoutine)


def test_zero_entries_of_the_tableau_cost_nothing() -> None:
    """One step of RK4 without parameters: counted by hand on xdot = u, whose stages are all equal to u."""
    ocp = OCP("integrator", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    interval = ExplicitRungeKutta(steps=1, unroll="all").interval(classify(ocp)).linearize
    assert isinstance(interval, Kernel)
    assert interval.count.call == interval.count.div == 0
    assert {e for o, e, _ in interval.stores if o == 1} == {0, 1}
    nonzero = [ins.constant for o, e, v in interval.stores if o == 1 for ins in [interval.instructions[v]]]
    np.testing.assert_allclose(nonzero, [1.0, 0.5], rtol=1e-15)


def test_structural_zeros_of_the_crane_are_kept() -> None:
    """The cart is independent of the load: S has 12 nonzeros, the others are never written."""
    interval = ExplicitRungeKutta(unroll="all").interval(stated("crane", True)).linearize
    assert isinstance(interval, Kernel)
    written = {divmod(e, 5) for o, e, _ in interval.stores if o == 1}
    cart = {(0, 0), (0, 1), (0, 4), (1, 1), (1, 4)}
    assert written == cart | {(i, j) for i in (2, 3) for j in (2, 3, 4)}
    outputs = {o: [e for port, e, _ in interval.stores if port == o] for o in (0, 1)}
    assert outputs[0] == [0, 1, 2, 3]


def test_a_state_that_vanishes_is_written() -> None:
    """One Euler step of length 1 of xdot = -x gives zero, whatever the caller's memory contains."""
    ocp = OCP("deadbeat", T=2.0, N=2)
    x, u = ocp.state("x", size=2), ocp.control("u")
    ocp.dynamics(ca.vertcat(-x[0], u))
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(3))
    interval = ExplicitRungeKutta(TABLEAUS["Euler"], 1, "all").interval(classify(ocp)).linearize
    x_next, S = np.full(2, 7.0), np.zeros((2, 3))
    Routines({"f": interval}).raw("f", np.array([3.0, 4.0]), np.array([5.0]), np.zeros(1), np.ones(1), x_next, S)
    np.testing.assert_array_equal(x_next, [0.0, 9.0])
    np.testing.assert_array_equal(S, [[0, 0, 0], [0, 1, 1]])


# Discrete maps -----------------------------------------------------------------------------------------------------


def test_discrete_map() -> None:
    problem = classify(discrete_map())
    functions = Discrete().interval(problem)
    interval, step = functions.linearize, functions.step
    x, u, p = np.array([0.4, -0.7]), np.array([0.2, 0.3]), np.array([0.8])

    def phi(z: Array) -> Array:
        return np.array([z[0] + 0.5 * z[1] ** 2 + p[0] * z[2], 0.84 * z[1] - z[0] * np.exp(z[3])])

    routines = Routines({"interval": interval, "step": step})
    z = np.concatenate([x, u])
    x_next, S = routines("interval", x, u, p, [1.0])
    assert normwise(x_next, phi(z)) <= TOLERANCE
    assert normwise(S, complex_step(phi, z)) <= TOLERANCE
    np.testing.assert_array_equal(routines("step", x, u, p, [0.1])[0], x_next)


def test_maps_and_equations_do_not_mix() -> None:
    with pytest.raises(OptionError, match="discrete map"):
        ExplicitRungeKutta().check(classify(discrete_map()))
    with pytest.raises(OptionError, match="ordinary differential equation"):
        Discrete().check(stated("crane", True))


def test_a_map_has_nothing_to_integrate() -> None:
    problem = classify(discrete_map())
    start = Call(ca.Function("nothing", [], [ca.SX(0)]), (), (Slice("l", 1),))
    for refuse in (Discrete().integrated_cost, Discrete().integrated_gradient):
        with pytest.raises(OptionError, match="map: a discrete map has no cost per unit of time"):
            refuse(problem, "path_cost", start, ())


# Tableaus and options ----------------------------------------------------------------------------------------------


def test_tableaus_equal_those_of_the_literature() -> None:
    for name, (a, b) in SCHEMES.items():
        np.testing.assert_array_equal(np.array(TABLEAUS[name].a, dtype=float), a)
        np.testing.assert_array_equal(np.array(TABLEAUS[name].b, dtype=float), b)


def test_stated_orders_are_sharp() -> None:
    """The order conditions of the next order fail (order 4 has no next one here)."""
    for tableau in TABLEAUS.values():
        if tableau.order < 4:
            assert any(order == tableau.order + 1 and residual for order, residual in tableau.order_residuals())


@pytest.mark.parametrize(
    ("a", "b", "order", "message"),
    [
        ([[0]], [Fraction(1, 2)], 1, "order 1 is off by -1/2"),
        ([[0, 0], [1, 0]], [Fraction(1, 3), Fraction(2, 3)], 2, "order 2 is off by 1/6"),
        ([[0, 1], [0, 0]], [1, 0], 1, "lower triangular"),
        ([[0, 0]], [1], 1, "must be 1 x 1"),
    ],
)
def test_a_wrong_tableau_is_refused(a: list, b: list, order: int, message: str) -> None:
    exact = tuple(tuple(Fraction(v) for v in row) for row in a)
    with pytest.raises(OptionError, match=message):
        ButcherTableau("wrong", exact, tuple(Fraction(v) for v in b), order)


def test_a_tableau_of_the_user() -> None:
    """Ralston's method of order 2, with a numerator other than 1."""
    F = Fraction
    ralston = ButcherTableau("Ralston", ((F(0), F(0)), (F(2, 3), F(0))), (F(1, 4), F(3, 4)), 2)
    x, u, p = POINTS["tanks"]
    interval = ExplicitRungeKutta(ralston, 2, "none").interval(stated("tanks", False)).linearize
    unrolled = lift_straight(Sensitivities(stated("tanks", False), ralston, 2).sweep())
    routines = Routines({"loops": interval, "line": unrolled})
    m, h = MODELS["tanks"], 0.1
    X = x
    for _ in range(2):
        k0 = m.f(X, u, p)
        X = X + h * (k0 / 4 + 3 * m.f(X + 2 / 3 * h * k0, u, p) / 4)
    for key in ("loops", "line"):
        assert normwise(routines(key, x, u, p, [0.2])[0], X) <= TOLERANCE


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tableau": "RK5"}, "tableau.*expected one of Euler"),
        ({"steps": 0}, "steps: 0; expected an integer >= 1"),
        ({"steps": True}, "steps"),
        ({"steps": 1.5}, "steps"),
        ({"unroll": "half"}, "unroll: 'half'; expected one of auto, all, none"),
    ],
)
def test_bad_options(arguments: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        ExplicitRungeKutta(**arguments)


def test_a_tableau_may_be_named() -> None:
    assert ExplicitRungeKutta("Heun").tableau is TABLEAUS["Heun"]  # type: ignore[arg-type]
