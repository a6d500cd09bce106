"""What stands in an emitted unit is there: no argument, member, word or statement for what the package lacks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache

import pytest

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.templates import template_directory
from verification.rendered import lowered, texts
from verification.samples import SAMPLES

#: Word of a comment -> whether a package has what it means.
TOPICS: Mapping[str, Callable[[CModule], bool]] = {
    r"\bslack(?:s\b| variable| sigma)": lambda m: m.sizes.get("NSL", 0) > 0,
    r"\bcoupled\b": lambda m: m.sizes["NE"] > 0,
    r"\bsoft (?:rows?|ones?|sides?)\b": lambda m: (
        has(m, "SOFT_ROWS", "ELASTIC") or any(r.soft for r in m.description.rows)
    ),
    r"\belastic\b": lambda m: has(m, "SOFT_ROWS", "ELASTIC"),
    r"(?<!/.)(?<!/\*.)\bfree components?\b|\bfree x_0": lambda m: m.sizes["NF"] > 0,
    r"\baccumulators?\b": lambda m: m.features.accumulators,
    r"\bsolve\(\)": lambda m: m.features.solve,
    r"\bin single\b|\bsingle precision\b": lambda m: m.features.single,
    r"\bREPAIRS?\b": lambda m: has(m, "REPAIRS", "REPAIR"),
}


def has(module: CModule, *sizes: str) -> bool:
    return any(module.sizes.get(name, 0) > 0 for name in sizes)


def without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL)


def words(text: str) -> set[str]:
    return set(re.findall(r"\w+", text))


def macros(unit: str) -> Iterator[tuple[str, list[str], str]]:
    """Name, arguments and text of every macro with arguments."""
    for found in re.finditer(r"^#define (\w+)\(([^)]*)\) ((?:.*\\\n)*.*)$", unit, re.MULTILINE):
        yield found[1], [a.strip() for a in found[2].split(",") if a.strip()], found[3]


def functions(code: str) -> Iterator[tuple[str, str]]:
    """Head and body of every function."""
    for found in re.finditer(r"^(\w[^;{}]*?\))\n\{\n(.*?)^\}", code, re.MULTILINE | re.DOTALL):
        yield " ".join(found[1].split()), found[2]


def idle_arguments(unit: str) -> list[str]:
    """Arguments that macros drop, and parameters of inner functions that have a statement in place of a use."""
    found = [f"{name}({a})" for name, arguments, text in macros(unit) for a in arguments if a not in words(text)]
    for head, body in functions(without_comments(unit)):
        if head.startswith("static"):
            found += [f"{head}: {name}" for name in re.findall(r"^ +\(void\)(\w+);", body, re.MULTILINE)]
    return found


def idle_statements(unit: str) -> list[str]:
    """Copies of a place to itself, a return that ends a function, loops of one pass, conditions and variables that are
    numbers, functions that do nothing."""
    code = without_comments(unit)
    found = [f"{a} = {b}" for a, b in re.findall(r"^ +([^ =]+) = ([^ ;]+);", code, re.MULTILINE) if a == b]
    found += [f"copy of {a}" for a, b in re.findall(r"mem(?:cpy|move)\((.+?), (.+?), ", code) if a == b]
    found += re.findall(
        r"(?:if|while) \((?:\d+|[A-Z]\w* [<>=]+ \d+)\) \{", re.sub(r"^#.*", "", code, flags=re.MULTILINE)
    )
    found += re.findall(r"for \(int (?:\w+) = 0; \w+ < 1; .*", code)
    found += re.findall(r".* (?:\* 1|[-+] 0)\b(?![.x\d]).*", re.sub(r"^#.*", "", code, flags=re.MULTILINE))
    found += re.findall(r".*(?:!|&& |\|\| )\d+(?: &&| \|\||\)).*", code)
    found += re.findall(r"^( *)for .*\n(?:\1 .*\n)*\1    continue;\n\1\}", code, re.MULTILINE)
    found += re.findall(r"^ +const int \w+ = (?:\d+|[A-Z][A-Z_0-9]*);", code, re.MULTILINE)
    found += re.findall(r"\b([A-Z]\w*) < \1\b", code)
    for head, body in functions(code):
        found += [f"{head}: return;"] * body.endswith("\n    return;\n")
        found += [f"{head}: nothing"] * (not body.strip() and head.startswith("static"))
    return [str(f) for f in found]


def idle_members(header: str, unit: str, structs: set[str]) -> list[str]:
    """Members that the unit does not name."""
    named = words(without_comments(unit))
    found = []
    for body, name in re.findall(
        r"^(?:typedef )?(?:struct|union)[^{;]*\{(.*?)^\} ?(\w*);", without_comments(header), re.M | re.S
    ):
        members = re.findall(r"(\w+)(?:\[[^\]]*\])*;", body)
        found += [f"{name}.{member}" for member in members if member not in named and member not in structs]
    return found


def foreign_words(module: CModule, unit: str) -> list[str]:
    """Comments that speak of what the package lacks."""
    comments = re.findall(r"/\*.*?\*/", unit, re.DOTALL)
    lacking = [word for word, is_there in TOPICS.items() if not is_there(module)]
    return [c for c in comments for word in lacking if re.search(word, " ".join(c.split()))]


@cache
def functions_of_parts() -> frozenset[str]:
    """Functions and thresholds of all parts."""
    code = "".join(without_comments(file.read_text(encoding="utf-8")) for file in template_directory().rglob("*.c"))
    return frozenset(re.findall(r"\b[a-z]+_\w+(?=\()|\b(?:TOL|FACTOR|HAS)_\w+", code))


def foreign_names(unit: str) -> list[str]:
    """Functions and thresholds that comments name and the unit lacks."""
    there = words(without_comments(unit))
    comments = re.findall(r"/\*.*?\*/", unit, re.DOTALL)
    return sorted({name for comment in comments for name in (words(comment) & functions_of_parts()) - there})


@pytest.mark.parametrize("name", [sample.name for sample in SAMPLES])
def test_a_package_has_what_stands_in_it(name: str) -> None:
    sample = next(sample for sample in SAMPLES if sample.name == name)
    module, sources = lowered(sample), texts(sample)
    unit, header = sources[f"{module.name}.c"], sources[f"{module.name}.h"]
    assert idle_arguments(unit) == []
    assert idle_statements(unit) == []
    assert idle_members(header, unit, {s.name for s in module.structs}) == []
    assert foreign_words(module, unit) == []
    assert foreign_names(unit) == []


@pytest.mark.parametrize(
    "fault",
    [
        "#define ROW(s, k) (s)->x",
        "static int idle(int n)\n{\n    (void)n;\n    return 1;\n}",
        "static void nothing(void)\n{\n}",
        "static void leave(solver_t *s)\n{\n    s->x = 1;\n    return;\n}",
        "    memcpy(s->x, s->x, sizeof s->x);",
        "    s->x[0] = s->x[0];",
        "    const int k = N;",
        "    const int n = (N < N) ? NZ : NX;",
        "    if (0) {",
        "    s->x[NX + 0] = R(1);",
        "    if (s->x[0] > R(1) && !1) {",
        "    for (int i = 0; i < NX; i++) {\n        s->x[i] = R(1);\n        continue;\n    }",
        "    for (int i = 0; i < 1; i++) {",
        "/* The slack variables\n * of soft rows. */",
        "/* A coupled row. */",
        "/* In solve(). */",
        "/* See riccati_backward(). */",
    ],
)
def test_faults_are_seen(fault: str) -> None:
    sample = next(sample for sample in SAMPLES if sample.name == "crane without solve")
    module = lowered(sample)
    unit = f"{texts(sample)[f'{module.name}.c']}\n{fault}\n"
    assert [*idle_arguments(unit), *idle_statements(unit), *foreign_words(module, unit), *foreign_names(unit)]


def test_members_are_seen() -> None:
    header = "typedef struct crane_qp_s {\n    double H[2][2]; /* H */\n    double spare[3];\n} crane_qp_t;\n"
    assert idle_members(header, "q->H[0][0] = 1;", set()) == ["crane_qp_t.spare"]
