"""The unit of a package without what the package does not need.

A part is written for every problem, with all its rows, bounds and components. Every function is simplified by itself
(passes.py); then functions that nothing reaches go, with their prototypes, and enumerations of which nothing is used. A
parameter, or a variable of which only macros take notice that drop it, gets a statement, (void)k.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import accumulate
from typing import NamedTuple

from nmpc_codegen.lowering.pruning.constants import Constants
from nmpc_codegen.lowering.pruning.passes import simplified
from nmpc_codegen.lowering.pruning.scopes import (
    blanked,
    declarators,
    free_names,
    function_of,
    in_line,
    names_in_code,
    signature,
    split,
)
from nmpc_codegen.lowering.pruning.tree import Edit, Node, edited, margin, parse

# (name, arguments or None, text)
Definition = tuple[str, str | None, str]

#: Heads of functions that only this unit calls.
_INNER = ("static ", "LANES_INLINE ", "PACK_INLINE ")
_ASSIGNS = re.compile(r"\+\+|--|(?<![=!<>])=(?!=)")
#: The entry point that what only it calls stands in front of, in the last part of a unit, and the heading of that part.
LAST = "API(solve)"
LAST_HEADING = "/* ==== solve(): what only it calls " + "=" * 68 + " */"
#: A call of a function.
CALLED = re.compile(r"\b[a-z]\w*(?=\()")


class Item(NamedTuple):
    """What stands between two empty lines or functions: its text with the comment above it, and its name."""

    kind: str  # function, prototype, enumeration, heading, other
    text: str
    name: str = ""
    gap: str = "\n"
    inner: bool = False  # a function that only this unit calls


@lru_cache(maxsize=8192)
def items(text: str) -> tuple[Item, ...]:
    """The items of a text that ends with a function, or has none."""
    head, brace, _ = text.partition("\n{\n")
    start = len(text)
    if brace:
        start = head.rfind("\n\n") + 2
        start += max((m.end() for m in _BEFORE.finditer(blanked(head[start:]))), default=0)
    found: list[Item] = []
    before = text[:start].rstrip("\n")
    nodes, at, place = parse(before), 0, 0
    while place < len(nodes):
        first = node = nodes[place]
        if node.kind == "comment" and place + 1 < len(nodes) and before[node.end : nodes[place + 1].start] == "\n":
            place += 1
            node = nodes[place]
        found.append(_item(before[first.start : node.end], node, before[at : first.start]))
        at, place = node.end, place + 1
    if brace:
        code = in_line(head[start:])
        gap = text[len(before) : start]
        found.append(Item("function", text[start:], signature(code)[0], gap, code.startswith(_INNER)))
    return tuple(found)


#: The end of a declaration or a directive.
_BEFORE = re.compile(r";\n|^#.*\n", re.MULTILINE)


def _item(piece: str, node: Node, gap: str) -> Item:
    code = piece[len(piece) - node.end + node.start :]
    if node.kind == "comment":
        return Item("other" if piece.startswith("/* ==") else "heading", piece, "", gap)
    if code.startswith("enum {"):
        return Item("enumeration", piece, "", gap)
    if code.startswith("static ") and "=" not in code and code.rstrip(";").endswith(")"):
        return Item("prototype", piece, signature(code)[0], gap)
    return Item("other", piece, "", gap)


def pruned(unit: str, kernels: Mapping[str, str], known: Sequence[Definition], constants: Constants) -> str:
    """The text of a unit, whose macros are ``known``, without what it does not need; ``kernels``: printed functions by
    name, which stand before it."""
    macros = Macros(known)
    *chunks, rest = f"{unit}\n".split("\n}\n")
    found = [item for chunk in (*(f"\n{chunk}\n}}" for chunk in chunks), f"\n{rest}") for item in items(chunk)]
    functions, names = reached(found, kernels, macros, constants)
    kept = _without_idle_headings([item for item in found if _stays(item, names)], found)
    early = names
    if any(item.name == LAST for item in kept):
        _, early = reached([item for item in found if item.name != LAST], kernels, macros, constants)
    first, last = _apart(kept, early)

    def text(items: Iterable[Item], printed: Collection[str]) -> str:
        of = ((i.gap, _marked_for(functions[i.name], macros) if i.kind == "function" else i.text) for i in items)
        called = [kernel for name, kernel in kernels.items() if name in printed]
        return "\n\n".join([*called, "".join(gap + t for gap, t in of).lstrip("\n")])

    parts = [text(first, early), *([LAST_HEADING, text(last, names - early)] if last else [])]
    return "\n\n".join(parts) + "\n"


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
            late.append(names_in_code(_constants(item)).isdisjoint(early))
        else:
            late.append(False)
    return late[::-1]


def calling(known: Iterable[Definition]) -> frozenset[str]:
    """Macros that call functions or assign, themselves or through others."""
    texts = {name: text for name, arguments, text in known if arguments}
    found = {name for name, text in texts.items() if CALLED.search(text) or _ASSIGNS.search(text)}
    while more := {name for name, text in texts.items() if not found.isdisjoint(names_in_code(text))} - found:
        found |= more
    return frozenset(found)


class Macros:
    """The macros of a unit: what their names stand for, and which arguments they drop."""

    def __init__(self, known: Iterable[Definition]) -> None:
        self.texts = {name: text for name, _, text in known}
        self.arguments = {name: arguments.split(", ") for name, arguments, _ in known if arguments}
        self.dropping: dict[str, tuple[int, ...]] = {}
        for name, arguments in self.arguments.items():
            read = names_in_code(without_dropped(self.texts[name], self.dropping))
            if dropped := tuple(i for i, argument in enumerate(arguments) if argument not in read):
                self.dropping[name] = dropped

    def expanded(self, names: Iterable[str]) -> set[str]:
        """The names, and those in the macros that they are."""
        found: set[str] = set()
        waiting = set(names)
        while waiting:
            found |= waiting
            inside = (names_in_code(self.texts[name]) for name in waiting if name in self.texts)
            waiting = set().union(*inside) - found
        return found


def without_dropped(code: str, dropping: Mapping[str, Sequence[int]]) -> str:
    """A text without the arguments that macros drop."""
    for name in sorted(names_in_code(code) & dropping.keys()):
        for call in reversed(list(re.finditer(rf"\b{name}\(", code))):
            rest = code[call.end() :]
            depths = accumulate(((c == "(") - (c == ")") for c in rest), initial=1)
            end = next((place - 1 for place, depth in enumerate(depths) if depth == 0), len(rest))
            kept = ["" if i in dropping[name] else given for i, given in enumerate(split(rest[:end]))]
            code = code[: call.end()] + ",".join(kept) + rest[end:]
    return code


def reached(
    found: Sequence[Item], kernels: Mapping[str, str], macros: Macros, constants: Constants
) -> tuple[dict[str, str], set[str]]:
    """Simplified texts of the functions that the interface, and what is no function, reach; all names on the way."""
    functions: dict[str, str] = {}
    for item in found:
        if item.kind == "function" and functions.setdefault(item.name, item.text) != item.text:
            raise ValueError(f"{item.name}(): there are two functions with this name")
    waiting = {item.name for item in found if item.kind == "function" and not item.inner}
    for item in found:
        if item.kind == "other":
            waiting |= macros.expanded(names_in_code(item.text))
    enumerations = [names_in_code(_constants(item)) for item in found if item.kind == "enumeration"]
    texts: dict[str, str] = {}
    mentioned: set[str] = set()
    while waiting:
        mentioned |= waiting
        inside: set[str] = set()
        for name in waiting:
            if name in functions:
                texts[name] = _simplified(name, functions[name], constants)
                inside |= free_names(texts[name])
            elif name in kernels:
                inside.update(CALLED.findall(kernels[name]))
        inside = inside.union(*(names for names in enumerations if not names.isdisjoint(waiting)))
        waiting = macros.expanded(inside) - mentioned
    return texts, mentioned


def _simplified(name: str, text: str, constants: Constants) -> str:
    try:
        return simplified(text, constants)
    except ValueError as error:
        raise ValueError(f"{name}(): {error}") from error


def _constants(enumeration: Item) -> str:
    """What stands in the braces of an enumeration."""
    return enumeration.text[enumeration.text.rindex("{") :]


def _stays(item: Item, names: Collection[str]) -> bool:
    if item.kind in ("function", "prototype"):
        return item.name in names
    if item.kind == "enumeration":
        return not names_in_code(_constants(item)).isdisjoint(names)
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


def _marked_for(text: str, macros: Macros) -> str:
    """A function with a statement for every parameter and variable that it does not read."""
    dropping = {name: macros.dropping[name] for name in names_in_code(text) & macros.dropping.keys()}
    return _marked(text, tuple(dropping.items()))


@lru_cache(maxsize=8192)
def _marked(text: str, dropping: tuple[tuple[str, tuple[int, ...]], ...]) -> str:
    """The same of a function that calls these macros, which drop arguments at these places."""
    function = function_of(text)
    _, parameters = signature(text[slice(*function.head)])
    body = blanked(text[slice(*function.inside)])
    read = names_in_code(without_dropped(body, dict(dropping)))
    edits = []
    if unread := "".join(f"\n    (void){name};" for name in parameters if name not in read):
        edits.append(Edit(function.inside[0], function.inside[0], unread))
    for node in function.walk() if dropping else ():
        code = text[node.start : node.end] if node.kind == "statement" else ""
        for name, _ in declarators(code):
            if name not in names_in_code(without_dropped(body.replace(blanked(code), "", 1), dict(dropping))):
                edits.append(Edit(node.end, node.end, f"\n{margin(text, node)}(void){name};"))
    return edited(text, edits)
