"""Only items that the interface of a unit reaches are kept; each function is simplified when it is reached."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace

from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import check_names
from nmpc_codegen.lowering.simplify.functions import simplify
from nmpc_codegen.lowering.unit.item import Item


def reach(
    items: Sequence[Item], waiting: Iterable[int], visit: Callable[[Item], Item] = lambda item: item
) -> dict[int, Item]:
    """Return {place: item} for all items that are reached from ``waiting``.

    ``visit`` may change an item before its names are followed.
    """
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
    """Return the places of the functions of the interface, and of directives that define no name."""
    return [n for n, item in enumerate(items) if item.is_entry or (item.kind == "directive" and not item.defines)]


def keep_reached(items: Sequence[Item], known: Constants) -> tuple[Item, ...]:
    """Return the items that the interface reaches, and the headings above them."""
    found = reach(items, roots(items), lambda item: item if item.state == "simple" else simplify_item(item, known))
    idle = _idle_headings(items, found.keys())
    return tuple(
        found.get(n, item)
        for n, item in enumerate(items)
        if n in found or (item.kind in ("section", "heading") and n not in idle)
    )


def simplify_item(item: Item, known: Constants) -> Item:
    """Return a function without the code that the package does not need; any other item unchanged."""
    if not item.is_prunable:
        return item
    try:
        if item.state == "raw":
            check_names(item.text, known.ranges.keys() | known.sizes.keys())
        return replace(item, text=simplify(item.text, known), state="simple")
    except ValueError as error:
        raise ValueError(f"{item.name}(): {error}") from error


def _idle_headings(items: Sequence[Item], kept: Collection[int]) -> set[int]:
    """Return the places of separate comments above items of which none is kept."""
    idle = set[int]()
    above, below = None, False
    for n, item in enumerate(items):
        if item.kind in ("heading", "section"):
            above, below = n if item.kind == "heading" else None, False
        elif above is not None:
            below = below or n in kept
            (idle.discard if below else idle.add)(above)
    return idle
