"""The program of a problem in NumPy against CasADi: values of rows, and where derivatives are not finite."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.row_program import program
from nmpc_codegen.ir.kernel import OPERATIONS, opcode_name
from nmpc_codegen.package.program import EDGES, VALUES, Finding, Program, Quantity, locate

a, b = ca.SX.sym("a"), ca.SX.sym("b")

#: Operations with an edge as functions of one or two expressions.
SUSPECTS: dict[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    "sqrt": lambda a, b: ca.sqrt(a),
    "hypot": ca.hypot,
    "atan2": ca.atan2,
    "pow": lambda a, b: a**b,
    "constpow": lambda a, b: a**1.5,
    "log": lambda a, b: ca.log(a),
    "log1p": lambda a, b: ca.log1p(a),
    "asin": lambda a, b: ca.asin(a),
    "acos": lambda a, b: ca.acos(a),
    "acosh": lambda a, b: ca.acosh(a),
    "atanh": lambda a, b: ca.atanh(a),
    "div": lambda a, b: a / b,
    "inv": lambda a, b: 1 / a,
    "exp": lambda a, b: ca.exp(a),
    "expm1": lambda a, b: ca.expm1(a),
    "sinh": lambda a, b: ca.sinh(a),
    "cosh": lambda a, b: ca.cosh(a),
}
POINTS = list(itertools.product((-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 3.0, 800.0), (-1.0, 0.0, 0.5, 1.0, 1.5, 2.0)))


def stated(row: Callable[[ca.SX, ca.SX], ca.SX], bounds: tuple[float, float] = (-1.0, 1.0)) -> OCP:
    ocp = OCP("edge", T=1.0, N=1)
    x, v, u = ocp.state("a"), ocp.state("b"), ocp.control("u")
    ocp.dynamics({x: u, v: -v})
    ocp.least_squares(ca.vertcat(x, v, u), weight=1)
    ocp.subject_to(bounds[0], row(x, v) + u, bounds[1], name="edge")
    return ocp


def found_at(of: Program, point: tuple[float, float], second: bool = True) -> list[Finding]:
    return locate(of, np.tile(point, (2, 1)), np.zeros((1, 1)), np.zeros((2, 0)), second)


def test_every_operation_has_a_value_and_every_edge_a_case() -> None:
    names = {opcode_name(op).removeprefix("OP_").lower() for op in OPERATIONS}
    assert names - {"call"} == set(VALUES)  # a look-up table has its own values
    assert set(SUSPECTS) == set(EDGES) <= set(VALUES)


@pytest.mark.parametrize("name", SUSPECTS)
def test_edges_are_where_casadi_has_no_finite_derivatives(name: str) -> None:
    """The order of the first derivative that is not finite, at points inside, outside and at the edge."""
    expression = SUSPECTS[name](a, b)
    z = ca.vertcat(a, b)
    derivatives = [expression, ca.gradient(expression, z), ca.hessian(expression, z)[0]]
    orders = [ca.Function("order", [a, b], [ca.densify(d)]) for d in derivatives]
    of = program(classify(stated(SUSPECTS[name])))
    assert name in {o.name for o in of.operations}
    for point in POINTS:
        broken = [order for order, f in enumerate(orders) if not np.all(np.isfinite(np.array(f(*point))))]
        found = found_at(of, point)
        assert [f.order for f in found] == broken[:1], point
        assert bool(found_at(of, point, second=False)) == bool(broken and broken[0] < 2), point
        assert all(f.where == "row 'edge'" for f in found)


def test_rows_have_the_values_of_casadi() -> None:
    """All operations at once, at both ends of the horizon."""

    def everything(x: ca.SX, v: ca.SX) -> ca.SX:
        smooth = [
            f(1.5 + ca.fabs(x) / 4, 0.5 + v**2) for n, f in SUSPECTS.items() if n not in ("asin", "acos", "atanh")
        ]
        bounded = [f(x / 9, v) for n, f in SUSPECTS.items() if n in ("asin", "acos", "atanh")]
        others = [
            *(ca.sin(x), ca.cos(v), ca.tan(x), ca.atan(v), ca.tanh(x), ca.asinh(v), ca.erf(x), ca.sign(v), ca.floor(x)),
            *(ca.ceil(v), ca.fmin(x, v), ca.fmax(x, v), ca.fmod(x, 0.7), ca.remainder(v, 0.7), ca.copysign(x, v)),
            *(ca.if_else(x < v, x, 2 * v), ca.if_else(ca.logic_and(x <= 1, v != 0), v, x), ca.logic_not(x), x == v),
            *(ca.logic_or(x > 1, v > 1), -x, x + x),
        ]
        return sum(k * value for k, value in enumerate([*smooth, *bounded, *others], 1))

    ocp = OCP("rows", T=1.0, N=3)
    x, v, u, p = ocp.state("x"), ocp.state("v"), ocp.control("u"), ocp.parameter("p", value=2.0)
    ocp.dynamics({x: u, v: -v})
    ocp.least_squares(ca.vertcat(x, v, u), weight=1)
    ocp.subject_to(-1, everything(x, v) * p, 1, name="all")
    ocp.subject_to(-1, u * x - p, 1, name="path")
    of = program(classify(ocp))
    rng = np.random.default_rng(0)
    z, w, q = rng.uniform(-2, 2, (20, 2)), rng.uniform(-1, 1, (20, 1)), rng.uniform(1, 2, (20, 1))
    f = ca.Function("f", [x, v, u, p], [everything(x, v) * p, u * x - p])
    names = [row.name for row in classify(ocp).rows]
    values = of.values(z, w, q)
    for k in range(20):
        both = [float(value) for value in f(*z[k], *w[k], *q[k])]
        (path, end), (only, none) = of.rows[names.index("all")], of.rows[names.index("path")]
        assert [values[path][k], values[end][k], values[only][k]] == pytest.approx(
            [both[0], both[0], both[1]], rel=1e-12
        )
        assert none == -1


def test_operations_belong_to_parts_in_the_names_of_the_user() -> None:
    ocp = OCP("many", T=1.0, N=4)
    r, u, w = ocp.state("r", size=2), ocp.control("u"), ocp.parameter("w")
    size = ca.norm_2(r)
    ocp.dynamics({r: ca.vertcat(u / r[1], -w * size)})
    ocp.least_squares(size, weight=1, names=["radius"])
    ocp.terminal_least_squares(size, weight=1, names=["last"])
    ocp.stage_cost(ca.log(3 * r[0] - 2))
    ocp.subject_to(0, ca.atan2(r[0], w), 1, at="end", name="angle")
    texts = {o.text: o.quantities for o in program(classify(ocp)).operations}
    assert texts == {
        "sqrt(r[0]**2 + r[1]**2)": (
            Quantity("the equation of r[1]", 0, 3),
            Quantity("the residual 'radius'", 0, 3),
            Quantity("the terminal residual 'last'", 4, 4),
        ),
        "u / r[1]": (Quantity("the equation of r[0]", 0, 3),),
        "log(r[0] * 3 - 2)": (Quantity("the general cost", 0, 3),),
        "atan2(r[0], w)": (Quantity("row 'angle_end'", 4, 4, squares=True),),
    }


def test_what_only_parameters_reach_needs_no_derivative() -> None:
    ocp = OCP("given", T=1.0, N=2)
    x, u, p = ocp.state("x"), ocp.control("u"), ocp.parameter("p")
    ocp.dynamics({x: u * ca.sqrt(p) - x})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    of = program(classify(ocp))
    assert not locate(of, np.zeros((3, 1)), np.zeros((2, 1)), np.zeros((3, 1)), True)
    (found,) = locate(of, np.zeros((3, 1)), np.zeros((2, 1)), np.full((3, 1), -1.0), True)
    assert str(found) == "the equation of x at nodes 0..1: sqrt(p) is not finite where its argument is -1"


def test_a_program_that_refers_to_nothing_is_refused() -> None:
    good = program(classify(stated(SUSPECTS["sqrt"])))
    good.check((2, 1, 0), 1, EDGES)
    with pytest.raises(ValueError, match="step 0 of the program is input 0 1"):
        Program((("input", 0, 1, 0.0),)).check((1, 1, 0), 0, EDGES)
    with pytest.raises(ValueError, match="step 1 of the program is add 0 1"):
        Program((("const", 0, 0, 1.0), ("add", 0, 1, 0.0))).check((1, 1, 0), 0, EDGES)
    with pytest.raises(ValueError, match="step 0 of the program is system"):
        Program((("system", 0, 0, 1.0),)).check((1, 1, 0), 0, EDGES)
    with pytest.raises(ValueError, match="lacks a step"):
        Program((), ((0, -1),)).check((1, 1, 0), 1, EDGES)
    with pytest.raises(ValueError, match="has 1 rows, expected 2"):
        good.check((2, 1, 0), 2, EDGES)
    other = replace(good, operations=(replace(good.operations[0], name="sin"),))
    with pytest.raises(ValueError, match="contains the operations sin"):
        other.check((2, 1, 0), 1, EDGES)
