"""Implicit Runge-Kutta schemes: tableaus, values and derivatives against CasADi's rootfinder, Newton steps."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import ESDIRK3, OCP, RK4, SDIRK2, SDIRK3, ExplicitRungeKutta, ImplicitRungeKutta, OptionError
from nmpc_codegen.components.integrators.implicit.trial import Trial
from nmpc_codegen.components.integrators.tableau import IMPLICIT, ButcherTableau, ImplicitEuler, ImplicitMidpoint
from nmpc_codegen.decisions.trials import trials_of
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.trajectory import Tableau, interval_map
from verification.implicit import Interval
from verification.models import discrete_map

POINT = np.array([1.0, 0.5, 0.3]), np.array([0.4, -0.3]), np.array([5.0]), 0.2
NAMES = pytest.mark.parametrize("name", IMPLICIT)


def mixed() -> OCP:
    """A van der Pol oscillator and a fast state, two controls, a parameter, a cost rate, all nonlinear."""
    ocp = OCP("mixed", T=2.0, N=10)
    x, y, w = ocp.state("x", initial=1.0), ocp.state("y", initial=0.5), ocp.state("w", initial=0.3)
    u, v, a = ocp.control("u"), ocp.control("v"), ocp.parameter("a", value=5.0)
    ocp.dynamics({x: y + 0.1 * u * x, y: a * (1 - x**2) * y - x + u + ca.sin(w) + v, w: -30 * (w - ca.cos(x * u))})
    ocp.stage_cost(x**2 * u + ca.exp(0.1 * y) + u**2 * w, integrate=True)
    ocp.least_squares(ca.vertcat(u, v), weight=[1, 1])
    return ocp


def algebraic() -> OCP:
    """The same size with two algebraic variables in dynamics and cost rate, coupled and nonlinear."""
    ocp = OCP("algebraic", T=2.0, N=10)
    x, y, w = ocp.state("x", initial=1.0), ocp.state("y", initial=0.5), ocp.state("w", initial=0.3)
    u, v, a = ocp.control("u"), ocp.control("v"), ocp.parameter("a", value=5.0)
    z, q = ocp.algebraic("z", initial=0.5), ocp.algebraic("q", initial=0.2)
    ocp.algebraic_equation(z + z**3 + q * x - y - 0.3 * u)
    ocp.algebraic_equation(a * q + ca.sin(z) * q - w * v - x)
    ocp.dynamics({x: z + 0.1 * u * q, y: a * (1 - x**2) * z - x + u, w: -30 * (w - ca.cos(q * u)) + v})
    ocp.stage_cost(z**2 * u + ca.exp(0.1 * q) + u**2 * w, integrate=True)
    ocp.least_squares(ca.vertcat(u, v), weight=[1, 1])
    return ocp


def numbers(tableau: ButcherTableau, steps: int) -> Tableau:
    return Tableau(tuple(tuple(map(float, row)) for row in tableau.a), tuple(map(float, tableau.b)), steps)


def derivatives(problem: Problem, tableau: ButcherTableau, steps: int, lam: np.ndarray) -> list[np.ndarray]:
    """End, S, integral of the rate, its gradient, second derivatives of lam' end + integral, by CasADi at POINT."""
    x, u, p, dt = POINT
    z = ca.MX.sym("z", x.size + u.size)
    end, q = interval_map(problem, numbers(tableau, steps))(z[: x.size], z[x.size :], p, dt)
    H = ca.hessian(ca.dot(lam, end) + q, z)[0]
    found = ca.Function("all", [z], [end, ca.jacobian(end, z), q, ca.gradient(q, z), H])
    return [np.array(value) for value in found(np.concatenate([x, u]))]


# Tableaus ------------------------------------------------------------------------------------------------------------


@NAMES
def test_a_tableau_has_the_order_and_the_stability_that_it_claims(name: str) -> None:
    tableau = IMPLICIT[name]
    residuals = tableau.order_residuals()
    assert all(abs(float(r)) < 1e-13 for order, r in residuals if order <= tableau.order)
    assert any(abs(float(r)) > 1e-4 for order, r in residuals if order == tableau.order + 1)
    decay = [abs(tableau.stability_function(z)) for z in (-1.0, -1e2, -1e4, -1e6)]
    assert all(value <= 1 + 1e-12 for value in decay)
    assert (decay[-1] < 1e-5) == (tableau.stability == "L")


def test_rk4_is_not_stable_where_implicit_schemes_are() -> None:
    assert abs(RK4.stability_function(-2.7)) < 1 < abs(RK4.stability_function(-2.8))
    assert RK4.stability_function(-1.0) == pytest.approx(1 - 1 + 1 / 2 - 1 / 6 + 1 / 24)


