"""The items of a unit: its functions, prototypes, enumerations and comments, each with the comment above it."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple

from nmpc_codegen.lowering.pruning.scopes import blank, in_line, signature
from nmpc_codegen.lowering.pruning.tree import Node, parse

#: Heads of functions that only this unit calls.
_INNER = ("static ", "LANES_INLINE ", "PACK_INLINE ")


class Item(NamedTuple):
    """What stands between two empty lines or functions: its text with the comment above it, and its name."""

    kind: str  # function, prototype, enumeration, heading, other
    text: str
    name: str = ""
    gap: str = "\n"
    inner: bool = False  # a function that only this unit calls
    simple: bool = False  # simplified before
    done: bool = False  # and its text has not changed since then


@lru_cache(maxsize=8192)
def items(text: str) -> tuple[Item, ...]:
    """The items of a text that ends with a function, or has none."""
    head, brace, _ = text.partition("\n{\n")
    start = len(text)
    if brace:
        start = head.rfind("\n\n") + 2
        start += max((m.end() for m in _BEFORE.finditer(blank(head[start:]))), default=0)
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


def constants_in(enumeration: Item) -> str:
    """What stands in the braces of an enumeration."""
    return enumeration.text[enumeration.text.rindex("{") :]
