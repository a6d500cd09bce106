"""Bounds on operations from the text of C functions: loops, branches, calls, stated passes."""

from __future__ import annotations

import pytest

from nmpc_codegen.analysis.interpret import UnboundedError, WorstCase
from nmpc_codegen.analysis.source import TextMacro, Type, Unit, functions
from tests.c_lines import in_lines


def unit(text: str) -> WorstCase:
    known = Unit(
        functions=functions(in_lines(text)),
        macros={
            "R": TextMacro(("x",), "((real_t)(x))"),
            "SQRT": TextMacro((), "sqrtf"),
            "TWICE": TextMacro(("x",), "(x + x)"),
        },
        counts={"kernel": 100},
        sizes={"N": 5, "M": 3},
        tables={"first": (0, 2, 2, 7)},
        ranges={"nw": (0, 4)},
        members={"nw": [Type("int")], "y": [Type("real", 1)]},
    )
    return WorstCase(known)


def cost(body: str, more: str = "") -> int:
    return unit(f"{more}\nstatic void f(solver_t *s, real_t *x, int n)\n{{\n{body}\n}}\n").operations("f")


ADD = "x[0] += R(1);"
STRAIGHT = {
    "one operation": ("x[0] = x[1] * x[2];", 1),
    "compound assignment, sign, comparison": ("x[0] += -x[1]; n = x[0] < x[1];", 3),
    "integers and addresses": ("int k = 2 * n + 1; real_t *y = x + k; y[0] = y[k - 1];", 0),
    "constants": ("x[0] = R(1.0 / 3);", 0),
    "function of math.h": ("x[0] = SQRT(x[1] * x[1]);", 2),
    "macro": ("x[0] = TWICE(x[1]);", 1),
    "known kernel": ("kernel(x);", 100),
    "members": ("s->y[n] *= s->y[0]; n = s->nw + 1;", 1),
}


@pytest.mark.parametrize("case", STRAIGHT)
def test_straight_line(case: str) -> None:
    body, expected = STRAIGHT[case]
    assert cost(body) == expected


LOOPS = {
    "constant": (f"for (int i = 0; i < N; i++) {{ {ADD} }}", 5),
    "inclusive, downwards, in steps": (f"for (int i = N; i >= 1; i -= 2) {{ {ADD} }}", 3),
    "triangle": (f"for (int i = 0; i < N; i++) {{ for (int j = 0; j <= i; ++j) {{ {ADD} }} }}", 15),
    "two conditions": (f"for (int i = 0; i < N && i + 2 < N; i++) {{ {ADD} }}", 3),
    "a condition that computes": ("for (int i = 0; i < N && x[i] > R(0); i++) { }", 5),
    "of a table": (f"for (int m = first[2]; m < first[3]; m++) {{ {ADD} }}", 5),
    "over a table": (f"for (int k = 0; k < M; k++) {{ for (int m = first[k]; m < first[k + 1]; m++) {{ {ADD} }} }}", 7),
    "of a member": (f"for (int k = 0; k < s->nw; k++) {{ {ADD} }}", 4),
    "unknown start": (f"/* 1 <= n <= N */\nfor (int k = n; k < N; k++) {{ {ADD} }}", 4),
    "stated passes": (f"while (x[0] > R(0)) {{ /* at most N + 1 passes */\n {ADD} }}", 13),
    "nothing to count": ("while (n > 0) { n = n / 2; }", 0),
    "known branch": (f"for (int k = 0; k <= N; k++) {{ if (k < N) {{ {ADD} }} else {{ {3 * ADD} }} }}", 8),
}


@pytest.mark.parametrize("case", LOOPS)
def test_loops(case: str) -> None:
    body, expected = LOOPS[case]
    assert cost(body) == expected


BRANCHES = {
    "larger branch": (f"if (n > 0) {{ {ADD} }} else {{ {4 * ADD} }}", 4),
    "what an early return skips": (f"if (n > 0) {{ {3 * ADD} return; }} {5 * ADD}", 5),
    "what follows a branch": (f"if (n > 0) {{ {3 * ADD} }} {5 * ADD}", 8),
    "selection": ("x[0] = n > 0 ? x[1] + x[2] : x[1] * x[2] * x[3];", 2),
    "never taken": (f"if (N < M) {{ {ADD} }}", 0),
}


@pytest.mark.parametrize("case", BRANCHES)
def test_branches(case: str) -> None:
    body, expected = BRANCHES[case]
    assert cost(body) == expected


def test_calls_are_evaluated_for_their_integer_arguments() -> None:
    g = f"static int g(real_t *x, int n)\n{{\nfor (int i = 0; i < n; i++) {{ {ADD} }}\nreturn 2 * n;\n}}\n"
    assert cost("g(x, N); g(x, M);", g) == 8
    assert cost(f"for (int i = 0; i < g(x, 2); i++) {{ {ADD} }}", g) == 4 + 5 * 2


def test_passes_of_a_function_are_shared() -> None:
    """The loop is entered three times, and each time one pass may end it; four more passes may occur in all."""
    g = f"static void g(real_t *x)\n{{\nwhile (x[0] > R(0)) {{ /* at most 4 passes in f */\n{ADD} }}\n}}\n"
    assert cost("for (int i = 0; i < 3; i++) { g(x); }", g) == (3 + 4) * 2 + 3


def test_shared_passes_count_in_every_call_outside_of_that_function() -> None:
    g = f"static void g(real_t *x)\n{{\nwhile (x[0] > R(0)) {{ /* at most 4 passes in h */\n{ADD} }}\n}}\n"
    assert cost("g(x); g(x);", g) == 2 * (4 * 2 + 1)


@pytest.mark.parametrize("condition", ["i / 2 < N", "N - i > 0", "2 * i < N", "i + i < N"])
def test_a_condition_that_is_not_understood_is_an_error(condition: str) -> None:
    with pytest.raises(UnboundedError, match="passes"):
        cost(f"for (int i = 0; {condition}; i++) {{ {ADD} }}")


@pytest.mark.parametrize(
    "body", [f"while (n > 0) {{ {ADD} }}", f"for (int i = 0; i < n; i++) {{ {ADD} }}", "foreign(x);"]
)
def test_what_is_unknown_is_an_error(body: str) -> None:
    with pytest.raises(UnboundedError, match=r"^f"):
        cost(body)
