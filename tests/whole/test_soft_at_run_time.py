"""Penalties that change at run time, by side, scaled and switched. Oracle: IPOPT with the same penalties declared."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    AdjointShooting,
    ControllerError,
    DenseActiveSet,
    Online,
    OptionError,
    Options,
    ProblemError,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    Soft,
    Status,
    build,
    generate,
    simulate,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference, ReferenceSolution, node_data
from nmpc_codegen.runtime.controller import Controller

N, X0 = 8, np.array([1.0, -0.2])
ROUTES = {
    "dense": Options(qp=DenseActiveSet()),
    "stages": Options(qp=RiccatiActiveSet()),
    "interior": Options(qp=RiccatiInteriorPoint()),
}


def pendulum() -> tuple[OCP, Any, Any]:
    """A pendulum that the cost drives against limits of its rate and torque."""
    ocp = OCP("pend", intervals=[0.1, 0.1, 0.2, 0.2, 0.2, 0.2, 0.1, 0.1])
    q, w, u = ocp.state("q", initial=1.0), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) + u})
    ocp.least_squares(ca.vertcat(q, w, u), weight=[5, 0.3, 0.1])
    ocp.terminal_least_squares(ca.vertcat(q, w), weight=[5, 1])
    ocp.subject_to(-3, u, 3)
    return ocp, w, u + 0.5 * q


def sides(lower: Any, upper: Any, scaled: bool = False) -> OCP:
    ocp, w, effort = pendulum()
    ocp.subject_to(-0.6, w, 0.3, soft=Soft(lower, upper, scale_with_dt=scaled), name="speed")
    ocp.subject_to(-1.0, effort, 0.5, soft=Soft(upper, upper, scale_with_dt=scaled), name="effort")
    return ocp


def switched(l2: float, hard: list[int] | None = None, l1: float = 0.0) -> OCP:
    """The rate is hard at nodes ``hard`` and soft at the others; None: hard, and soft on request."""
    ocp, w, _ = pendulum()
    if hard is None:
        ocp.subject_to(-0.6, w, 0.3, soft=(math.inf, l2), name="speed")
        return ocp
    soft = [k for k in range(1, N + 1) if k not in hard]
    for nodes, penalty in ((hard, None), (soft, (l1, l2))):
        if nodes:
            ocp.subject_to(-0.6, w, 0.3, at=nodes, soft=penalty, name="soft" if penalty else "hard")
    return ocp


def best(ocp: OCP) -> ReferenceSolution:
    problem = classify(ocp)
    return Reference(problem).solve(node_data(problem, x0=X0))


@cache
def built(route: str, kind: str, precision: str = "double") -> Controller:
    options = replace(ROUTES[route], precision=precision, online=Online(soft="node"))
    ocp = {
        "sides": lambda: sides((3.0, 2.0), (1.0, 4.0)),
        "one": lambda: sides((1.0, 1.0), (1.0, 1.0)),
        "scaled": lambda: sides((3.0, 2.0), (1.0, 4.0), scaled=True),
        "linear": lambda: switched(0.0),
        "quadratic": lambda: switched(2.0),
    }[kind]()
    return build(ocp, options, "test")


def fresh(route: str, kind: str, precision: str = "double") -> Controller:
    ctrl = built(route, kind, precision).copy()
    ctrl.reset()
    return ctrl


@pytest.mark.few(3)
@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("kind", ["sides", "one", "scaled"])
def test_penalties_of_sides(route: str, kind: str) -> None:
    ctrl = fresh(route, kind)
    low, high = ((0.5, 3.0), (2.0, 1.0)) if kind != "one" else ((0.7, 3.0), (0.7, 3.0))
    ctrl.set_soft({"speed": Soft(low, high), "effort": high})
    found, expected = ctrl.solve(X0, tol=1e-10), best(sides(low, high, scaled=kind == "scaled"))
    assert found.status.name == "OK"
    np.testing.assert_allclose(found.u, expected.u, atol=1e-8)
    assert found.cost == pytest.approx(expected.cost, rel=1e-8)
    if kind == "sides":
        ctrl.set_soft("speed", Soft(upper=(5.0, 1.0)))
        found, expected = ctrl.solve(X0, tol=1e-10), best(sides_of_speed(low, (5.0, 1.0), high))
        np.testing.assert_allclose(found.u, expected.u, atol=1e-8)


def sides_of_speed(lower: Any, upper: Any, effort: Any) -> OCP:
    ocp, w, e = pendulum()
    ocp.subject_to(-0.6, w, 0.3, soft=Soft(lower, upper), name="speed")
    ocp.subject_to(-1.0, e, 0.5, soft=effort, name="effort")
    return ocp


@pytest.mark.few(3)
@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("kind", ["linear", "quadratic"])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_hard_becomes_soft_and_back_by_node(route: str, kind: str, precision: str) -> None:
    ctrl, l2 = fresh(route, kind, precision), 2.0 if kind == "quadratic" else 0.0
    double = precision == "double"
    for hard in (list(range(1, N + 1)), [1, 2, 3], [5, 6, 7, 8], [], list(range(1, N + 1))):
        l1 = np.full(N + 1, 0.2)
        l1[hard] = math.inf
        ctrl.set_soft("speed", (l1, l2))
        found, expected = ctrl.solve(X0, tol=1e-10 if double else None), best(switched(l2, hard, 0.2))
        assert found.status.name == "OK"
        np.testing.assert_allclose(found.u, expected.u, atol=1e-8 if double else 3e-4)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("kind", ["linear", "quadratic"])
def test_loops_with_penalties_that_change(route: str, kind: str) -> None:
    """Every sample has other penalties, set between the phases too; a hard row holds wherever the status is OK, and the
    loop comes to rest once they stay."""
    ctrl, l2 = fresh(route, kind), 2.0 if kind == "quadratic" else 0.0
    random = np.random.default_rng(3)

    def change(k: int, c: Controller) -> None:
        if k < 60:
            l1 = np.where(random.random(N + 1) < 0.5, math.inf, 10.0 ** random.uniform(-2, 2, N + 1))
            if k % 3 == 0:
                c.prepare()
            c.set_soft("speed", (l1, l2 * 10.0 ** random.uniform(-1, 1, N + 1) if l2 else 0.0))
        else:
            c.set_soft("speed", (math.inf, l2))

    def kick(k: int, x: Any) -> Any:
        return random.normal(scale=0.05, size=2) if k < 90 else [0.0, 0.0]

    log = simulate(ctrl, [0.5, 0.0], 130, dt=0.1, before=change, disturbance=kick)
    assert set(log.status[100:]) == {0}
    assert np.abs(log.x[-1]).max() < 1e-2
    failures = [s for s in log.status if s not in (0, 3, 13)]  # OK, RELAXED, NOT_CONVERGED
    assert not failures


@pytest.mark.usefixtures("compiler")
def test_bounds_and_names_of_a_row_with_two_sides() -> None:
    ctrl = build(sides((3.0, 2.0), (1.0, 4.0)), profile="test")
    assert ctrl.names.rows == ("u", "speed_lower", "speed_upper", "effort")
    ctrl.set_bounds("speed", -0.5, 0.2)
    np.testing.assert_array_equal(ctrl.view("lower")[0, 1:3], [-0.5, -np.inf])
    np.testing.assert_array_equal(ctrl.view("upper")[0, 1:3], [np.inf, 0.2])
    ctrl.set_bounds("speed_upper", -np.inf, 0.1, node=N)
    np.testing.assert_array_equal(ctrl.view("upper")[:, 2], [0.2, 0.1])
    ctrl.set_soft("speed", (7.0, 8.0))
    np.testing.assert_array_equal(ctrl.view("soft_l1")[:, :2], np.full((2, 2), 7.0))
    with pytest.raises(ControllerError, match="expected node None or 8"):
        ctrl.set_soft("speed", (7.0, 8.0), node=2)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("name", "soft", "message"),
    [
        ("speed", (1.0, 0.0), "expected a positive l2, as declared"),
        ("speed", 1.0, "expected a positive l2, as declared"),
        ("speed", (-1.0, 1.0), "expected numbers >= 0"),
        ("speed", (np.nan, 1.0), "expected numbers >= 0"),
        ("speed", (math.inf, 1.0), "is infinite, but was declared 1"),
        ("speed", Soft(lower=(1.0, 2.0)), "the same on both sides, as it was declared"),
        ("speed", Soft(), "names no side"),
        ("speed", (np.ones(N + 1), np.ones(3)), "has shape"),
        (3, 1.0, "no row 3"),
        ("speed", Soft((1.0, 2.0), (1.0, 2.0), True), "scale_with_dt is declared"),
        ("speed", None, r"is None; expected \(l1, l2\)"),
        ("speed", (np.ones(N), 1.0), r"has shape \(8,\); expected .*\(9,\)"),
        ("u", (1.0, 1.0), "'u' is hard: state it with soft"),
        ("spin", (1.0, 1.0), "no row 'spin'"),
    ],
)
def test_refused_penalties_change_nothing(name: str, soft: Any, message: str) -> None:
    ctrl = fresh("dense", "one")
    before = ctrl._memory.copy()
    with pytest.raises(ControllerError, match=message):
        ctrl.set_soft({"effort": (1.0, 5.0), name: soft})
    np.testing.assert_array_equal(ctrl._memory, before)


def test_what_is_refused_at_export() -> None:
    with pytest.raises(ProblemError, match=r"soft lower=.* must be nonnegative"):
        sides((-1.0, 2.0), None)
    with pytest.raises(ProblemError, match="names no side"):
        sides(None, None)
    with pytest.raises(
        OptionError, match=r"uses rows with an infinite penalty \(speed\), which algorithm AdjointShooting"
    ):
        generate(switched(1.0), Options(algorithm=AdjointShooting()))
    fixed = generate(sides((3.0, 2.0), (1.0, 4.0)), Options(online=Online(soft="fixed")))
    assert "pend_set_soft(" not in fixed["pend.h"]


@pytest.mark.usefixtures("compiler")
def test_one_side_may_be_hard() -> None:
    """Soft(upper=...) leaves the lower side hard; where there is no lower bound the row is one."""
    ocp, w, _ = pendulum()
    ocp.subject_to(-0.6, w, 0.3, soft=Soft(upper=(0.2, 1.0)), name="speed")
    found = build(ocp, profile="test").solve(X0, tol=1e-10)
    np.testing.assert_allclose(found.u, best(ocp).u, atol=1e-8)
    assert found.x[1:, 1].min() >= -0.6 - 1e-8
    ocp, w, _ = pendulum()
    ocp.subject_to(-np.inf, w, 0.3, soft=Soft(upper=(0.2, 1.0)), name="speed")
    assert [r.name for r in classify(ocp).rows] == ["u", "speed"]
    ctrl = build(ocp, profile="test")
    ctrl.set_soft("speed", Soft(upper=(0.3, 1.0)))
    ctrl.set_bounds("speed", -np.inf, 0.2)
    with pytest.raises(ControllerError, match="it has the upper side alone"):
        ctrl.set_soft("speed", Soft(lower=(0.3, 1.0)))
    with pytest.raises(ControllerError, match="it has the upper side alone; state it with both bounds"):
        ctrl.set_bounds("speed", -0.2, 0.2)


def test_rows_of_two_sides_are_stated_all_or_not() -> None:
    """Names, contradictions and elements without a bound, of both sides at once."""
    ocp, w, effort = pendulum()
    two = Soft((1.0, 0.0), (2.0, 0.0))
    ocp.subject_to(-1, effort, 1, name="f_upper")
    before = len(ocp.statements)
    with pytest.raises(ProblemError, match="clashes with 'f_upper'"):
        ocp.subject_to(-1, w + effort, 1, name="f", soft=two)
    assert len(ocp.statements) == before
    ocp.subject_to(-1, w, 1, soft=two)
    with pytest.raises(ProblemError, match="contradicts"):
        ocp.subject_to(1.5, w, 2, soft=two)
    ocp.subject_to(-1, w + effort, 1, name="s", soft=two)
    with pytest.raises(ProblemError, match="the row name 's' clashes"):
        ocp.subject_to(-1, w - effort, 1, name="s")
    ocp.subject_to([-1, -np.inf], ca.vertcat(w * effort, w - effort), [1, 1], name="r", soft=Soft(upper=(1.0, 0.0)))
    names = [r.name for r in classify(ocp).rows]
    assert names == ["u", "f_upper", "w_lower", "w_upper", "s_lower", "s_upper", "r[1]", "r[0]_lower", "r[0]_upper"]


@pytest.mark.usefixtures("compiler")
def test_the_only_node_of_a_coupled_row() -> None:
    ocp, w, _ = pendulum()
    ocp.boundary(0, ocp.at_start(w) - ocp.at_end(w), 0, name="period", soft=(1.0, 0.0))
    ctrl = build(ocp, Options(online=Online(soft="node", bounds="node")), "test")
    for call in (lambda: ctrl.set_soft("period", 0.1, node=0), lambda: ctrl.set_bounds("period", 0, 1, node=0)):
        with pytest.raises(ControllerError, match=r"does not hold at node 0, but at \[8\]"):
            call()
    ctrl.set_soft("period", 0.1, node=N)
    number = [r.name for r in ctrl.description.rows].index("period")
    assert ctrl._call("set_soft", ctrl._s, number, 0, 0.2, 0.0) == Status.BAD_INDEX
    one, none = (ctrl._package.ffi.new("pend_real[]", [value] * N) for value in (0.2, 0.0))
    assert ctrl._call("set_soft_range", ctrl._s, number, 0, N, one, none) == Status.BAD_INDEX


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("kind", ["linear", "quadratic"])
@pytest.mark.parametrize("before", [0.2, math.inf])
def test_what_is_set_between_the_phases_waits_for_the_next_prepare(route: str, kind: str, before: float) -> None:
    l2, x, late = 2.0 if kind == "quadratic" else 0.0, [1.0, -1.5], math.inf if before < 1 else 0.2
    plain, changed = fresh(route, kind), fresh(route, kind)
    for ctrl in (plain, changed):
        ctrl.set_soft("speed", (before, l2))
        ctrl.step([1.0, -0.2])
        ctrl.prepare()
    changed.set_soft("speed", (late, l2))
    np.testing.assert_array_equal(changed.feedback(x), plain.feedback(x))
    assert (changed.status, changed.cost) == (plain.status, plain.cost)
    plain.set_soft("speed", (late, l2))
    np.testing.assert_array_equal(changed.step(x), plain.step(x))
