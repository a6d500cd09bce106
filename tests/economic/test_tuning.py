"""Steady state and tuning of the evaporation process and of the car, against models written in NumPy."""

from __future__ import annotations

import sys
from functools import cache

import casadi as ca
import numpy as np
import pytest
import scipy.optimize

from examples import driving, evaporation
from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, ExtraError, OptionError, Options, ProblemError
from nmpc_codegen.economic import Tuning, steady_state, tune
from nmpc_codegen.economic.terminal import lqr_terminal_cost
from nmpc_codegen.frontend.classify import classify


@cache
def tuning() -> Tuning:
    return evaporation.tuned()


def model(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, float]:
    """Derivatives and cost of the evaporation process, in numbers of the paper."""
    X2, P2, P100, F200 = *x, *u
    T2, T3 = 0.5616 * P2 + 0.3126 * X2 + 48.43, 0.507 * P2 + 55
    Q100 = 9.6 * (0.1538 * P100 + 90 - T2)
    F4 = (Q100 - 0.7 * (T2 - 40)) / 38.5
    F5 = 6.84 * (T3 - 25) / (1 + 6.84 / (0.14 * F200)) / 38.5
    F2 = 10 - F4
    cost = 10.09 * (F2 + 50) + 600 * Q100 / 36.6 + 0.6 * F200
    return np.array([(50 - F2 * X2) / 20, (F4 - F5) / 4]), cost


def interval(w: np.ndarray) -> np.ndarray:
    """One RK4 step of a minute."""
    x, u = w[:2], w[2:]
    k1 = model(x, u)[0]
    k2 = model(x + k1 / 2, u)[0]
    k3 = model(x + k2 / 2, u)[0]
    k4 = model(x + k3, u)[0]
    return x + (k1 + 2 * k2 + 2 * k3 + k4) / 6


def best(shift: np.ndarray, lowest: float = 25.0) -> float:
    """Least cost of x = Phi(x, u) + shift, X2 >= lowest, by SLSQP."""
    found = scipy.optimize.minimize(
        lambda s: model(s[:2], s[2:] * 100)[1] / 1000,
        [25.0, 49.7, 1.9, 2.1],
        method="SLSQP",
        constraints=[
            {"type": "eq", "fun": lambda s: interval(np.append(s[:2], s[2:] * 100)) + shift - s[:2]},
            {"type": "ineq", "fun": lambda s: s[0] - lowest},
        ],
        options={"ftol": 1e-15, "maxiter": 500},
    )
    return float(found.fun) * 1000


def test_steady_state_of_the_paper() -> None:
    t = tuning()
    np.testing.assert_allclose([*t.x_s, *t.u_s], [25, 49.743, 191.713, 215.888], rtol=0, atol=1e-3)
    assert t.cost == pytest.approx(6210.38, abs=5e-3)
    w = np.concatenate([t.x_s, t.u_s])
    assert np.abs(interval(w) - t.x_s).max() <= 1e-12 * 50
    assert t.active == ("X2",)


def test_multipliers_are_sensitivities() -> None:
    """d cost / d shift = lam, d cost / d bound = -mu: this fixes the signs."""
    t, h = tuning(), 1e-2
    for i in range(2):
        e = h * np.eye(2)[i]
        assert (best(e) - best(-e)) / (2 * h) == pytest.approx(t.lam_s[i], rel=1e-3)
    slope = (best(np.zeros(2), 25 + h) - best(np.zeros(2), 25 - h)) / (2 * h)
    assert slope == pytest.approx(-t.mu_s[0], rel=1e-3)


def test_hessian_by_differences() -> None:
    """Central differences of l + lam' Phi of the NumPy model."""
    t = tuning()
    w = np.concatenate([t.x_s, t.u_s])

    def L(v: np.ndarray) -> float:
        return model(v[:2], v[2:])[1] + float(t.lam_s @ interval(v))

    h = 1e-2
    E = h * np.eye(4)
    H = [[(L(w + a + b) - L(w + a - b) - L(w - a + b) + L(w - a - b)) / (4 * h * h) for b in E] for a in E]
    np.testing.assert_allclose(t.H, H, rtol=0, atol=2e-4)
    AB = [[(interval(w + a) - interval(w - a))[i] / (2 * h) for a in E] for i in range(2)]
    np.testing.assert_allclose(np.hstack([t.A, t.B]), AB, rtol=0, atol=1e-6)