@pytest.mark.parametrize(
    ("a", "b", "order", "stability", "message"),
    [
        (((Fraction(1, 3),),), (Fraction(1),), 1, "A", "not A-stable"),
        (((Fraction(1, 2),),), (Fraction(1),), 2, "L", "not L-stable"),
        (((Fraction(1, 2),),), (Fraction(1),), 2, "stiff", "stability 'stiff'; expected one of"),
        (((Fraction(1, 2),),), (Fraction(1),), 3, "", "order 3 is off"),
        (((Fraction(-1),),), (Fraction(1),), 1, "", "must not be negative"),
        (((0.3, 0.0), (0.4, 0.3)), (0.4, 0.6), 2, "", "order 2 is off"),
    ],
)
def test_a_wrong_claim_is_refused(a: Any, b: Any, order: int, stability: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        ButcherTableau("wrong", a, b, order, stability)


def test_a_scheme_of_the_user() -> None:
    """Crouzeix, two stages of order 3, A-stable."""
    g = (3 + np.sqrt(3)) / 6
    crouzeix = ButcherTableau("Crouzeix", ((g, 0.0), (1 - 2 * g, g)), (0.5, 0.5), 3, "A")
    problem = classify(mixed())
    end, S, *_ = derivatives(problem, crouzeix, 2, np.ones(3))
    found, slopes, _ = Interval(problem, ImplicitRungeKutta(crouzeix, 2))("interval", *POINT)
    assert np.allclose(found, end.ravel(), rtol=0, atol=1e-12)
    assert np.allclose(slopes, S.ravel(), rtol=0, atol=1e-11)


@pytest.mark.parametrize("z", [-0.3, -2.7 + 0.4j, 3j, -1e6])
def test_stability_functions(z: complex) -> None:
    assert RK4.stability_function(z) == pytest.approx(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, rel=1e-9)
    assert ImplicitEuler.stability_function(z) == pytest.approx(1 / (1 - z), rel=1e-9)
    assert ImplicitMidpoint.stability_function(z) == pytest.approx((1 + z / 2) / (1 - z / 2), rel=1e-9)


def test_a_mode_beyond_the_numbers_is_not_stable() -> None:
    """|h lambda|^4 exceeds the largest number: the choice is that for a very stiff model."""
    ocp = OCP("instant", T=1.0, N=2)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -1e120 * x + u})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    assert trials_of(classify(ocp)).needed_steps(ExplicitRungeKutta())[0] is None


def test_schemes_belong_to_their_components() -> None:
    with pytest.raises(OptionError, match=r"RK4 is explicit; expected an implicit scheme"):
        ImplicitRungeKutta(RK4)
    with pytest.raises(OptionError, match=r"SDIRK2 is diagonally implicit; expected an explicit.*ImplicitRunge"):
        ExplicitRungeKutta(SDIRK2)
    late = ButcherTableau("late", ((0.5, 0.0), (0.5, 0.0)), (1.0, 0.0), 1)
    with pytest.raises(OptionError, match="explicit stages behind the first"):
        ImplicitRungeKutta(late)
    with pytest.raises(OptionError, match=r"discrete map; expected Discrete\(\)"):
        ImplicitRungeKutta().check(classify(discrete_map()))


# Values and derivatives ----------------------------------------------------------------------------------------------


@pytest.mark.few(9)
@pytest.mark.parametrize("make", [mixed, algebraic])
@pytest.mark.parametrize("steps", [1, 3])
@NAMES
def test_an_interval_and_all_its_derivatives(name: str, steps: int, make: Callable[[], OCP]) -> None:
    problem, tableau, rng = classify(make()), IMPLICIT[name], np.random.default_rng(1)
    if problem.solved and not tableau.a[0][0]:
        with pytest.raises(OptionError, match="first stage of ESDIRK3 is explicit, and Newton's method solves for z"):
            ImplicitRungeKutta(tableau).check(problem)
        return
    interval = Interval(problem, ImplicitRungeKutta(tableau, steps))
    lam, V, d = rng.normal(size=3), rng.normal(size=(3, 2)), rng.normal(size=5)
    end, S, q, g, H = derivatives(problem, tableau, steps, lam)
    found = {
        "value": [end, 0],
        "interval": [end, S, 0],
        "forced": [end, S[:, 3:]],
        "free": [end, S[:, :3] @ V],
        "forward": [S @ d],
        "adjoint": [S[:, :3].T @ lam, S[:, 3:].T @ lam],
        "integral": [q],
        "integral_gradient": [g],
        **{key: [end, S, 0, g, np.tril(H)] for key in ("symmetric", "forward_over_adjoint")},
    }
    more = {"free": (V,), "forward": (d[:3], d[3:]), "adjoint": (lam,)}
    more |= dict.fromkeys(("symmetric", "forward_over_adjoint"), (lam,))
    for function, expected in found.items():
        x, *others = POINT
        start = problem.algebra.start if problem.algebra else ()
        results = interval(function, [*x, *start], *others, *more.get(function, ()))
        for result, value in zip(results, expected, strict=True):
            scale = max(1.0, float(np.abs(value).max()))
            assert np.allclose(result, np.ravel(value), rtol=0, atol=1e-10 * scale), function


