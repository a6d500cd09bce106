"""The bound of random functions, whose conditions are all known, is the number of operations that they carry out."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmpc_codegen.bounds.c_source import functions
from nmpc_codegen.bounds.facts import Results
from nmpc_codegen.bounds.names import Unit
from nmpc_codegen.bounds.worst_case import WorstCase

FIRST = (0, 2, 2, 7)
KIND = (1, 0, 0, 1, 1, 2, 0, 1)


def bounds(text: str) -> WorstCase:
    return WorstCase(Unit(functions(text), {}, {}, {"N": 5, "M": 3}, {"first": FIRST, "kind": KIND}, {}, {}))


@st.composite
def integers(draw: st.DrawFn, names: tuple[str, ...], depth: int = 2) -> str:
    """An expression, as C and Python spell it, whose value is not negative."""
    kind = draw(st.sampled_from(["name"] * 3 + ["number", "+", "*", "first", "kind", "pick"]))
    if depth == 0 or kind in ("name", "number"):
        return draw(st.sampled_from(names if kind == "name" and names else ("0", "1", "2", "N", "M")))
    inner = draw(integers(names, depth - 1))
    if kind == "+":
        return f"({inner} + {draw(integers(names, depth - 1))})"
    if kind == "pick":
        return f"pick({inner}, {draw(integers(names, depth - 1))})"
    return {"*": f"2 * {inner}", "first": f"first[{inner} % 4]", "kind": f"kind[{inner} % 8]"}[kind]


@st.composite
def conditions(draw: st.DrawFn, names: tuple[str, ...]) -> str:
    """A comparison or a pair of comparisons, as C spells it."""
    pairs = [f"{draw(integers(names))} {draw(st.sampled_from(['<', '>=', '==', '!=']))} {draw(integers(names))}"]
    if draw(st.booleans()):
        pairs.append(f"{draw(integers(names, 1))} > {draw(integers(names, 1))}")
    return draw(st.sampled_from([" && ", " || "])).join(pairs)


@st.composite
def blocks(draw: st.DrawFn, names: tuple[str, ...], calls: tuple[str, ...], depth: int) -> list[Any]:
    """Statements: a number of operations, or (head, its blocks)."""
    found: list[Any] = []
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["add", "const", *(["for", "for", "if"] if depth else []), *calls]))
        new = f"v{len(names)}"
        if kind == "add":
            found.append(draw(st.integers(1, 3)))
        elif kind == "const":
            found.append(("const", new, draw(integers(names))))
            names = (*names, new)
        elif kind == "for":
            start = draw(integers(names, 1))
            limit = draw(st.sampled_from([draw(integers(names, 1)), f"{draw(integers(names, 1))} % 6"]))
            body = draw(blocks((*names, new), calls, depth - 1))
            found.append(("for", new, start, limit, draw(st.integers(1, 2)), body))
        elif kind == "if":
            branches = [draw(blocks(names, calls, depth - 1)) for _ in range(2)]
            found.append(("if", draw(conditions(names)), *branches))
        else:
            found.append(("call", kind, draw(integers(names, 1)), draw(integers(names, 1))))
    return found


def in_c(block: list[Any]) -> str:
    text = ""
    for item in block:
        match item:
            case int():
                text += "x[0] += 1; " * item
            case ("const", name, value):
                text += f"const int {name} = {value}; "
            case ("for", name, start, limit, step, body):
                text += f"for (int {name} = {start}; {name} < {limit}; {name} += {step}) {{ {in_c(body)} }}\n"
            case ("if", condition, then, other):
                text += f"if ({condition}) {{ {in_c(then)} }} else {{ {in_c(other)} }}\n"
            case ("call", name, a, b):
                text += f"{name}(x, {a}, {b});\n"
    return text


def in_python(block: list[Any], indent: str) -> str:
    text = ""
    for item in block:
        match item:
            case int():
                text += f"{indent}done.extend([1] * {item})\n"
            case ("const", name, value):
                text += f"{indent}{name} = {value}\n"
            case ("for", name, start, limit, step, body):
                text += f"{indent}for {name} in range({start}, {limit}, {step}):\n{in_python(body, indent + ' ')}"
            case ("if", condition, then, other):
                spelt = condition.replace("&&", "and").replace("||", "or")
                text += f"{indent}if {spelt}:\n{in_python(then, indent + ' ')}"
                text += f"{indent}else:\n{in_python(other, indent + ' ')}"
            case ("call", name, a, b):
                text += f"{indent}{name}({a}, {b})\n"
    return text


PICK = "static int pick(int a, int b)\n{\nif (a < b) { return first[a % 4]; } return kind[(a + b) % 8];\n}\n"


@settings(max_examples=60, deadline=None)
@given(
    blocks(("a", "b"), (), 2),
    blocks(("a", "b"), ("g",), 2),
    blocks((), ("g", "h", "h"), 3),
)
def test_the_bound_is_the_number_of_operations(g: list[Any], h: list[Any], f: list[Any]) -> None:
    text = PICK + "".join(
        f"static void {name}(real_t *x{more})\n{{\n{in_c(body)}\n}}\n"
        for name, more, body in (("g", ", int a, int b", g), ("h", ", int a, int b", h), ("f", "", f))
    )
    done: list[int] = []
    known = {"done": done, "first": FIRST, "kind": KIND, "N": 5, "M": 3}
    known["pick"] = lambda a, b: FIRST[a % 4] if a < b else KIND[(a + b) % 8]
    for name, parameters, body in (("g", "a, b", g), ("h", "a, b", h), ("f", "", f)):
        exec(f"def {name}({parameters}):\n{in_python(body, ' ')}", known)
    known["f"]()
    assert bounds(text).operations("f") == len(done)


CALLED = {
    "a comparison": ("if (k < N) { x[0] += 1; }", 2, 5),
    "an entry": ("for (int i = 0; i < kind[k % 8]; i++) { x[0] += 1; }", 3, 125 * sum(KIND)),
    "a difference": ("for (int i = k; i < k + N; i++) { x[0] += 1; }", 1, 5000),
    "nothing": ("const int l = 4 * k; x[l] += 1;", 1, 1000),
    "two arguments": ("if (k < l) { x[0] += 1; }", 1, 1000),
    "the value": ("for (int i = 0; i < k; i++) { if (i != k) { x[0] += 1; } }", 1000, 499500),
}


@pytest.mark.parametrize("case", CALLED)
def test_a_function_is_evaluated_once_for_the_same_facts(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    body, times, operations = CALLED[case]
    kept = []
    keep = Results.keep

    def counted(self: Results[Any], facts: Any, result: Any) -> None:
        kept.extend([result] if not isinstance(result, int) else [])
        keep(self, facts, result)

    monkeypatch.setattr(Results, "keep", counted)
    g = f"static void g(real_t *x, int k, int l)\n{{\n{body}\n}}\n"
    text = f"{g}static void f(real_t *x)\n{{\nfor (int j = 0; j < 1000; j++) {{ g(x, j, j + 1); }}\n}}\n"
    assert bounds(text).operations("f") == operations
    assert len(kept) == times + 1