def test_hessian_of_the_paper() -> None:
    """Eigenvalues 6e-5 .. 2.1e-2 and beta 352; M is what its formula says."""
    t = tuning()
    values = np.linalg.eigvalsh(t.M)
    assert values[0] == pytest.approx(6e-5, rel=0.05)
    assert values[-1] == pytest.approx(2.1e-2, rel=0.05)
    assert t.beta == pytest.approx(352, rel=0.01)
    AB, E = np.hstack([t.A, t.B]), np.eye(2, 4)
    M = t.H + (AB.T @ t.dP @ AB - E.T @ t.dP @ E + t.C.T @ t.F @ t.C) / t.alpha
    np.testing.assert_allclose(t.M, M, rtol=0, atol=1e-10)
    assert t.M_f is None
    assert not t.dissipative
    assert t.with_rows.positive
    np.testing.assert_allclose(t.C, [[1, 0, 0, 0]])


def test_eta_0_is_refused_with_a_reason() -> None:
    with pytest.raises(ProblemError, match=r"no M exists for eta = 0.*eta=1 uses the strictly active rows \(X2\)"):
        evaporation.tuned(eta=0)


def test_readable() -> None:
    text = str(tuning())
    for word in ("P100 = 191.713", "X2: multiplier -60.29", "condition number 351.9", "not strictly dissipative"):
        assert word in text


@pytest.mark.parametrize("scaling", ["curvature", "magnitude", np.array([10.0, 20.0, 100.0, 100.0])])
def test_scalings_keep_the_reduced_hessian(scaling: object) -> None:
    """Other M, the same on the null space of dynamics and rows: along the motions of any frequency."""
    t = tune(evaporation.build_ocp(), evaporation.options(), scaling=scaling)
    assert np.linalg.eigvalsh(t.M)[0] > 0
    for theta in (0.0, 0.3, 2.0):
        z = np.exp(1j * theta)
        rows = np.vstack([np.hstack([t.A - z * np.eye(2), t.B]), t.C])
        motion = np.linalg.svd(rows)[2][-1].conj()
        assert abs(motion.conj() @ (t.M - t.H) @ motion) <= 1e-8


@pytest.mark.parametrize(
    ("units", "money"), [((1, 1, 1, 1), 1.0), ((100, 1e-3, 1e-3, 1 / 60), 1.0), ((0.01, 1e3, 1, 1), 1e-3)]
)
def test_units_do_not_decide(units: tuple[float, ...], money: float) -> None:
    """The process with the regulator as terminal cost, in other units: the same steady state, verdict and rows."""
    base, s = evaporation.process(3), np.array(units)
    ocp = OCP("units", T=3.0, N=3)
    x = [ocp.state("X2", initial=25 / s[0]), ocp.state("P2", initial=55 / s[1])]
    u = [ocp.control("P100"), ocp.control("F200")]
    f = ca.Function("f", [base.x, base.u], [base.derivatives[0], base.derivatives[1], base.costs[0].expression])
    X2, P2, cost = f(ca.vertcat(*x) * s[:2], ca.vertcat(*u) * s[2:])
    ocp.dynamics(ca.vertcat(X2, P2) / s[:2])
    ocp.stage_cost(cost * money)
    ocp.subject_to(25 / s[0], x[0], np.inf)
    for symbol, scale in zip(u, s[2:], strict=True):
        ocp.subject_to(0, symbol, 400 / scale)
    ocp.lqr_terminal_cost(economic=True)
    t = tune(ocp, evaporation.options())
    np.testing.assert_allclose(t.x_s * s[:2], tuning().x_s, rtol=1e-8)
    np.testing.assert_allclose(t.u_s * s[2:], tuning().u_s, rtol=1e-6)
    assert t.active == t.active_terminal == ("X2",)
    assert not t.dissipative
    assert t.dissipativity.least == pytest.approx(tuning().dissipativity.least, rel=1e-5)
    for matrix, scale in ((t.M, s), (t.M_f, s[:2])):
        assert matrix is not None
        assert np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0] > 0


