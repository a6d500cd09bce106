"""What a package does not need is not in its unit; what it needs stays."""

from __future__ import annotations

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
from nmpc_codegen.lowering.pruning.fold import Constants
from nmpc_codegen.lowering.pruning.unused import without_unused
from verification import quality

#: N is a size; ROW drops its second argument; OUTER passes its arguments to ROW in turn.
KNOWN = [
    ("N", None, "P_N"),
    ("ROW", "s, h", "(s)->x[N]"),
    ("OUTER", "a, b", "ROW(a, b) + 1"),
    ("BOTH", "a, b", "a * b"),
    ("KERNEL", "s", "kernel((s)->x)"),
]


def kept(text: str) -> str:
    """The text after the pass, without the lines that every case has."""
    return without_unused(text, KNOWN).strip("\n")


def function(*block: str, head: str = "void API(f)(solver_t *s, int *out)") -> str:
    """A function of the package's interface."""
    return "\n".join([head, "{", *(f"    {line}" for line in block), "}"])


@pytest.mark.parametrize(
    "block",
    [
        ("out[0] = s->a;",),
        ("const int h = 2;", "out[0] = s->a + h;"),
        ("const int h = 2;", "out[0] = BOTH(s->a, h);"),
        ("const int h = API(step)(s), i = s->a++;", "out[0] = s->a;"),
        ("int h[2] = {0}, i = 1;", "out[h[i]] = s->a;"),
        ("int (*h)[N] = s->a;", "out[0] = s->a;"),  # no plain variable
        ("const int h = 1, i = h + 1;", "out[i] = s->a;"),
        ("for (int h = 0; h < 2; h++) {", "    out[h] = s->a;", "}"),
    ],
)
def test_what_is_read_stays(block: tuple[str, ...]) -> None:
    assert kept(function(*block)) == function(*block)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (("const int h = 2;", "out[0] = s->h;"), ("out[0] = s->h;",)),
        (("const int h = next(s);", "out[0] = s->a;"), ("(void)next(s);", "out[0] = s->a;")),  # a call may have effects
        (("const int h = KERNEL(s);", "out[0] = s->a;"), ("(void)KERNEL(s);", "out[0] = s->a;")),
        (("const int h = 2;", "out[0] = ROW(s, h);"), ("out[0] = ROW(s, h);",)),
        (("const int h = 2;", "out[0] = OUTER(s, h + 1);"), ("out[0] = OUTER(s, h + 1);",)),
        (("int g[N], h[N * 2] = {0}, i;", "out[g[0]] = s->a;"), ("int g[N];", "out[g[0]] = s->a;")),
        (("const int g = 1;", "const int h = g;", "out[0] = s->a;"), ("out[0] = s->a;",)),
        (("const int h = 1; /* length */", "out[0] = s->a; /* h */"), ("out[0] = s->a; /* h */",)),
        (
            ("if (s->a) {", "    const int h = 1;", "}", "for (int h = 0; h < 2; h++) {", "    out[h] = 1;", "}"),
            ("(void)s;", "for (int h = 0; h < 2; h++) {", "    out[h] = 1;", "}"),
        ),
    ],
)
def test_what_nothing_reads_goes(before: tuple[str, ...], after: tuple[str, ...]) -> None:
    assert kept(function(*before)) == function(*after)


def test_directives_end_no_block() -> None:
    """#pragma stands at the margin."""
    loop = "#pragma GCC unroll 4\n    for (int i = 0; i < h; i++) {\n        n++;\n    }"
    text = f"int f(int n)\n{{\n    int h = n;\n{loop}\n}}"
    assert kept(text) == text


def test_unread_parameters_of_the_interface_get_a_statement() -> None:
    head = "int API(f)(const real_t (*Q)[N], const real_t u[N], real_t *x, int k)"
    found = kept(function("return ROW(x, u) + Q[0][0];", head=head))
    assert found == function("(void)u;", "(void)k;", "return ROW(x, u) + Q[0][0];", head=head)
    assert kept(function("return 1;", head="int API(f)(void)")) == function("return 1;", head="int API(f)(void)")


def test_functions_that_nothing_reaches_go_with_their_comments() -> None:
    static = "static int {}(int n)"
    called = function("return deeper(n) + 1;", head=static.format("called"))
    deeper = function("return n + 2;", head=static.format("deeper"))
    spare = "/* For other problems:\n * returns 1. */\n" + function("return spare(n);", head=static.format("spare"))
    table = "/* functions */\nstatic int (*const table[1])(int) = { listed };"
    listed = function("return n;", head=static.format("listed"))
    root = function("out[0] = called(s->a);")
    found = kept("\n\n".join([deeper, spare, called, listed, table, root]))
    assert "spare" not in found
    assert "For other problems" not in found
    assert all(text in found for text in (deeper, called, listed, table, root))


def test_unread_parameters_of_inner_functions_go() -> None:
    """Also from prototypes and calls, unless an argument has effects or a macro calls the function."""
    inner = function("return s->a;", head="static int f(const solver_t *s, int unread)")
    root = function("out[0] = f(s, out[1]);", "out[1] = f(s,", "    out[0] + 1);")
    found = kept(f"static int f(const solver_t *s, int unread);\n\n{root}\n\n{inner}")
    assert found.count("int f(const solver_t *s)") == 2
    assert found.count("f(s);") == 2
    effects = function("out[0] = f(s, next(s));")
    assert "(void)unread;" in kept(f"{effects}\n\n{inner}")
    kernel = function("x[0] = 1;", head="static void kernel(real_t *x, int unread)")
    assert "(void)unread;" in kept(f"{kernel}\n\n{function('KERNEL(s);')}")


