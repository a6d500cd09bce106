"""What OK promises: the plan satisfies model and hard rows, controls leave inside rows on controls, no status stays."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    AdjointShooting,
    AugmentedLagrangian,
    Controller,
    DenseActiveSet,
    FullCondensing,
    Options,
    RealTimeIteration,
    RiccatiInteriorPoint,
    Status,
    build,
)
from verification import problems
from verification.strangers.problems import known
from verification.strangers.remedies import cart_in_a_box

DT, TURN = 0.1, 0.03
TOLERANCE = 0.1


# ---- controls inside a circle, |u| <= 1, with a reference that turns


def circle(box: float | None, price: float, terminal: bool) -> Controller:
    """x' = u - 0.3 x, |u|^2 <= 1; without a terminal cost the last control has no influence."""
    ocp = OCP("circle", T=1.0, N=10)
    x, u = ocp.state("x", size=2), ocp.control("u", size=2)
    r = ocp.parameter("r", size=2, value=[3, 0])
    ocp.dynamics({x: u - 0.3 * x})
    ocp.least_squares(ca.vertcat(x - r, u), weight=[1, 1, price, price])
    if terminal:
        ocp.terminal_least_squares(x - r, weight=[5, 5])
    if box:
        ocp.subject_to(-box, u, box)
    ocp.subject_to(-np.inf, ca.sumsqr(u), 1, name="circle")
    return build(ocp, profile="test")


