"""The first part of the feedback phase: a control before the QP is solved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    Controller,
    Options,
    Osqp,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    Status,
    build,
    generate,
)
from verification.problems import actuated_pendulum
from verification.routes import PURE, on

ROUTES = {route: on(route, algorithm=replace(PURE, levels=True)) for route in ("dense", "riccati", "partial")}


def problem(rows: str) -> OCP:
    """The pendulum; "closed": with a linear row between its ends, which can be reached at every sample."""
    if rows != "closed":
        return actuated_pendulum(rows)
    ocp = actuated_pendulum()
    angle = ocp.x[0]
    ocp.boundary(-0.5, ocp.at_end(angle) - 0.5 * ocp.at_start(angle), 0.5, name="closed")
    return ocp


@pytest.fixture(scope="module")
def made() -> Callable[[str, str], Controller]:
    """Controllers by route and rows, each built once."""
    known: dict[tuple[str, str], Controller] = {}

    def make(route: str, rows: str) -> Controller:
        if (route, rows) not in known:
            known[route, rows] = build(problem(rows), ROUTES[route], "test")
        return known[route, rows].copy()

    return make


def disturbed_loop(ctrl: Controller, samples: int = 40) -> list[tuple[float, int]]:
    """Deviation of the first part, and changes of the working set, of every sample; both parts against feedback()."""
    random, found = np.random.default_rng(0), []
    x = np.array([1.5, 0.0])
    whole = ctrl.copy()
    for _ in range(samples):
        ctrl.prepare()
        whole.prepare()
        first = ctrl.feedback_first(x)
        status = ctrl.feedback_finish()
        u = whole.feedback(x)
        assert status is whole.status
        np.testing.assert_array_equal(ctrl.u, whole.u)
        np.testing.assert_array_equal(ctrl.x, whole.x)
        assert (np.abs(first) <= [2, 0.5]).all()
        assert ctrl.stats.first_deviation == pytest.approx(np.abs(first - u).max(), abs=1e-12)
        assert status is Status.OK
        found.append((ctrl.stats.first_deviation, ctrl.stats.active_set_changes))
        x = ctrl.integrate(x, u, 0.1) + random.uniform(-0.1, 0.1, 2)
    return found


@pytest.mark.few(6)
@pytest.mark.parametrize("rows", ["", "soft", "hard", "closed"])
@pytest.mark.parametrize("route", ROUTES)
def test_it_is_the_control_of_the_qp_if_the_working_set_holds(made: Any, route: str, rows: str) -> None:
    found = disturbed_loop(made(route, rows))
    held = [deviation for deviation, changes in found if changes == 0]
    assert len(held) > 10
    assert max(held) < 1e-7
    assert rows or max(deviation for deviation, _ in found) > 1e-3


@pytest.mark.parametrize("route", ROUTES)
def test_it_does_not_solve_the_qp(made: Any, route: str) -> None:
    ctrl = made(route, "")
    ctrl.prepare()
    before = ctrl.u.copy()
    ctrl.feedback_first([1.0, 0.0])
    np.testing.assert_array_equal(ctrl.u, before)
    assert ctrl.feedback_finish() is Status.OK
    assert np.abs(ctrl.u - before).max() > 0.1


@pytest.mark.parametrize("route", ROUTES)
def test_references_that_change_after_prepare_are_heeded(made: Any, route: str) -> None:
    ctrl, whole = made(route, ""), made(route, "")
    for c in (ctrl, whole):
        c.prepare()
        c.set_reference([0.5, 0, 0, 0])
    first, u = ctrl.feedback_first([0.3, 0.0]), whole.feedback([0.3, 0.0])
    np.testing.assert_array_equal(first, u)
    assert ctrl.feedback_finish() is Status.OK
    assert ctrl.stats.first_deviation == 0


@pytest.mark.parametrize("xhat", [[np.nan, 0.0], [0.0, np.inf], [1e300, 1e300]])
@pytest.mark.parametrize("route", ROUTES)
def test_hostile_measurements(made: Any, route: str, xhat: list[float]) -> None:
    """The control is finite and inside its bounds; the second part has the status of feedback()."""
    ctrl, whole = made(route, ""), made(route, "")
    for c in (ctrl, whole):
        c.step([0.5, 0.0])
        c.prepare()
    first = ctrl.feedback_first(xhat)
    assert np.isfinite(first).all()
    assert (np.abs(first) <= [2, 0.5]).all()
    whole.feedback(xhat)
    assert ctrl.feedback_finish() is whole.status


def test_calls_in_the_wrong_order(made: Any) -> None:
    ctrl = made("dense", "")
    assert ctrl.feedback_finish() is Status.NOT_PREPARED
    ctrl.feedback_first([0.1, 0.0])
    assert ctrl.status is Status.NOT_PREPARED
    assert ctrl.feedback_finish() is Status.NOT_PREPARED
    ctrl.prepare()
    ctrl.feedback_first([0.1, 0.0])
    ctrl.prepare()  # discards the first part
    assert ctrl.feedback_finish() is Status.NOT_PREPARED
    ctrl.feedback([0.1, 0.0])
    assert ctrl.status is Status.OK


@pytest.mark.parametrize("xhat", [[0.3, 0.1], [np.nan, 0.0]])
@pytest.mark.parametrize("level", ["A", "B", "D"])
def test_an_iteration_between_both_parts_is_refused(made: Any, level: str, xhat: list[float]) -> None:
    """Its plan has another x_0 than the measured state: no OK for it, whatever the first part was."""
    ctrl = made("dense", "")
    ctrl.step([0.5, 0.0])
    ctrl.prepare()
    ctrl.feedback_first(xhat)
    ctrl.iterate(level)
    assert ctrl.feedback_finish() is Status.NOT_PREPARED
    ctrl.step([0.1, 0.0])
    np.testing.assert_allclose(ctrl.x[0], [0.1, 0.0], atol=1e-12)


def test_bounds_that_shrink_after_prepare_hold(made: Any) -> None:
    ctrl = made("riccati", "")
    ctrl.prepare()
    ctrl.set_bounds("torque", -0.01, 0.01)
    assert np.abs(ctrl.feedback_first([1.5, 0.0])[0]) <= 0.01
    assert ctrl.feedback_finish() is Status.OK
    assert np.abs(ctrl.u[:, 0]).max() <= 0.01


@pytest.mark.parametrize("qp", [RiccatiActiveSet(), RiccatiInteriorPoint(), Osqp()])
@pytest.mark.parametrize("measured", [True, False])
def test_it_exists_where_the_qp_solver_predicts_a_working_set(qp: Any, measured: bool) -> None:
    """And where x_0 is the measured state."""
    ocp = actuated_pendulum()
    if not measured:
        ocp.free_initial("angle")
    made = generate(ocp, Options(qp=qp, algorithm=replace(PURE, levels=True)))
    assert ("feedback_first" in made[f"{ocp.name}.h"]) == (measured and isinstance(qp, RiccatiActiveSet))
