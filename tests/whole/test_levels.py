"""Levels of an iteration: what is evaluated anew while the derivatives and factors of an earlier one are kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nmpc_codegen import (
    Controller,
    ControllerError,
    ExactHessian,
    Options,
    Status,
    build,
)
from verification import routes
from verification.problems import actuated_pendulum

LEVELS = replace(routes.PURE, levels=True)
ROUTES = {route: routes.on(route, algorithm=LEVELS) for route in routes.ROUTES}
ROUTES["exact"] = routes.on("dense", hessian=ExactHessian(), algorithm=LEVELS)
ROWS = ["", "soft", "hard", "closed", "end", "integrated"]
START = [0.8, 0.2]


@pytest.fixture(scope="module")
def made() -> Callable[[str, str], Controller]:
    """Controllers by route and rows, each built once."""
    known: dict[tuple[str, str], Controller] = {}

    def make(route: str, rows: str = "") -> Controller:
        if (route, rows) not in known:
            options = replace(ROUTES[route], hessian=ExactHessian()) if rows == "integrated" else ROUTES[route]
            known[route, rows] = build(actuated_pendulum(rows), options, "test")
        return known[route, rows].copy()

    return make


@pytest.mark.few(10)
@pytest.mark.parametrize(
    ("route", "rows"), [(route, rows) for route in ROUTES for rows in ROWS if route != "OSQP" or not rows]
)
def test_level_c_converges_to_the_optimum(made: Any, route: str, rows: str) -> None:
    """With the derivatives of one linearisation, far from the optimum: the KKT point is that of solve()."""
    solved, ctrl = made(route, rows), made(route, rows)
    optimum = solved.solve(START, tol=1e-6 if route == "OSQP" else 1e-10)
    assert optimum.status is Status.OK
    ctrl.step(START)
    ctrl.step(START)
    assert ctrl.iterate("A") is Status.OK
    errors = []
    for _ in range(60):
        assert ctrl.iterate("C") is Status.OK
        errors.append(np.abs(ctrl.u - optimum.u).max())
    accuracy = 1e-4 if route == "OSQP" else 1e-7
    assert errors[-1] < accuracy
    np.testing.assert_allclose(ctrl.x, optimum.x, atol=10 * accuracy)


@pytest.mark.parametrize("route", [r for r in ROUTES if r != "OSQP"])
def test_level_b_satisfies_rows_and_dynamics_alone(made: Any, route: str) -> None:
    ctrl = made(route, "hard")
    ctrl.step(START)
    for _ in range(30):
        assert ctrl.iterate("B") is Status.OK
    plan = ctrl.copy()
    plan.prepare()
    np.testing.assert_allclose(plan.view("node")["b"], 0, atol=1e-12)
    assert np.abs(plan.view("node")["h"]).max() <= 0.7 + 1e-9
    optimum = made(route, "hard").solve(START, tol=1e-10)
    assert np.abs(ctrl.u - optimum.u).max() > 1e-6


@pytest.mark.few(5)
@pytest.mark.parametrize("rows", ["", "soft"])
@pytest.mark.parametrize("route", [r for r in ROUTES if r != "OSQP"])
def test_level_d_is_the_qp_of_the_last_linearisation(made: Any, route: str, rows: str) -> None:
    """Its plan for another state is that of the same QP, and does not depend on the states in between."""
    ctrl, direct = made(route, rows), made(route, rows)
    for c in (ctrl, direct):
        c.prepare()
    expected = direct.feedback([0.31, -0.1])
    ctrl.feedback([0.2, 0.1])
    for x in ([0.4, 0.0], [0.1, 0.3], [0.31, -0.1]):
        assert ctrl.prepare(level="D") is Status.OK
        u = ctrl.feedback(x)
    np.testing.assert_allclose(u, expected, atol=1e-9)
    np.testing.assert_allclose(ctrl.x, direct.x, atol=1e-9)
    before = ctrl.u.copy()
    assert ctrl.iterate("D") is Status.OK
    np.testing.assert_allclose(ctrl.u, before, atol=1e-9)


@pytest.mark.parametrize("level", "BCD")
def test_there_is_a_linearisation_first(made: Any, level: str) -> None:
    """At first, after reset(), after solve() and after a failure every level is A."""
    ctrl, whole = made("dense"), made("dense")

    def same() -> None:
        ctrl.prepare(level=level)
        whole.prepare()
        np.testing.assert_array_equal(ctrl.feedback(START), whole.feedback(START))

    same()
    for c in (ctrl, whole):
        c.reset()
    same()
    for c in (ctrl, whole):
        c.solve(START, max_iterations=2)
    same()
    for c in (ctrl, whole):
        c.prepare()
        c.u[1] = np.nan
        c.step(START)
        assert c.status is not Status.OK
    same()


@pytest.mark.parametrize("level", "ABCD")
@pytest.mark.parametrize("route", ["dense", "riccati"])
def test_references_after_the_preparation_are_heeded(made: Any, route: str, level: str) -> None:
    ctrl, before = made(route, "soft"), made(route, "soft")
    for c in (ctrl, before):
        c.step(START)
    ctrl.prepare(level=level)
    for c in (ctrl, before):
        c.set_reference([0.2, 0, 0, 0])
    before.prepare(level="B" if level == "D" else level)
    np.testing.assert_allclose(ctrl.feedback(START), before.feedback(START), atol=1e-12)


def test_parameters_act_at_level_c(made: Any) -> None:
    """Parameters that the kept derivatives do not know change the optimum to which level C converges."""
    ctrl, solved = made("riccati"), made("riccati")
    ctrl.step(START)
    for c in (ctrl, solved):
        c.set_parameter("weight", 2.0)
    for _ in range(60):
        ctrl.iterate("C")
    np.testing.assert_allclose(ctrl.u, solved.solve(START, tol=1e-10).u, atol=1e-7)


def test_a_failed_iteration_changes_no_plan(made: Any) -> None:
    ctrl = made("dense")
    ctrl.step(START)
    good, status = ctrl.x.copy(), ctrl.status
    assert status is Status.OK
    ctrl.lam[2] = np.inf
    assert ctrl.iterate("C") is not Status.OK
    np.testing.assert_array_equal(ctrl.x, good)
    ctrl.lam[2] = 0
    assert ctrl.iterate("C") is Status.OK


def test_after_an_iteration_a_preparation_is_due(made: Any) -> None:
    ctrl = made("dense")
    ctrl.prepare()
    ctrl.iterate("A")
    ctrl.feedback(START)
    assert ctrl.status is Status.NOT_PREPARED


@pytest.mark.parametrize("level", ["E", "a", "AB", "", 0, None])
def test_levels_that_do_not_exist(made: Any, level: Any) -> None:
    with pytest.raises(ControllerError, match=r"level is .*; allowed: 'A', 'B', 'C', 'D'"):
        made("dense").prepare(level=level)
    with pytest.raises(ControllerError, match=r"level is .*; allowed"):
        made("dense").iterate(level)


def test_levels_that_do_not_exist_in_c(made: Any) -> None:
    ctrl = made("dense")
    for call in ("prepare_level", "iterate"):
        for level in (-1, 4):
            assert ctrl._call(call, ctrl._s, level) == Status.BAD_ARGUMENT


def test_a_package_without_levels_says_so() -> None:
    ctrl = build(actuated_pendulum(), Options(), "test")
    ctrl.prepare(level="A")
    with pytest.raises(ControllerError, match="without prepare_level"):
        ctrl.prepare(level="C")
    with pytest.raises(ControllerError, match="without iterate"):
        ctrl.iterate()


def test_the_law_of_the_first_control_belongs_to_level_a() -> None:
    """After other levels feedback_first() is the whole feedback phase."""
    algorithm = replace(routes.PURE, levels=True)
    for route in ("dense", "riccati"):
        ctrl = build(actuated_pendulum(), replace(ROUTES[route], algorithm=algorithm), "test")
        whole = ctrl.copy()
        for c in (ctrl, whole):
            c.step(START)
            c.prepare(level="C")
        np.testing.assert_array_equal(ctrl.feedback_first([0.5, 0.1]), whole.feedback([0.5, 0.1]))
        assert ctrl.feedback_finish() is Status.OK
        np.testing.assert_array_equal(ctrl.x, whole.x)
