"""Conditional expressions, c ? a : b, whose condition sizes and features decide."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache

from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.expressions import Expression, expression
from nmpc_codegen.lowering.dialect.scopes import DECLARATION, blank, split
from nmpc_codegen.lowering.dialect.tree import Edit, Node

#: A condition of sizes and features alone.
_DECISIVE = re.compile(r"[A-Z0-9_ <>=!&|()*+-]+")
_ATOMS = ("name", "number", "call", "index", "member", "group")


@lru_cache(maxsize=16384)
def choices(text: str, node: Node) -> tuple[tuple[int, Expression, Expression | None], ...]:
    """The place of an expression of a node, a conditional one in it that sizes may decide, and the brackets around."""
    found = []
    for start, code in _expressions(text, node):
        if "?" in code:
            try:
                whole = expression(code)
            except ValueError:  # an initialiser with braces, or a cast that is not understood
                continue
            for choice, around in _conditional(whole, None):
                condition = choice.operands[0]
                if _DECISIVE.fullmatch(code[condition.start : condition.end]):
                    found.append((start, choice, around))
    return tuple(found)


def _expressions(text: str, node: Node) -> Iterator[tuple[int, str]]:
    """The expressions of a statement or the head of a loop, with their places."""
    start, end = node.head if node.kind in ("if", "loop") else (node.start, node.end)
    if node.kind not in ("statement", "leave", "if", "loop"):
        return
    code = blank(text[start:end])
    for part in re.finditer(r"[^;]+", code):
        piece, at = part[0], start + part.start()
        declared = DECLARATION.match(piece)
        if declared is not None:
            at += declared.end()
            for declarator in split(piece[declared.end() :]):
                _, sign, value = declarator.partition("=")
                if sign:
                    yield at + len(declarator) - len(value), value
                at += len(declarator) + 1
        elif found := re.match(r"\s*return\b", piece):
            yield at + found.end(), piece[found.end() :]
        else:
            yield at, piece


def _conditional(found: Expression, around: Expression | None) -> Iterator[tuple[Expression, Expression | None]]:
    if found.word == "?":
        yield found, around
    for operand in found.operands:
        yield from _conditional(operand, found if found.kind == "group" else None)


def decide(text: str, node: Node, known: Constants) -> Iterator[Edit]:
    """Edits that leave one side of a conditional expression."""
    for start, choice, around in choices(text, node):
        value = known.truth(choice.operands[0])
        if value is not None:
            side = choice.operands[1 if value else 2]
            place = around if around is not None and side.kind in _ATOMS else choice
            yield Edit(start + place.start, start + place.end, text[start + side.start : start + side.end])
