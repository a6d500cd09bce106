"""What the passes leave of a function: conditions, loops, writes to what is absent, unread variables."""

from __future__ import annotations

import pytest

from nmpc_codegen.lowering.dialect.c_expressions import expression
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import free_names
from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.reach import simplify_item

CONSTANTS = Constants(
    sizes={"NG": 0, "NE": 2, "N": 5, "NU": 1, "SOFT": 0, "HARD": 1},
    ranges={"row_first": (0, 0), "side": (-1, -1), "offset": (0, 4), "index": (0, 3), "is_free": (0, 0)},
    absent=frozenset({("qp", "held"), ("solver", "curved"), ("solver", "held"), ("solver", "schur")}),
    types={("solver", "qp"): "qp", ("solver", "riccati"): "riccati"},
    kernels=frozenset({"COUPLED_ROWS"}),
    calling=frozenset({"COUPLED_ROWS", "NEXT"}),
)
HEAD = "static void f(solver_t *s, qp_t *q, riccati_t *r, int m, int n)"


def function(*block: str) -> str:
    return "\n".join([HEAD, "{", *(f"    {line}" if line else "" for line in block), "}"])


def left(*block: str) -> list[str]:
    """The lines of a function after the passes."""
    item = Item("f", "function", function(*block))
    lines = simplify_item(item, CONSTANTS).text.split("\n")
    assert lines[:2] == [HEAD, "{"]
    assert lines[-1] == "}"
    return [line.removeprefix("    ") for line in lines[2:-1]]


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("NG", False),
        ("!NG", True),
        ("NG > 0 && is_held(s, m)", False),
        ("HARD && is_held(s, m)", "is_held(s, m)"),
        ("NE > 0 && (SOFT || !s->a)", "!s->a"),
        ("SOFT || HARD", True),
        ("s->a || HARD", True),
        ("next(s) && NG", "next(s) && NG"),  # the call may have effects
        ("NEXT(s) && NG", "NEXT(s) && NG"),  # so may that of a macro
        ("s->a++ && NG", "s->a++ && NG"),
        ("side[m] < 0", True),
        ("index[m] >= 0", True),
        ("index[m] > 1", "index[m] > 1"),
        ("side[index[m]] < 0", True),
        ("side[n++] < 0", "side[n++] < 0"),
        ("is_free(m)", False),
        ("is_free(m++)", "is_free(m++)"),
        ("offset[k] < offset[k + 1]", "offset[k] < offset[k + 1]"),  # entries differ from each other
        ("k < N", "k < N"),
        ("x < R(0)", "x < R(0)"),
        ("(HARD && a) || (NG && b)", "a"),
        ("HARD && (a ? b : c)", "a ? b : c"),
        ("HARD && (a ? b : c) && d", "(a ? b : c) && d"),
        ("c && ((HARD && a) || b)", "c && (a || b)"),
        ("!(HARD && a)", "!a"),
        ("!(HARD && a && b)", "!(a && b)"),
        ("a && !(NG || (b && c))", "a && !(b && c)"),
        ("-NE < 0 && NE * 2 - 3 == 1", True),
        ("(real_t)m < s->a[NE] && HARD && sizeof(int) > n", "(real_t)m < s->a[NE] && sizeof(int) > n"),
    ],
)
def test_conditions(condition: str, expected: bool | str) -> None:
    assert CONSTANTS.reduce(condition) == expected


