"""Parts of templates/ are read as items: `#if` over sizes is resolved, `#include "part.c"` becomes the part's items.

A part compiles unchanged after the preamble of a whole package (lower(whole=True)), so that linters check the shipped
code. A condition is an integer expression of C in the sizes and features of the package (0: absent). The caller writes
the files that parts include as ``generated/<name>.c``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, lru_cache

from nmpc_codegen.ir.kernel import OPERATIONS
from nmpc_codegen.lowering.dialect.directives import resolve
from nmpc_codegen.lowering.dialect.scopes import blank, in_line
from nmpc_codegen.lowering.dialect.tree import Node, parse
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.lowering.unit.item import Item, Kind, name_of

_INCLUDE = re.compile(r'^#include "([\w/]+\.c)".*\n', re.MULTILINE)
#: The end of a declaration or a directive.
_BEFORE = re.compile(r";[ \t]*\n|^#(?:[^\\\n]|\\.)*\n", re.MULTILINE | re.DOTALL)


def no_generated_part(path: str) -> str:
    """Raise LookupError; this function serves parts without generated includes.

    Raises:
        LookupError: always.
    """
    raise LookupError(f"{path}: expected a part that is a file")


def read_part(
    path: str, generate: Callable[[str], str] = no_generated_part, sizes: Mapping[str, int] | None = None
) -> str:
    """Return the text of a part and of the parts that it includes.

    ``generate`` maps the path of a generated part to its text; ``sizes`` holds values for `#if`; with None, `#if` is
    kept.
    """
    text, *included = _INCLUDE.split(resolve(_file(path), sizes))
    for include, following in zip(included[::2], included[1::2], strict=True):
        inner = generate(include) if include.startswith("generated/") else read_part(include, generate, sizes)
        text += inner.rstrip("\n") + "\n" + following
    return text


@cache
def _file(path: str) -> str:
    """Return the text of a file in templates/."""
    return (template_directory() / path).read_text(encoding="utf-8").rstrip("\n") + "\n"


def items_of(text: str) -> tuple[Item, ...]:
    """Return the items of a text; a line `}` ends a function, a line `{` begins its body.

    Raises:
        ValueError: the text does not belong to the dialect, or an item has no name.
    """
    *functions, rest = f"\n{text}\n".split("\n}\n")
    pieces = [*(f"{piece}\n}}" for piece in functions), rest]
    return tuple(item for piece in pieces for item in _items(f"\n{piece}"))


@lru_cache(maxsize=8192)
def _items(piece: str) -> tuple[Item, ...]:
    """Return the items of a text that ends with a function, or has none."""
    head, brace, _ = piece.partition("\n{\n")
    start = len(piece)
    if brace:
        start = head.rfind("\n\n") + 2
        start += max((m.end() for m in _BEFORE.finditer(blank(head[start:]))), default=0)
    before = piece[:start].rstrip("\n")
    found = list(_declarations(before, parse(before)))
    if brace:
        gap = piece[len(before) : start]
        found.append(Item(name_of("function", head[start:]), "function", piece[start:], apart=_is_apart(gap)))
    return tuple(found)


def _declarations(text: str, nodes: tuple[Node, ...]) -> Iterator[Item]:
    """Yield the items before a function.

    A comment belongs to the item on the next line; definitions of macros on consecutive lines are one item.
    """
    at, place = 0, 0
    while place < len(nodes):
        first = last = nodes[place]
        place += 1
        if first.kind == "comment" and _is_next_line(text, last, nodes[place:]):
            last = nodes[place]
            place += 1
        while text.startswith("#define", last.start) and _is_next_line(text, last, nodes[place:], "#define"):
            last = nodes[place]
            place += 1
        piece = text[first.start : last.end]
        kind = _kind(in_line(piece) or piece)
        yield Item(name_of(kind, piece), kind, piece, apart=_is_apart(text[at : first.start]))
        at = last.end


def _is_next_line(text: str, node: Node, following: Sequence[Node], word: str = "") -> bool:
    """Return True if the text after a node begins on the next line, with this word."""
    return bool(following) and text[node.end : following[0].start] == "\n" and text.startswith(word, following[0].start)


def _is_apart(gap: str) -> bool:
    return gap.count("\n") > 1


def _kind(code: str) -> Kind:
    if code.startswith("/*"):
        return "section" if code.startswith("/* ==") else "heading"
    if code.startswith("#"):
        return "directive"
    if code.startswith("enum ") and "=" not in code.partition("{")[0]:
        return "enum"
    if code.startswith(("typedef ", "struct ", "union ")):
        return "type"
    return "prototype" if "=" not in code and code.rstrip(";").endswith(")") else "table"


_DEFINITION = re.compile(
    r"^#define (\w+)|^typedef \w+ (\w+);|^(?:static|LANES_INLINE) [\w *]*?\b(\w+)[(\[]", re.MULTILINE
)
_ENUMERATION = re.compile(r"\benum \{([^}]*)\}")


def defined_names(text: str) -> set[str]:
    """Return the names of macros, types, tables, functions and constants in a text, inside any `#if`."""
    code = blank(text)
    constants = {part.partition("=")[0].strip() for inside in _ENUMERATION.findall(code) for part in inside.split(",")}
    return {next(filter(None, found)) for found in _DEFINITION.findall(code)} | constants


# -- the elementary functions ------------------------------------------------------------------------------------------

#: Parts with the elementary functions of a package, and with those that lanes also have.
MATH, MATH_IN_LANES = "math/own.c", "math/functions.c"

_FUNCTION = re.compile(r"^static (?:inline )?real_t own_(\w+)\(", re.MULTILINE)


@cache
def own_names(part: str = MATH) -> frozenset[str]:
    """Return the functions of math.h that have a replacement in the package."""
    in_math_h = {operation.function for operation in OPERATIONS.values()}
    return frozenset(_FUNCTION.findall(read_part(part))) & in_math_h
