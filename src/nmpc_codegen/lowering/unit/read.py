"""Parts of templates/ as items: `#if` over sizes is resolved, `#include "part.c"` stands for the items of the part.

A part compiles as it stands after the preamble of a whole package (lower(whole=True)), so that linters check the code
that is shipped. A condition is an integer expression of C in the sizes and features of the package (0: absent). What
parts include as ``generated/<name>.c`` is written by the caller.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache, lru_cache

from nmpc_codegen.ir.kernel import OPERATIONS
from nmpc_codegen.lowering.dialect.directives import resolve
from nmpc_codegen.lowering.dialect.scopes import blank, in_line
from nmpc_codegen.lowering.dialect.tree import Node, parse
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.lowering.unit.item import Item, Kind, name_of

#: Path of a generated part -> its text.
Generate = Callable[[str], str]

_INCLUDE = re.compile(r'^#include "([\w/]+\.c)".*\n', re.MULTILINE)
#: The end of a declaration or a directive.
_BEFORE = re.compile(r";\n|^#.*\n", re.MULTILINE)


def no_generated_part(path: str) -> str:
    """For parts that include none.

    Raises:
        LookupError: the part includes one.
    """
    raise LookupError(f"{path}: expected a part that is a file")


def read_part(path: str, generate: Generate = no_generated_part, sizes: Mapping[str, int] | None = None) -> str:
    """Text of a part below templates/ with the parts that it includes; ``sizes``: those for `#if`; None: it stays."""
    whole = _file(path)
    text, *included = _INCLUDE.split(whole if sizes is None else resolve(whole, sizes))
    for include, following in zip(included[::2], included[1::2], strict=True):
        inner = generate(include) if include.startswith("generated/") else read_part(include, generate, sizes)
        text += inner.rstrip("\n") + "\n" + following
    return text


@cache
def _file(path: str) -> str:
    """Text of a file below templates/."""
    return (template_directory() / path).read_text(encoding="utf-8").rstrip("\n") + "\n"


@lru_cache(maxsize=2048)
def items_of(text: str) -> tuple[Item, ...]:
    """The items of a text. A brace at the margin ends a function, or begins its body."""
    *functions, rest = f"\n{text}\n".split("\n}\n")
    pieces = [*(f"{piece}\n}}" for piece in functions), rest]
    return tuple(item for piece in pieces for item in _items(f"\n{piece}"))


@lru_cache(maxsize=8192)
def _items(piece: str) -> tuple[Item, ...]:
    """The items of a text that ends with a function, or has none."""
    head, brace, _ = piece.partition("\n{\n")
    start = len(piece)
    if brace:
        start = head.rfind("\n\n") + 2
        start += max((m.end() for m in _BEFORE.finditer(blank(head[start:]))), default=0)
    before = piece[:start].rstrip("\n")
    found = list(_declarations(before, parse(before)))
    if brace:
        name = name_of("function", in_line(head[start:]))
        found.append(Item(name, "function", piece[start:], apart=_is_apart(piece[len(before) : start])))
    return tuple(found)


def _declarations(text: str, nodes: tuple[Node, ...]) -> Iterator[Item]:
    """What stands in front of a function; a comment belongs to what begins in the next line."""
    at, place = 0, 0
    while place < len(nodes):
        first = node = nodes[place]
        if first.kind == "comment" and _next_line(text, nodes, place):
            place, node = place + 1, nodes[place + 1]
        last = node
        while node.kind == "directive" and (following := _next_line(text, nodes, place)):
            if following.kind != "directive":
                break
            place, last = place + 1, following
        kind = _kind(text[node.start : last.end])
        name = name_of(kind, text[node.start : last.end])
        yield Item(name, kind, text[first.start : last.end], apart=_is_apart(text[at : first.start]))
        at, place = last.end, place + 1


def _next_line(text: str, nodes: tuple[Node, ...], place: int) -> Node | None:
    """The next node, if it begins in the line behind a node."""
    following = nodes[place + 1] if place + 1 < len(nodes) else None
    return following if following and text[nodes[place].end : following.start] == "\n" else None


def _is_apart(gap: str) -> bool:
    return gap.count("\n") > 1


def _kind(code: str) -> Kind:
    if code.startswith("/*"):
        return "section" if code.startswith("/* ==") else "heading"
    if code.startswith("#"):
        return "directive"
    if code.startswith("typedef "):
        return "type"
    if code.startswith("enum {"):
        return "enum"
    return "prototype" if "=" not in code and code.rstrip(";").endswith(")") else "table"


_DEFINITION = re.compile(
    r"^#define (\w+)|^typedef \w+ (\w+);|^(?:static|LANES_INLINE) [\w *]*?\b(\w+)[(\[]", re.MULTILINE
)
_ENUMERATION = re.compile(r"\benum \{([^}]*)\}")


def defined_names(text: str) -> set[str]:
    """Names of the macros, types, tables, functions and constants that a text defines, whatever `#if` it stands in."""
    code = blank(text)
    constants = {part.partition("=")[0].strip() for inside in _ENUMERATION.findall(code) for part in inside.split(",")}
    return {next(filter(None, found)) for found in _DEFINITION.findall(code)} | constants


# -- the elementary functions ------------------------------------------------------------------------------------------

#: The elementary functions of a package, and those of them that lanes have too.
MATH, MATH_IN_LANES = "math/own.c", "math/functions.c"

_FUNCTION = re.compile(r"^static (?:inline )?real_t own_(\w+)\(", re.MULTILINE)


@cache
def own_names(part: str = MATH) -> frozenset[str]:
    """Functions of math.h that have a text of their own."""
    in_math_h = {operation.function for operation in OPERATIONS.values()}
    return frozenset(_FUNCTION.findall(read_part(part))) & in_math_h