@pytest.mark.parametrize("tableau", [SDIRK2, ESDIRK3], ids=lambda t: t.name)
def test_the_product_with_the_hessian_of_an_integral(tableau: ButcherTableau) -> None:
    """Second derivatives of the rate along linearised stages: d2 integral without the curvature of the stage points."""
    problem = classify(mixed())
    u, dt = POINT[1], POINT[3]
    stage, d = problem.path, np.random.default_rng(2).normal(size=5)
    w = Interval(problem, ImplicitRungeKutta(tableau))("integral_product", *POINT, d)[0]
    rate = ca.Function("l", [stage.x, stage.u], [stage.cost_rate])
    total = np.zeros((5, 5))
    for weight, Z, X in _stages(problem, tableau, dt):
        z = ca.SX.sym("z", 5)
        H = np.array(ca.Function("H", [z], [ca.hessian(rate(z[:3], z[3:]), z)[0]])(np.concatenate([X, u])))
        full = np.vstack([Z, np.eye(5)[3:]])
        total += weight * full.T @ H @ full
    assert np.allclose(w, total @ d, rtol=1e-9, atol=1e-10)


def _stages(problem: Problem, tableau: ButcherTableau, h: float) -> Any:
    """(h b_i, dX_i / d(x, u), X_i) of the stages of one step from POINT: truncated schemes, whose end is a stage."""
    x, u, p, _ = POINT
    for i in range(tableau.stages):
        rows = tuple(tuple(row[: i + 1]) for row in tableau.a[: i + 1])
        z = ca.MX.sym("z", 5)
        cut = Tableau(tuple(tuple(map(float, row)) for row in rows), tuple(map(float, rows[i])))
        if cut.implicit:
            X = interval_map(problem, cut)(z[:3], z[3:], p, h)[0]
            both = [np.array(v) for v in ca.Function("X", [z], [X, ca.jacobian(X, z)])(np.concatenate([x, u]))]
        else:
            both = [x[:, None], np.eye(3, 5)]
        yield h * float(tableau.b[i]), both[1], both[0].ravel()


@NAMES
def test_order_of_convergence(name: str) -> None:
    """Errors over four halvings of the step, of a nonlinear problem with a known solution: y = sin(t) + 1 / (1 + t)."""
    tableau = IMPLICIT[name]
    ocp = OCP("known", T=1.0, N=1)
    t, y = ocp.state("t"), ocp.state("y", initial=1.0)
    u = ocp.control("u")
    solution, slope = ca.sin(t) + 1 / (1 + t), ca.cos(t) - 1 / (1 + t) ** 2
    ocp.dynamics({t: 1 + 0 * u, y: slope + solution**2 - y**2})
    ocp.least_squares(y, weight=1.0)
    problem = classify(ocp)
    trial, errors = Trial(problem, np.ones(problem.nx), tableau), []
    for steps in (2, 4, 8, 16, 32) if tableau.order > 3 else (8, 16, 32, 64, 128):
        end = trial.interval(np.array([0.0, 1.0]), np.zeros(1), np.zeros(0), 1.0, steps, 30).x
        errors.append(abs(end[1] - np.sin(1) - 0.5))
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert slopes[-2:] == pytest.approx(tableau.order, abs=0.1)


# Newton steps --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("newton", [1, 2, 3])
@NAMES
def test_a_sample_takes_so_many_steps(name: str, newton: int) -> None:
    """The same as in NumPy; what is left is about the error, and falls from step to step."""
    problem = classify(mixed())
    interval = Interval(problem, ImplicitRungeKutta(IMPLICIT[name], 2, newton))
    expected = Trial(problem, np.ones(problem.nx), IMPLICIT[name]).interval(*POINT, 2, newton)
    end, S, left = interval("interval", *POINT, newton=newton)
    exact = interval("interval", *POINT)
    for found, value in ((end, expected.x), (S, expected.S.ravel()), (left, expected.left)):
        assert np.allclose(found, value, rtol=1e-9, atol=1e-11)
    assert np.max(np.abs(end - exact[0])) <= np.max(left) + 1e-13
    assert np.array_equal(end, interval("value", *POINT, newton=newton)[0])
    assert np.max(exact[2]) < 1e-13


