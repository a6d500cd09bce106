"""resolve() against unifdef and the C preprocessor on random texts, and its refusals."""

from __future__ import annotations

import subprocess

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmpc_codegen.lowering.dialect.directives import evaluate, resolve
from tests.conftest import require_tool

SIZES = st.fixed_dictionaries({name: st.integers(0, 3) for name in ("A", "B", "NX", "NH_N")})

ATOMS = st.sampled_from(["A", "B", "NX", "NH_N", "0", "1", "2"])


COMPARISONS = ("==", "!=", "<", "<=", ">", ">=", "&&", "||")
ARITHMETIC = ("+", "-", "*")


def conditions(operators: tuple[str, ...]) -> st.SearchStrategy[str]:
    """Integer expressions with these operators; some rely on their precedence."""

    def joined(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
        binary = st.tuples(inner, st.sampled_from(operators), inner).map(lambda t: f"({t[0]} {t[1]} {t[2]})")
        return st.one_of(binary, inner.map(lambda c: f"!{c}"), inner.map(lambda c: f"({c})"))

    loose = st.tuples(ATOMS, ATOMS, ATOMS).map(lambda t: f"!{t[0]} == {t[1]} || !({t[2]}) < {t[0]} && {t[1]}")
    return st.one_of(st.recursive(ATOMS, joined, max_leaves=4), loose)


#: Whole statements, including text that looks like directives and braces.
STATEMENTS = st.sampled_from(
    [
        "x = 1;",
        "for (;;) {\n    y();\n}",
        'c = "{ #if";',
        "b = '}';",
        "/* } #endif\n#else { */",
        "int v[] = { 1, 2 };",
        "",
        "    indented();",
    ]
)


Lines = list[str]


def texts(operators: tuple[str, ...]) -> st.SearchStrategy[str]:
    """Statements and nested directives."""
    condition, notes = conditions(operators), st.sampled_from(["", " /* A { */"])

    def written(parts: tuple[str, Lines, list[tuple[str, Lines]], Lines | None, str]) -> Lines:
        first, body, more, last, note = parts
        lines = [f"#if {first}{note}", *body]
        for other, branch in more:
            lines += [f"#elif {other}", *branch]
        return [*lines, *(["#else", *last] if last is not None else []), f"#endif{note}"]

    def branches(inner: st.SearchStrategy[Lines]) -> st.SearchStrategy[Lines]:
        more = st.lists(st.tuples(condition, inner), max_size=2)
        one = st.tuples(condition, inner, more, st.none() | inner, notes).map(written)
        return st.lists(one, min_size=1, max_size=2).map(lambda found: [line for lines in found for line in lines])

    blocks = st.recursive(st.lists(STATEMENTS, max_size=3), branches, max_leaves=6)
    return blocks.map(lambda lines: "\n".join(["start();", *lines, "end();"]) + "\n")


def _defines(sizes: dict[str, int]) -> list[str]:
    return [f"-D{name}={value}" for name, value in sizes.items()]


@settings(max_examples=60, deadline=None)
@given(texts(COMPARISONS + ARITHMETIC), SIZES)
def test_resolve_agrees_with_the_c_preprocessor(text: str, sizes: dict[str, int]) -> None:
    """The tokens that gcc -E keeps: it removes comments and changes blanks."""
    require_tool("gcc")
    command = ["gcc", "-E", "-P", "-Wundef", "-Werror", "-x", "c", "-", *_defines(sizes)]
    run = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    command = ["gcc", "-E", "-P", "-x", "c", "-"]
    ours = subprocess.run(command, input=resolve(text, sizes), capture_output=True, text=True, check=True).stdout
    assert ours.split() == run.stdout.split()


@settings(max_examples=60, deadline=None)
@given(texts(COMPARISONS), SIZES)
def test_resolve_agrees_with_unifdef_line_by_line(text: str, sizes: dict[str, int]) -> None:
    """The other tool supports no arithmetic."""
    require_tool("unifdef")
    run = subprocess.run(["unifdef", "-k", *_defines(sizes)], input=text, capture_output=True, text=True, check=False)
    assert run.returncode in (0, 1), run.stderr
    assert resolve(text, sizes) == run.stdout


@pytest.mark.parametrize(
    ("condition", "value"),
    [
        ("!(A + 1) == A", False),
        ("!!A", True),
        ("!A + !B", True),
        ("A && !B || B", True),
        ("A * 2 - 2 > 0", False),
        ("(A /* one */ == 1)", True),
    ],
)
def test_conditions(condition: str, value: bool) -> None:
    assert evaluate(condition, {"A": 1, "B": 0}) is value


@pytest.mark.parametrize(
    "condition",
    [
        "",
        "A +",
        "A and B",
        "not A",
        "A if B else 1",
        "~A",
        "A ** 2",
        "A // 2",
        "1.5",
        "f(A)",
        "A ^ 1",
    ],
)
def test_what_is_no_condition(condition: str) -> None:
    with pytest.raises(ValueError, match="#if"):
        evaluate(condition, {"A": 1, "B": 0, "f": 1, "True": 1})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("#if MISSPELT\nx;\n#endif\n", "line 1, #if MISSPELT: MISSPELT has no value"),
        ("#if A\n#elif MISSPELT\n#endif\n#if !A\n#elif MISSPELT\n#endif\n", "line 5.*MISSPELT has no value"),
        ("#if A\nx;\n", "#if without #endif"),
        ("x;\n#endif\n", "line 2, '#endif': '#endif' closes what nothing has opened"),
        ("#else\n#endif\n", "'#else' closes what nothing has opened"),
        ("#if A\n#else\n#else\n#endif\n", "#else after #else"),
        ("#if A\n#else\n#elif A\n#endif\n", "#elif after #else"),
        ("#ifdef A\n#endif\n", "line 1, '#ifdef A': expected #if"),
        (" #if A\n#endif\n", "at the start of a line"),
        ("#if A\n#endif A\n", "expected nothing after #endif"),
        ("#if A\nfor (;;) {\n#endif\n}\n", "line 3, '#endif': .*opens a brace without closing it"),
        ("#if !A\nfor (;;) {\n#endif\n}\n", "line 3, '#endif': .*opens a brace without closing it"),
        ("if (a) {\n#if A\n} else {\n#endif\n}\n", "line 3, '} else {': a branch of an #if closes a brace"),
        ("#if A\nif (a) {\n#else\nif (b) {\n#endif\n}\n", "line 3, '#else': .*opens a brace"),
        ("if (a) {\n#if A\n}\n#endif\n", "line 3, '}': .*closes a brace"),
        ("#if A\n#if A\nif (a) {\n#endif\n}\n#endif\n", "line 4, '#endif': .*opens a brace"),
    ],
)
def test_refusals(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        resolve(text, {"A": 1})


def test_no_name_is_needed_where_nothing_is_decided() -> None:
    text = "#if !A\n#if MISSPELT\nx;\n#endif\n#elif A\ny;\n#elif MISSPELT\n#endif\n"
    assert resolve(text, {"A": 1}) == "y;\n"
