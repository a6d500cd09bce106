"""The unit of a package: what nothing reaches is not in it, what it needs stays."""

from __future__ import annotations

import re

import casadi as ca
import numpy as np
import pytest
from conftest import require_tool

from nmpc_codegen import (
    OCP,
    RK4,
    AugmentedLagrangian,
    Euler,
    ExactHessian,
    ExplicitRungeKutta,
    ForwardOverAdjoint,
    Options,
    RealTimeIteration,
    Symmetric,
    build,
    generate,
)
from nmpc_codegen.components.integrators import ButcherTableau
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.macros import macro
from nmpc_codegen.lowering.unit.pipeline import run, verify
from nmpc_codegen.lowering.unit.read import items_of
from nmpc_codegen.lowering.unit.text import text_of_unit
from nmpc_codegen.lowering.unit.unread_arguments import macros_that_act
from verification import quality

#: N is a size; ROW drops its second argument; OUTER passes its arguments to ROW in turn.
KNOWN = (
    macro("N", "P_N"),
    macro("ROW", "(s)->x[N]", "s, h"),
    macro("OUTER", "ROW(a, b) + 1", "a, b"),
    macro("BOTH", "a * b", "a, b"),
    macro("KERNEL", "kernel((s)->x)", "s"),
)
KERNELS = (
    Item("kernel", "function", "static void kernel(const real_t *x)\n{\n    own_sin(x[0]);\n}", state="ready"),
    Item("spare", "function", "static void spare(void)\n{\n}", state="ready"),
)


def kept(text: str, constants: Constants | None = None, known: tuple[Item, ...] = KNOWN) -> str:
    """The functions of a text, and what else is no macro, after the pipeline."""
    unit = run((*known, *items_of(text)), constants or Constants())
    return text_of_unit([item for item in unit if item.kind != "macro"], "", "p", ()).strip("\n")


def left(text: str, known: tuple[Item, ...]) -> list[tuple[str, str | None, str]]:
    """The macros after the pipeline."""
    return [(i.name, i.arguments, i.text) for i in run((*known, *items_of(text)), Constants()) if i.kind == "macro"]


def function(*block: str, head: str = "void API(f)(solver_t *s, int *out)", unread: str = "") -> str:
    """A function, of the package's interface by default; ``unread``: its parameter that it does not read."""
    marked = [f"    (void){unread};"] if unread else []
    return "\n".join([head, "{", *marked, *(f"    {line}" for line in block), "}"])


def test_what_macros_drop_leaves_them() -> None:
    """The argument, what passes it on, and the variable that was only there for it."""
    for call in ("ROW(s, h)", "ROW(s,\n        h + 1)"):
        found = kept(function("const real_t h = s->h;", f"out[0] = {call};"))
        assert found == function("out[0] = ROW(s);")
    assert kept(function("out[0] = OUTER(s, h + 1);")) == function("out[0] = OUTER(s);")
    read = function("const real_t h = s->h;", "out[0] = BOTH(s->a, h);")
    assert kept(read) == read
    known = left(function("out[0] = OUTER(s, 1);"), KNOWN)
    assert known == [("N", None, "P_N"), ("ROW", "s", "(s)->x[N]"), ("OUTER", "a", "ROW(a) + 1")]


def test_macros_that_are_names() -> None:
    """Without arguments they are one; the call of a function with the same arguments, or with none, is that call."""
    known = (macro("TABLE", "table", "s, k"), macro("CALL", "next(1)", "s, k"), macro("SAME", "step(x, y)", "x, y"))
    text = function("out[0] = TABLE(s, 1) + CALL(s, TABLE(s, 2)) + SAME(s->a, CALL(s, 1));")
    assert kept(text, known=known) == function("out[0] = TABLE + next(1) + step(s->a, next(1));")
    assert left(text, known) == [("TABLE", None, "table")]


def test_directives_end_no_block() -> None:
    """#pragma stands at the margin."""
    loop = "#pragma GCC unroll 4\n    for (int i = 0; i < h; i++) {\n        n++;\n    }"
    text = f"int f(int n)\n{{\n    int h = n;\n{loop}\n}}"
    assert kept(text) == text


def test_unread_parameters_leave_inner_functions() -> None:
    """Those of the interface stay, with a statement."""
    head = "int API(f)(const real_t (*Q)[N], const real_t u[N], real_t *x, int k)"
    text = function("return ROW(x, u) + Q[0][0] + g(s, k);", head=head) + "\n\n" + function("return n + 1;", head=TWO)
    body = ("(void)u;", "return ROW(x) + Q[0][0] + g(k);")
    assert kept(text) == function(*body, head=head) + "\n\n" + function("return n + 1;", head=INNER)
    assert kept(function("return 1;", head="int API(f)(void)")) == function("return 1;", head="int API(f)(void)")