# Driving --------------------------------------------------------------------------------------------------------------


@cache
def car() -> Tuning:
    return driving.tuned()


def test_driving() -> None:
    """50 km/h, the brake at its bound, zero rows for the position, M > 0 on the others, M_f > 0."""
    t = car()
    assert t.x_s[2] * 3.6 == pytest.approx(50, abs=1e-4)
    assert t.active == ("Fb",)
    assert not t.M[0].any()
    assert not t.M[:, 0].any()
    assert t.M_f is not None
    assert not t.M_f[0].any()
    assert np.linalg.eigvalsh(t.M[1:, 1:])[0] > 0
    assert np.linalg.eigvalsh(t.M_f[1:, 1:])[0] > 0
    assert "no row" not in str(t)


def test_false_infeasibility_is_named() -> None:
    """Clarabel calls the car infeasible without scaling; the frequency function knows better."""
    with pytest.raises(ProblemError, match=r"says that M exists, but the solver fails \(none: infeasible"):
        tune(driving.build_ocp(newton=1.0), driving.options(), scaling="none")
    assert tune(driving.build_ocp(newton=1.0), driving.options()).scaling == "curvature"


def test_terminal_cost_of_the_car() -> None:
    """The least eigenvalue of P is -17025 W per second of the interval; its rows of the position are zero."""
    found = lqr_terminal_cost(driving.build_ocp(), driving.options(), economic=True)
    assert np.linalg.eigvalsh(found.P)[0] * driving.POWER / driving.SAMPLING == pytest.approx(-17025, abs=1)
    assert not found.P[0].any()
    assert not found.semidefinite
    assert found.lam[2] == pytest.approx(-1.70025, abs=1e-4)


# Refusals -------------------------------------------------------------------------------------------------------------


def small(cost: float = 1.0, **more: bool) -> OCP:
    ocp = OCP("small", N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: 0.5 * x + u}, discrete=True)
    ocp.stage_cost(cost * x**2 + u**2)
    if more.get("end", True):
        ocp.subject_to(0, x, 0, at="end")
    return ocp


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"eta": 2}, "eta=2; expected 0 or 1"),
        ({"rho1": -1.0}, "rho1=-1.0; expected a number >= 0"),
        ({"rho2": float("nan")}, "rho2=nan"),
        ({"scaling": "other"}, "expected one of auto, none, curvature, magnitude"),
        ({"eta": np.array([1, 2])}, "expected 0 or 1"),
        ({"scaling": ["a", 1.0]}, "scaling must be 2 positive numbers"),
        ({"scaling": [1.0]}, "scaling must be 2 positive numbers"),
        ({"scaling": [1.0, -1.0]}, "scaling must be 2 positive numbers"),
    ],
)
def test_bad_arguments(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        tune(small(), **arguments)  # type: ignore[arg-type]


def test_no_solution() -> None:
    """x+ = u with x^2 + u^2 + 3 x u rests best at 0, but earns by changing its sign at every interval."""
    ocp = OCP("swing", N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u}, discrete=True)
    ocp.stage_cost(x**2 + u**2 + 3 * x * u)
    with pytest.raises(ProblemError, match=r"no M exists for eta = 1: the frequency function .* at 3\.14 rad"):
        tune(ocp)


def test_a_value_of_zero_is_not_positive() -> None:
    """A position without weight: rounding must not make the frequency function positive."""
    ocp = OCP("undetectable", T=2.0, N=5)
    p, v, a = ocp.state("p", initial=1.0), ocp.state("v"), ocp.control("a")
    ocp.dynamics({p: v, v: a})
    ocp.stage_cost(v**2 + a**2)
    with pytest.raises(ProblemError, match="no M exists for eta = 1"):
        tune(ocp)


