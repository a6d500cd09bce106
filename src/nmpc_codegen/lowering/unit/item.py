"""A translation unit consists of items: a function, a macro, a table, ..., each with the comment above it.

The names that an item defines, calls and reads are computed once for its text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

from nmpc_codegen.lowering.dialect.c_expressions import words
from nmpc_codegen.lowering.dialect.scopes import blank, free_names, in_line, names_in_code, signature, split

#: A section is the heading of a part of the unit, a heading is a separate comment. An alias is a short name of a
#: declaration in the header; macros are written by the compiler; definitions in parts are directives.
Kind = Literal["section", "heading", "alias", "macro", "directive", "type", "table", "enum", "prototype", "function"]

State = Literal["raw", "simple", "changed", "ready"]

#: Words in heads of functions that only this unit calls.
_INNER = frozenset(("static", "LANES_INLINE", "PACK_INLINE"))
_ATTRIBUTE = re.compile(r" ?__attribute__\(\((?:[^()]|\((?:[^()]|\([^()]*\))*\))*\)\)")
_CALL = re.compile(r"(?<![.\w])(?<!->)[A-Za-z_]\w*(?=\()")
_DEFINED = re.compile(r"^#define (\w+)", re.MULTILINE)
#: The name of a type, or of a table before its values.
_TYPE = re.compile(r"\(\*(\w+)\)\(|(\w+)(?:\[\w*\])*;$|^struct (\w+)")
_TABLE = re.compile(r"(\w+)(?:\[[^\]]*\])*(?:\)\([^)]*\))?$")


@dataclass(frozen=True)
class Item:
    """An item is a piece of a unit.

    Attributes:
        name: the name that it defines, if it is a single one; API(f) for a function f of the interface.
        kind: see Kind.
        text: C text with the comment above it; for an alias or a macro the text that the name stands for.
        arguments: names of the arguments of a macro.
        apart: True if an empty line is printed before it.
        note: a comment that is printed after a macro or an alias.
        state: state of a function. raw: as in the part; simple: simplified; changed: edited since then; ready: a
            printed kernel or elementary function, which no pass changes.
    """

    name: str
    kind: Kind
    text: str
    arguments: str | None = None
    apart: bool = True
    note: str = ""
    state: State = "raw"

    def with_text(self, text: str) -> Item:
        """Return the item with another text."""
        if text == self.text:
            return self
        return replace(self, text=text, state="changed" if self.state == "simple" else self.state)

    @cached_property
    def defines(self) -> frozenset[str]:
        """Return the names that other items may read."""
        return frozenset((self.name,)) if self.kind in ("alias", "macro") else _defines(self.kind, self.name, self.text)

    @cached_property
    def calls(self) -> frozenset[str]:
        """Return the functions and macros that the item calls."""
        return calls(self.text)

    @cached_property
    def reads(self) -> frozenset[str]:
        """Return the names that the item uses and does not declare."""
        if self.kind in ("section", "heading", "alias"):
            return frozenset()
        return free_names(self.text) if self.is_prunable else names_in_code(self.text)

    @cached_property
    def words(self) -> frozenset[str]:
        """Return all names in the code of the item, including members and variables."""
        return self.defines if self.kind == "alias" else words(blank(self.text)) | self.defines

    @property
    def is_prunable(self) -> bool:
        """Return True for a function of a part, which passes may change."""
        return self.kind == "function" and self.state != "ready"

    @cached_property
    def is_entry(self) -> bool:
        """Return True for a function that other units call, or its prototype."""
        return self.kind in ("function", "prototype") and not _is_inner(self.text)


@lru_cache(maxsize=16384)
def _defines(kind: Kind, name: str, text: str) -> frozenset[str]:
    code = blank(text)
    found = {name} if name else set()
    if kind == "directive":
        found.update(_DEFINED.findall(code))
    if kind in ("enum", "type") and "enum" in code:
        inside = code[code.index("{") + 1 : code.rindex("}")]
        found.update(part.partition("=")[0].strip() for part in split(inside) if part.strip())
    return frozenset(found)


@lru_cache(maxsize=16384)
def calls(text: str) -> frozenset[str]:
    """Return the functions and macros that a text calls."""
    return frozenset(_CALL.findall(blank(text)))


@lru_cache(maxsize=16384)
def _is_inner(text: str) -> bool:
    """Return True for a function that only its own unit calls."""
    return not _INNER.isdisjoint(_ATTRIBUTE.sub("", in_line(text)).partition("(")[0].split())


def name_of(kind: Kind, text: str) -> str:
    """Return the name of an item with this text.

    Raises:
        ValueError: the item has no name.
    """
    code = _ATTRIBUTE.sub("", in_line(text))
    if kind in ("function", "prototype"):
        return signature(code)[0]
    if kind not in ("type", "table"):
        return ""
    found = _TYPE.search(code) if kind == "type" else _TABLE.search(code.partition("=")[0].rstrip(" ;"))
    if found is None:
        raise ValueError(f"{code[:60]!r}: expected a function with braces in lines of their own, a table or a type")
    return str(next(filter(None, found.groups())))
