"""`#if` over sizes and features is resolved to the branch that a package has."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache

from nmpc_codegen.lowering.dialect.c_expressions import Expression, expression, words
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import blank
from nmpc_codegen.lowering.dialect.tree import Edit, Node, edit, parse


def resolve(text: str, sizes: Mapping[str, int] | None) -> str:
    """Return the text with the branches of `#if` that hold; with None, they are left to the compiler.

    Raises:
        ValueError: the text is not of the dialect; a condition is no integer expression, or a name in it has no value.
    """
    if sizes is None:
        return text
    return _resolve(text, frozenset((name, sizes[name]) for name in _names(text) if name in sizes))


@lru_cache(maxsize=2048)
def _names(text: str) -> frozenset[str]:
    """Return the names in conditions."""
    nodes = (node for top in parse(text) for node in top.walk() if node.kind == "branch")
    return frozenset().union(*(words(text[slice(*node.head)]) for node in nodes))


@lru_cache(maxsize=4096)
def _resolve(text: str, known: frozenset[tuple[str, int]]) -> str:
    sizes = dict(known)
    while edits := [Edit(node.start, node.end + 1, _take(text, node, sizes)) for node in _outermost(parse(text))]:
        text = edit(text, edits)
    return text


def _outermost(nodes: Iterable[Node]) -> Iterable[Node]:
    """Yield the conditionals that are inside no other one."""
    for node in nodes:
        if node.kind == "conditional":
            yield node
        else:
            yield from _outermost(node.body if node.other is None else (*node.body, node.other))


def _take(text: str, conditional: Node, sizes: Mapping[str, int]) -> str:
    """Return the text of the first branch that holds, "" if none does."""
    for branch in conditional.body:
        start, end = branch.head
        try:
            if text.startswith("#else", branch.start) or evaluate(text[start:end], sizes):
                return text[slice(*branch.inside)]
        except ValueError as error:
            raise ValueError(f"line {text.count(chr(10), 0, start) + 1}, {error}") from error
    return ""


def evaluate(condition: str, sizes: Mapping[str, int]) -> bool:
    """Evaluate an integer expression of C with the operators + - * == != < <= > >= ! && || and parentheses.

    Raises:
        ValueError: the text is no such expression, or a name has no value.
    """
    try:
        found = expression(blank(condition))
    except ValueError as error:
        raise ValueError(f"#if {condition}: {error}") from error
    if unknown := sorted(name for name in _operands(found) if name not in sizes):
        raise ValueError(f"#if {condition}: {unknown[0]} has no value in this package")
    values = Constants(sizes).range(found, {})
    if values is None:
        raise ValueError(f"#if {condition}: expected an integer expression")
    return values[0] != 0


def _operands(found: Expression) -> Iterable[str]:
    if found.kind == "name":
        yield found.word
    for operand in found.operands:
        yield from _operands(operand)