class CircleByIpopt:
    """The optimal first control of the same problem, written apart from the product."""

    def __init__(self, price: float, terminal: bool) -> None:
        X, U = ca.SX.sym("X", 2, 11), ca.SX.sym("U", 2, 10)
        x_0, r = ca.SX.sym("x_0", 2), ca.SX.sym("r", 2)
        cost, rows = ca.SX(0), [X[:, 0] - x_0]
        decay = -0.3 * DT / 2
        half = 1 + decay + decay**2 / 2 + decay**3 / 6 + decay**4 / 24  # RK4 of a linear system, half an interval
        for k in range(10):
            cost += 0.5 * ca.sumsqr(X[:, k] - r) + 0.5 * price * ca.sumsqr(U[:, k])
            rows.append(half**2 * X[:, k] + (1 - half**2) / 0.3 * U[:, k] - X[:, k + 1])
        cost += 2.5 * ca.sumsqr(X[:, 10] - r) if terminal else 0
        rows += [ca.sumsqr(U[:, k]) for k in range(10)]
        nlp = {"x": ca.vertcat(ca.vec(X), ca.vec(U)), "p": ca.vertcat(x_0, r), "f": cost, "g": ca.vertcat(*rows)}
        quiet = {"print_time": 0, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
        self._solver = ca.nlpsol("circle", "ipopt", nlp, quiet)

    def __call__(self, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        guess = np.concatenate([np.zeros(22), np.tile(0.3 * r / np.linalg.norm(r), 10)])
        upper = np.concatenate([np.zeros(22), np.ones(10)])
        lower = np.concatenate([np.zeros(22), np.full(10, -np.inf)])
        w = np.asarray(self._solver(x0=guess, p=np.concatenate([x, r]), lbg=lower, ubg=upper)["x"]).ravel()
        return w[22:24]


@pytest.mark.filterwarnings("ignore:.*its gradient vanishes at the first plan")
@pytest.mark.parametrize(
    ("box", "price", "terminal"), [(None, 0.01, False), (2.0, 0.01, False), (1.0, 0.01, False), (None, 1.0, True)]
)
def test_controls_in_a_circle(box: float | None, price: float, terminal: bool) -> None:
    """Every control leaves inside the circle; with OK, the whole plan is, and the control is that of IPOPT."""
    c, optimum, x, good = circle(box, price, terminal), CircleByIpopt(price, terminal), np.zeros(2), 0
    for k in range(60):
        r = 3 * np.array([np.cos(TURN * k), np.sin(TURN * k)])
        c.set_parameter("r", r)
        u = np.asarray(c.step(x))
        assert u @ u <= 1 + 1e-9
        if c.status is Status.OK:
            good += 1
            assert np.max(np.sum(c.u**2, axis=1)) <= 1 + TOLERANCE
            if k > 5:
                # the box touches the circle at its bounds, where two rows have one gradient
                np.testing.assert_allclose(u, optimum(x, r), atol=0.25 if box == 1.0 else 0.02)
        x = np.asarray(c.integrate(x, u, DT))
    assert good >= 56


@pytest.mark.filterwarnings("ignore:.*its gradient vanishes at the first plan")
def test_a_control_of_a_failed_sample_stays_inside_rows_on_controls() -> None:
    """What is returned without a new plan is pulled back, too; the plan that a user has written may be outside."""
    c = circle(None, 0.01, False)
    c.step([0.0, 0.0])
    c.u[...] = 3.0
    u = np.asarray(c.step([np.nan, 0.0]))
    assert c.status is Status.NOT_FINITE
    assert u @ u <= 1 + 1e-9


# ---- rates of the first control


def cart(name: str = "cart", previous: bool = True) -> OCP:
    """A hard rate, and a hard limit of the speed that no plan meets at once where it is measured beyond it."""
    ocp = OCP(name, T=1.0, N=10)
    p, v, a = ocp.state("p", initial=1.0), ocp.state("v"), ocp.control("a")
    ocp.dynamics({p: v, v: a - 0.1 * v**3})
    ocp.least_squares(ca.vertcat(p, v, a), weight=[10, 1, 0.1])
    ocp.subject_to(-2, a, 2)
    ocp.subject_to(-1, v, 1)
    if previous:
        ocp.subject_to(-0.3, a - ocp.previous(a), 0.3, name="change")
    return ocp


RATES = {
    "default": Options(),
    "dense": Options(condensing=FullCondensing(), qp=DenseActiveSet()),
    "interior point": Options(qp=RiccatiInteriorPoint()),
    "one iteration": Options(algorithm=RealTimeIteration(iterations=1)),
    "augmented Lagrangian": Options(algorithm=AugmentedLagrangian()),
    "adjoint shooting": Options(algorithm=AdjointShooting()),
}


@pytest.mark.parametrize("options", RATES)
def test_a_rate_of_the_first_control_holds_whatever_the_status(options: str) -> None:
    """As bounds do: a row on the first control, the one before and data can be kept whatever the state is."""
    c, x, applied = build(cart(), RATES[options], "test"), np.array([1.0, 0.0]), 0.0
    for measured in (x, [0.5, 1.2], [0.5, 2.0], [0.5, 5.0], [np.nan, 0.0], [1e200, 1e200], [-3.0, -0.5], x):
        if c.description.has_phases:  # without a preparation
            u = float(c.copy().feedback(measured)[0])
            assert abs(u - applied) <= 0.3 * (1 + 1e-9)
        u = float(c.step(measured)[0])
        assert abs(u - applied) <= 0.3 * (1 + 1e-9), c.status
        applied = u
    applied = float(c.u[0, 0])
    c.u[...] = 2.0
    assert abs(float(c.step([0.1, np.inf])[0]) - u) <= 0.3 * (1 + 1e-9)


def test_a_rate_of_the_plan_of_a_solve_that_fails() -> None:
    c = build(cart(), profile="test")
    u = float(c.step([1.0, 0.0])[0])
    solution = c.solve([0.5, 5.0])
    assert solution.status is not Status.OK
    assert abs(solution.u[0, 0] - u) <= 0.3 * (1 + 1e-9)


def test_several_rows_of_the_first_control_hold_together() -> None:
    """Rates of two controls and a sum that a parameter limits, met by moves onto one row after the other."""
    ocp = OCP("pair", T=1.0, N=10)
    v, a, b, most = ocp.state("v"), ocp.control("a"), ocp.control("b"), ocp.parameter("most", value=1.0)
    ocp.dynamics({v: a + b - 0.1 * v**3})
    ocp.least_squares(ca.vertcat(v - 3, a, b), weight=[10, 0.1, 0.2])
    ocp.subject_to(-2, ca.vertcat(a, b), 2)
    ocp.subject_to(-0.2, v, 0.2)
    ocp.subject_to(-0.3, a - ocp.previous(a), 0.3, name="change_a")
    ocp.subject_to(-0.4, b - ocp.previous(b), 0.4, name="change_b")
    ocp.subject_to(-np.inf, a + b - most, 0, name="sum")
    c, before = build(ocp, profile="test"), np.zeros(2)
    for k, measured in enumerate((0.0, 0.5, 2.0, -3.0, -1.0, 4.0, 0.1, -2.0, -2.0, -2.0)):
        if k == 7:
            c.set_parameter("most", 0.5)
        u = c.step([measured])
        assert (np.abs(u - before) <= np.array([0.3, 0.4]) * (1 + 1e-6)).all()
        assert u.sum() <= (0.5 if k > 6 else 1.0) + 1e-6
        before = u


# ---- plans that are far from the model, or still move


def test_a_plan_that_escapes_to_infinity_is_not_converged() -> None:
    """x' = x^3 + u from rest; from a measured 3 the model has no finite state, whatever the control."""
    ocp = OCP("escape", T=2.0, N=20)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: x**3 + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1, 0.1])
    ocp.terminal_least_squares(x, weight=5)
    ocp.subject_to(-1, u, 1)
    c = build(ocp, profile="test")
    for _ in range(5):
        c.step([0.0])
    for measured in (0.3, 0.8, 1.2, 2.0, 3.0, 30.0):
        d = c.copy()
        d.step([measured])
        ends = np.array([d.integrate(d.x[k], d.u[k], DT) for k in range(20)])
        gap = np.max(np.abs(ends - d.x[1:])) / max(measured, float(np.max(np.abs(c.x))))
        far = max(gap, d.kkt().relative) > TOLERANCE
        assert d.status is (Status.NOT_CONVERGED if far else Status.OK), measured


