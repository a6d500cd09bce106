"""Classification of rows, costs and stages: from the OCP to the frozen problem."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Problem, Row

N = 4
PATH, LATER, ALL, END = (0, 1, 2, 3), (1, 2, 3, 4), (0, 1, 2, 3, 4), (4,)


class Model:
    """x, r[2] | u, w[2] | q over four intervals."""

    def __init__(self, intervals: int = N) -> None:
        self.ocp = OCP("plant", T=2.0, N=intervals)
        self.x = self.ocp.state("x")
        self.r = self.ocp.state("r", size=2)
        self.u = self.ocp.control("u")
        self.w = self.ocp.control("w", size=2)
        self.q = self.ocp.parameter("q", value=3.0)
        self.ocp.dynamics({"x": self.u, "r": self.w})

    def problem(self) -> Problem:
        self.ocp.least_squares(self.ocp.u, 1)
        return classify(self.ocp)


def stated(*statements: Callable[[Model], Any], intervals: int = N) -> tuple[Row, ...]:
    m = Model(intervals)
    for statement in statements:
        statement(m)
    return m.problem().rows


def to(lower: Any, pick: Callable[[Model], Any], upper: Any, **how: Any) -> Callable[[Model], Any]:
    """A statement lower <= pick(model) <= upper."""
    return lambda m: m.ocp.subject_to(lower, pick(m), upper, **how)


X, U, R, W = (lambda m: m.x), (lambda m: m.u), (lambda m: m.r), (lambda m: m.w)

# statements -> (name, kind, index, index_terminal, nodes) of every row
CASES: dict[str, tuple[list[Callable[[Model], Any]], list[tuple[str, str, int, int, tuple[int, ...]]]]] = {
    "control": ([to(-1, U, 1)], [("u", "control", 0, -1, PATH)]),
    "vector control": ([to(-1, W, 1)], [("w[0]", "control", 1, -1, PATH), ("w[1]", "control", 2, -1, PATH)]),
    "control at every path node": ([to(-1, U, 1, at=range(N))], [("u", "control", 0, -1, PATH)]),
    "control at some nodes": ([to(-1, U, 1, at=[1, 2])], [("u", "general", 0, -1, (1, 2))]),
    "control at the start": ([to(-1, U, 1, at="start")], [("u_start", "general", 0, -1, (0,))]),
    "second row of a control": (
        [to(-1, U, 1), to(-2, U, 0, name="again")],
        [("u", "control", 0, -1, PATH), ("again", "general", 0, -1, PATH)],
    ),
    "soft control": (
        [to(-1, U, 1, soft=(1, 0)), to(-2, U, 2, name="hard")],
        [("u", "general", 0, -1, PATH), ("hard", "control", 0, -1, PATH)],
    ),
    "state": ([to(-1, X, 1)], [("x", "state", 0, -1, LATER)]),
    "vector state named": (
        [to(-1, R, 1, name="box")],
        [("box[0]", "state", 1, -1, LATER), ("box[1]", "state", 2, -1, LATER)],
    ),
    "all at once": (
        [to(-1, lambda m: ca.vertcat(m.r[1], m.u, m.x), 1)],
        [("r[1]", "state", 2, -1, LATER), ("u", "control", 0, -1, PATH), ("x", "state", 0, -1, LATER)],
    ),
    "state times two": ([to(-1, lambda m: 2 * m.x, 1)], [("row_0", "general", 0, 0, LATER)]),
    "minus control": ([to(-1, lambda m: -m.u, 1)], [("row_0", "general", 0, -1, PATH)]),
    "state and parameter": ([to(-1, lambda m: m.x - m.q, 1, name="c")], [("c", "general", 0, 0, LATER)]),
    "state and control": ([to(-1, lambda m: m.x * m.u, 1)], [("row_0", "general", 0, -1, PATH)]),
    "control and parameter": ([to(-1, lambda m: m.q * m.u, 1)], [("row_0", "general", 0, -1, PATH)]),
    "state that cancels": ([to(-1, lambda m: m.u + 0 * m.x, 1)], [("u", "control", 0, -1, PATH)]),
    "terminal equality": ([to(0, X, 0, at="end")], [("x_end", "state", 0, -1, END)]),
    "terminal inequality": ([to(-1, X, 1, at="end")], [("x_end", "state", 0, -1, END)]),
    "terminal equality takes node N": (
        [to(-1, X, 1), to(0, X, 0, at="end")],
        [("x", "state", 0, -1, (1, 2, 3)), ("x_end", "state", 0, -1, END)],
    ),
    "whatever the order": (
        [to(0, X, 0, at="end"), to(-1, X, 1)],
        [("x_end", "state", 0, -1, END), ("x", "state", 0, -1, (1, 2, 3))],
    ),
    "of that state only": (
        [to(-1, R, 1), to(0, lambda m: m.r[1], 0, at="end")],
        [("r[0]", "state", 1, -1, LATER), ("r[1]", "state", 2, -1, (1, 2, 3)), ("r[1]_end", "state", 2, -1, END)],
    ),
    "terminal inequality beside a path row": (
        [to(-1, X, 1, at="end"), to(-2, X, 2)],
        [("x_end", "general", -1, 0, END), ("x", "state", 0, -1, LATER)],
    ),
    "soft terminal equality beside a path row": (
        [to(-2, X, 2), to(0, X, 0, at="end", soft=(1, 1))],
        [("x", "state", 0, -1, LATER), ("x_end", "general", -1, 0, END)],
    ),
    "two terminal equalities": (
        [to(0, X, 0, at="end"), to(1, X, 1, at=[4], name="other")],
        [("x_end", "state", 0, -1, END), ("other", "general", -1, 0, END)],
    ),
    "nodes beside nodes": (
        [to(-1, X, 1, at=[1, 3]), to(-1, X, 1, at=[2, 4], name="even")],
        [("x", "state", 0, -1, (1, 3)), ("even", "state", 0, -1, (2, 4))],
    ),
    "nodes on nodes": (
        [to(-1, X, 1, at=[3, 1, 3]), to(-1, X, 1, at=[3, 4], name="late")],
        [("x", "state", 0, -1, (1, 3)), ("late", "general", 0, 0, (3, 4))],
    ),
    "soft state": ([to(-1, X, 1, soft=(1e3, 1e2), name="swing")], [("swing", "state", 0, -1, LATER)]),
    "general positions": (
        [
            to(-1, lambda m: m.x * m.u, 1, name="a"),
            to(-1, lambda m: m.x**2, 1, name="b", at="end"),
            to(-1, lambda m: m.x**3, 1, name="c"),
            to(-1, lambda m: m.x**4, 1, name="d", at=[2]),
        ],
        [
            ("a", "general", 0, -1, PATH),
            ("b_end", "general", -1, 0, END),
            ("c", "general", 1, 1, LATER),
            ("d", "general", 2, -1, (2,)),
        ],
    ),
    "free state": ([lambda m: m.ocp.free_initial(m.x), to(-1, X, 1)], [("x", "state", 0, -1, ALL)]),
    "free afterwards": ([to(-1, X, 1), lambda m: m.ocp.free_initial("x")], [("x", "state", 0, -1, ALL)]),
    "another one free": (
        [lambda m: m.ocp.free_initial(m.x), to(-1, lambda m: m.r[0], 1)],
        [("r[0]", "state", 1, -1, LATER)],
    ),
    "partly free": (
        [lambda m: m.ocp.free_initial(m.x), to(-1, lambda m: m.x + m.r[0], 1)],
        [("row_0", "general", 0, 0, ALL)],
    ),
    "free at the start": (
        [lambda m: m.ocp.free_initial(m.x), to(0, X, 0, at="start"), to(1, X, 2, name="later", at=LATER)],
        [("x_start", "state", 0, -1, (0,)), ("later", "state", 0, -1, LATER)],
    ),
    "boundary": (
        [
            to(-1, lambda m: m.x * m.u, 1),
            lambda m: m.ocp.boundary(0, m.ocp.at_start(m.r) - m.ocp.at_end(m.r), 0, name="period"),
            lambda m: m.ocp.boundary(0, m.ocp.at_end(m.x), 1),
        ],
        [
            ("row_0", "general", 0, -1, PATH),
            ("period[0]", "coupled", 0, -1, (0, N)),
            ("period[1]", "coupled", 1, -1, (0, N)),
            ("row_1", "coupled", 2, -1, (0, N)),
        ],
    ),
}


@pytest.mark.parametrize("case", CASES, ids=str)
def test_rows_are_classified(case: str) -> None:
    statements, expected = CASES[case]
    rows = stated(*statements)
    assert [(r.name, r.kind, r.index, r.index_terminal, r.nodes) for r in rows] == expected


def test_one_interval() -> None:
    """Path and end rows of the states coincide: the equality replaces the path row completely."""
    rows = stated(to(-1, X, 1), to(0, X, 0, at="end"), to(-1, U, 1), intervals=1)
    assert [(r.kind, r.nodes) for r in rows] == [("state", ()), ("state", (1,)), ("control", (0,))]


def test_general_rows_are_evaluated_where_they_stand() -> None:
    """h of path and terminal stage at a point, against NumPy."""
    m = Model()
    m.ocp.subject_to(0, m.x * m.u, 1)
    m.ocp.subject_to(0, m.r[1] * m.q, 1, name="b")
    problem = m.problem()
    path, end = problem.path, problem.terminal
    x, u, p = [2.0, 3.0, 5.0], [7.0, 0.0, 0.0], [11.0]
    h = ca.Function("h", [path.x, path.u, path.p], [path.h])(x, u, p)
    h_N = ca.Function("h", [end.x, end.u, end.p], [end.h])(x, ca.DM(0, 1), p)
    np.testing.assert_array_equal(np.asarray(h).ravel(), [14, 55])
    np.testing.assert_array_equal(np.asarray(h_N).ravel(), [55])
    assert path.h_names == ("row_0", "b")
    assert end.h_names == ("b",)


def test_every_general_row_has_one_name_in_its_stages() -> None:
    for statements, _ in CASES.values():
        m = Model()
        for statement in statements:
            statement(m)
        problem = m.problem()
        for row in problem.rows:
            if row.kind == "general":
                assert row.index < 0 or problem.path.h_names[row.index] == row.name
                assert row.index_terminal < 0 or problem.terminal.h_names[row.index_terminal] == row.name
        assert len(problem.path.h_names) == problem.path.nh
        assert len(problem.terminal.h_names) == problem.terminal.nh
        simple = [(r.kind, r.index, k) for r in problem.rows if r.kind in ("control", "state") for k in r.nodes]
        assert len(simple) == len(set(simple)), "one simple bound per component and node"


def test_sizes_and_names() -> None:
    problem = Model().problem()
    assert (problem.nx, problem.nu, problem.np, problem.N) == (3, 3, 1, N)
    assert problem.state_names == ("x", "r[0]", "r[1]")
    assert problem.control_names == ("u", "w[0]", "w[1]")
    assert problem.parameter_names == ("q",)
    assert problem.dt == (0.5,) * N
    assert problem.uniform
    assert problem.terminal.nu == 0
    assert problem.terminal.x is not problem.path.x
    np.testing.assert_array_equal(problem.p_value, [3.0])
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.N = 3  # type: ignore[misc]


def test_stage_symbols_are_all_that_expressions_contain() -> None:
    m = Model()
    m.ocp.stage_cost(m.x * m.q + m.u**2)
    m.ocp.stage_cost(m.x**2, integrate=True)
    m.ocp.terminal_cost(m.x * m.q)
    m.ocp.terminal_least_squares(m.r * m.q, 1)
    m.ocp.subject_to(0, m.x * m.q, 1)
    problem = m.problem()
    for stage in (problem.path, problem.terminal):
        known = {s.element_hash() for s in ca.symvar(ca.vertcat(stage.x, stage.u, stage.p, stage.dt))}
        for e in (stage.y, stage.h, stage.cost, stage.cost_rate):
            assert e is None or {s.element_hash() for s in ca.symvar(e)} <= known


def test_general_costs_and_their_scaling() -> None:
    """Node terms are multiplied by dt unless stated otherwise, integrated and terminal ones never; terms are added."""
    m = Model()
    m.ocp.stage_cost(m.x)
    m.ocp.stage_cost(10 * m.u, scale_with_dt=False)
    m.ocp.stage_cost(100 * m.x, integrate=True)
    m.ocp.stage_cost(m.q, integrate=True)
    m.ocp.terminal_cost(m.x + 1)
    problem = m.problem()
    s, e = problem.path, problem.terminal
    value = ca.Function("l", [s.x, s.u, s.p, s.dt], [s.cost, s.cost_rate])([2, 0, 0], [3, 0, 0], [7], 0.5)
    assert [float(v) for v in value] == [2 * 0.5 + 30, 207]
    assert float(ca.Function("l", [e.x], [e.cost])([2, 0, 0])) == 3
    assert e.cost_rate is None
    assert problem.uses == {"general cost", "integrated cost"}


def test_least_squares_alone_has_no_general_cost() -> None:
    problem = Model().problem()
    assert problem.path.cost is None
    assert problem.path.cost_rate is None
    assert problem.terminal.ny == 0
    assert problem.terminal.weight.shape == (0, 0)
    assert problem.uses == frozenset()
    assert problem.control_reference == (0, 1, 2)


def test_terminal_cost_alone_is_a_cost() -> None:
    m = Model()
    m.ocp.terminal_least_squares(m.x, 1)
    problem = classify(m.ocp)
    assert problem.path.ny == 0
    assert problem.control_reference == (-1, -1, -1)


@pytest.mark.parametrize(
    ("statement", "feature"),
    [
        (to(-1, X, 1, soft=(1, 0)), "soft rows"),
        (lambda m: m.ocp.boundary(0, m.ocp.at_end(m.x), 1), "coupled rows"),
        (lambda m: m.ocp.free_initial(m.x), "free initial state"),
        (lambda m: m.ocp.terminal_cost(m.x), "general cost"),
        (lambda m: m.ocp.accumulator(m.x), "accumulators"),
    ],
)
def test_features(statement: Callable[[Model], Any], feature: str) -> None:
    m = Model()
    statement(m)
    assert m.problem().uses == {feature}


def test_coupled_function() -> None:
    m = Model()
    m.ocp.boundary(0, m.ocp.at_start(m.ocp.x) - 2 * m.ocp.at_end(m.ocp.x), 0)
    r = m.problem().coupled
    np.testing.assert_array_equal(np.asarray(r([1, 2, 3], [10, 20, 30])).ravel(), [-19, -38, -57])


def test_free_accumulator_cyclic() -> None:
    m = Model()
    m.ocp.free_initial(m.r, "x")
    m.ocp.cyclic("r")
    problem = m.problem()
    assert problem.free_initial == (0, 1, 2)
    assert problem.cyclic == (1, 2)


def test_discrete_map_has_unit_intervals_unless_given() -> None:
    for ocp, dt in ((OCP("a", N=2), (1.0, 1.0)), (OCP("a", T=1.0, N=2), (0.5, 0.5))):
        x, u = ocp.state("x"), ocp.control("u")
        ocp.dynamics({x: x + u}, discrete=True)
        ocp.least_squares(u, 1)
        problem = classify(ocp)
        assert problem.discrete
        assert problem.dt == dt


def test_analyse_twice_and_after_a_change() -> None:
    """The OCP remains mutable; an existing problem does not change with it."""
    m = Model()
    before = m.problem()
    m.ocp.subject_to(-1, m.u, 1)
    after = classify(m.ocp)
    assert len(before.rows) == 0
    assert len(after.rows) == 1
    assert [str(r) for r in classify(m.ocp).rows] == [str(r) for r in after.rows]


def test_row_on_given_initial_state_says_how_to_go_on() -> None:
    with pytest.raises(ProblemError, match=r"free_initial"):
        stated(to(0, R, 1, at=[0]))


def test_crane_with_every_kind_of_statement() -> None:
    """The crane with a length parameter, terminal equalities, a soft swing and a periodic position."""
    ocp = OCP("crane", T=3.0, N=10)
    p, v = ocp.state("p", unit="m", initial=2.0), ocp.state("v", unit="m/s")
    phi, omega = ocp.state("phi", unit="rad"), ocp.state("omega", unit="rad/s")
    a, L = ocp.control("a", unit="m/s^2"), ocp.parameter("L", value=1.0)
    ocp.dynamics({p: v, v: a, phi: omega, omega: -(9.81 / L) * ca.sin(phi) - a * ca.cos(phi) - 0.2 * omega})
    ocp.least_squares(ca.vertcat(p, v, phi, omega, a), weight=np.eye(5), names=["p", "v", "phi", "omega", "a"])
    ocp.terminal_least_squares(ca.vertcat(p, v, phi, omega), weight=10 * np.eye(4))
    ocp.subject_to(-1, a, 1)
    ocp.subject_to(0, ca.vertcat(p, v, phi, omega), 0, at="end")
    ocp.subject_to(-0.5, phi, 0.5, soft=(1e3, 1e2), name="swing")
    ocp.boundary(0, ocp.at_start(ocp.x) - ocp.at_end(ocp.x), 0, soft=None)
    ocp.free_initial(p, v)
    problem = classify(ocp)
    named = {row.name: row for row in problem.rows}
    assert list(named)[:6] == ["a", "p_end", "v_end", "phi_end", "omega_end", "swing"]
    assert named["swing"].nodes == tuple(range(1, 10))
    assert named["swing"].soft == (1e3, 1e2)
    assert [row.kind for row in problem.rows].count("coupled") == 4
    assert problem.control_reference == (4,)
    assert problem.x_initial.tolist() == [2, 0, 0, 0]
    xdot = problem.dynamics([0.1, 0.2, 0.3, 0.4], [0.5], [2.0])
    expected = [0.2, 0.5, 0.4, -9.81 / 2 * np.sin(0.3) - 0.5 * np.cos(0.3) - 0.08]
    np.testing.assert_allclose(np.asarray(xdot).ravel(), expected, rtol=1e-14)
