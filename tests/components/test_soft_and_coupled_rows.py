"""Soft and coupled rows in solve() and in the feedback phase, against IPOPT and the KKT residuals of NumPy."""

from __future__ import annotations

import functools
import itertools
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
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference
from nmpc_codegen.oracle.trajectory import kkt_residuals, node_data
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.controller import Controller
from verification import problems
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


def periodic() -> OCP:
    """x_0 free, a period of a driven orbit."""
    ocp = pendulum("periodic")
    ocp.free_initial(*(ocp.x[i] for i in range(2)))
    ocp.boundary(0, ocp.at_start(ocp.x) - ocp.at_end(ocp.x), 0, name="period")
    ocp.subject_to(0.3, ocp.x[0], 0.3, at=[6], name="pass")
    return ocp


def partly_free() -> OCP:
    """th_0 given, w_0 free; a hard nonlinear row on both ends, and one with a penalty."""
    ocp = pendulum("partly_free")
    ocp.free_initial(ocp.x[1])
    start, end = ocp.at_start(ocp.x), ocp.at_end(ocp.x)
    ocp.boundary(0, end[1] - start[1] - 0.3 * start[0] * end[0], 0, name="swing")
    ocp.boundary(-np.inf, end[0] + start[1] ** 2, 0.05, soft=(0.2, 1.0), name="low")
    return ocp


def soft_periodic() -> OCP:
    ocp = pendulum("soft_periodic")
    ocp.boundary(0, ocp.at_start(ocp.x) - ocp.at_end(ocp.x), 0, soft=(0.5, 0.1), name="period")
    return ocp


CASES: dict[str, Callable[[], OCP]] = {
    "l1 not exact": lambda: soft_bound(0.05, 0.0),
    "l1 exact": lambda: soft_bound(50.0, 0.0),
    "l1 and l2": lambda: soft_bound(0.05, 2.0),
    "l2 alone": lambda: soft_bound(0.0, 3.0),
    "soft equality": soft_equality,
    "coupled": coupled,
    "periodic": periodic,
    "partly free": partly_free,
    "soft periodic": soft_periodic,
}

FORMS: dict[str, dict[str, Any]] = {
    "condensed": {"qp": DenseActiveSet()},
    "active set": {"qp": RiccatiActiveSet()},
    "interior point": {"qp": RiccatiInteriorPoint()},
}


@functools.cache
def controller(case: str, form: str) -> Controller:
    return build(CASES[case](), Options(**FORMS[form], algorithm=PURE), profile="test")


@functools.cache
def ipopt(case: str) -> Reference:
    return Reference(classify(CASES[case]()))


#: Forms in turn; test_stage_qps.py has soft, coupled and free rows in QPs of all solvers.
PICKS = [
    (case, "condensed" if case == "partly free" else form)
    for case, form in zip(CASES, itertools.cycle(FORMS), strict=False)
]


@pytest.mark.few(6)
@pytest.mark.parametrize(("case", "form"), PICKS)
def test_equal_to_ipopt(case: str, form: str) -> None:
    problem = ipopt(case).problem
    ctrl = controller(case, form)
    ctrl.reset()
    solution = ctrl.solve(problem.x_initial, tol=1e-10, max_iterations=200)
    assert solution.status == Status.OK
    reference = ipopt(case).solve(node_data(problem, x0=problem.x_initial), x=solution.x, u=solution.u)
    assert reference.success
    np.testing.assert_allclose(solution.u, reference.u, atol=2e-6)
    np.testing.assert_allclose(solution.x, reference.x, atol=2e-6)
    np.testing.assert_allclose(solution.cost, reference.cost, rtol=1e-8)
    np.testing.assert_allclose(solution.eta, reference.eta, atol=1e-5)
    np.testing.assert_allclose(solution.mu_x, reference.mu_x, atol=1e-5)
    residuals = kkt_residuals(problem, problems.point(solution), node_data(problem, x0=problem.x_initial))
    assert residuals.worst <= 1e-9
    assert max(solution.kkt.__dict__.values()) <= 1e-9  # judged relative to the terms that they sum


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
