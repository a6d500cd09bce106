"""Statements of the user, and the message of every mistake."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen.errors import ProblemError, ProblemWarning
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.ir.naming import C_KEYWORDS


class Given:
    """x, r[2], u, q: the names used in the cases below, without dynamics, cost and rows."""

    def __init__(self) -> None:
        self.ocp = OCP("plant", T=2.0, N=4)
        self.x = self.ocp.state("x")
        self.r = self.ocp.state("r", size=2)
        self.u = self.ocp.control("u")
        self.q = self.ocp.parameter("q", value=1.0)

    def complete(self) -> OCP:
        """Complete a problem with the missing statements."""
        self.ocp.dynamics({"x": self.u, "r": self.r})
        self.ocp.least_squares(self.u, 1)
        return self.ocp


def foreign() -> Any:
    """An SX symbol that belongs to no OCP."""
    return ca.SX.sym("w")


def lookup_table() -> Any:
    return ca.interpolant("lut", "linear", [[0.0, 1.0, 2.0]], [0.0, 1.0, 4.0])


MISTAKES: dict[str, tuple[Callable[[Given], Any], str]] = {
    # the OCP itself
    "name not a string": (lambda g: OCP(7, T=1, N=2), "OCP: name: 7; expected a string"),  # type: ignore[arg-type]
    "name no identifier": (lambda g: OCP("my plant", T=1, N=2), "name 'my plant': expected a C identifier"),
    "name reserved": (lambda g: OCP("_plant", T=1, N=2), "name '_plant': expected a C identifier"),
    "N zero": (lambda g: OCP("a", T=1, N=0), "OCP 'a': N must be an integer >= 1, got 0"),
    "N float": (lambda g: OCP("a", T=1, N=2.0), "N must be an integer >= 1, got float '2.0'"),  # type: ignore[arg-type]
    "N bool": (lambda g: OCP("a", T=1, N=True), "N must be an integer >= 1, got bool"),
    "N missing": (lambda g: OCP("a", T=1), "give T and N, or intervals, or N for a discrete map"),
    "T zero": (lambda g: OCP("a", T=0, N=2), "T must be a positive length in s, got '0'"),
    "T negative": (lambda g: OCP("a", T=-1, N=2), "T must be a positive length"),
    "T infinite": (lambda g: OCP("a", T=np.inf, N=2), "T must be a positive length"),
    "T nan": (lambda g: OCP("a", T=np.nan, N=2), "T must be numbers, got NaN"),
    "T text": (lambda g: OCP("a", T="1", N=2), "T must be numbers, got str '1'"),  # type: ignore[arg-type]
    "bound complex": (lambda g: g.ocp.subject_to(np.array([1j]), g.u, 1), "lower must be numbers, got ndarray"),
    "T vector": (lambda g: OCP("a", T=[1, 2], N=2), "T must be a positive length"),  # type: ignore[arg-type]
    "T denormal": (
        lambda g: OCP("a", T=1e-320, N=2),
        "OCP 'a': T / N is 4.99994e-321 s, expected a length between 1e-15",
    ),
    "T enormous": (lambda g: OCP("a", T=1e300, N=2), "T / N is 5e+299 s, expected a length between 1e-15 and 1e+15 s"),
    "N enormous": (lambda g: OCP("a", T=1, N=10**7), "OCP 'a': N must be an integer <= 10000, got '10000000'"),
    "N beyond words": (lambda g: OCP("a", T=1, N=10**5000), "N must be an integer <= 10000, got"),
    "intervals denormal": (
        lambda g: OCP("a", intervals=[1, 5e-324]),
        "interval 1 is 4.94066e-324 s, expected a length",
    ),
    "intervals apart": (
        lambda g: OCP("a", intervals=[1e-6, 2, 1e-6]),
        "interval 1 of 2 s is more than 1e+06 times as long as interval 0 of 1e-06 s",
    ),
    "intervals too many": (lambda g: OCP("a", intervals=np.ones(10**6)), "number of intervals must be an integer <= 1"),
    "size enormous": (lambda g: g.ocp.state("y", size=10**6), "state 'y': size must be an integer <= 4000, got"),
    "T and intervals": (lambda g: OCP("a", T=1, intervals=[1]), "give T or intervals, not both"),
    "intervals negative": (lambda g: OCP("a", intervals=[1, -1]), "intervals must be positive lengths"),
    "intervals empty": (lambda g: OCP("a", intervals=[]), "intervals must be positive lengths"),
    "intervals infinite": (lambda g: OCP("a", intervals=[np.inf]), "intervals must be positive lengths"),
    "intervals text": (lambda g: OCP("a", intervals="abc"), "intervals must be numbers, got str 'abc'"),
    "intervals and N": (lambda g: OCP("a", intervals=[1, 2], N=3), "N = 3, but 2 intervals are given"),
    # signals
    "state name": (lambda g: g.ocp.state("2x"), "state '2x': name '2x' is no C identifier"),
    "state name not ASCII": (lambda g: g.ocp.state("φ"), "no C identifier"),
    "control keyword": (lambda g: g.ocp.control("class"), "control 'class': name 'class' is a keyword"),
    "duplicate": (lambda g: g.ocp.control("x"), "control 'x': the name 'x' clashes with 'x'"),
    "duplicate in C": (lambda g: g.ocp.state("r_0"), "state 'r_0': the name 'r_0' clashes with 'r'"),
    "duplicate in C, reverse": (
        lambda g: (g.ocp.state("s_1"), g.ocp.state("s", size=2)),
        "the name 's[1]' clashes with 's_1'",
    ),
    "size zero": (lambda g: g.ocp.state("y", size=0), "state 'y': size must be an integer >= 1, got 0"),
    "size text": (lambda g: g.ocp.state("y", size="2"), "size must be an integer >= 1, got str"),  # type: ignore[arg-type]
    "unit": (lambda g: g.ocp.state("y", unit=3), "state 'y': unit must be a string, got int"),  # type: ignore[arg-type]
    "initial shape": (
        lambda g: g.ocp.state("y", size=2, initial=[1, 2, 3]),
        "initial has shape (3,), expected a scalar or 2",
    ),
    "initial infinite": (lambda g: g.ocp.state("y", initial=np.inf), "state 'y': initial must be finite"),
    "value nan": (lambda g: g.ocp.parameter("y", value=np.nan), "parameter 'y': value must be numbers, got NaN"),
    "value symbolic": (
        lambda g: g.ocp.parameter("y", value=2 * g.x),
        "value must be numbers, got the expression '(2.*x)'",
    ),
    # dynamics
    "no state": (lambda g: OCP("a", T=1, N=1).dynamics(0), "no state is declared"),
    "too few": (lambda g: g.ocp.dynamics([g.u, g.x]), "dynamics has 2 elements, expected 3"),
    "row vector": (
        lambda g: g.ocp.dynamics(ca.horzcat(g.x, g.x, g.x)),
        "shape (1, 3), expected a scalar or a column (transpose it)",
    ),
    "matrix": (lambda g: g.ocp.dynamics(np.eye(3)), "shape (3, 3), expected a scalar or a column"),
    "nested list": (lambda g: g.ocp.dynamics([[g.x], [g.x], [g.x]]), "must be a scalar or a column, got nested lists"),
    "text": (lambda g: g.ocp.dynamics("x"), "dynamics: value must be numbers, got str 'x'"),
    "unknown name": (lambda g: g.ocp.dynamics({"y": 0}), "dynamics: key 'y' is no state; declared are: x, r[0], r[1]"),
    "key control": (lambda g: g.ocp.dynamics({g.u: 0}), "dynamics: key 'u' is no state; declared are: x"),
    "key expression": (lambda g: g.ocp.dynamics({g.x + 1: 0}), "is no state"),
    "key number": (lambda g: g.ocp.dynamics({1: 0}), "must be the symbol or the name of a state"),
    "derivative shape": (lambda g: g.ocp.dynamics({"r": g.u}), "derivative of 'r' has 1 elements, expected 2"),
    "twice, name and symbol": (lambda g: g.ocp.dynamics({g.x: 0, "x": 0}), "the derivative of 'x' is given twice"),
    "twice, vector and element": (
        lambda g: g.ocp.dynamics({"r": g.r, g.r[1]: 0}),
        "the derivative of 'r[1]' is given twice",
    ),
    "twice, two calls": (
        lambda g: (g.ocp.dynamics({"x": 0}), g.ocp.dynamics({"x": 0})),
        "the derivative of 'x' is given twice",
    ),
    "twice, vector": (
        lambda g: (g.ocp.dynamics({"x": 0}), g.ocp.dynamics([0, 0, 0])),
        "the derivative of 'x' is given twice",
    ),
    "missing": (lambda g: (g.ocp.dynamics({"r": g.r}), classify(g.ocp)), "OCP 'plant': the derivative of x is missing"),
    "missing next": (
        lambda g: (g.ocp.dynamics({"x": 0}, discrete=True), classify(g.ocp)),
        "the next value of r[0], r[1] is missing",
    ),
    "mixed": (
        lambda g: (g.ocp.dynamics({"x": 0}), g.ocp.dynamics({"r": g.r}, discrete=True)),
        "discrete and continuous dynamics cannot be mixed",
    ),
    "discrete flag": (
        lambda g: g.ocp.dynamics({"x": 0}, discrete=1),
        "discrete must be True, False or {state: next value}, got int",
    ),  # type: ignore[arg-type]
    "foreign symbol": (
        lambda g: g.ocp.dynamics({"x": foreign()}),
        "derivative of 'x' contains the unknown symbol 'w'; declared are: x, r, u, q",
    ),
    "symbol of another OCP": (
        lambda g: g.ocp.dynamics({"x": Given().x}),
        "contains a symbol 'x' that was not declared in this OCP",
    ),
    "nan": (lambda g: g.ocp.dynamics({"x": g.x * np.nan}), "contains a constant that is not finite"),
    "nan number": (lambda g: g.ocp.dynamics({"x": np.nan}), "got NaN"),
    "log of zero": (lambda g: g.ocp.dynamics({"x": g.x + ca.log(ca.SX(0))}), "contains a constant that is not finite"),
    "lookup table": (
        lambda g: g.ocp.dynamics({"x": lookup_table()(g.x)}),
        "contains a function call (interpolant, callback, external) that has no C",
    ),
    "erfinv": (lambda g: g.ocp.dynamics({"x": ca.erfinv(g.x)}), "'erfinv(x)' contains an operation that has no C"),
    "continuous without T": (
        lambda g: (lambda o: (o.state("x"), o.dynamics([0])))(OCP("map", N=3)),
        "OCP 'map' was given N only, so its dynamics must be discrete",
    ),
    "MX of nobody": (lambda g: g.ocp.dynamics({"x": ca.MX.sym("w")}), "contains the unknown symbol 'w'"),
    "MX of other size": (
        lambda g: g.ocp.dynamics({"r": ca.MX.sym("r", 3)}),
        "the MX symbol 'r' has shape (3, 1), declared was (2, 1)",
    ),
    "MX callback": (
        lambda g: g.ocp.dynamics({"x": callback(ca.MX.sym("x"))}),
        "contains a function call (interpolant, callback, external)",
    ),
    "MX linear solver": (
        lambda g: g.ocp.dynamics(
            {"r": ca.solve(ca.cos(ca.MX.sym("r", 2)) @ ca.MX.sym("r", 2).T, ca.MX.sym("r", 2), "qr")}
        ),
        "cannot be expanded to scalar operations, so it has no C equivalent; write it with SX",
    ),
    "at_end in dynamics": (
        lambda g: g.ocp.dynamics({"x": g.ocp.at_end(g.x)}),
        "contains at_end(x), which is allowed in boundary() only",
    ),
    # cost
    "weight shape": (
        lambda g: g.ocp.least_squares(g.r, np.eye(3)),
        "least_squares: weight has shape (3, 3), expected (2, 2)",
    ),
    "weight not symmetric": (
        lambda g: g.ocp.least_squares(g.r, [[1, 1], [0, 1]]),
        "must be symmetric, but entry [0, 1] is 1 and [1, 0] is 0",
    ),
    "weight indefinite": (
        lambda g: g.ocp.least_squares(g.r, [[1, 2], [2, 1]]),
        "must be positive semidefinite, but has the eigenvalue -1",
    ),
    "weight negative": (lambda g: g.ocp.least_squares(g.u, -1), "positive semidefinite, but has the eigenvalue -1"),
    "weight infinite": (lambda g: g.ocp.least_squares(g.u, np.inf), "weight must be finite"),
    "weight nan": (lambda g: g.ocp.least_squares(g.u, np.nan), "weight must be numbers, got NaN"),
    "weight symbolic": (lambda g: g.ocp.least_squares(g.u, g.q), "weight must be numbers, got the expression 'q'"),
    "residual empty": (lambda g: g.ocp.least_squares([], 1), "least_squares: the expression is empty"),
    "reference shape": (
        lambda g: g.ocp.least_squares(g.r, 1, reference=[1, 2, 3]),
        "reference has shape (3,), expected a scalar or 2 values",
    ),
    "reference infinite": (lambda g: g.ocp.least_squares(g.u, 1, reference=np.inf), "reference must be finite"),
    "names count": (lambda g: g.ocp.least_squares(g.r, 1, names=["a"]), "names must be 2 strings, got"),
    "names keyword": (lambda g: g.ocp.least_squares(g.u, 1, names=["int"]), "'int' is a keyword"),
    "names twice": (lambda g: g.ocp.least_squares(g.r, 1, names=["a", "a"]), "the name 'a' is used twice"),
    "names not strings": (lambda g: g.ocp.least_squares(g.r, 1, names=[1, 2]), "name must be a string, got int"),
    "scale flag": (lambda g: g.ocp.least_squares(g.u, 1, scale_with_dt=None), "scale_with_dt must be True or False"),  # type: ignore[arg-type]
    "terminal control": (
        lambda g: g.ocp.terminal_least_squares(g.u, 1),
        "contains the control 'u'; only these may occur: state, parameter",
    ),
    "stage cost vector": (lambda g: g.ocp.stage_cost(g.r), "stage_cost must be a scalar, got 2 elements"),
    "terminal cost control": (lambda g: g.ocp.terminal_cost(g.u * g.x), "terminal_cost contains the control 'u'"),
    "no cost": (lambda g: (g.ocp.dynamics([0, 0, 0]), classify(g.ocp)), "OCP 'plant' has no cost; use least_squares"),
    "quadrature of a map": (
        lambda g: (g.ocp.dynamics([0, 0, 0], discrete=True), g.ocp.stage_cost(g.x, integrate=True), classify(g.ocp)),
        "a discrete map has no quadrature",
    ),
    # rows
    "crossed": (lambda g: g.ocp.subject_to(1, g.u, -1), "subject_to: row 0 has lower 1 > upper -1"),
    "crossed, named": (
        lambda g: g.ocp.subject_to(0, g.r, [1, -1], name="b"),
        "subject_to 'b': row 1 has lower 0 > upper -1",
    ),
    "bound nan": (lambda g: g.ocp.subject_to(np.nan, g.u, 1), "lower must be numbers, got NaN"),
    "bound shape": (
        lambda g: g.ocp.subject_to([0, 0, 0], g.r, 1),
        "lower has shape (3,), expected a scalar or 2 values",
    ),
    "bound symbolic": (lambda g: g.ocp.subject_to(0, g.x, g.q), "upper must be numbers, got the expression 'q'"),
    "bound empty": (lambda g: g.ocp.subject_to(np.inf, g.u, np.inf), "which nothing can satisfy"),
    "row empty": (lambda g: g.ocp.subject_to(0, [], 1), "the expression is empty"),
    "row constant": (lambda g: g.ocp.subject_to(0, 1, 1), "'1' depends on no state and no control"),
    "row on parameter": (lambda g: g.ocp.subject_to(0, g.q, 1), "'q' depends on no state and no control"),
    "at word": (
        lambda g: g.ocp.subject_to(0, g.x, 1, at="all"),
        "at='all', expected 'path', 'start', 'end' or an iterable",
    ),
    "at number": (lambda g: g.ocp.subject_to(0, g.x, 1, at=3), "at='3', expected 'path'"),
    "at empty": (lambda g: g.ocp.subject_to(0, g.x, 1, at=[]), "at= names no node"),
    "at negative": (lambda g: g.ocp.subject_to(0, g.x, 1, at=[-1]), "must be an integer >= 0, got -1"),
    "at beyond": (lambda g: g.ocp.subject_to(0, g.x, 1, at=[5]), "node 5 in at= is out of range 0..4"),
    "at float": (lambda g: g.ocp.subject_to(0, g.x, 1, at=[1.5]), "node in at= must be an integer"),
    "end control": (
        lambda g: g.ocp.subject_to(0, g.u, 1, at="end"),
        "'u' contains a control, and node 4 (the end) has none",
    ),
    "node N control": (lambda g: g.ocp.subject_to(0, g.x * g.u, 1, at=range(5)), "contains a control, and node 4"),
    "given x_0": (
        lambda g: (g.ocp.subject_to(0, g.x, 1, at="start"), classify(g.complete())),
        "row 'x_start' constrains states alone at node 0, where x_0 is given",
    ),
    "given x_0, list": (
        lambda g: (g.ocp.subject_to(0, g.x * g.q, 1, at=[0, 2]), classify(g.complete())),
        "row 'row_0' constrains states alone at node 0",
    ),
    "soft text": (
        lambda g: g.ocp.subject_to(0, g.x, 1, soft="1"),
        "soft must be None, (l1, l2) or Soft(lower=(l1, l2)",
    ),
    "soft negative": (
        lambda g: g.ocp.subject_to(0, g.x, 1, soft=(-1, 1)),
        "must be nonnegative and not both zero, and l2 finite",
    ),
    "soft zero": (
        lambda g: g.ocp.subject_to(0, g.x, 1, soft=(0, 0)),
        "must be nonnegative and not both zero, and l2 finite",
    ),
    "soft infinite": (lambda g: g.ocp.subject_to(0, g.x, 1, soft=(1, np.inf)), "and l2 finite, got (1, inf)"),
    "row name": (lambda g: g.ocp.subject_to(0, g.x, 1, name="a b"), "'a b' is no C identifier"),
    "row twice, hard and soft": (
        lambda g: (g.ocp.subject_to(0, g.x, 1), g.ocp.subject_to(0, g.x, 2, soft=(1, 0))),
        "the row name 'x' clashes with 'x' (both are ROW_X in C); give name=",
    ),
    "row twice, other nodes": (
        lambda g: (g.ocp.subject_to(0, g.x, 1), g.ocp.subject_to(0, g.x, 2, at=[2])),
        "the row name 'x' clashes with 'x' (both are ROW_X in C); give name=",
    ),
    "row twice, an expression": (
        lambda g: (g.ocp.subject_to(0, 2 * g.x, 1, name="a"), g.ocp.subject_to(0, 2 * g.x, 2, name="a")),
        "the row name 'a' clashes with 'a'",
    ),
    "row twice, contradiction": (
        lambda g: (g.ocp.subject_to(2, g.u, np.inf), g.ocp.subject_to(-np.inf, g.u, 1)),
        "subject_to: the row 'u' in [-inf, 1] contradicts the row 'u' stated before, in [2, inf]",
    ),
    "comparison": (
        lambda g: g.ocp.subject_to(-1 <= g.u),  # noqa: SIM300
        "subject_to: '(-1<=u)' is a comparison; the same row is subject_to(-1, u, inf)",
    ),
    "comparison from above": (lambda g: g.ocp.subject_to(2 * g.u <= 1), "the same row is subject_to(-inf, (2.*u), 1)"),
    "comparison of two": (lambda g: g.ocp.subject_to(g.x <= g.u), "the same row is subject_to(-inf, (x-u), 0)"),
    "comparison, equal": (
        lambda g: g.ocp.subject_to(g.x == 2, name="goal", at="end"),
        "subject_to 'goal': '(x==2)' is a comparison; the same row is subject_to(2, x, 2)",
    ),
    "comparison, two equal": (lambda g: g.ocp.subject_to(g.x == g.u), "the same row is subject_to(0, (x-u), 0)"),
    "comparison, unequal": (lambda g: g.ocp.subject_to(g.x != 2), "'(x!=2)' is a comparison, not an expression"),
    "comparison of a vector": (lambda g: g.ocp.subject_to(g.r >= 0), "the same row is subject_to(0, r_0, inf)"),
    "comparison as the row": (lambda g: g.ocp.subject_to(0, g.u <= 1, 1), "subject_to(-inf, u, 1)"),
    "comparison in boundary": (
        lambda g: g.ocp.boundary(g.ocp.at_end(g.x) <= 1),
        "the same row is boundary(-inf, x_end, 1)",
    ),
    "chained comparison": (
        lambda g: g.ocp.subject_to(-1 <= g.u <= 1),
        "the truth value of '(-1<=u)' is not known before the problem is solved; state a row as subject_to(-1, u, inf)",
    ),
    "chained comparison of a vector": (lambda g: g.ocp.subject_to(-1 <= g.r <= 1), "the truth value of '(-1<=r_0)'"),
    "case": (lambda g: 1 if g.u > 0 else 2, "casadi.if_else(condition, then, otherwise)"),
    "two parts": (lambda g: g.ocp.subject_to(-1, g.u), "got '-1', 'u' only; it takes lower, expression, upper"),
    "one part": (lambda g: g.ocp.subject_to(g.u), "got 'u' only; it takes lower, expression, upper"),
    "row twice in C": (
        lambda g: (g.ocp.subject_to(0, g.r, 1), g.ocp.subject_to(0, g.x, 1, name="r_1")),
        "the row name 'r_1' clashes with 'r[1]'",
    ),
    "row foreign": (
        lambda g: g.ocp.subject_to(0, foreign(), 1),
        "subject_to: expression contains the unknown symbol 'w'",
    ),
    "boundary of a state": (
        lambda g: g.ocp.boundary(0, g.x, 0),
        "contains the state 'x'; write at_start(...) or at_end(...)",
    ),
    "boundary at start": (
        lambda g: g.ocp.boundary(0, g.ocp.at_start(g.x), 0),
        "does not depend on the end of the horizon",
    ),
    "at_end of a control": (lambda g: g.ocp.at_end(g.u), "at_end contains the control 'u'"),
    "at_start twice": (lambda g: g.ocp.at_start(g.ocp.at_start(g.x)), "contains at_start(x)"),
    # initial state and the rest
    "free control": (lambda g: g.ocp.free_initial(g.u), "free_initial: 'u' is no state"),
    "free nothing": (lambda g: g.ocp.free_initial(), "free_initial names no state; declared are: x, r[0], r[1]"),
    "free unknown": (lambda g: g.ocp.free_initial("y"), "free_initial: 'y' is no state"),
    "free accumulator": (
        lambda g: (g.ocp.free_initial(g.x), g.ocp.accumulator(g.x), classify(g.complete())),
        "state 'x' cannot be both free_initial and accumulator",
    ),
    **{
        f"assigned {name}": (
            lambda g, name=name, value=value: setattr(g.ocp, name, value),
            f"OCP 'plant': the attribute {name} cannot be assigned; "
            "name, T, N, intervals and time_unit are given to OCP(...)",
        )
        for name, value in {
            "N": 7,
            "dt": None,
            "name": "no identifier",
            "states": 3,
            "controls": (),
            "free": {1},
        }.items()
    },
    "assigned statements": (lambda g: setattr(g.ocp, "statements", [1]), "the attribute statements cannot be assigned"),
    "assigned residuals": (lambda g: setattr(g.ocp, "residuals", [1]), "the attribute residuals cannot be assigned"),
    "assigned discrete": (lambda g: setattr(g.ocp, "discrete", 1), "the attribute discrete cannot be assigned"),
    "nothing": (lambda g: classify(OCP("a", T=1, N=1)), "OCP 'a' has no state"),
    "no control": (lambda g: (lambda o: (o.state("x"), classify(o)))(OCP("a", T=1, N=1)), "OCP 'a' has no control"),
}


class _Callback(ca.Callback):  # type: ignore[misc]
    """A function that CasADi cannot inspect."""

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.construct("opaque", {})

    def eval(self, arguments: list[Any]) -> list[Any]:
        return [2 * arguments[0]]


_OPAQUE = _Callback()


def callback(x: Any) -> Any:
    return _OPAQUE(x)


@pytest.mark.parametrize("case", MISTAKES, ids=str)
def test_every_mistake_is_named(case: str) -> None:
    """Each mistake raises ProblemError, whose message names the object and the expected input."""
    make, message = MISTAKES[case]
    with pytest.raises(ProblemError, match=re.escape(message)):
        make(Given())


@pytest.mark.parametrize("keyword", ["int", "restrict", "class", "template", "_Bool", "co_await", "xor", "inline"])
def test_keywords_of_c_and_cpp_are_refused(keyword: str) -> None:
    with pytest.raises(ProblemError):
        OCP("a", N=1).state(keyword)


def test_keyword_table_holds_c99_and_no_library_names() -> None:
    assert {"auto", "while", "typedef", "sizeof", "new", "this"} <= C_KEYWORDS
    assert not {"p", "v", "sin", "a", "omega", "printf"} & C_KEYWORDS


def test_a_refused_call_changes_nothing() -> None:
    """After an error the OCP is unchanged."""
    g = Given()
    for wrong in (
        lambda: g.ocp.dynamics({"x": g.u, "r": 0}),
        lambda: g.ocp.least_squares(g.u, -1),
        lambda: g.ocp.subject_to(1, g.x * g.u, 0),
        lambda: g.ocp.subject_to(0, g.u, 1, soft=(0, 0)),
        lambda: g.ocp.state("r_0"),
        lambda: g.ocp.free_initial(g.x, g.u),
    ):
        with pytest.raises(ProblemError):
            wrong()
    g.ocp.subject_to(0, g.x * g.u, 1)
    problem = classify(g.complete())
    assert [row.name for row in problem.rows] == ["row_0"]
    assert problem.nx == 3
    assert problem.free_initial == ()


# What is allowed -----------------------------------------------------------------------------------------------------


def right_hand_side(ocp: OCP, at: tuple[Any, Any, Any]) -> np.ndarray[Any, Any]:
    ocp.least_squares(ocp.u, 1)
    return np.asarray(classify(ocp).dynamics(*at)).ravel()


AT = (np.array([0.3, -0.7, 1.1]), np.array([0.5]), np.array([2.0]))
EXPECTED = [0.5 * 2.0, -0.7, np.sin(0.3) - 0.2 * 1.1]


@pytest.mark.parametrize("form", ["symbols", "names", "elements", "column", "list", "calls", "array", "MX", "mixed MX"])
def test_forms_of_dynamics_agree(form: str) -> None:
    """However the derivatives are given, f(x, u, p) is the same (numbers computed with NumPy)."""
    g = Given()
    ocp, x, r, u, q = g.ocp, g.x, g.r, g.u, g.q
    rate = ca.vertcat(r[0], ca.sin(x) - 0.2 * r[1])
    if form == "symbols":
        ocp.dynamics({x: u * q, r[0]: rate[0], r[1]: rate[1]})
    elif form == "names":
        ocp.dynamics({"r": rate, "x": u * q})
    elif form == "elements":
        ocp.dynamics({"r[1]": rate[1], "x": u * q, "r[0]": rate[0]})
    elif form == "column":
        ocp.dynamics(ca.vertcat(u * q, rate))
    elif form == "list":
        ocp.dynamics([u * q, rate])
    elif form == "calls":
        ocp.dynamics({"r": rate})
        ocp.dynamics({x: u * q})
    elif form == "array":
        ocp.dynamics(np.array([u * q, rate[0], rate[1]], dtype=object))
    else:
        X, R, U, Q = ca.MX.sym("x"), ca.MX.sym("r", 2), ca.MX.sym("u"), ca.MX.sym("q")
        if form == "MX":
            ocp.dynamics(ca.vertcat(U * Q, R[0], ca.sin(X) - 0.2 * R[1]))
        else:
            ocp.dynamics([U * Q, R[0], rate[1]])
    np.testing.assert_allclose(right_hand_side(ocp, AT), EXPECTED, rtol=1e-15)


def test_mx_function_called_on_sx_symbols_is_inlined() -> None:
    g = Given()
    X = ca.MX.sym("anything", 2)
    f = ca.Function("f", [X], [ca.mtimes(ca.DM([[0.0, 1.0], [-1.0, 0.0]]), X)])
    g.ocp.dynamics({"x": 0, "r": f(g.r)})
    np.testing.assert_allclose(right_hand_side(g.ocp, AT), [0, 1.1, 0.7], rtol=1e-15)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (ca.floor, "floor"),
        (ca.sign, "sign"),
        (ca.fabs, "fabs"),
        (lambda x: ca.fmin(x, 1), "fmin"),
        (lambda x: ca.fmax(x, 1), "fmax"),
        (lambda x: ca.if_else(x > 0, x, 2 * x), "if_else"),
        (lambda x: ca.fmod(x, 2), "fmod"),
        (lambda x: x <= 3, "<="),
    ],
)
def test_nonsmooth_dynamics_warn(make: Callable[[Any], Any], word: str) -> None:
    g = Given()
    with pytest.warns(ProblemWarning, match=rf"dynamics of 'x' contain .*{re.escape(word)}.*derivatives"):
        g.ocp.dynamics({"x": make(g.x)})


def test_smooth_dynamics_and_nonsmooth_rows_do_not_warn() -> None:
    g = Given()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        g.ocp.dynamics({"x": ca.tanh(g.x) ** 3, "r": ca.sqrt(1 + g.r**2)})
        g.ocp.subject_to(0, ca.fmax(g.x, 0), 1)


def test_bounds_of_every_form() -> None:
    g = Given()
    g.ocp.subject_to(-np.inf, g.u, ca.DM(1))
    g.ocp.subject_to([-1, -2], g.r, np.array([[1.0], [2.0]]), name="box")
    g.ocp.subject_to(ca.SX(0), g.x * g.u, np.float32(3))
    rows = classify(g.complete()).rows
    bounds = [(r.name, r.lower, r.upper) for r in rows]
    assert bounds == [("u", -np.inf, 1), ("box[0]", -1, 1), ("box[1]", -2, 2), ("row_0", 0, 3)]


def test_weights_of_every_form() -> None:
    """Scalar, vector and matrix weights; several terms are stacked block by block."""
    g = Given()
    dense = np.array([[2.0, 1.0], [1.0, 2.0]])
    g.ocp.least_squares(g.r, dense, reference=[1, 2])
    g.ocp.least_squares(ca.vertcat(g.x, g.u), ca.DM([3, 4]), scale_with_dt=True)
    g.ocp.least_squares(g.x * g.q, 5)
    g.ocp.terminal_least_squares(g.r, 0)
    g.ocp.dynamics([0, 0, 0])
    problem = classify(g.ocp)
    expected = np.zeros((5, 5))
    expected[:2, :2] = dense
    expected[2:, 2:] = np.diag([3, 4, 5])
    np.testing.assert_array_equal(problem.path.weight, expected)
    np.testing.assert_array_equal(problem.path.reference, [1, 2, 0, 0, 0])
    assert problem.path.scale_with_dt == (False, False, True, True, False)
    assert problem.path.y_names == ("r[0]", "r[1]", "x", "u", "y_4")
    assert problem.control_reference == (3,)
    assert not problem.path.diagonal_weight
    np.testing.assert_array_equal(problem.terminal.weight, np.zeros((2, 2)))
    assert not problem.path.weight.flags.writeable


def test_weight_with_round_off_is_accepted_and_symmetric() -> None:
    rng = np.random.default_rng(1)
    J = rng.standard_normal((2, 2))
    W = J @ np.diag([1.0, 0.0]) @ J.T  # singular: one eigenvalue is zero up to rounding
    W[0, 1] *= 1 + 1e-15
    g = Given()
    g.ocp.least_squares(g.r, W)
    got = analyse_weight(g)
    np.testing.assert_array_equal(got, got.T)
    np.testing.assert_allclose(got, W, rtol=1e-14)


def analyse_weight(g: Given) -> Any:
    g.ocp.dynamics([0, 0, 0])
    return classify(g.ocp).path.weight


def test_same_symbol_in_two_terms_gets_two_names() -> None:
    g = Given()
    g.ocp.least_squares(g.u, 1)
    g.ocp.least_squares(g.u, 2, reference=1)
    g.ocp.dynamics([0, 0, 0])
    problem = classify(g.ocp)
    assert problem.path.y_names == ("u", "y_1")
    assert problem.control_reference == (0,)


def test_grids() -> None:
    assert OCP("a", T=3.0, N=10).dt == (0.3,) * 10
    assert OCP("a", intervals=np.array([0.1, 0.2])).dt == (0.1, 0.2)
    assert OCP("a", intervals=[0.1, 0.2], N=2).N == 2
    assert OCP("a", N=3).dt is None
