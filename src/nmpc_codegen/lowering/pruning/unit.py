"""The unit of a package without what the package does not need.

A part is written for every problem, with all its rows, bounds and components. Every function is simplified by itself
(passes.py); then functions that nothing reaches go, with their prototypes, and enumerations of which nothing is used,
and arguments that nothing reads (arguments.py).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import lru_cache

from nmpc_codegen.lowering.pruning.arguments import unread_parameters, without_unread
from nmpc_codegen.lowering.pruning.comments import without_entries, word_comments
from nmpc_codegen.lowering.pruning.constants import Constants
from nmpc_codegen.lowering.pruning.items import Item, constants_in, items
from nmpc_codegen.lowering.pruning.reach import Definition, Macros, reach
from nmpc_codegen.lowering.pruning.scopes import function_of, names_in_code

#: The entry point that what only it calls stands in front of, in the last part of a unit, and the heading of that part.
LAST = "API(solve)"
LAST_HEADING = "/* ==== solve(): what only it calls " + "=" * 68 + " */"
#: A constant in a sum, behind its first term.
_TERM = re.compile(r"(?<=[\w)]) [-+] ([A-Z]\w*)\b(?! *[*/%\[(.])")


def prune(
    unit: str, kernels: Mapping[str, str], known: Sequence[Definition], constants: Constants
) -> tuple[str, list[Definition]]:
    """The text of a unit, whose macros are ``known``, without what it does not need, and the macros without the
    arguments that they do not read; ``kernels``: printed functions by name, which stand before it."""
    unit = _without_zeros(word_comments(unit, constants), constants)
    *chunks, rest = f"{unit}\n".split("\n}\n")
    found = [item for chunk in (*(f"\n{chunk}\n}}" for chunk in chunks), f"\n{rest}") for item in items(chunk)]
    found, known = without_unread(found, kernels, known, constants)
    macros = Macros(known)
    functions, names = reach(found, kernels, macros, constants)
    there = {"API", *functions}
    kept = _without_idle_headings([item for item in found if _stays(item, names)], found)
    kept = [item if item.kind == "function" else item._replace(text=without_entries(item.text, there)) for item in kept]
    early = names
    if any(item.name == LAST for item in kept):
        _, early = reach([item for item in found if item.name != LAST], kernels, macros, constants)
    first, last = _apart(kept, early)

    def text(items: Iterable[Item], printed: Collection[str]) -> str:
        of = ((i.gap, _mark(functions[i.name]) if i.kind == "function" else i.text) for i in items)
        called = [kernel for name, kernel in kernels.items() if name in printed]
        return "\n\n".join([*called, "".join(gap + t for gap, t in of).lstrip("\n")])

    parts = [text(first, early), *([LAST_HEADING, text(last, names - early)] if last else [])]
    return "\n\n".join(parts) + "\n", known


def _without_zeros(unit: str, constants: Constants) -> str:
    """A unit without sizes that are 0 in sums."""
    return _TERM.sub(lambda found: "" if constants.sizes.get(found[1]) == 0 else found[0], unit)


def _apart(kept: Sequence[Item], early: Collection[str]) -> tuple[list[Item], list[Item]]:
    """The items that the early entry points reach, and those that only the last one does, under the headings of their
    sections."""
    sections: list[list[Item]] = [[]]
    for item in kept:
        if _is_section(item):
            sections.append([])
        sections[-1].append(item)
    first: list[Item] = []
    last: list[Item] = []
    for section in sections:
        late = _late(section, early)
        for target, of in ((first, False), (last, True)):
            items = [item for item, is_late in zip(section, late, strict=True) if is_late is of or _is_section(item)]
            if any(not _is_section(item) for item in items) or not (of or any(late)):
                target += items
    return first, last


def _is_section(item: Item) -> bool:
    return item.kind == "other" and item.text.startswith("/* ==")


def _late(section: Sequence[Item], early: Collection[str]) -> list[bool]:
    """Which items of a section only the last entry point reaches; a comment that stands alone goes with the functions
    below it."""
    late: list[bool] = []
    below = True  # all functions below, up to the next comment, are late
    some = False
    for item in reversed(section):
        if item.kind == "heading":
            late.append(some and below)
            below, some = True, False
        elif item.kind in ("function", "prototype"):
            late.append(item.name not in early)
            below, some = below and late[-1], True
        elif item.kind == "enumeration":
            late.append(names_in_code(constants_in(item)).isdisjoint(early))
        else:
            late.append(False)
    return late[::-1]


def _stays(item: Item, names: Collection[str]) -> bool:
    if item.kind in ("function", "prototype"):
        return item.name in names
    if item.kind == "enumeration":
        return not names_in_code(constants_in(item)).isdisjoint(names)
    return True


def _without_idle_headings(kept: Sequence[Item], all_items: Sequence[Item]) -> list[Item]:
    """The items without comments that stand alone above functions of which none is left."""
    left = {item.name or item.text for item in kept}
    idle: set[str] = set()
    heading, names = "", set[str]()
    for item in [*all_items, Item("heading", "")]:
        if item.kind == "heading":
            if heading and names and not names & left:
                idle.add(heading)
            heading, names = item.text, set()
        elif item.kind not in ("prototype", "enumeration"):
            names.add(item.name or item.text)
    return [item for item in kept if item.text not in idle]


@lru_cache(maxsize=8192)
def _mark(text: str) -> str:
    """A function with a statement for every parameter that it does not read: those of the interface stay."""
    at, _ = function_of(text).inside
    return text[:at] + "".join(f"\n    (void){name};" for _, name in unread_parameters(text)) + text[at:]