def one_state() -> OCP:
    """An unstable state whose cost has ripples: first plans creep along a saddle; u = 1.0555 is right at the start."""
    ocp = OCP("one", T=4.0, N=40)
    x, u = ocp.state("x", initial=-0.13750148), ocp.control("u")
    ocp.dynamics({x: 0.5272117 * x + 1.2804641 * ca.sin(2 * x) - 1.2758098 * ca.exp(-(x**2)) + 2.1242732 * u})
    ripples = 3.0534962 * (ca.sqrt(1 + x**2) - 1) + 0.5 * 0.0971212 * u**2 + 0.1 * ca.cos(3 * x)
    ocp.stage_cost(ripples, scale_with_dt=False)
    ocp.terminal_cost(2 * 3.0534962 * x**2)
    ocp.subject_to(-1.0555491, u, 1.0555491)
    ocp.subject_to(-1.2530545, x + 0.5 * u, 1.2530545, name="mixed")
    ocp.subject_to(-0.5, x, 0.5, at="end", name="end")
    return ocp


def test_a_first_plan_that_creeps_is_not_called_ok() -> None:
    c, x = build(one_state(), profile="test"), np.array([-0.13750148])
    statuses = []
    for _ in range(45):
        right = float(c.copy().solve(x).u[0, 0])
        u = c.step(x)
        if c.status is Status.OK:
            assert abs(float(u[0]) - right) <= TOLERANCE * 2 * 1.0555
        statuses.append(c.status)
        x = np.asarray(c.integrate(x, u, DT))
    assert statuses.count(Status.OK) >= 40
    assert abs(float(x[0])) < 0.1


@pytest.mark.parametrize("solved", [False, True])
def test_a_plan_follows_a_hard_limit_that_bends(solved: bool) -> None:
    """A sample goes on where its step leaves the limit; otherwise the cell is 2.4 K too hot."""
    c, x, hottest, good = build(known("charge").ocp(), profile="test"), np.array([0.1, 25.0]), 0.0, 0
    if solved:
        c.solve(x)
    for _ in range(110):
        u = c.step(x)
        good += c.status is Status.OK
        x = np.asarray(c.integrate(x, u, 30.0))
        hottest = max(hottest, float(x[1]))
    assert hottest <= 42.02
    assert good >= 108
    assert x[0] > 0.85


# ---- no status stays for ever


@pytest.mark.parametrize("N", [20, 50])
def test_relaxed_ends_where_the_way_back_leads_through_larger_violations(N: int) -> None:
    """The cart is outside of its limit of speed, and can only slow down by going faster first."""
    ocp, A, B = cart_in_a_box(N)
    c, x, relaxed = build(ocp, profile="test"), np.array([1.0, 0, 0, 0]), 0
    for _ in range(500):
        u = c.step(x)
        relaxed += c.status is Status.RELAXED
        x = A @ x + B @ u
    assert c.status is Status.OK
    assert 0 < relaxed < 100
    np.testing.assert_allclose(x, 0, atol=0.01)


