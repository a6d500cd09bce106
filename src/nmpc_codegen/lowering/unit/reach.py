"""What the interface of a unit reaches, each function simplified when it is reached; the rest goes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import check_names
from nmpc_codegen.lowering.unit.functions import simplify
from nmpc_codegen.lowering.unit.item import Item


def reach(
    items: Sequence[Item], waiting: Iterable[int], visit: Callable[[Item], Item] = lambda item: item
) -> dict[int, Item]:
    """Place -> item, as ``visit`` makes it, of all that the items at these places read, and what those read in turn."""
    places = defaultdict(list)
    for place, item in enumerate(items):
        for name in item.defines:
            places[name].append(place)
    found: dict[int, Item] = {}
    left = list(waiting)
    while left:
        place = left.pop()
        if place not in found:
            found[place] = visit(items[place])
            left += (other for name in found[place].reads for other in places.get(name, ()))
    return found


def roots(items: Sequence[Item]) -> list[int]:
    """The places of the functions of the interface, and of what has no name to reach it by."""
    return [n for n, item in enumerate(items) if item.is_entry or (item.kind == "directive" and not item.defines)]


def keep_reached(items: Sequence[Item], known: Constants) -> tuple[Item, ...]:
    """The items that the interface reaches, and the headings above them."""
    found = reach(items, roots(items), lambda item: item if item.state == "simple" else simplified(item, known))
    idle = _idle_headings(items, found.keys())
    return tuple(
        found.get(n, item)
        for n, item in enumerate(items)
        if n in found or (item.kind in ("section", "heading") and n not in idle)
    )


def simplified(item: Item, known: Constants) -> Item:
    """A function without what the package does not need; any other item as it is."""
    if not item.is_prunable:
        return item
    try:
        if item.state == "raw":
            check_names(item.text, known.ranges.keys() | known.sizes.keys())
        return replace(item, text=simplify(item.text, known), state="simple")
    except ValueError as error:
        raise ValueError(f"{item.name}(): {error}") from error


def _idle_headings(items: Sequence[Item], kept: Iterable[int]) -> set[int]:
    """The places of comments that stand alone above items of which none is kept."""
    there, idle = set(kept), set[int]()
    above, below = None, False
    for n, item in enumerate(items):
        if item.kind == "heading":
            above, below = n, False
        elif item.kind not in ("prototype", "enum") and above is not None:
            below = below or n in there or item.kind == "section"
            (idle.discard if below else idle.add)(above)
    return idle