@pytest.mark.parametrize("cost", [-1.0, 0.0])
def test_cost_without_bound_is_named(cost: float) -> None:
    """-x^2 starts at a maximum, which is left; -x runs away at once."""
    ocp = OCP("unbounded", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(cost * x**2 - (1 + cost) * x)
    with pytest.raises(ProblemError, match="no lower bound on the steady states"):
        steady_state(ocp)


def test_start_at_a_maximum_is_left() -> None:
    """x = u = 0 is stationary, but the best steady state lies on the bound of u."""
    ocp = OCP("hill", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(-(x**2) + 0.1 * u**2 + 0.01 * x**4)
    ocp.subject_to(-3, u, 3)
    found = steady_state(ocp)
    assert abs(found.x[0]) == pytest.approx(3, abs=1e-9)
    assert found.active == (0,)


def test_start_that_is_not_finite_is_named() -> None:
    ocp = OCP("logarithm", T=1.0, N=3)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(u**2 - ca.log(x))
    with pytest.raises(ProblemError, match=r"not finite at x = 0, u = 0.*initial="):
        steady_state(ocp)
    assert steady_state(ocp, guess=([1.0], [0.0])).x[0] == pytest.approx(np.sqrt(0.5), abs=1e-9)


@pytest.mark.parametrize("money", [1e-9, 1e9])
@pytest.mark.parametrize("units", [(1e-4, 1e4, 1e4, 1e-4), (1e4, 1e-4, 1e-4, 1e4)])
def test_steady_state_in_bad_units(units: tuple[float, ...], money: float) -> None:
    """The best steady state, its active row and the cost-to-go of the evaporation process do not depend on units."""
    plain, ocp = evaporation.process(5), OCP("units", T=5.0, N=5)
    d = np.array(units)
    a, b = ocp.state("a", initial=25 / d[0]), ocp.state("b", initial=54.7 / d[1])
    v = ocp.control("v", size=2)
    w = ca.vertcat(a, b, v) * d
    problem = classify(plain)
    x, u = problem.path.x, problem.path.u
    rates = problem.dynamics(w[:2], w[2:], [])
    cost = ca.Function("l", [x, u, problem.path.dt], [problem.path.cost])(w[:2], w[2:], 1.0)
    ocp.dynamics({a: rates[0] / d[0], b: rates[1] / d[1]})
    ocp.stage_cost(money * cost)
    ocp.subject_to(np.array([25, 40]) / d[:2], ca.vertcat(a, b), np.array([np.inf, 80]) / d[:2])
    ocp.subject_to(0, v, 400 / d[2:])
    best = steady_state(ocp, evaporation.options())
    np.testing.assert_allclose(best.w * d, [25, 49.742975, 191.713225, 215.888440], rtol=1e-7)
    assert best.active == (0,)
    ends = [lqr_terminal_cost(o, evaporation.options(), economic=True) for o in (plain, ocp)]
    np.testing.assert_allclose(ends[1].P * money**-1 / np.outer(d[:2], d[:2]), ends[0].P, atol=1e-6)
    np.testing.assert_allclose(ends[1].slope / money / d[:2], ends[0].slope, rtol=1e-7)


@pytest.mark.parametrize("end", [1e-33, -3e-20, 0.0])
def test_equation_at_the_end_is_no_unit(end: float) -> None:
    """x_N = x_s with x_s = 0 up to rounding: the least cost of u >= 0 is at 0, where u is held by its bound."""
    ocp = OCP("rounded", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(u + x**2)
    ocp.subject_to(0, u, 2)
    ocp.subject_to(end, x, end, at="end")
    for guess in (None, ([end], [1.0])):
        best = steady_state(ocp, guess=guess)
        assert best.size == pytest.approx([1.0, 2.0])
        assert best.active == (0,)
        np.testing.assert_allclose(best.w, 0, atol=1e-12)


def test_contradictory_rows_are_named() -> None:
    ocp = small(end=False)
    ocp.subject_to(-1, ocp.u, 1)
    ocp.subject_to(3, ocp.x, 4)
    with pytest.raises(ProblemError, match=r"no steady state was found .*(row|state) 'x'.*check rows"):
        steady_state(ocp)


@pytest.mark.parametrize("guess", [3, ([1.0],), ("a", "b"), ([1.0, 2.0, 3.0], [0.0]), ([np.nan], [0.0])])
def test_bad_guess(guess: object) -> None:
    with pytest.raises(ProblemError, match="guess"):
        steady_state(small(), guess=guess)


def test_bad_first_arguments() -> None:
    with pytest.raises(ProblemError, match="expected an OCP"):
        tune("small")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"expected Options\(...\)"):
        steady_state(small(), "RK4")  # type: ignore[arg-type]


def test_missing_terminal_cost_is_named() -> None:
    """Without a terminal cost -dP >= I must hold; an unstable system without a cost of x does not allow that."""
    ocp = OCP("unstable", N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: 2 * x + u}, discrete=True)
    ocp.stage_cost(u**2)
    with pytest.raises(ProblemError, match=r"M exists, but no positive definite M_f.*lqr_terminal_cost"):
        tune(ocp)
    ocp.lqr_terminal_cost(economic=True)
    assert np.linalg.eigvalsh(tune(ocp).M)[0] > 0


def test_missing_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    with pytest.raises(ExtraError, match=r"tune\(\) needs the package cvxpy: .*nmpc-codegen\[economic\]"):
        tune(small())


def test_other_grids_and_cyclic_states_are_refused() -> None:
    ocp = OCP("grid", intervals=[0.1, 0.2])
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(x**2 + u**2)
    with pytest.raises(ProblemError, match="intervals of different length"):
        tune(ocp)
    ocp = small()
    ocp.cyclic("x")
    with pytest.raises(ProblemError, match="all states are cyclic"):
        tune(ocp)


def test_dependence_on_a_cyclic_state_is_refused() -> None:
    ocp = OCP("cyclic", N=3)
    x, y, u = ocp.state("x"), ocp.state("y"), ocp.control("u")
    ocp.dynamics({x: x + y, y: 0.5 * y + u}, discrete=True)
    ocp.stage_cost(x**2 + y**2 + u**2)
    ocp.cyclic(x)
    with pytest.raises(ProblemError, match="the cost depends on x"):
        steady_state(ocp)


def test_no_steady_state() -> None:
    """A state that grows for ever and is not named."""
    ocp = OCP("grows", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: 1 + u**2})
    ocp.stage_cost(u**2)
    with pytest.raises(ProblemError, match=r"no steady state was found.*ocp\.cyclic"):
        steady_state(ocp)


