"""Soft and coupled rows in solve() and in the feedback phase, against IPOPT and the KKT residuals of NumPy."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    DenseActiveSet,
    Options,
    RealTimeIteration,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    build,
)
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.controller import Controller
from verification.routes import PURE


def pendulum(name: str) -> OCP:
    """A pendulum on N = 12 intervals: th'' = -sin th + u, |u| <= 0.7."""
    ocp = OCP(name, T=2.4, N=12)
    th, w, u = ocp.state("th", initial=0.6), ocp.state("w"), ocp.control("u")
    ocp.dynamics({th: w, w: -ca.sin(th) + u})
    ocp.least_squares(ca.vertcat(th, w, u), weight=[1.0, 0.1, 0.05])
    ocp.terminal_least_squares(ca.vertcat(th, w), weight=[2.0, 2.0])
    ocp.subject_to(-0.7, u, 0.7)
    return ocp


def soft_bound(l1: float, l2: float) -> OCP:
    """The speed has the soft lower bound -0.2: its multiplier at the optimum is about 0.5."""
    ocp = pendulum("soft_bound")
    ocp.subject_to(-0.2, ocp.x[1], np.inf, soft=(l1, l2), name="speed")
    return ocp


def soft_equality() -> OCP:
    """A soft equality at the end that the controls cannot satisfy, and a soft path row with the control."""
    ocp = pendulum("soft_equality")
    ocp.subject_to(-1.5, ocp.x[0], -1.5, at="end", soft=(0.3, 0.2), name="target")
    ocp.subject_to(-0.4, ocp.x[0] * ocp.x[1] + ocp.u, 0.5, soft=(0.02, 0.5), name="mixed")
    return ocp


def coupled() -> OCP:
    """x_0 given: th_N = 0.5 th_0 exactly, w_N + w_0 at most -0.05."""
    ocp = pendulum("coupled")
    start, end = ocp.at_start(ocp.x), ocp.at_end(ocp.x)
    ocp.boundary(0, end[0] - 0.5 * start[0], 0, name="halved")
    ocp.boundary(-np.inf, end[1] + start[1] ** 2, -0.05, name="falling")
    return ocp


CASES: dict[str, Callable[[], OCP]] = {
    "l1 not exact": lambda: soft_bound(0.05, 0.0),
    "l1 exact": lambda: soft_bound(50.0, 0.0),
    "soft equality": soft_equality,
    "coupled": coupled,
}

FORMS: dict[str, dict[str, Any]] = {
    "condensed": {"qp": DenseActiveSet()},
    "active set": {"qp": RiccatiActiveSet()},
    "interior point": {"qp": RiccatiInteriorPoint()},
}


@functools.cache
def controller(case: str, form: str) -> Controller:
    return build(CASES[case](), Options(**FORMS[form], algorithm=PURE), profile="test")


@pytest.mark.few(2)
@pytest.mark.parametrize("case", ["l1 not exact", "soft equality", "coupled"])
def test_multipliers_of_one_feedback(case: str) -> None:
    """All forms yield the same multipliers of the dynamics, whether from elimination or from the check of the QP."""
    ctrls = [controller(case, form) for form in FORMS]
    for ctrl in ctrls:
        ctrl.reset()
        ctrl.step([0.55, -0.1])
        assert ctrl.status == Status.OK
        np.testing.assert_allclose(ctrl.lam, ctrls[0].lam, atol=1e-8)
    assert np.all(np.max(np.abs(ctrls[0].lam), axis=1) > 1e-3)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_loop_with_violated_rows(precision: str) -> None:
    """Rows with both penalties that are violated, met and left, an equality among them: always OK, with one control."""
    dense, stages = (
        build(soft_equality(), Options(qp=qp, precision=precision), profile="test")
        for qp in (DenseActiveSet(), RiccatiInteriorPoint())
    )
    x, violated = np.array([0.6, 0.0]), []
    for sample in range(25):
        u = dense.step(x)
        assert dense.status == Status.OK
        np.testing.assert_allclose(u, stages.step(x), atol={"double": 1e-6, "single": 2e-3}[precision])
        violated.append(dense.stats.relaxed_rows)
        assert violated[-1] == np.sum(np.abs(dense.mu) > 0.0201) + np.sum(np.abs(dense.mu_x) > 0.301)
        x = np.asarray(dense.integrate(x, u, 0.2)) + (sample == 12) * np.array([0.5, -0.5])
    assert len(set(violated)) > 2


def test_an_exact_penalty_is_the_hard_row() -> None:
    hard = pendulum("hard_bound")
    hard.subject_to(-0.2, hard.x[1], np.inf, name="speed")
    x0 = np.array([0.6, 0.0])
    expected = build(hard, profile="test").solve(x0, tol=1e-10)
    ctrl = controller("l1 exact", "condensed")
    ctrl.reset()
    soft = ctrl.solve(x0, tol=1e-10)
    np.testing.assert_allclose(soft.u, expected.u, atol=1e-8)
    np.testing.assert_allclose(soft.mu_x, expected.mu_x, atol=1e-8)
    assert ctrl.stats.relaxed_rows == 0


def tight() -> OCP:
    """|th| <= 0.5, infeasible for th_0' outside."""
    ocp = pendulum("tight")
    ocp.subject_to(-0.5, ocp.x[0], 0.5, name="angle")
    return ocp


def test_infeasible_names_the_row_and_recovers() -> None:
    ctrl = build(tight(), Options(algorithm=PURE), profile="test")
    good, bad = np.array([0.4, 0.0]), np.array([0.4, 2.0])
    ctrl.step(good)
    assert ctrl.stats.violated_row is None
    plan = ctrl.u.copy()
    u0 = ctrl.step(bad)
    assert ctrl.status == Status.INFEASIBLE
    np.testing.assert_array_equal(u0, plan[0])
    np.testing.assert_array_equal(ctrl.u, plan)
    assert ctrl.stats.violated_row == "angle"
    assert ctrl.stats.violated_node in range(1, 13)
    assert ctrl.stats.violation > 1e-3
    with pytest.raises(ControllerError, match=r"(?s)INFEASIBLE.*row 'angle' at node \d+ is violated by"):
        ctrl.step(bad, on_failure="raise")
    ctrl.step(good)
    assert ctrl.status == Status.OK
    with pytest.raises(ControllerError, match=r"(?s)NOT_FINITE.*measured w"):
        ctrl.step([0.1, np.nan], on_failure="raise")


def test_relaxation_on_request() -> None:
    ctrl = build(tight(), Options(algorithm=RealTimeIteration()), profile="test", name="relaxed")
    bad = np.array([0.4, 2.0])
    u0 = ctrl.step(bad)
    assert ctrl.status == Status.RELAXED
    assert u0[0] == -0.7
    assert ctrl.stats.violated_row == "angle"
    soft = pendulum("softened")
    soft.subject_to(-0.5, soft.x[0], 0.5, soft=(1e4, 0.0), name="angle")
    expected = build(soft, profile="test")
    expected.step(bad)
    assert expected.status == Status.OK
    np.testing.assert_allclose(ctrl.u, expected.u, atol=1e-9)
    assert expected.stats.relaxed_rows > 0