@pytest.mark.parametrize("text", ["", "a +", "a b", "f(", "a ? b", "{1, 2", "a[1", "@"])
def test_what_is_no_expression(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        expression(text)


@pytest.mark.parametrize(
    ("head", "runs"),
    [
        ("int k = 0; k < NG; k++", False),
        ("int k = 0; k < NG && s->a; k++", False),
        ("int k = NG - 1; k >= 0; k--", False),
        ("int k = row_first[m]; k < row_first[m + 1]; k++", False),
        ("int k = 1; k < NU; k++", False),
        ("int k = offset[m]; k < offset[m + 1]; k++", True),
        ("int e = 0; e < NE; e++", True),
        ("int e = m + 1; e < NE; e++", True),
        ("int k = N; k >= 0; k--", True),
        ("int k = next(s); k < NG; k++", True),  # it is called once
        ("k = 0; k < NG; k++", True),  # what follows may read k
    ],
)
def test_loops(head: str, runs: bool) -> None:
    lines = ["a = 1;", "/* rows */", f"for ({head}) {{", "    b = a;", "}", "c = a;"]
    assert left(*lines) == (lines if runs else [lines[0], lines[-1]])


def test_conditions_of_loops() -> None:
    assert left("for (int k = 0; HARD && k < n; k++) {", "    s->a = k;", "}")[0] == "for (int k = 0; k < n; k++) {"
    assert left("while (NG > 0 || s->a) {", "    s->a--;", "}") == ["while (s->a) {", "    s->a--;", "}"]
    assert left("while (NG > 0) {", "    s->a--;", "}", "s->b = 1;") == ["s->b = 1;"]
    assert left("for (int k = 0; k < n; k++) {", "    /* nothing */", "}", "s->b = 1;") == ["s->b = 1;"]
    for step in ("k++, m++", "k += next(s)", "s->a++", "m++"):
        lines = [f"for (int k = 0; k < n; {step}) {{", "}", "s->b = m;"]
        assert left(*lines) == lines
    broken = ["for (int k = 0; HARD &&", "         k < n; k++) {", "    s->a = k;", "}"]
    assert left(*broken)[0] == "for (int k = 0; k < n; k++) {"


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ("HARD", "s->b", ["a = 1;", "b = a;"]),
        ("NG", "HARD", ["a = 2;", "b = a;"]),
        ("NG", "SOFT", ["a = 3;", "b = a;"]),
        ("NG", "s->b", ["if (s->b) {", "    a = 2;", "} else {", "    a = 3;", "}", "b = a;"]),
        ("s->b", "HARD", ["if (s->b) {", "    a = 1;", "} else {", "    a = 2;", "}", "b = a;"]),
        ("s->b", "NG", ["if (s->b) {", "    a = 1;", "} else {", "    a = 3;", "}", "b = a;"]),
        ("HARD && s->b", "s->c", None),
    ],
)
def test_chains(first: str, second: str, expected: list[str] | None) -> None:
    chain = [f"if ({first}) {{", "    a = 1;", f"}} else if ({second}) {{", "    a = 2;", "} else {", "    a = 3;", "}"]
    lines = [*chain, "b = a;"]
    assert left(*lines) == (expected or ["if (s->b) {", *lines[1:]])


def test_a_variable_with_the_name_of_a_table_is_refused() -> None:
    with pytest.raises(ValueError, match="side is a variable here and known elsewhere; expected another name"):
        left("const int *side = s->sides;", "if (side[m] < 0) {", "    s->a = 1;", "}")


def test_conditions_that_are_numbers() -> None:
    assert left("if (0) {", "    s->a = 1;", "}", "s->b = 1;") == ["s->b = 1;"]
    assert left("if (1) {", "    s->a = 1;", "}") == ["s->a = 1;"]
    assert left("if (s->a && !1) {", "    s->a = 1;", "}", "s->b = 1;") == ["s->b = 1;"]
    assert left("if (s->a == 2 || 0) {", "    s->a = 1;", "}") == ["if (s->a == 2) {", "    s->a = 1;", "}"]


def test_empty_branches() -> None:
    assert left("if (HARD) {", "} else {", "    b = 1;", "}", "b = 2;") == ["b = 2;"]
    assert left("if (NG) {", "    b = 1;", "} else {", "    /* nothing */", "}", "b = 2;") == [
        "/* nothing */",
        "b = 2;",
    ]
    assert left("if (HARD) { /* always", "* so */", "    b = 1;", "}", "b = 2;") == ["b = 1;", "b = 2;"]
    assert left("if (s->a) {", "    /* nothing */", "}", "b = 1;") == ["b = 1;"]
    assert left("if (s->a++) {", "}", "b = 1;") == ["if (s->a++) {", "}", "b = 1;"]
    assert left("if (s->a) {", "    b = 1;", "} else {", "    s->held = 1;", "}") == ["if (s->a) {", "    b = 1;", "}"]


