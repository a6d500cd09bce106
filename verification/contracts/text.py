"""The contracts of a package's text state that comments describe only what is there, and functions fit a screen.

The text also compiles without a warning and needs nothing but math.h.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.templates import template_directory
from verification import quality
from verification.contracts.subject import Subject
from verification.rendered import lowered

LONGEST = 60

#: A function that starts a line, until the brace that ends it.
FUNCTION = re.compile(r"^(?:static |API)[^;{}]*?\b(\w+)\)?\([^;{}]*\)\n\{\n.*?^\}", re.MULTILINE | re.DOTALL)

#: The user's functions and their derivatives: functions that evaluate f, the cost or a row at a point, and products of
#: their derivatives with a column.
OF_MODEL = re.compile(
    r"(?:path|terminal|start|stage|coupled|initial)_(?:cost|gradient|hessian|product|rows|curvature|slopes|equation"
    r"|exact_of_data)\w*"
    r"|(?:integrator|path_exact|interval)\w*_(?:f|taped_f|tape|slopes|linearize_f|f_and_tangent|node|backward_\d"
    r"|curvature|derivatives_at_all_stages|curvatures_at_all_stages)"
    r"|\w+_(?:sensitivities|adjoint)_of_stages?_\d\w*"
)

#: Products with the matrices of a stage, written out over their nonzeros, are a little longer.
PRODUCTS, LONGEST_PRODUCT = re.compile(r"condense_\w+_panel|adjoint_step"), 64


def too_long(text: str) -> dict[str, int]:
    """Return {name: lines} of the functions of a .c that are too long."""
    found = {m[1]: m[0].count("\n") + 1 for m in FUNCTION.finditer(text)}
    assert len(found) > 20, "the pattern finds no functions"
    return {
        name: lines
        for name, lines in found.items()
        if lines > (LONGEST_PRODUCT if PRODUCTS.fullmatch(name) else LONGEST) and not OF_MODEL.fullmatch(name)
    }


#: Word of a comment -> test whether a package has the thing that it means.
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
    """Yield name, arguments and text of every macro with arguments."""
    for found in re.finditer(r"^#define (\w+)\(([^)]*)\) ((?:.*\\\n)*.*)$", unit, re.MULTILINE):
        yield found[1], [a.strip() for a in found[2].split(",") if a.strip()], found[3]


def functions(code: str) -> Iterator[tuple[str, str]]:
    """Yield head and body of every function."""
    for found in re.finditer(r"^(\w[^;{}]*?\))\n\{\n(.*?)^\}", code, re.MULTILINE | re.DOTALL):
        yield " ".join(found[1].split()), found[2]


def idle_arguments(unit: str) -> list[str]:
    """Return arguments that macros drop, and parameters of inner functions that are only cast to void."""
    found = [f"{name}({a})" for name, arguments, text in macros(unit) for a in arguments if a not in words(text)]
    for head, body in functions(without_comments(unit)):
        if head.startswith("static"):
            found += [f"{head}: {name}" for name in re.findall(r"^ +\(void\)(\w+);", body, re.MULTILINE)]
    return found


def idle_statements(unit: str) -> list[str]:
    """Return statements without effect.

    They are copies of an object to itself, a return that ends a function, loops of one pass, conditions and variables
    that are numbers, and functions that do nothing.
    """
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
    """Return the members of structs that the unit does not name."""
    named = words(without_comments(unit))
    found = []
    for body, name in re.findall(
        r"^(?:typedef )?(?:struct|union)[^{;]*\{(.*?)^\} ?(\w*);", without_comments(header), re.M | re.S
    ):
        members = re.findall(r"(\w+)(?:\[[^\]]*\])*;", body)
        found += [f"{name}.{member}" for member in members if member not in named and member not in structs]
    return found


def foreign_words(module: CModule, unit: str) -> list[str]:
    """Return the comments about things that the package lacks."""
    comments = re.findall(r"/\*.*?\*/", unit, re.DOTALL)
    lacking = [word for word, is_there in TOPICS.items() if not is_there(module)]
    return [c for c in comments for word in lacking if re.search(word, " ".join(c.split()))]


@cache
def functions_of_parts() -> frozenset[str]:
    """Return the functions and thresholds of all parts."""
    code = "".join(without_comments(file.read_text(encoding="utf-8")) for file in template_directory().rglob("*.c"))
    return frozenset(re.findall(r"\b[a-z]+_\w+(?=\()|\b(?:TOL|FACTOR|HAS)_\w+", code))


def foreign_names(unit: str) -> list[str]:
    """Return the functions and thresholds that comments name and the unit lacks."""
    there = words(without_comments(unit))
    comments = re.findall(r"/\*.*?\*/", unit, re.DOTALL)
    return sorted({name for comment in comments for name in (words(comment) & functions_of_parts()) - there})


def what_stands_in_a_unit_is_there(subject: Subject) -> None:
    """Assert that no argument, member, word or statement belongs to something that the package lacks."""
    module = lowered(subject.sample)
    unit, header = subject.text[f"{module.name}.c"], subject.text[f"{module.name}.h"]
    assert idle_arguments(unit) == []
    assert idle_statements(unit) == []
    assert idle_members(header, unit, {s.name for s in module.structs}) == []
    assert foreign_words(module, unit) == []
    assert foreign_names(unit) == []


def functions_fit_a_screen(subject: Subject) -> None:
    """Assert that only functions of the user's model are longer than a screen."""
    assert too_long(subject.text[f"{lowered(subject.sample).name}.c"]) == {}


def front_ends_find_nothing(subject: Subject) -> None:
    """Assert that C99 and C++17 compilers give no warning, with all warnings of the project."""
    assert quality.warnings_of(subject.text, ("-fsyntax-only",), ("C99", "C++17")) == ""


def symbols_are_its_own(subject: Subject) -> None:
    """Assert that only the interface is external, only math.h and memcpy are called, and no data are writable."""
    assert quality.foreign_symbols(subject.text, "-O0") == []
    name = quality.package_name(subject.text)
    included = set(re.findall(r'#include [<"](.*)[>"]', subject.text[f"{name}.c"] + subject.text[f"{name}.h"]))
    assert included - {"stddef.h"} == {f"{name}.h", "math.h", "stdint.h", "string.h"}
    code = without_comments(subject.text[f"{name}.c"])
    assert not re.search(r"\b(malloc|calloc|free|printf|goto|setjmp|restrict)\b", code)
