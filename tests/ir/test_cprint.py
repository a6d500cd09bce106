"""Numbers and kernels as C text."""

from __future__ import annotations

import ctypes

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmpc_codegen.ir.kernel import Instruction, Kernel, Port, lift
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.kernels import comment, print_kernel, signature
from nmpc_codegen.ir.printing.nested_expressions import NestedExpressions
from verification.c_harness import shared_library

DOUBLE, SINGLE = CStyle("real", False), CStyle("real", True)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_literal_reads_back_to_the_same_number(value: float) -> None:
    text = DOUBLE.literal(value)
    assert float(text) == value
    assert any(c in text for c in ".e"), "an integer literal would divide as integers"


@pytest.mark.parametrize(
    ("value", "text"), [(1, "1.0"), (-2.0, "-2.0"), (0.1, "0.1"), (1e-5, "1e-05"), (1e300, "1e+300"), (3e22, "3e+22")]
)
def test_literals(value: float, text: str) -> None:
    assert DOUBLE.literal(value) == text
    assert SINGLE.literal(value) == text + "F"


def test_the_compiler_reads_what_was_meant() -> None:
    """Literals through the C compiler, bit by bit."""
    values = [0.1, -1 / 3, 1e-300, 5e-324, 1.7976931348623157e308, 123456789.0, 2.0**-1074, np.pi]
    lines = ["double value(int i);", "double value(int i)", "{", "    static const double v[] = {"]
    lines += [f"        {DOUBLE.literal(v)}," for v in values] + ["    };", "    return v[i];", "}", ""]
    library = shared_library({"v.c": "\n".join(lines).replace(",\n    };", "\n    };")}, "v.c")
    library.value.restype = ctypes.c_double
    assert [library.value(i) for i in range(len(values))] == values


def test_functions_of_the_precision() -> None:
    assert DOUBLE.function("sin") == "sin"
    assert SINGLE.function("sin") == "sinf"


IN = (Port("x", 2), Port("p", 0))
OUT = (Port("y", 2, 2, "a matrix"), Port("z", 1))


def test_signature() -> None:
    expected = "static void f(const real x[2], const real p[0], real y[2][2], real z[1])"
    assert signature("f", IN, OUT, DOUBLE) == expected


def test_comment() -> None:
    expected = "/* y = A x; y: a matrix: 3 add */"
    assert comment("y = A x", IN, OUT, "3 add") == expected


KERNEL = Kernel(
    "f",
    "y = a hand-written kernel",
    IN,
    OUT,
    (
        Instruction(ca.OP_INPUT, (0, 0)),
        Instruction(ca.OP_INPUT, (0, 1)),
        Instruction(ca.OP_CONST, (), -0.5),
        Instruction(ca.OP_MUL, (0, 2)),
        Instruction(ca.OP_SIN, (3,)),
        Instruction(ca.OP_NEG, (4,)),
        Instruction(ca.OP_INV, (1,)),
    ),
    ((0, 0, 5), (0, 3, 6)),
)

TEXT = """\
/* y = a hand-written kernel; y: a matrix: 1 mul, 1 div, 1 call, 1 other */
static void f(const real x[2], real y[2][2])
{
    const real x_0 = x[0], x_1 = x[1];
    y[0][0] = -sin(x_0 * (-0.5));
    y[1][1] = 1.0 / x_1;
}"""


def test_a_whole_kernel() -> None:
    """Loads first, stores last; ports that are neither read nor written are no arguments."""
    assert print_kernel(KERNEL, DOUBLE) == TEXT


def test_a_whole_kernel_in_single_precision() -> None:
    expected = TEXT.replace("-0.5", "-0.5F").replace("sin(", "sinf(").replace("1.0 /", "1.0F /")
    assert print_kernel(KERNEL, SINGLE) == expected


def test_no_operations() -> None:
    copy = Kernel("g", "copy", IN[:1], OUT[1:], (Instruction(ca.OP_INPUT, (0, 1)),), ((0, 0, 0),))
    assert "no operations" in print_kernel(copy, DOUBLE)


@pytest.mark.parametrize("seed", range(40))
def test_nested_expressions_have_the_value_of_the_kernel(seed: int) -> None:
    """Random sums, differences, products, quotients and squares: Python reads the nested text as C does."""
    random = np.random.default_rng(seed)
    x = ca.SX.sym("x", 4)
    known = [x[i] for i in range(4)]
    for _ in range(12):
        a, b = (known[i] for i in random.integers(len(known), size=2))
        known.append([a + b, a - b, a * b, a / (b * b + 1), a * a, -a][random.integers(6)])
    outputs = ca.vertcat(*known[-3:])
    function = ca.Function("f", [x], [outputs])
    kernel = lift(function, "f", "", [Port("x", 4)], [Port("y", 3)])
    expressions = NestedExpressions(kernel, CStyle("real", False), lambda _, element: f"x[{element}]")
    point = random.uniform(-1, 1, 4)
    names: dict[str, object] = {"x": point}
    for statement in expressions.statements:
        name, _, text = statement.removeprefix("const real ").removesuffix(";").partition(" = ")
        names[name] = eval(text, {}, names)
    expected = np.array(function(point)).ravel()
    for _, element, value in kernel.stores:
        text = expressions.assignment("y", value).removeprefix("y = ")
        np.testing.assert_allclose(eval(text, {}, names), expected[element], rtol=1e-13)


def test_what_is_used_once_is_nested_without_needless_parentheses() -> None:
    a, b, c = (ca.SX.sym(name) for name in "abc")
    function = ca.Function("f", [a, b, c], [a + b * c, (a + b) * c, a - (b - c), c + a * b])
    kernel = lift(function, "f", "", [Port(n, 1) for n in "abc"], [Port(n, 1) for n in "wxyz"])
    expressions = NestedExpressions(kernel, CStyle("real", False), lambda port, _: "abc"[port])
    texts = ["w = a + b * c", "x = c * (a + b)", "y = a - (b - c)", "c += a * b"]
    assert expressions.statements == []
    assert [expressions.assignment(t.split()[0], v) for t, (_, _, v) in zip(texts, kernel.stores, strict=True)] == texts