def test_nothing_follows_a_return() -> None:
    assert left("if (HARD) { /* always */", "    b = 1;", "    return;", "}", "s->held = 1;", "a = 2;") == ["b = 1;"]
    lines = ["if (s->a) {", "    return;", "}", "b = 1;"]
    assert left(*lines) == lines
    loop = [
        "for (int k = 0; k < N; k++) {",
        "    if (HARD) {",
        "        continue;",
        "    }",
        "    b = 1;",
        "}",
        "a = 1;",
    ]
    assert left(*loop) == ["a = 1;"]
    loop[1:4] = ["    s->a += k;", *loop[1:4]]
    assert left(*loop) == [loop[0], "    s->a += k;", "}", "a = 1;"]


def test_statements_on_what_is_absent() -> None:
    gone = ["s->qp.held[m] = R(0);", "memset(s->curved, 0, sizeof s->curved);", "q->held[m] = R(0);"]
    gone += ["COUPLED_ROWS(s, s->coupled.r,", "    s->coupled.J);", "s->schur.joint += 2;", "(*s).curved[0] = R(0);"]
    kept = ["s->held[m] = next(s);", "s->held[n++] = R(0);", "COUPLED_ROWS(s, n++);", "s->weight = s->other;"]
    kept += ["r->held[m] = R(0);", "s->riccati.held = 1;", "b = s->held;"]  # of another struct; it is read
    assert left(*gone, *kept) == kept


def test_a_name_for_two_structs_is_refused() -> None:
    """A member of one of them would tell nothing about the other one."""
    blocks = [("if (s->a) {", f"    {of}_t *p = &s->{of};", "    p->held = 1;", "}") for of in ("ipm", "qp")]
    with pytest.raises(ValueError, match="p points to ipm_t and to qp_t; expected a name for each"):
        left(*blocks[0], *blocks[1])
    assert left(*blocks[1]) == []
    assert left(*blocks[0]) == list(blocks[0])


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (["const int h = 2;", "b = s->h;"], ["b = s->h;"]),
        (["const int h = next(s);", "b = 1;"], ["(void)next(s);", "b = 1;"]),
        (["const int h = NEXT(s);", "b = 1;"], ["(void)NEXT(s);", "b = 1;"]),
        (["int g[N], h[N * 2] = {0}, i;", "b = g[0];"], ["int g[N];", "b = g[0];"]),
        (["const int g = 1;", "const int h = g;", "b = 1;"], ["b = 1;"]),
        (["const int h = 1; /* length */", "b = s->a; /* h */"], ["b = s->a; /* h */"]),
        (["/* length */", "const int h = 1;", "", "b = 1;"], ["b = 1;"]),
        (["if (s->a) {", "    const int h = 1;", "}", "b = 1;"], ["b = 1;"]),
        (["const int h = next(s), i = s->a++;", "b = 1;"], None),  # in their order
        (["const int h = next(s) + 1;", "b = 1;"], ["(void)(next(s) + 1);", "b = 1;"]),
        (["const int h = s->a++;", "b = 1;"], ["(void)(s->a++);", "b = 1;"]),
        (["const int h[2] = {next(s), 1};", "b = 1;"], None),
        (["int h[next(s)];", "b = 1;"], None),
        (["int h[N][2] = {1, 2};", "b = 1;"], ["b = 1;"]),
        (["real_t h[2 * N] PACK_ALIGNED;", "b = 1;"], ["b = 1;"]),
        (["const int h = 1, i = h + 1;", "b = i;"], None),
        (["int (*h)[N] = s->a;", "b = h[0][0];"], None),
        (["int h;", "for (int k = 0; k < N; k++) {", "    h = k;", "    b = h;", "}"], None),
    ],
)
def test_variables(before: list[str], after: list[str] | None) -> None:
    assert left(*before) == (before if after is None else after)


