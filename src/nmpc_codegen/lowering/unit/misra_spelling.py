"""The last passes write spellings that MISRA C:2012 requires and that parts need not have.

conditions  a condition compares: `if (flag)` becomes `if (flag != 0)` (rule 14.4) results     an unused result is cast
to void (17.7) constants   constants without a type are macros: an enumeration without a name declares an unused type
(2.4)
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from nmpc_codegen.lowering.dialect.c_expressions import expression
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import function_of, head_of, in_line, split
from nmpc_codegen.lowering.dialect.tree import Edit, Node, edit, margin, wrap_line
from nmpc_codegen.lowering.unit.item import Item

#: Kinds of expressions that are numbers.
_NUMBERS = ("name", "member", "call", "index")
_ENUMERATION = re.compile(r"enum \{(?P<inside>[^{}]*)\};", re.DOTALL)
_CALL = re.compile(r"((?:API\()?\w+\)?)\(")
_SIMPLE = re.compile(r"-?\w+")


def state_conditions(items: Sequence[Item], _: Constants) -> tuple[Item, ...]:
    """Return functions whose conditions are comparisons."""
    return tuple(item.with_text(_compare(item.text)) if item.is_prunable else item for item in items)


def _compare(text: str) -> str:
    edits = [e for node in function_of(text).walk() if node.kind in ("if", "loop") for e in _condition(text, node)]
    return edit(text, edits)


def _condition(text: str, node: Node) -> Iterator[Edit]:
    """Yield the edit of the head of an if or a while."""
    head = in_line(text[slice(*node.head)])
    if ";" in head or '"' in head or expression(head).kind not in _NUMBERS:
        return
    opening = f"{margin(text, node)}{text[node.start : node.head[0]]}{head} != 0) {{"
    blanks = len(margin(text, node))
    yield Edit(node.start, node.inside[0], "\n".join(wrap_line(opening))[blanks:])


def cast_results(items: Sequence[Item], _: Constants) -> tuple[Item, ...]:
    """Return functions with casts before calls whose results are unused."""
    heads = {item.name: head_of(item.text).split("(")[0].split() for item in items if item.kind == "function"}
    valued = {name for name, words in heads.items() if "void" not in words}
    return tuple(item.with_text(_cast(item.text, valued)) if item.is_prunable else item for item in items)


def _cast(text: str, valued: Collection[str]) -> str:
    statements = (node for node in function_of(text).walk() if node.kind == "statement")
    calls = ((node, _CALL.match(text, node.start)) for node in statements)
    cast = (n for n, call in calls if call and call[1] in valued and _is_call(in_line(text[n.start : n.end])))
    return edit(text, [Edit(node.start, node.start, "(void)") for node in cast])


def _is_call(statement: str) -> bool:
    return expression(statement.removesuffix(";")).kind == "call"


def name_constants(items: Sequence[Item], _: Constants) -> tuple[Item, ...]:
    """Return macros instead of enumerations without a name."""
    return tuple(replace(i, kind="directive", text=_macros(i.text)) if i.kind == "enum" else i for i in items)


def _macros(text: str) -> str:
    found = _ENUMERATION.search(text)
    assert found is not None
    lines, before, following = [], "", 0
    for part in split(re.sub(r"/\*.*?\*/", "", found["inside"], flags=re.DOTALL)):
        name, _, value = (word.strip() for word in part.partition("="))
        if not name:
            continue
        if value:
            before, following = value if _SIMPLE.fullmatch(value) else f"({value})", 0
        counted = f"({before} + {following})" if before and following else before or str(following)
        if re.fullmatch(r"-?\d+", before):
            counted = str(int(before) + following)
        lines.append(f"#define {name} {f'({counted})' if counted.startswith('-') else counted}")
        following += 1
    behind = text[found.end() :].strip()
    if behind:
        lines[0] += f" {behind}"
    return text[: found.start()] + "\n".join(lines)