def test_parameters_go_with_those_that_only_pass_them_on() -> None:
    """Also from prototypes; the last one leaves (void)."""
    outer = function("last(k, s);", "s->a = 1;", head="static void outer(solver_t *s, int k)")
    last = "/* Of (k). */\n" + function("count();", head="static void last(int k,\n    solver_t *s)")
    text = "static void last(int k, solver_t *s);\n\n" + outer + "\n\n" + last + "\n\n" + function("outer(s, out[0]);")
    found = kept(text)
    assert "static void outer(solver_t *s)\n{\n    last();\n" in found
    assert found.startswith("static void last(void);\n")
    assert "/* Of (k). */\nstatic void last(void)\n{" in found
    assert "outer(s);" in found


def test_an_argument_that_acts_stays() -> None:
    acts = function("out[0] = g(next(s), 1);") + "\n\n" + function("return n + 1;", head=TWO)
    assert kept(acts) == acts.replace("int n)\n{", "int n)\n{\n    (void)s;")


def test_functions_that_are_numbers() -> None:
    """They stand where they are called, unless the call is a statement."""
    one = function("return N;", head=TWO)
    assert kept(function("out[0] = s->x[g(s, 1)];") + "\n\n" + one) == function("out[0] = s->x[N];")
    found = kept(function("g(s, 1);", "out[0] = s->a;") + "\n\n" + one)
    assert "g();" in found
    assert "static int g(void)\n{\n    return N;" in found


def test_variables_that_are_numbers() -> None:
    """A number or a size from the declaration on."""
    found = kept(function("const int k = N;", "int h = 2;", "real_t sum = R(0);", "out[k] = s->k[h] + sum;"))
    assert found == function("out[N] = s->k[2];")
    assert kept(function("real_t sum = R(0);", "out[0] = s->a * sum;")) == function("out[0] = s->a * R(0);")
    for line in ("h++;", "--h;", "h = 3;", "h += 1;", "f(&h);", "h <<= 1;"):
        text = function("int h = 2;", line, "out[0] = s->a + h;")
        assert kept(text) == text
    compared = function("int h = 2;", "out[0] = s->a == h && h == 3;")
    assert kept(compared) == function("out[0] = s->a == 2 && 2 == 3;")


INNER = "static int g(int n)"
TWO = "static int g(solver_t *s, int n)"


def test_functions_that_nothing_reaches_go_with_their_comments() -> None:
    static = "static int {}(int n)"
    called = function("return deeper(n) + 1;", head=static.format("called"))
    deeper = function("return n + 2;", head=static.format("deeper"))
    spare = "/* For other problems:\n * returns 1. */\n" + function("return spare(n);", head=static.format("spare"))
    table = "/* functions */\nstatic int (*const table[1])(int) = { listed };"
    listed = function("return n;", head=static.format("listed"))
    root = function("out[0] = called(s->a) + table[0](1);")
    prototype = "static int spare(int n);"
    found = kept("\n\n".join([prototype, deeper, spare, called, listed, table, root]))
    assert "spare" not in found
    assert "For other problems" not in found
    assert all(text in found for text in (deeper, called, listed, table, root))


def test_calls_that_constants_exclude_reach_nothing() -> None:
    call = function("if (NG > 0) {", "    rows(s);", "}", "out[0] = 1;")
    rows = function("s->a = 1;", head="static void rows(solver_t *s)")
    found = kept(f"{rows}\n\n{call}", Constants({"NG": 0}))
    assert found == function("out[0] = 1;", unread="s")


def test_printed_kernels_that_nothing_calls_go() -> None:
    found = kept(function("KERNEL(s);", "out[0] = 1;"), known=(*KNOWN, *KERNELS))
    assert found.startswith(KERNELS[0].text + "\n\nvoid API(f)")
    assert "spare" not in found


def test_enumerations_and_headings_of_what_is_gone() -> None:
    spare = "/* Slacks. */\n\nenum { LEFT, RIGHT };\n\n" + function("return LEFT;", head="static int spare(void)")
    used = "/* Used. */\n\n/* Signs. */\nenum { UP, DOWN };\n\n" + function("out[0] = s->a + DOWN;")
    found = kept(f"{spare}\n\n{used}")
    assert "Slacks" not in found
    assert "LEFT" not in found
    assert found == used.replace("enum { UP, DOWN };", "#define UP 0\n#define DOWN 1")