def test_effects_stay() -> None:
    """Assignments in conditions, counts, a variable that is read after its loop."""
    lines = ["int k;", "s->flags &= 1;", "for (k = 0; k < NG; k++) {", "    s->a = k;", "}", "b[k++] += R(0);"]
    assert left(*lines) == lines
    stored = ["while ((s->a = s->b) > 0) {", "    s->b--;", "}"]
    assert left("const int c = (b = 3);", *stored) == ["(void)(b = 3);", *stored]


@pytest.mark.parametrize(
    "use", ["s->c = v;", "if (v > 0) {\n        s->c = 1;\n    }", "for (int k = v; k < N; k++) {\n    }"]
)
@pytest.mark.parametrize("declaration", ["const int v = s->a;", "real_t(*v)[NE] = s->Q;", "int u, v;"])
def test_a_part_is_c_before_it_is_pruned(declaration: str, use: str) -> None:
    """A variable does not outlive the block that declares it, although the block may lose its braces."""
    block = ["if (HARD) {", f"    {declaration}", "    s->b = v;", "}"]
    with pytest.raises(ValueError, match=r"f\(\): v is declared in a block and used outside of it"):
        left(*block, use)
    assert "s->v = 1;" in left(*block, "s->v = 1;")
    assert "s->b += v;" in "".join(left(*block, "for (int v = 0; v < NE; v++) {", "    s->b += v;", "}"))


def test_blocks_with_the_same_variable_do_not_both_lose_their_braces() -> None:
    block = ["if (HARD) {", "    const int v = s->a;", "    s->b = v;", "}"]
    bare = ["const int v = s->a;", "s->b = v;"]
    assert left(*block, *block) == [*bare, "{", *block[1:]]
    assert left("if (SOFT) {", "    s->a = 1;", "} else {", *block[1:], *block) == [*bare, "{", *block[1:]]


@pytest.mark.parametrize("inner", ["int v = 2;", "for (int v = 0; v < N; v++) {\n    }", "real_t(*m)[N] = s->Q;"])
def test_no_variable_hides_another_one(inner: str) -> None:
    """A block that loses its braces would hide it from what follows."""
    lines = [
        "int v = next(s);",
        "while (s->a) {",
        "    if (HARD) {",
        f"        {inner}",
        "        s->b = v + m[0][0];",
        "    }",
    ]
    with pytest.raises(ValueError, match=r"[vm] is declared where there is a variable with this name"):
        left(*lines, "    s->c = v;", "}")


def test_strings_stay() -> None:
    lines = ['const char *text = "a;  /* b */ {", *other = text, letter = \'"\';', "s->text = text;"]
    assert left(*lines) == lines
    head = ['if (HARD && s->letter == \'"\' && "  "[0]) {', "    s->b = 1;", "}"]
    assert left(*head) == head


def test_free_names() -> None:
    text = function("int a = N, b[2] = {c, d};", "for (int k = 0; k < b[0]; k++) {", "    s->e = g(k, a) + H(m);", "}")
    types = {"static", "void", "solver_t", "qp_t", "riccati_t", "int"}
    assert free_names(text) == {"N", "c", "d", "for", "g", "H"} - {"for"} | types
    with pytest.raises(ValueError, match="a is declared twice in a block"):
        free_names(function("int a = 1;", "int a = 2;", "s->b = a;"))


def test_long_conditions_are_broken() -> None:
    (first, *rest) = left(f"if (HARD && {' && '.join(['condition'] * 15)}) {{", "    b = 1;", "}")
    head = [first, *rest[: rest.index("    b = 1;")]]
    assert all(len(line) <= 116 for line in head)
    assert " ".join(line.strip() for line in head) == f"if ({' && '.join(['condition'] * 15)}) {{"
