"""The bound of random functions, whose conditions are all known, is the number of operations that they carry out."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmpc_codegen.analysis.interpret import WorstCase
from nmpc_codegen.analysis.source import Unit, functions
from tests.c_lines import in_lines

TABLES = {"first": (0, 2, 2, 7), "kind": (1, 0, 0, 1, 1, 2, 0, 1)}


def bounds(text: str) -> WorstCase:
    return WorstCase(Unit(functions(in_lines(text)), {}, {}, {"N": 5, "M": 3}, TABLES, {}, {}))


def integer(random: Random, names: Sequence[str], depth: int = 2) -> str:
    """An expression, as C and Python spell it, whose value is not negative."""
    kind = random.choice(["name"] * 4 + ["number", "+", "*", "first", "kind", "pick"])
    if depth == 0 or kind in ("name", "number"):
        return random.choice(names if kind == "name" and names else ["0", "1", "2", "N", "M"])
    inner, other = integer(random, names, depth - 1), integer(random, names, depth - 1)
    spelt = {"+": f"({inner} + {other})", "*": f"2 * {inner}", "pick": f"pick({inner}, {other})"}
    return spelt.get(kind) or f"{kind}[{inner} % {len(TABLES[kind])}]"


def condition(random: Random, names: Sequence[str]) -> str:
    """A comparison or a pair of them, as C spells it."""
    pairs = [f"{integer(random, names)} {random.choice(['<', '>=', '==', '!='])} {integer(random, names)}"]
    if random.random() < 0.3:
        pairs.append(f"{integer(random, names, 1)} > {integer(random, names, 1)}")
    return random.choice([" && ", " || "]).join(pairs)


def statements(random: Random, names: Sequence[str], calls: Sequence[str], depth: int) -> list[Any]:
    """Statements: a number of operations, or (kind, its parts)."""
    found: list[Any] = []
    for _ in range(random.randint(1, 3)):
        kind = random.choice(["add", "const", *(["for", "for", "if"] if depth else []), *calls])
        new = f"v{len(names)}"
        if kind == "add":
            found.append(random.randint(1, 3))
        elif kind == "const":
            found.append(("const", new, integer(random, names)))
            names = [*names, new]
        elif kind == "for":
            start, limit = integer(random, names, 1), integer(random, names, 1)
            body = statements(random, [*names, new], calls, depth - 1)
            found.append(("for", new, start, random.choice([limit, f"({limit}) % 6"]), random.randint(1, 2), body))
        elif kind == "if":
            branches = [statements(random, names, calls, depth - 1) for _ in range(2)]
            found.append(("if", condition(random, names), *branches))
        else:
            found.append(("call", kind, integer(random, names, 1), integer(random, names, 1)))
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


def pick(a: int, b: int) -> int:
    """PICK in Python."""
    return TABLES["first"][a % 4] if a < b else TABLES["kind"][(a + b) % 8]


def agree(seed: int) -> None:
    """g is called by h, both are called by f, most often in loops; all of them read tables."""
    random = Random(seed)
    bodies = {
        "g": statements(random, ["a", "b"], [], 2),
        "h": statements(random, ["a", "b"], ["g", "g"], 2),
        "f": statements(random, [], ["g", "h", "h"], 2),
    }
    bodies["f"] += [
        ("for", "k", "0", "6", 1, [("call", "g", "k", "2"), ("call", "h", "N", "k"), ("call", "h", "k", "k")])
    ]
    done: list[int] = []
    known: dict[str, Any] = {"done": done, **TABLES, "N": 5, "M": 3, "pick": pick}
    text = PICK
    for name, body in bodies.items():
        parameters = "" if name == "f" else ", int a, int b"
        text += f"static void {name}(real_t *x{parameters})\n{{\n{in_c(body)}\n}}\n"
        exec(f"def {name}({'' if name == 'f' else 'a, b'}):\n{in_python(body, ' ')}", known)
    known["f"]()
    assert bounds(text).operations("f") == len(done), text


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_the_bound_is_the_number_of_operations(seed: int) -> None:
    for more in range(20):
        agree(20 * seed + more)


CALLED = {
    "a comparison": ("if (k < N) { x[0] += 1; }", 5),
    "an entry": ("for (int i = 0; i < kind[k % 8]; i++) { x[0] += 1; }", 25 * sum(TABLES["kind"])),
    "a difference": ("for (int i = k; i < k + N; i++) { x[0] += 1; }", 1000),
    "nothing": ("const int l = 4 * k; x[l] += 1;", 200),
    "two arguments": ("if (k < l) { x[0] += 1; }", 200),
    "the value": ("for (int i = 0; i < k; i++) { if (i != k) { x[0] += 1; } }", 19900),
}


@pytest.mark.parametrize("case", CALLED)
def test_a_called_function_has_the_bound_of_its_arguments(case: str) -> None:
    body, operations = CALLED[case]
    g = f"static void g(real_t *x, int k, int l)\n{{\n{body}\n}}\n"
    text = f"{g}static void f(real_t *x)\n{{\nfor (int j = 0; j < 200; j++) {{ g(x, j, j + 1); }}\n}}\n"
    assert bounds(text).operations("f") == operations