def test_states_that_are_at_rest_stay_to_the_last_bit() -> None:
    ocp = OCP("rest", T=1.0, N=2)
    x, y, u = ocp.state("x"), ocp.state("y"), ocp.control("u")
    ocp.dynamics({x: -1e3 * x + y**2, y: -y + u})
    ocp.least_squares(x, weight=1.0)
    interval = Interval(classify(ocp), ImplicitRungeKutta(ESDIRK3))
    for newton in (2, 30):
        end, _, left = interval("interval", np.zeros(2), np.zeros(1), [], 0.5, newton=newton)
        assert np.all(end == 0)
        assert np.all(left == 0)


def test_rows_are_exchanged_where_a_pivot_vanishes() -> None:
    """1 - h a f_x is regular and has a zero on its diagonal; units that differ by 1e6 change nothing."""
    ocp = OCP("exchange", T=1.0, N=1)
    x, y, u = ocp.state("x", initial=1.0), ocp.state("y", initial=2.0), ocp.control("u")
    ocp.dynamics({x: x + 3e-6 * y, y: 2e6 * x + u})
    ocp.least_squares(x, weight=1.0)
    problem = classify(ocp)
    end, S, _ = Interval(problem, ImplicitRungeKutta(ImplicitEuler), scale=[1.0, 1e6])(
        "interval", [1.0, 2e6], [1e5], [], 1.0
    )
    M = np.eye(2) - np.array([[1, 3e-6], [2e6, 0]])
    assert end == pytest.approx(np.linalg.solve(M, [1.0, 2.1e6]), rel=1e-13)
    assert S.reshape(2, 3) == pytest.approx(np.linalg.solve(M, [[1, 0, 0], [0, 1, 1]]), rel=1e-12)


def test_a_stage_that_cannot_be_solved_is_named() -> None:
    ocp = OCP("blow", T=1.0, N=1)
    x, y, u = ocp.state("x"), ocp.state("y", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u - x, y: 4 * y + x})
    ocp.least_squares(x, weight=1.0)
    interval = Interval(classify(ocp), ImplicitRungeKutta(ImplicitMidpoint))
    assert interval("failure", [0.0, 1.0], [0.0], [], 0.5)[0].tolist() == [1.0, 0.0, 0.0]  # state y, no pivot
    assert np.isnan(interval("value", [0.0, 1.0], [0.0], [], 0.5)[0]).any()
    assert interval("failure", [0.0, 1.0], [0.0], [], 0.4)[0][0] == -1
    assert interval("failure", [np.inf, 1.0], [0.0], [], 0.4)[0][0] >= 0
    assert np.isnan(interval("value", [np.nan, 1.0], [0.0], [], 0.4)[0]).any()


def test_newton_steps_that_do_not_converge_are_named() -> None:
    """The equation of the stage has no real solution."""
    ocp = OCP("escape", T=1.0, N=1)
    x, y, u = ocp.state("x"), ocp.state("y", initial=3.0), ocp.control("u")
    ocp.dynamics({x: u - x, y: 5 * y**2 + 3})
    ocp.least_squares(x, weight=1.0)
    interval = Interval(classify(ocp), ImplicitRungeKutta(ImplicitEuler, 2))
    assert interval("failure", [0.0, 3.0], [0.0], [], 0.4)[0].tolist() == [3.0, 0.0, 0.0]  # NX + state y
    assert np.isnan(interval("value", [0.0, 3.0], [0.0], [], 0.4)[0]).any()
    assert np.isfinite(interval("value", [0.0, 3.0], [0.0], [], 0.4, newton=2)[0]).all()


def test_single_precision() -> None:
    problem = classify(mixed())
    double, single = (Interval(problem, ImplicitRungeKutta(SDIRK3, 2), precision) for precision in ("double", "single"))  # type: ignore[arg-type]
    for exact, rough in zip(double("interval", *POINT)[:2], single("interval", *POINT)[:2], strict=True):
        assert np.allclose(rough, exact, rtol=1e-4, atol=1e-5)


# Stiff problems ------------------------------------------------------------------------------------------------------


@NAMES
def test_prothero_robinson(name: str) -> None:
    """y' = -L (y - cos t) - sin t, L = 1e6: the error after ten steps of 0.1, from y = 1 and from y = 2."""
    tableau = IMPLICIT[name]
    ocp = OCP("prothero", T=1.0, N=1)
    t, y, u = ocp.state("t"), ocp.state("y", initial=1.0), ocp.control("u")
    ocp.dynamics({t: 1 + 0 * u, y: -1e6 * (y - ca.cos(t)) - ca.sin(t)})
    ocp.least_squares(y, weight=1.0)
    interval = Interval(classify(ocp), ImplicitRungeKutta(tableau, 10))
    ends = [interval("value", [0.0, start], [0.0], [], 1.0)[0][1] for start in (1.0, 2.0)]
    errors = [abs(end - np.cos(1.0)) for end in ends]
    assert errors[0] < 1e-2
    assert (errors[1] < 1e-2) == (tableau.stability == "L")  # what is not on the solution is damped