def test_an_enumeration_may_need_another_one() -> None:
    text = "enum { ONE = 1, TWO };\n\nenum { THREE = TWO + 1 };\n\n" + function("out[0] = s->a + THREE;")
    ones, three = "#define ONE 1\n#define TWO 2", "#define THREE (TWO + 1)"
    assert kept(text) == text.replace("enum { ONE = 1, TWO };", ones).replace("enum { THREE = TWO + 1 };", three)


def test_a_loop_that_runs_once_is_its_statements() -> None:
    loop = ("for (int j = 0; j < 1; j++) {", "    out[j] = s->k[ONE + j] + s->k[j * N];", "}")
    assert kept(function(*loop)) == function("out[0] = s->k[ONE] + s->k[0];")
    left = (
        "for (int j = 0; j < 1; j++) {",
        "    if (s->a > 1) {",
        "        break;",
        "    }",
        "    out[j] = s->b;",
        "}",
    )
    assert kept(function(*left)) == function(*left)
    two = ("for (int j = 0; j < 2; j++) {", "    out[j] = s->b;", "}")
    assert kept(function(*two)) == function(*two)
    counted = ("for (int j = 0; j < 1; j++) {", "    out[j] = s->b;", "    j += s->a;", "}")
    assert kept(function(*counted)) == function(*counted)
    twice = ("for (int j = 0; j < 1; j++) {", "    const int a = s->a;", "    out[j] = a * a;", "}")
    other = ("for (int i = 0; i < 2; i++) {", "    const int a = s->b;", "    out[i] += a * a;", "}")
    assert kept(function(*twice, *other)) == function(*twice, *other), "one of them would hide the other"


def test_tables_of_one_value() -> None:
    row = "static const int row[2] = { 3, 3 };\n"
    size = "static const real_t size[2] = { 4.0, 4.0 };\n"
    assert kept(row + "\n" + function("out[0] = s->k[row[s->a]];")) == function("out[0] = s->k[3];")
    flag = row + "\n" + function("out[0] = row[s->a] ? s->a : s->b;")
    assert kept(flag) == flag.replace("\n\n", "\n", 0)
    scalar = "static const real_t size = 4.0;\n"
    assert kept(size + "\n" + function("out[0] = size[s->a] > 2;")) == scalar + "\n" + function(
        "out[0] = size > 2;", unread="s"
    )
    pointer = size + "\n" + function("out[0] = s->a > *size;")
    assert kept(pointer) == pointer


def test_conditions_compare_and_results_are_used() -> None:
    valued = function("out[0] = s->a;", "return 1;", head="static int g(solver_t *s, int *out)")
    text = f"{valued}\n\n" + function(
        "if (s->a) {", "    g(s, out);", "}", "while (s->a > 1) {", "    out[1] = 2;", "}"
    )
    found = kept(text)
    assert "if (s->a != 0) {\n        (void)g(s, out);" in found
    assert "while (s->a > 1) {" in found


def test_a_comment_does_not_hide_what_belongs_to_the_interface() -> None:
    text = "/* state in\nstatic memory */\n" + function("out[0] = s->a;")
    assert kept(text) == text


def test_two_functions_with_a_name_are_refused() -> None:
    with pytest.raises(ValueError, match=r"g\(\): there are two functions with this name"):
        kept("\n\n".join([function("return 1;", head=INNER), function("return 2;", head=INNER)]))


def test_macros_that_call_through_others() -> None:
    texts = {"A": "B(s)", "B": "next(s)", "C": "(s)->n++", "D": "(s)->n == 1"}
    assert macros_that_act([*(macro(name, text, "s") for name, text in texts.items()), macro("E", "f(1)")]) == set(
        "ABC"
    )


def test_a_pass_that_loses_a_definition_is_found_out() -> None:
    """A function, a macro and a type that something still reads; what nothing reads may go."""
    text = "static int g(int n)\n{\n    return n + N;\n}\n\n" + function("out[0] = g(1);")
    before = (*KNOWN, *items_of(text))
    for name, reader in (("g", "API(f)"), ("N", "ROW")):
        with pytest.raises(ValueError, match=rf"drop has left {name}, which {re.escape(reader)} reads, without its"):
            verify("drop", [item for item in before if item.name != name], before)
    verify("drop", [item for item in before if item.name != "KERNEL"], before)


