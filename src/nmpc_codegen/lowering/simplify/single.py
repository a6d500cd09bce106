"""Loops that run once are replaced by their statements, with the value of the counter."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from nmpc_codegen.lowering.dialect.c_expressions import expression
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import blank, declarators, in_line, signature
from nmpc_codegen.lowering.dialect.tree import Edit, Node, margin

#: A loop that declares its variable and only counts.
_COUNTED = re.compile(
    r"(?:int|ptrdiff_t) (?P<variable>\w+) = (?P<first>\w+); (?P=variable) (?P<relation><=?) (?P<last>[\w +-]+); "
    r"(?:(?P=variable)\+\+|\+\+(?P=variable))"
)
_LEAVES = re.compile(r"\b(?:break|continue)\b")


def run_once(text: str, function: Node, known: Constants) -> Iterator[Edit]:
    """Yield the edits for the first loop that runs once."""
    for node in function.walk():
        found = _value(text, node, known) if node.kind == "loop" else None
        if found and _may_stand_alone(text, function, node, found[0]):
            yield Edit(node.start, node.end, _without_loop(text, node, *found))
            return


def _value(text: str, node: Node, known: Constants) -> tuple[str, str] | None:
    """Return the counter and its value in a loop that runs once."""
    match = _COUNTED.fullmatch(in_line(text[slice(*node.head)]))
    if match is None:
        return None
    first, last = (known.range(expression(match[part]), {}) for part in ("first", "last"))
    if first is None or last is None or first[0] < first[1] or last[0] < last[1]:
        return None
    once = last[0] - first[0] + (match["relation"] == "<=") == 1
    return (match["variable"], match["first"]) if once else None


def _may_stand_alone(text: str, function: Node, node: Node, variable: str) -> bool:
    """Return True if the statements of a loop may replace the loop.

    This requires that nothing leaves the loop early, its counter does not change, no directive refers to the counter,
    and none of the loop's names occurs outside.
    """
    if text[: node.start].rstrip().rpartition("\n")[2].startswith("#"):
        return False
    inside = blank(text[slice(*node.inside)])
    if _LEAVES.search(inside) or re.search(rf"\b{variable}(?:\+\+|--| [-+*/]?= )|(?:\+\+|--|&){variable}\b", inside):
        return False
    own = _names_below(text, node.body)
    others = _names_below(text, function.body, but=node, counters=True)
    return own.isdisjoint(others | set(signature(text[slice(*function.head)])[1]))


def _names_below(text: str, nodes: Sequence[Node], but: Node | None = None, counters: bool = False) -> set[str]:
    """Return the variables declared in nodes and below them, except in one node; optionally with loop counters."""
    names: set[str] = set()
    for node in nodes:
        if node is but:
            continue
        if node.kind == "statement":
            names |= {name for name, _ in declarators(text[node.start : node.end])}
        elif node.kind == "loop" and counters:
            names |= {name for name, _ in declarators(text[slice(*node.head)].partition(";")[0])}
        below = (*node.body, *(() if node.other is None else (node.other,)))
        names |= _names_below(text, below, but, counters)
    return names


def _without_loop(text: str, node: Node, variable: str, value: str) -> str:
    """Return the content of the loop, one step to the left, with the value instead of the counter."""
    start, end = node.inside
    head, _, rest = text[start:end].partition("\n")
    lines = [line.removeprefix("    ") for line in rest.rstrip().split("\n")]
    comment = [f"{margin(text, node)}{head.strip()}"] if head.strip() and "at most" not in head else []
    body = "\n".join([*comment, *lines])
    body = re.sub(rf"(?<![.\w])(?<!->)\b{variable}\b", value, body)
    return body.removeprefix(margin(text, node))
