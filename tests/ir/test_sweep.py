"""Sweeps: the unrolled, printed and counted versions agree with NumPy, computed by hand."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen.ir.kernel import Kernel, Port
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.ir.sweep import (
    Affine,
    Call,
    For,
    LoopedRoutine,
    Slice,
    Sweep,
    lift_loops,
    lift_straight,
    unroll,
)
from nmpc_codegen.package.opcount import OpCount
from verification.c_harness import Routines

N, M = 3, 4


def _leaf(name: str, *sizes: int, outputs: list[ca.SX], symbols: list[ca.SX]) -> ca.Function:
    assert [s.numel() for s in symbols] == list(sizes)
    return ca.Function(name, symbols, outputs, [f"i{k}" for k in range(len(symbols))], ["o"])


def recursion() -> Sweep:
    """Backward over rows of A (M x N): s <- 0.5 s + A[k]; then forward over columns: y[c] = sum of column c times s[c].

    Offsets, a loop that runs down, a loop inside a loop, strided reads and writes, an update in place.
    """
    s, a, c, t = ca.SX.sym("s", N), ca.SX.sym("a", N), ca.SX.sym("c", M), ca.SX.sym("t")
    fade = _leaf("fade", N, N, symbols=[s, a], outputs=[0.5 * s + a])
    column = _leaf("column", M, 1, symbols=[c, t], outputs=[ca.sum1(c) * t])
    spread = _leaf("spread", 1, symbols=[t], outputs=[ca.vertcat(t, ca.sin(t))])
    double = _leaf("double", 1, symbols=[t], outputs=[t + t])
    return Sweep(
        "recursion",
        "a test of everything",
        (Port("A", M * N), Port("unused", 2)),
        (Port("y", N), Port("Y", 2, N)),
        (("s", N), ("idle", 5)),
        (
            For(
                "k", 0, M, (Call(fade, (Slice("s", N), Slice("A", N, Affine(0, (("k", N),)))), (Slice("s", N),)),), True
            ),
            For(
                "c",
                0,
                N,
                (
                    Call(
                        column,
                        (Slice("A", M, Affine(0, (("c", 1),)), N), Slice("s", 1, Affine(0, (("c", 1),)))),
                        (Slice("y", 1, Affine(0, (("c", 1),))),),
                    ),
                    For(
                        "r",
                        1,
                        2,
                        (
                            Call(
                                double,
                                (Slice("y", 1, Affine(0, (("c", 1),))),),
                                (Slice("y", 1, Affine(0, (("c", 1),))),),
                            ),
                        ),
                    ),
                    Call(
                        spread,
                        (Slice("y", 1, Affine(0, (("c", 1),))),),
                        (Slice("Y", 2, Affine(0, (("c", 1),)), N),),
                    ),
                ),
            ),
        ),
    )


def by_hand(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    s = np.zeros(N)
    for k in reversed(range(M)):
        s = 0.5 * s + A[k]
    y = 4 * A.sum(axis=0) * s
    return y, np.array([y, np.sin(y)])


def _started(sweep: Sweep) -> Sweep:
    """The same with s initialised to zero, because buffers in C may contain any values."""
    zero = ca.Function("zero", [], [ca.SX.zeros(N)], [], ["o"])
    return Sweep(
        sweep.name,
        sweep.doc,
        sweep.inputs,
        sweep.outputs,
        sweep.locals,
        (Call(zero, (), (Slice("s", N),)), *sweep.body),
    )


SWEEP = _started(recursion())
A = np.random.default_rng(1).uniform(-1, 1, (M, N))


@pytest.fixture(scope="module")
def routines() -> Routines:
    return Routines({"line": lift_straight(SWEEP), "loops": lift_loops(SWEEP)})


@pytest.mark.parametrize("spelling", ["line", "loops"])
def test_c_against_numpy(routines: Routines, spelling: str) -> None:
    for value, expected in zip(routines(spelling, A, np.zeros(2)), by_hand(A), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-14, atol=1e-15)


def test_unrolled_function_against_numpy() -> None:
    y, Y = unroll(SWEEP)(A.ravel(), np.zeros(2))
    for value, expected in zip((np.array(y).ravel(), np.array(Y)), by_hand(A), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-14, atol=1e-15)


def test_counts_multiply_loops_out() -> None:
    """fade: N mul and N add; column: M - 1 add and 1 mul; double: 1 add; spread: 1 call."""
    count = lift_loops(SWEEP).count
    fade, column = OpCount(add=N, mul=N) * M, OpCount(add=M - 1, mul=1) * N
    assert count == fade + column + OpCount(add=1) * (2 * N) + OpCount(call=1) * N
    line = lift_straight(SWEEP)
    assert isinstance(line, Kernel)
    assert line.count.total <= count.total
    assert line.count.call == N


def test_a_straight_line_program_has_one_kernel_and_a_looped_one_its_leaves() -> None:
    assert len(lift_straight(SWEEP).kernels) == 1
    names = [k.name for k in lift_loops(SWEEP).kernels]
    assert names == [f"recursion_{leaf}" for leaf in ("zero", "fade", "column", "double", "spread")]


def test_printed_loops() -> None:
    text = print_routine(lift_loops(SWEEP), CStyle("real", False))
    body = text[text.index("static void recursion(") :]
    expected = """\