@pytest.mark.parametrize(
    ("text", "kind", "defines"),
    [
        ("enum side { LEFT = 1, RIGHT };", "enum", {"LEFT", "RIGHT"}),
        ("typedef enum { UP, DOWN } side_t;", "type", {"UP", "DOWN", "side_t"}),
        ("typedef int (*compare_t)(int a);", "type", {"compare_t"}),
        ("typedef real_t wide_t __attribute__((vector_size(4 * sizeof(real_t)), may_alias));", "type", {"wide_t"}),
        ("static const real_t eps = 1; /* last */", "table", {"eps"}),
        ("static const p_t gains[1] = {\n    { .gain[0] = 1 }\n};", "table", {"gains"}),
        ("static int (*const of[1])(int) = { f };", "table", {"of"}),
        ("static int f(int a); /* later */", "prototype", {"f"}),
        ("/* Two. */\n#define A 1\n#define B(x) \\\n    (x)", "directive", {"A", "B"}),
        ("__attribute__((noinline)) static int f(int a)\n{\n    return a;\n}", "function", {"f"}),
    ],
)
def test_what_an_item_defines(text: str, kind: str, defines: set[str]) -> None:
    (item,) = items_of(text)
    assert (item.kind, item.defines, item.is_entry) == (kind, defines, False)


def test_what_has_no_name_is_refused() -> None:
    """It would go without a word, as nothing can read it."""
    with pytest.raises(ValueError, match="expected a function with braces in lines of their own"):
        items_of("int f(int a)\n{ /* why */\n    return a;\n}")


def test_what_writes_through_an_array_acts() -> None:
    fill = function("x[0] = 7;", "return 1;", head="static int fill(int x[2])")
    assert "(void)fill(s->x);" in kept(f"{fill}\n\n{function('const int n = fill(s->x);', 'out[0] = s->x[0];')}")


def test_a_function_that_is_passed_keeps_its_parameters() -> None:
    head = "static int less(const int *a, const int *b)"
    less = function("return *a;", head=head)
    assert head in kept(f"{less}\n\n{function('sort(s->x, less);', 'out[0] = less(s->x, out);')}")


def test_layout_stays() -> None:
    """Text of which nothing goes is the same to the byte."""
    items = [
        "#define A 1\n#define B 2",
        "/* Two. */\nstatic int g(int n);\nstatic int h(int n);",
        function("out[0] = s->a + g(1);"),
    ]
    items += [
        f"/* {name} */\n" + function("", "/* n */", "return n;", head=f"static int {name}(int n)") for name in "gh"
    ]
    text = "\n\n".join(items).replace("g(1)", "g(h(A))").replace("{\n    \n", "{\n")
    assert kept(text) == text


def test_a_refusal_names_the_function() -> None:
    with pytest.raises(
        ValueError, match=r"API\(f\)\(\): line 5, 's->b = 2; s->c = 3;': expected one statement in a line"
    ):
        kept(function("/* 3 */", "s->a = 1;", "s->b = 2; s->c = 3;"))


def integrator(f: str, name: str = "pk") -> OCP:
    """x' = f(x, u) with control bounds."""
    ocp = OCP(name, T=1.0, N=3)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: {"u": u, "u - x": u - x, "0": ca.SX(0), "-x": -x, "0.1": ca.SX(0.1)}[f]})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    ocp.subject_to(-1, u, 1)
    return ocp


@pytest.mark.parametrize("sweep", [Symmetric(), ForwardOverAdjoint()])
@pytest.mark.parametrize("tableau", [Euler, RK4])
@pytest.mark.parametrize("f", ["u", "u - x"])
def test_loops_over_no_columns(f: str, tableau: ButcherTableau, sweep: Symmetric | ForwardOverAdjoint) -> None:
    """Dynamics without second derivatives: the looped sweep gives the control of the straight one."""
    controls = []
    for unroll in ("none", "all"):
        integrators = ExplicitRungeKutta(tableau, steps=2, unroll=unroll)
        options = Options(integrator=integrators, hessian=ExactHessian(sweep=sweep))
        controls.append(build(integrator(f), options, profile="test").step([1.0]))
    np.testing.assert_allclose(controls[0], controls[1], rtol=1e-13)


@pytest.mark.few(2)
@pytest.mark.parametrize("f", ["0", "0.1", "-x"])
@pytest.mark.parametrize("algorithm", [RealTimeIteration(), AugmentedLagrangian()], ids=lambda a: a.name)
def test_dynamics_without_a_control(f: str, algorithm: RealTimeIteration | AugmentedLagrangian) -> None:
    """No warning, and the model is integrated: x(dt) of the linear equation."""
    require_tool("gcc")
    options = Options(algorithm=algorithm)
    text = generate(integrator(f), options)
    assert quality.warnings_of(text, ("-O2",), ("C99",), "gcc") == ""
    assert "(void)u;" in text["pk.c"]
    x = build(integrator(f), options, profile="test").integrate([1.0], [0.5], 0.2)
    np.testing.assert_allclose(x, {"0": 1.0, "0.1": 1.02, "-x": np.exp(-0.2)}[f], rtol=1e-6)
