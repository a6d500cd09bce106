"""The passes of the pipeline remove from a unit everything that its package does not need.

A part is written for every problem, with all its rows, bounds and components. Rounds of passes follow each other while
they change the unit; the last passes bring the result into order. After every pass, a verifier checks that all names
that are read are still defined.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import reduce
from itertools import pairwise

from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import function_of
from nmpc_codegen.lowering.unit.contracts import without_entries
from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.misra_spelling import cast_results, name_constants, state_conditions
from nmpc_codegen.lowering.unit.reach import keep_reached, reach, roots, simplify_item
from nmpc_codegen.lowering.unit.uniform_tables import fold_tables
from nmpc_codegen.lowering.unit.unread_arguments import (
    drop_arguments_of_macros,
    drop_parameters,
    functions_without_effect,
    macros_that_act,
    pure_functions,
    put_in_calls,
    put_in_numbers,
    unread_parameters,
)

#: The last part of a unit holds the functions that only this entry point calls, under this heading.
LAST = "API(solve)"
LAST_HEADING = "/* ==== solve(): what only it calls " + "=" * 68 + " */"
#: A constant in a sum, after its first term.
_TERM = re.compile(r"(?<=[\w)]) [-+] ([A-Z]\w*)\b(?! *[*/%\[(.])")

Items = Sequence[Item]
Pass = Callable[[Items, Constants], tuple[Item, ...]]


def drop_zeros(items: Items, known: Constants) -> tuple[Item, ...]:
    """Remove sizes that are 0 from sums."""

    def term(found: re.Match[str]) -> str:
        return "" if known.sizes.get(found[1]) == 0 else found[0]

    return tuple(item if item.state == "ready" else item.with_text(_TERM.sub(term, item.text)) for item in items)


def drop_idle_calls(items: Items, known: Constants) -> tuple[Item, ...]:
    """Remove calls of functions that do nothing."""
    idle = functions_without_effect(items)
    more = replace(known, kernels=known.kernels | idle)
    return tuple(item if idle.isdisjoint(item.calls) else simplify_item(item, more) for item in items)


def drop_entries(items: Items, _: Constants) -> tuple[Item, ...]:
    """Remove the entries of functions that do not exist from contracts."""
    there = {"API", *(item.name for item in items if item.kind == "function")}
    return tuple(i.with_text(without_entries(i.text, there)) if "ontract" in i.text else i for i in items)


def put_last(items: Items, _: Constants) -> tuple[Item, ...]:
    """Move items that only the last entry point reaches to the end, under copies of their section headings."""
    early = reach(items, [n for n in roots(items) if items[n].name != LAST])
    sections: list[list[int]] = [[]]
    for n, item in enumerate(items):
        if item.kind == "section":
            sections.append([])
        sections[-1].append(n)
    first: list[Item] = []
    last: list[Item] = []
    for section in sections:
        late = _late(items, section, early.keys())
        for target, of in ((first, False), (last, True)):
            chosen = [n for n, is_late in late.items() if is_late is of or items[n].kind == "section"]
            if any(items[n].kind != "section" for n in chosen):
                target += (items[n] for n in chosen)
    return (*first, *([Item("", "section", LAST_HEADING), *last] if last else []))


def _late(items: Items, section: Sequence[int], early: Collection[int]) -> dict[int, bool]:
    """Return which items of a section only the last entry point reaches.

    A separate comment goes with the functions below it.
    """
    late: dict[int, bool] = {}
    below, some = True, False  # all functions below, up to the next comment, are late
    for n in reversed(section):
        kind = items[n].kind
        if kind == "heading":
            late[n] = some and below
            below, some = True, False
        elif kind in ("function", "prototype"):
            late[n] = n not in early
            below, some = below and late[n], True
        else:
            late[n] = kind == "enum" and n not in early
    return dict(sorted(late.items()))


def mark_unread(items: Items, _: Constants) -> tuple[Item, ...]:
    """Add a statement to functions of the interface for every parameter that they do not read."""
    return tuple(item.with_text(_mark(item.text)) if item.is_prunable else item for item in items)


def _mark(text: str) -> str:
    at, _ = function_of(text).inside
    return text[:at] + "".join(f"\n    (void){name};" for _, name in unread_parameters(text)) + text[at:]


#: Passes that run in rounds, until a round changes nothing.
REPEATED: tuple[Pass, ...] = (
    drop_arguments_of_macros,
    keep_reached,
    fold_tables,
    drop_idle_calls,
    drop_parameters,
    put_in_numbers,
    put_in_calls,
)
#: Passes that run once, after the rounds.
LAST_PASSES: tuple[Pass, ...] = (drop_entries, put_last, mark_unread, state_conditions, cast_results, name_constants)


def run(
    items: Items, known: Constants, watch: Callable[[str, Items, Items], None] = lambda step, before, after: None
) -> tuple[Item, ...]:
    """Return the unit after the pipeline; ``watch`` is called after every pass that has changed it.

    Raises:
        ValueError: a function does not belong to the dialect, two functions have one name, or a pass has removed the
            definition of a name in use.
    """
    _check_names(items)
    known = replace(known, calling=macros_that_act(items), pure=pure_functions(items))

    def take(unit: tuple[Item, ...], step: Pass) -> tuple[Item, ...]:
        after = step(unit, known)
        if after != unit:
            watch(step.__name__, unit, after)
            verify(step.__name__, after, items)
        return after

    unit = take(tuple(items), drop_zeros)
    while (after := reduce(take, REPEATED, unit)) != unit:
        unit = after
    return reduce(take, LAST_PASSES, unit)


def verify(step: str, unit: Items, first: Items) -> None:
    """Raise ValueError if an item reads a name that was defined at first and is no longer defined."""
    lost = all_names(first) - all_names(unit)
    for item in unit if lost else ():
        if missing := sorted(lost & item.reads):
            raise ValueError(f"{step} has left {missing[0]}, which {item.name} reads, without its definition")


def all_names(items: Items) -> frozenset[str]:
    """Return all names that the items define."""
    return frozenset[str]().union(*(item.defines for item in items))


def _check_names(items: Items) -> None:
    """Raise ValueError if two functions have the same name."""
    names = sorted(item.name for item in items if item.kind == "function")
    if twice := [name for name, following in pairwise(names) if name == following]:
        raise ValueError(f"{twice[0]}(): there are two functions with this name")
