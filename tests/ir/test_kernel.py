"""lift(): every operation in C against CasADi, value numbering, aliasing, dead code, and refusals."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import ProblemError
from nmpc_codegen.ir.kernel import OPERATIONS, Instruction, Kernel, Port, lift, live, opcode_name
from nmpc_codegen.package.opcount import OpCount
from verification.c_harness import Routines

x, y = ca.SX.sym("x"), ca.SX.sym("y")

#: Expressions in x and y, one per opcode, and arguments that reach every branch.
WIDE = [(0.7, 1.9), (-1.3, 0.4), (2.5, -0.6), (-0.2, -3.1), (0.0, 1.0), (1.5, 1.5)]
POSITIVE = [(0.7, 1.9), (1.3, 0.4), (2.5, 0.6), (1.2, 3.1)]
UNIT = [(0.7, 0.0), (-0.3, 0.0), (0.0, 0.0), (-0.95, 0.0)]
ABOVE_ONE = [(1.1, 0.0), (2.7, 0.0), (40.0, 0.0)]
LOGIC = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (-2.0, 0.5)]
EXPRESSIONS: dict[int, tuple[ca.SX, list[tuple[float, float]]]] = {
    ca.OP_ADD: (x + y, WIDE),
    ca.OP_SUB: (x - y, WIDE),
    ca.OP_MUL: (x * y, WIDE),
    ca.OP_DIV: (x / y, WIDE),
    ca.OP_NEG: (-x, WIDE),
    ca.OP_SQ: (x * x, WIDE),
    ca.OP_TWICE: (x + x, WIDE),
    ca.OP_INV: (1 / x, POSITIVE),
    ca.OP_SQRT: (ca.sqrt(x), POSITIVE),
    ca.OP_EXP: (ca.exp(x), WIDE),
    ca.OP_EXPM1: (ca.expm1(x), WIDE),
    ca.OP_LOG: (ca.log(x), POSITIVE),
    ca.OP_LOG1P: (ca.log1p(x), POSITIVE),
    ca.OP_POW: (x**y, POSITIVE),
    ca.OP_CONSTPOW: (x**2.7, POSITIVE),
    ca.OP_SIN: (ca.sin(x), WIDE),
    ca.OP_COS: (ca.cos(x), WIDE),
    ca.OP_TAN: (ca.tan(x), WIDE),
    ca.OP_ASIN: (ca.asin(x), UNIT),
    ca.OP_ACOS: (ca.acos(x), UNIT),
    ca.OP_ATAN: (ca.atan(x), WIDE),
    ca.OP_ATAN2: (ca.atan2(x, y), WIDE),
    ca.OP_SINH: (ca.sinh(x), WIDE),
    ca.OP_COSH: (ca.cosh(x), WIDE),
    ca.OP_TANH: (ca.tanh(x), WIDE),
    ca.OP_ASINH: (ca.asinh(x), WIDE),
    ca.OP_ACOSH: (ca.acosh(x), ABOVE_ONE),
    ca.OP_ATANH: (ca.atanh(x), UNIT),
    ca.OP_ERF: (ca.erf(x), WIDE),
    ca.OP_HYPOT: (ca.hypot(x, y), WIDE),
    ca.OP_FABS: (ca.fabs(x), WIDE),
    ca.OP_FMIN: (ca.fmin(x, y), WIDE),
    ca.OP_FMAX: (ca.fmax(x, y), WIDE),
    ca.OP_FLOOR: (ca.floor(x), WIDE),
    ca.OP_CEIL: (ca.ceil(x), WIDE),
    ca.OP_FMOD: (ca.fmod(x, y), WIDE),
    ca.OP_REMAINDER: (ca.remainder(x, y), WIDE),
    ca.OP_COPYSIGN: (ca.copysign(x, y), WIDE),
    ca.OP_SIGN: (ca.sign(x), WIDE),
    ca.OP_LT: (x < y, WIDE),
    ca.OP_LE: (x <= y, WIDE),
    ca.OP_EQ: (x == y, WIDE),
    ca.OP_NE: (x != y, WIDE),
    ca.OP_NOT: (ca.logic_not(x), LOGIC),
    ca.OP_AND: (ca.logic_and(x, y), LOGIC),
    ca.OP_OR: (ca.logic_or(x, y), LOGIC),
    ca.OP_IF_ELSE_ZERO: (ca.if_else(x, y, 0), LOGIC),
}


def of(*expressions: ca.SX, inputs: tuple[ca.SX, ...] = (x, y), name: str = "f") -> Kernel:
    """Kernel of expressions in the given inputs; outputs are named o0, o1, ..."""
    outputs = [Port(f"o{i}", e.shape[0], e.shape[1] if e.shape[1] > 1 else 0) for i, e in enumerate(expressions)]
    ports = [Port(f"i{i}", s.numel()) for i, s in enumerate(inputs)]
    return lift(ca.Function("f", list(inputs), list(expressions)), name, "test", ports, outputs)


@functools.cache
def compiled(precision: str) -> Routines:
    kernels = {f"op_{opcode}": of(e, name=f"op_{opcode}") for opcode, (e, _) in EXPRESSIONS.items()}
    return Routines(kernels, precision)


def test_every_operation_has_an_expression() -> None:
    assert set(EXPRESSIONS) == set(OPERATIONS) - {ca.OP_CALL}
    for opcode, (e, _) in EXPRESSIONS.items():
        assert opcode in {ins.opcode for ins in of(e).instructions}, opcode_name(opcode)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("opcode", EXPRESSIONS, ids=opcode_name)
def test_c_gives_the_value_of_casadi(opcode: int, precision: str) -> None:
    """A few units in the last place: the same libm in double precision; functions and arguments rounded to float."""
    e, points = EXPRESSIONS[opcode]
    f = ca.Function("f", [x, y], [e])
    scalar = {"double": np.float64, "single": np.float32}[precision]
    for point in points:
        rounded = [scalar(v) for v in point]
        (value,) = compiled(precision)(f"op_{opcode}", [rounded[0]], [rounded[1]])
        expected = float(f(*(float(v) for v in rounded)))
        np.testing.assert_allclose(value[0], expected, rtol=8 * np.finfo(scalar).eps, atol=0)
        assert value.dtype == scalar


# Refusals ----------------------------------------------------------------------------------------------------------


def test_an_operation_without_c_is_named() -> None:
    with pytest.raises(ProblemError, match="model: OP_ERFINV has no C code"):
        of(ca.erfinv(x), name="model")


def test_a_call_is_named() -> None:
    inner = ca.Function("inner", [x], [ca.sin(x)], {"never_inline": True})
    outer = ca.Function("outer", [x, y], [inner(x) + y])
    assert ca.OP_CALL in {outer.instruction_id(k) for k in range(outer.n_instructions())}
    with pytest.raises(ProblemError, match="model: OP_CALL has no C code"):
        lift(outer, "model", "", [Port("x", 1), Port("y", 1)], [Port("z", 1)])


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan])
def test_constants_are_finite(bad: float) -> None:
    with pytest.raises(ProblemError, match=r"model: the expressions contain the constant (inf|-inf|nan)"):
        of(x + ca.SX(bad), name="model")


# Value numbering, dead code, counts --------------------------------------------------------------------------------


def test_commutative_operands_share_one_value() -> None:
    assert of(x * y, y * x, ca.sin(x + y) - ca.sin(y + x) + x).count == OpCount(add=3, mul=1, call=1)


def test_other_operands_keep_their_order() -> None:
    kernel = of(x - y, y - x, x / y, y / x, ca.atan2(x, y), ca.atan2(y, x))
    assert kernel.count == OpCount(add=2, div=2, call=2)
    values = Routines({"f": kernel})("f", [0.5], [2.0])
    expected = [-1.5, 1.5, 0.25, 4.0, np.arctan2(0.5, 2), np.arctan2(2, 0.5)]
    np.testing.assert_allclose(np.ravel(values), expected, rtol=1e-15)


def test_every_commutative_operation_commutes() -> None:
    """Marked operations give one instruction for both orders; all other binary operations give two."""
    for opcode, operation in OPERATIONS.items():
        if "{1}" not in operation.c or opcode == ca.OP_CONSTPOW:
            continue
        forward, backward = (ca.SX.binary(opcode, *pair) for pair in ((x, y), (y, x)))
        found = [ins for ins in of(forward, backward).instructions if ins.opcode == opcode]
        assert len(found) == (1 if operation.commutative else 2), opcode_name(opcode)


def test_values_that_no_output_needs_are_dropped() -> None:
    v = ca.SX.sym("v", 3)
    dead = ca.Function("f", [v], [ca.vertcat(v[0], ca.sin(v[1]))])
    whole = lift(dead, "f", "", [Port("v", 3)], [Port("a", 2)])
    assert whole.count == OpCount(call=1)
    program = [
        Instruction(ca.OP_INPUT, (0, 0)),
        Instruction(ca.OP_SIN, (0,)),
        Instruction(ca.OP_INPUT, (0, 1)),
        Instruction(ca.OP_MUL, (1, 2)),
        Instruction(ca.OP_COS, (2,)),
    ]
    kept, new = live(program, [4])
    assert kept == (Instruction(ca.OP_INPUT, (0, 1)), Instruction(ca.OP_COS, (0,)))
    assert new == {2: 0, 4: 1}


def test_structural_zeros_are_not_stored_and_matrices_are_row_major() -> None:
    matrix = ca.SX(2, 3)
    matrix[0, 1], matrix[1, 0], matrix[1, 2] = x, y, x + y
    kernel = of(matrix)
    assert sorted(e for _, e, _ in kernel.stores) == [1, 3, 5]
    (value,) = Routines({"f": kernel})("f", [2.0], [3.0])
    np.testing.assert_array_equal(value, [[0, 2, 0], [3, 0, 5]])


def test_outputs_may_alias_inputs() -> None:
    """A rotation in place, and both outputs on the two inputs exchanged."""
    v, w = ca.SX.sym("v", 3), ca.SX.sym("w", 3)
    kernel = of(ca.vertcat(v[1] + w[0], v[2] * w[1], v[0]), ca.vertcat(v[0] - w[2], w[0], v[1]), inputs=(v, w))
    routines = Routines({"f": kernel})
    first, second = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    separate = routines("f", first, second)
    for order in ((0, 1), (1, 0)):
        arrays = [first.copy(), second.copy()]
        routines.raw("f", *arrays, *(arrays[i] for i in order))
        np.testing.assert_array_equal([arrays[i] for i in order], separate)


def test_classes_of_the_counts() -> None:
    e = ca.sqrt(x) / y + ca.exp(x) * ca.fabs(y) - ca.if_else(x < y, x, y)
    kernel = of(e)
    assert kernel.count.sqrt == 1
    assert kernel.count.div == 1
    assert kernel.count.call == 1
    assert kernel.count.add >= 2
    assert kernel.count.total == sum(kernel.count.as_dict().values())


def test_counts_add_and_multiply() -> None:
    a, b = OpCount(1, 2, 3, 4, 5, 6), OpCount(add=10)
    assert a + b == OpCount(11, 2, 3, 4, 5, 6)
    assert a * 3 == OpCount(3, 6, 9, 12, 15, 18)
    assert a.total == 21


def test_empty_inputs_and_outputs() -> None:
    empty = ca.SX.sym("p", 0)
    kernel = of(2 * x, ca.SX(0, 1), inputs=(x, empty))
    value, nothing = Routines({"f": kernel})("f", [1.5], [])
    assert value[0] == 3.0
    assert nothing.shape == (0,)