static void recursion(const real A[12], real y[3], real Y[2][3])
{
    real s[3];
    s[0] = 0.0;
    s[1] = 0.0;
    s[2] = 0.0;
    for (ptrdiff_t k = 3; k >= 0; --k) {
        const real s_0 = s[0], s_1 = s[1], s_2 = s[2];
        s[0] = 0.5 * s_0 + A[3 * k];
        s[1] = 0.5 * s_1 + A[3 * k + 1];
        s[2] = 0.5 * s_2 + A[3 * k + 2];
    }
    for (ptrdiff_t c = 0; c < 3; ++c) {
        y[c] = (A[c] + A[c + 3] + A[c + 6] + A[c + 9]) * s[c];
        for (ptrdiff_t r = 1; r < 3; ++r) {
            y[c] = y[c] + y[c];
        }
        const real y_0 = y[c];
        Y[0][c] = y_0;
        Y[1][c] = sin(y_0);
    }
}"""
    assert body == expected


def test_leaves_store_structural_zeros() -> None:
    """A buffer is used again: entries that a leaf does not write would keep an old value."""
    t = ca.SX.sym("t", 2)
    sparse = ca.Function("sparse", [t], [ca.vertcat(ca.SX(1, 1), t[0])], ["t"], ["o"])
    sweep = Sweep("f", "", (Port("x", 2),), (Port("y", 2),), (), (Call(sparse, (Slice("x", 2),), (Slice("y", 2),)),))
    y = np.full(2, 9.0)
    Routines({"f": lift_loops(sweep)}).raw("f", np.array([3.0, 4.0]), y)
    np.testing.assert_array_equal(y, [0.0, 3.0])


def test_renamed() -> None:
    other = lift_loops(replace(SWEEP, name="other"))
    assert isinstance(other, LoopedRoutine)
    assert other.name == "other"
    assert other.kernels[0].name == "other_zero"


@pytest.mark.parametrize(
    ("offset", "text"),
    [
        (Affine(), "0"),
        (Affine(3), "3"),
        (Affine(0, (("k", 1),)), "k"),
        (Affine(-4, (("k", 2), ("c", 1))), "2 * k + c - 4"),
    ],
)
def test_affine_offsets(offset: Affine, text: str) -> None:
    assert offset.c() == text
    assert offset.at({"k": 5, "c": 7}) == eval(text, {"k": 5, "c": 7})


def test_slices_and_loops() -> None:
    assert Slice("b", 3, Affine(1, (("k", 2),)), 4).elements({"k": 5}) == [11, 15, 19]
    assert list(For("k", 2, 3, ()).values({})) == [2, 3, 4]
    assert list(For("k", 2, Affine(1, (("i", 2),)), ()).values({"i": 1})) == [2, 3, 4]
    assert list(For("k", 2, 3, (), down=True).values({})) == [4, 3, 2]
