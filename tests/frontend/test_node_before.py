"""Previous controls, rates, blocks, time and discrete states: what an OCP refuses, and what it warns of."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import casadi as ca
import pytest

from nmpc_codegen import OCP, generate
from nmpc_codegen.economic import steady_state
from nmpc_codegen.errors import ProblemError, ProblemWarning
from nmpc_codegen.frontend.classify import classify


def stated() -> tuple[OCP, Any, Any]:
    """(ocp, state, control) of an integrator."""
    ocp = OCP("stated", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(u, 1.0)
    return ocp, x, u


def classified(state: Callable[[OCP, Any, Any], object]) -> object:
    ocp, x, u = stated()
    state(ocp, x, u)
    return classify(ocp)


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (lambda ocp, x, u: ocp.previous(x), "previous: 'x' is no control; declared are: u"),
        (lambda ocp, x, u: ocp.rate("v"), "rate: 'v' is no control"),
        (lambda ocp, x, u: ocp.terminal_cost(ocp.rate(u) ** 2), "contains the control 'u'"),
        (lambda ocp, x, u: ocp.start_cost(ocp.previous(u)), r"ocp\.previous\(u\), which may not occur there"),
        (lambda ocp, x, u: ocp.boundary(0, ocp.at_end(x) + ocp.time, 1), r"ocp\.time, which may not occur there"),
        (lambda ocp, x, u: ocp.subject_to(0, ocp.time, 1), "depends on no state and no control"),
        (lambda ocp, x, u: ocp.subject_to(0, ocp.previous(u), 1, at="start"), "constrains states alone at node 0"),
        (lambda ocp, x, u: ocp.control("v", hold=[1, 2]), "control 'v': hold: the lengths sum up to 3, expected 5"),
        (lambda ocp, x, u: ocp.control("v", hold=[0, 5]), "hold: length must be an integer >= 1"),
        (lambda ocp, x, u: ocp.control("v", hold=5), "hold must be a list of lengths of blocks"),
        (lambda ocp, x, u: ocp.dynamics({}, discrete={x: u}), "next value of 'x' is given twice"),
        (lambda ocp, x, u: ocp.dynamics([u], discrete={x: u}), r"derivatives must be \{state: expression\}, too"),
        (lambda ocp, x, u: ocp.dynamics({}, discrete={u: x}), "dynamics: key 'u' is no state"),
    ],
)
def test_what_is_refused(state: Callable[[OCP, Any, Any], object], message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        classified(state)


def test_a_refused_block_declares_nothing() -> None:
    ocp, _, _ = stated()
    with pytest.raises(ProblemError):
        ocp.control("v", hold=[2])
    ocp.control("v", hold=[2, 3])


def test_a_discrete_map_of_unequal_intervals_has_no_time() -> None:
    ocp = OCP("uneven", intervals=[1.0, 2.0])
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: x + u}, discrete=True)
    ocp.least_squares(u - ocp.time, 1.0)
    with pytest.raises(ProblemError, match="requires intervals of one length"):
        classify(ocp)


def test_neither_control_nor_free_state() -> None:
    ocp = OCP("idle", T=1.0, N=2)
    x = ocp.state("x")
    ocp.dynamics({x: -x})
    ocp.least_squares(x, 1.0)
    with pytest.raises(ProblemError, match=r"use ocp\.control\(name\), or ocp\.free_initial\(state\)"):
        classify(ocp)
    ocp.free_initial(x)
    assert classify(ocp).augmentation.idle


def test_only_what_is_used_becomes_a_state() -> None:
    ocp, _, u = stated()
    ocp.previous(u)
    assert classify(ocp).nx == 1
    ocp.least_squares(ocp.rate(u), 1.0, names="slew")
    problem = classify(ocp)
    assert problem.state_names == ("x", "previous(u)")
    assert problem.parameter_names == ()
    assert classify(ocp, 2 * problem.dt[0]).parameter_names == ("interval before",)
    assert problem.measured == 1
    assert not problem.nonlinear_rows


@pytest.mark.parametrize(("name", "compared"), [("last", False), ("u_prev", False), ("z", True)])
def test_a_state_that_should_remember_a_control_and_integrates_it(name: str, compared: bool) -> None:
    ocp, _, u = stated()
    last = ocp.state(name)
    ocp.dynamics({last: u})
    if compared:
        ocp.subject_to(-1, u - last, 1, name="move")
    with pytest.warns(ProblemWarning, match=rf"'{name}' is the integral of u, .*ocp\.previous\(u\).*ocp\.rate\(u\)"):
        classify(ocp)


def test_a_double_integrator_is_none_of_these() -> None:
    ocp = OCP("double", T=1.0, N=5)
    x, v, a = ocp.state("x"), ocp.state("v"), ocp.control("a")
    ocp.dynamics({x: v, v: a})
    ocp.least_squares(ca.vertcat(x, v, a, a + v), 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ProblemWarning)
        classify(ocp)


@pytest.mark.parametrize("name", ["set_rterm", "du", "delta_u", "n_control_horizon", "move_blocking"])
def test_names_of_other_tools(name: str) -> None:
    words = "hold=" if name in ("n_control_horizon", "move_blocking") else r"ocp\.rate\(u\)"
    with pytest.raises(AttributeError, match=rf"no attribute '{name}'; here: .*{words}"):
        getattr(stated()[0], name)


def test_tools_of_steady_states_refuse_what_they_do_not_know() -> None:
    ocp, _, u = stated()
    ocp.least_squares(ocp.rate(u), 1.0, names="slew")
    with pytest.raises(ProblemError, match="steady state: 'stated' has previous controls"):
        steady_state(ocp)
    ocp.lqr_terminal_cost()
    with pytest.raises(ProblemError, match="terminal_least_squares"):
        generate(ocp)