def test_the_price_of_rows_on_controls_does_not_fall() -> None:
    """A limit of the sum of two controls holds while a state is outside for good."""
    ocp = OCP("pushed", T=1.0, N=10)
    x, u, push = ocp.state("x"), ocp.control("u", size=2), ocp.parameter("push", value=0.0)
    ocp.dynamics({x: u[0] + u[1] + push})
    ocp.least_squares(ca.vertcat(x, u), weight=[1, 0.01, 0.01])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-1, u[0] + u[1], 1, name="sum")
    ocp.subject_to(-0.5, x, 0.5, name="room")
    c, state = build(ocp, profile="test"), np.array([0.0])
    c.set_parameter("push", 1.5)
    for _ in range(80):
        u_0 = c.step(state)
        assert abs(u_0[0] + u_0[1]) <= 1 + 1e-6
        state = np.asarray(c.integrate(state, u_0, DT))
    assert c.status is Status.RELAXED
    assert np.sum(u_0) == pytest.approx(-1, abs=1e-4)  # as far back as it can
    c.set_parameter("push", 0.0)
    statuses = []
    for _ in range(80):
        u_0 = c.step(state)
        statuses.append(c.status)
        state = np.asarray(c.integrate(state, u_0, DT))
    assert statuses[-1] is Status.OK
    assert abs(float(state[0])) < 0.01


@pytest.mark.parametrize("factor", [1e3, 1e6, 1e12, 1e20])
def test_a_weight_of_one_sample_leaves_no_status_behind(factor: float) -> None:
    """Single shooting, after good data: OK within 20 samples, and the same control as without that sample."""
    ocp: Any = problems.CASES["crane"].make()
    c = build(ocp, Options(algorithm=AdjointShooting()), profile="test")
    x = [2.0, 0, 0, 0]
    for _ in range(50):
        right = c.step(x)
    weight = np.array(c.view("W")[0])
    weight = weight if weight.ndim == 2 else np.diag(weight)
    c.set_weight(weight * factor)
    c.step(x)
    c.set_weight(weight)
    for _ in range(20):
        u = c.step(x)
    assert c.status is Status.OK
    np.testing.assert_allclose(u, right, atol=1e-3)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_sample_without_a_plan_is_relaxed_in_both_precisions(precision: Any) -> None:
    """An elevator that is above its upper end: the multipliers of the relaxed row are no reason to fail."""
    ocp = OCP("elevator", T=4.0, N=20)
    z, v, force = ocp.state("z", initial=20.0, unit="m"), ocp.state("v"), ocp.control("force", unit="N")
    ocp.dynamics({z: v, v: force / 1200 - 9.81})
    ocp.least_squares(ca.vertcat(z - 40, v, force - 11772), weight=[1, 0.1, 1e-9])
    ocp.terminal_least_squares(z - 40, weight=10)
    ocp.subject_to(0, z, 30)
    ocp.subject_to(-2.5, v, 2.5)
    ocp.subject_to(9000, force, 14500)
    c = build(ocp, Options(precision=precision), "test")
    for above in ([30.0016, 0.2437], [30.01, 0.4]):
        d = c.copy()
        u = d.step(above)
        assert d.status is Status.RELAXED
        np.testing.assert_allclose(u, 9000.0)


@pytest.mark.parametrize(
    ("order", "N", "T", "reach", "start"), [(1, 10, 1.0, 0.3, 4.0), (1, 40, 4.0, 0.3, 3.0), (2, 20, 2.0, 1.0, 1.0)]
)
def test_relaxed_samples_come_back_to_a_bound_that_holds(
    order: int, N: int, T: float, reach: float, start: float
) -> None:
    """x <= 1 with a reference beyond it: no plan rests outside because violations are cheap, and no QP is given up."""
    ocp = OCP("back", T=T, N=N)
    x, u = ocp.state("x"), ocp.control("u")
    v = ocp.state("v") if order == 2 else None
    ocp.dynamics({x: u} if v is None else {x: v, v: u})
    ocp.least_squares(ca.vertcat(x - 5, u), weight=[1, 1e-3])
    ocp.subject_to(-10, x, 1)
    ocp.subject_to(-reach, u, reach)
    c, state, statuses = build(ocp, profile="test"), np.full(order, start), []
    for _ in range(250):
        u_0 = c.step(state)
        statuses.append(c.status)
        state = np.asarray(c.integrate(state, u_0, T / N))
    assert set(statuses[150:]) == {Status.OK}
    assert state[0] == pytest.approx(1.0, abs=1e-3)
