"""The samples are compared with the C parts and the conditions that they reach.

Conditions are those of `#if`, and those of a plain `if` that the exporter decides. A plain `if` counts where an operand
consists of sizes and features only, as in ``if (NE > 0 && row_is_coupled(m)) {``.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.kernel import called_lookups
from nmpc_codegen.lowering.dialect.c_expressions import Expression, expression
from nmpc_codegen.lowering.dialect.directives import evaluate
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.lowering.unit.assemble import INTERVALS, SEARCH
from nmpc_codegen.lowering.unit.read import MATH

#: Parts of every package.
ALWAYS = ("core/sizes.c", "core/rows.c", "core/cost.c", "core/augmented.c", "core/algebraic.c")
_PLAIN = re.compile(r"^ +(?:\} else )?if \((.*)\) \{")
_CONSTANT = re.compile(r"[A-Z0-9_ <>=!+&|()]*[A-Z]{2}[A-Z0-9_ <>=!+&|()]*")
_LINE = re.compile(r'#(include|if|elif|else|endif)\b\s*"?([^"]*)"?')

#: (part, line number) of a condition -> its observed values.
Values = dict[tuple[str, int], set[bool]]


#: Folders whose parts belong to no controller but to packages of derivatives and to programs for a target, which have
#: tests of their own.
OTHERS = ("derivatives", "firmware")


def all_parts() -> set[str]:
    """Return every C part of controllers, relative to the templates."""
    found = (path.relative_to(template_directory()) for path in template_directory().rglob("*.c"))
    return {str(path) for path in found if path.parts[0] not in OTHERS}


def conditions(part: str) -> list[tuple[int, str]]:
    """Return line number and text of every condition of a part that the exporter decides."""
    found = []
    for number, line in enumerate((template_directory() / part).read_text(encoding="utf-8").splitlines(), 1):
        directive = _LINE.match(line)
        if directive and directive[1] in ("if", "elif"):
            found.append((number, directive[2]))
        elif decided := _decided(line):
            found.append((number, decided))
    return found


def _decided(line: str) -> str:
    """Return the operands of a plain `if` that consist of sizes and features."""
    plain = _PLAIN.match(line)
    operands = _conjuncts(expression(plain[1])) if plain else []
    texts = (plain[1][operand.start : operand.end] for operand in operands) if plain else ()
    return " && ".join(text for text in texts if _CONSTANT.fullmatch(text))


def _conjuncts(found: Expression) -> list[Expression]:
    """Return the operands of && in a condition."""
    if found.word != "&&":
        return [found]
    return [conjunct for operand in found.operands for conjunct in _conjuncts(operand)]


def reached(modules: Iterable[CModule]) -> tuple[set[str], Values]:
    """Return the parts used by the modules, and the observed values of the conditions."""
    parts: set[str] = set()
    values: Values = defaultdict(set)
    for module in modules:
        math = (MATH,) if module.features.own_math or module.sizes["LANE_NODES"] else ()
        search = (SEARCH,) if called_lookups(module.routines) else ()
        stages = (INTERVALS,) if module.stage_parts else ()
        sections = (section.template for section in module.sections)
        for root in (*ALWAYS, *math, *search, *stages, *sections, *module.hooked_parts):
            for part, number, value in _walk(root, module.sizes):
                parts.add(part)
                if number:
                    values[part, number].add(value)
    return parts, values


def covering(modules: Mapping[str, CModule]) -> list[str]:
    """Choose a few modules that together reach every part and condition value that all modules reach."""
    found: dict[str, set[object]] = {}
    for name, module in modules.items():
        parts, values = reached([module])
        found[name] = {*parts, *((place, value) for place, both in values.items() for value in both)}
    missing, chosen = set[object]().union(*found.values()), list[str]()
    while missing:
        chosen.append(max(found, key=lambda name: len(found[name] & missing)))
        missing -= found[chosen[-1]]
    return chosen


def gaps(modules: Iterable[CModule]) -> list[str]:
    """Return the parts that no module uses, and the conditions that are never true or never false."""
    parts, values = reached(modules)
    missing = [f"{part}: in no sample" for part in sorted(all_parts() - parts)]
    for part in sorted(parts):
        lines = (template_directory() / part).read_text(encoding="utf-8").splitlines()
        for number, text in conditions(part):
            undecided = set[bool]() if lines[number - 1].startswith("#") else {True, False}
            never = {True, False} - values.get((part, number), undecided)
            missing += [f"{part}:{number}: {text} is never {str(v).lower()}" for v in sorted(never)]
    return missing


def _walk(part: str, sizes: Mapping[str, int]) -> Iterator[tuple[str, int, bool]]:
    """Yield (part, line, value) of every resolved condition; line 0: the part itself is used."""
    yield part, 0, True
    stack: list[tuple[bool, bool]] = []  # for every open #if: this branch is taken, one branch has been taken
    for number, line in enumerate((template_directory() / part).read_text(encoding="utf-8").splitlines(), 1):
        found = _LINE.match(line)
        if found is None:
            if all(active for active, _ in stack):
                with suppress(ValueError):  # a word in capitals that is no size, or no condition
                    yield part, number, evaluate(_decided(line), sizes)
            continue
        word, text = found.groups()
        if word == "include":
            if text.endswith(".c") and not text.startswith("generated/") and all(active for active, _ in stack):
                yield from _walk(text, sizes)
            continue
        done = stack.pop()[1] if word != "if" else False
        if word == "endif":
            continue
        holds = not done and all(active for active, _ in stack)
        if holds and word != "else":
            holds = evaluate(text, sizes)
            yield part, number, holds
        stack.append((holds, done or holds))