def test_calls_of_functions_without_a_purpose_go() -> None:
    """A function that does nothing, that returns a constant or what it was given."""
    idle = function("for (int m = 0; m < NG; m++) {", "    s->a = m;", "}", head="static void idle(solver_t *s)")
    one = function("return 1;", head="static int one(const solver_t *s)")
    same = function("return k;", head="static int same(const solver_t *s, int k)")
    block = ("/* rows */", "idle(s);", "if (!one(s)) {", "    out[0] = 2;", "}", "out[1] = same(s, s->b);")
    text = "\n\n".join([idle, one, same, function(*block)])
    found = without_unused(text, KNOWN, Constants({"NG": 0})).strip("\n")
    assert found == function("out[1] = s->b;")


@pytest.mark.parametrize(
    ("head", "result", "call", "expected"),
    [
        ("static int f(int k)", "k", "2 * f(a + b)", "2 * (a + b)"),
        ("static int f(int k)", "k", "2 * f(a->b[i])", "2 * a->b[i]"),
        ("static int f(int k)", "-1", "2 -f(a)", "2 -(-1)"),
        ("static real_t f(int k)", "k", "f(1) / 2", "f(1) / 2"),  # another type
        ("static real_t f(int k)", "1", "f(1) / 2", "f() / 2"),
        ("static real_t f(int k)", "R(1)", "f(1) / 2", "R(1) / 2"),
        ("static int f(int k)", "k", "f(next(s))", "f(next(s))"),  # the argument has effects
    ],
)
def test_constant_results(head: str, result: str, call: str, expected: str) -> None:
    found = kept(f"{function(f'return {result};', head=head)}\n\n{function(f'out[0] = {call};')}")
    assert f"out[0] = {expected};" in found


@pytest.mark.parametrize(
    "block",
    [
        ("if (s->a)", "    s->b = 1;"),
        ("for (int m = 0; m < NG; m++)", "    s->b = m;"),
        ("if (s->a) {", "    s->b = 1;", "} else", "    s->b = 2;"),
        ("do {", "    s->a--;", "} while (s->a);"),
        ("switch (s->a) {", "default:", "    s->b = 1;", "}"),
        ("s->a = 1; s->b = 2;",),
    ],
)
def test_what_cannot_be_told_from_its_text_is_refused(block: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"API\(f\)\(\): .*expected one statement in a line, blocks in braces"):
        kept(function(*block))


def test_a_name_for_two_structs_is_refused() -> None:
    """A member of one of them would tell nothing about the other one."""

    def block(struct: str) -> list[str]:
        return ["for (int n = 0; n < 2; n++) {", f"    {struct}_t *q = &s->{struct};", "    q->held = 1;", "}"]

    with pytest.raises(ValueError, match=r"API\(f\)\(\): q points to ipm_t and to qp_t; expected a name for each"):
        without_unused(function(*block("ipm"), *block("qp")), KNOWN, Constants(members=frozenset({("qp", "held")})))


def test_effects_stay() -> None:
    """Assignments in conditions, counts in a place that is absent, a variable that is read after its loop."""
    nothing = function("return R(0);", head="static real_t zero(void)")
    block = ("int m;", "s->flags &= 1;", "for (m = 0; m < NG; m++) {", "    s->a = m;", "}", "out[m++] += zero();")
    found = without_unused(f"{function(*block)}\n\n{nothing}", KNOWN, Constants({"NG": 0})).strip("\n")
    assert found == function(*block[:-1], "out[m++] += R(0);")
    stored = ("const int b = (out[0] = 3);", "while ((s->a = s->b) > 0) {", "    s->b--;", "}")
    assert kept(function(*stored)) == function("(void)(out[0] = 3);", *stored[1:])


def test_functions_whose_address_is_passed_keep_their_parameters() -> None:
    less = function("return b > 1;", head="static int less(int a, int b)")
    sort = function("out[0] = order(1, 2);", head="static void sort(int *out, int (*order)(int, int))")
    found = kept("\n\n".join([less, sort, function("sort(out, less);", "out[1] = less(1, 2);")]))
    assert "less(int a, int b)" in found
    assert "less(1, 2)" in found


def test_enumerations_and_headings_of_what_is_gone() -> None:
    spare = "/* Slacks. */\n\nenum { LEFT, RIGHT };\n\n" + function("return LEFT;", head="static int spare(void)")
    used = "/* Used. */\n\n/* Signs. */\nenum { UP, DOWN };\n\n" + function("out[0] = DOWN;")
    found = kept(f"{spare}\n\n{used}")
    assert "Slacks" not in found
    assert "LEFT" not in found
    assert "/* Signs. */\nenum { UP, DOWN };" in found


def test_pointers_to_arrays_are_returned() -> None:
    head = "static inline real_t (*block(solver_t *s, int k))[N]"
    found = kept(f"{function('return s->Q;', head=head)}\n\n{function('out[0] = block(s, 1)[0][0];')}")
    assert "static inline real_t (*block(solver_t *s))[N]" in found
    assert "block(s)[0][0]" in found


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