def test_soft_row_that_is_violated_at_the_steady_state() -> None:
    ocp = small(end=False)
    ocp.subject_to(1, ocp.x, np.inf, soft=(0.1, 0.0))
    with pytest.raises(ProblemError, match="the soft row 'x' is violated at the steady state"):
        steady_state(ocp)


def test_scheme_of_the_options() -> None:
    """A and B are those of the scheme: x' = -x over 1 s gives 1 - 1 + 1/2 - 1/6 + 1/24 for one RK4 step."""
    ocp = OCP("decay", T=2.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(x**2 + u**2)
    t = tune(ocp, Options(integrator=ExplicitRungeKutta(RK4, steps=1)), eta=0)
    assert t.A[0, 0] == pytest.approx(0.375, abs=1e-14)
    assert tune(ocp).A[0, 0] == pytest.approx((1 - 0.5 + 0.125 - 0.125 / 6 + 0.0625 / 24) ** 2, abs=1e-14)
    assert t.dissipative
    assert "strictly dissipative at the steady state" in str(t)


def test_variables_that_are_not_coupled_have_no_products() -> None:
    """The lateral motion of the car is independent of its speed at the steady state: zeros, not rounding errors."""
    t = driving.tuned()
    lateral, along = [1, 3, 4, 7], [2, 5, 6]
    assert not np.any(t.M[np.ix_(lateral, along)])
    assert t.M_f is not None
    assert not np.any(t.M_f[np.ix_([1, 3, 4], [2])])
    assert np.all(t.M[np.ix_(lateral, lateral)])
