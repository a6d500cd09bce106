"""Tables whose entries are all equal are removed: an integer replaces its reads, any other number becomes a scalar."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import blank, names_in_code
from nmpc_codegen.lowering.unit.item import Item

_TABLE = re.compile(r"static const (?P<type>real_t|int) (?P<name>\w+)\[\d+\] = \{(?P<values>[^{}]*)\};")
#: The use of a name, and whether its address is taken.
_USE = r"(?P<address>(?<![&\w)\]] )(?<!&)&)?(?<![.\w])(?<!->)\b{name}\b(?P<index>\[)?"
#: Tables of numbers that kernels read through the address of an entry.
_READ_ONE = frozenset({"interval_length"})
_ZERO_LITERAL = re.compile(r"0\.0F?")


@dataclass(frozen=True)
class Same:
    """All entries of a table are ``value``."""

    name: str
    value: str
    is_real: bool

    @property
    def text(self) -> str:
        """Return the text that replaces an entry."""
        if not self.is_real:
            return self.value
        return "R(0)" if self.is_zero else self.name

    @property
    def is_zero(self) -> bool:
        return self.is_real and _ZERO_LITERAL.fullmatch(self.value) is not None

    @property
    def scalar(self) -> str:
        """Return the definition of a scalar that replaces the entries."""
        return f"static const real_t {self.name} = {self.value};"


def fold_tables(items: Sequence[Item], known: Constants) -> tuple[Item, ...]:
    """Remove tables whose entries are all equal."""
    found = {same.name: same for item in items if item.kind == "table" and (same := _same(item.text))}
    texts = [blank(i.text) for i in items if i.kind in ("function", "macro", "directive")]
    found = {name: same for name, same in found.items() if all(_may_fold(text, same) for text in texts)}
    if not found:
        return tuple(items)
    return tuple(folded for item in items if (folded := _fold(item, found)) is not None)


def _same(text: str) -> Same | None:
    """Return the table if its entries are all equal, else None."""
    match = _TABLE.search(text)
    values = {value.strip() for value in match["values"].split(",")} if match else set()
    if match is None or len(values) != 1:
        return None
    return Same(match["name"], values.pop(), match["type"] == "real_t")


def _may_fold(text: str, same: Same) -> bool:
    """Return True if a text only reads entries."""
    if same.name not in names_in_code(text):
        return True
    pattern = re.compile(_USE.format(name=same.name))
    uses = list(pattern.finditer(text))
    if not all(m["index"] and (not m["address"] or _may_point(same)) for m in uses):
        return False
    return same.is_real or all(_is_place(text[m.start() - 2 : m.start()], text[_end(text, m.end())]) for m in uses)


def _is_place(before: str, behind: str) -> bool:
    """Return True for an index or an argument; in conditions, the number of a flag would decide them."""
    return (before.endswith("[") and behind == "]") or (before == ", " and behind in ",)")


def _end(text: str, at: int) -> int:
    """Return the place after the bracket that closes the one open before a place."""
    depth = 1
    while depth:
        depth += {"[": 1, "]": -1}.get(text[at], 0)
        at += 1
    return at


def _may_point(same: Same) -> bool:
    return same.name in _READ_ONE and not same.is_zero


def _fold(item: Item, found: Mapping[str, Same]) -> Item | None:
    """Return the item with the entries of these tables replaced; None for a table that is no longer read."""
    if item.kind == "table" and item.name in found:
        same = found[item.name]
        return item.with_text(_TABLE.sub(same.scalar, item.text)) if same.text == same.name else None
    if item.kind not in ("function", "macro") or names_in_code(item.text).isdisjoint(found):
        return item
    text = item.text
    for name, same in found.items():
        text = _put(text, name, same)
    return item.with_text(text)


def _put(text: str, name: str, same: Same) -> str:
    """Return the text with the entry instead of its reads."""
    pattern = re.compile(rf"(?<![.\w])(?<!->)\b{name}\[")
    while match := pattern.search(blank(text)):
        text = text[: match.start()] + same.text + text[_end(text, match.end()) :]
    return text
