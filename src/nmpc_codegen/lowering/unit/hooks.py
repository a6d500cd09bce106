"""The call of a hook in an algorithm becomes one call for every hooked part that defines the hook."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache

from nmpc_codegen.components.base import HOOKS
from nmpc_codegen.lowering.dialect.scopes import head_of
from nmpc_codegen.lowering.dialect.tree import Edit, edit, margin, parse
from nmpc_codegen.lowering.unit.item import Item, calls
from nmpc_codegen.lowering.unit.read import items_of, read_part

_CALL = re.compile(rf"(?P<before>(?:\w+ = )?)(?P<hook>{'|'.join(HOOKS)})(?P<arguments>\(.*\);)", re.DOTALL)
_NAMES = frozenset(HOOKS)


@cache
def _hooks(part: str) -> Mapping[str, Item]:
    """Return {hook: its function} for the hooks that a hooked part defines."""
    name = part.rpartition("/")[2].removesuffix(".c")
    functions = [item for item in items_of(read_part(part)) if item.kind == "function"]
    found = {}
    for item in functions:
        word = item.name.removeprefix(f"{name}_")
        if word in HOOKS and word != item.name:
            found[word] = item
        elif word != item.name and not any(item.name in other.calls for other in functions if other is not item):
            raise ValueError(f"{part}: {item.name}(): expected a hook, {', '.join(HOOKS)}, or a function that it calls")
    return found


def check_hooks(algorithm: str, hooked_parts: Sequence[str]) -> None:
    """Raise ValueError if a hooked part defines a hook that the text of the algorithm does not call."""
    stated = calls(algorithm) & _NAMES
    for part in hooked_parts:
        if missing := sorted(_hooks(part).keys() - stated):
            has = f"it has {', '.join(sorted(stated))}"
            raise ValueError(f"{part} defines {', '.join(missing)}, which the algorithm does not state; {has}")


def hook_prototypes(hooked_parts: Iterable[str]) -> str:
    """Return declarations of the functions that hooked parts define for hooks."""
    heads = [f"{head_of(hook.text)};" for part in hooked_parts for hook in _hooks(part).values()]
    return "\n".join(["/* Functions that the algorithm calls at its hooks. */", *heads]) if heads else ""


def call_hooks(item: Item, hooked_parts: tuple[str, ...]) -> Item:
    """Return the item with the calls of hooks written out."""
    if _NAMES.isdisjoint(item.calls):
        return item
    return replace(item, text=_with_hooks(item.text, hooked_parts))


@lru_cache(maxsize=1024)
def _with_hooks(text: str, hooked_parts: tuple[str, ...]) -> str:
    named = {part.rpartition("/")[2].removesuffix(".c"): _hooks(part) for part in hooked_parts}
    edits = []
    for node in (n for top in parse(text) for n in top.walk() if n.kind == "statement"):
        call = _CALL.fullmatch(text, node.start, node.end)
        if call is None:
            continue
        names = [f"{name}_{call['hook']}" for name, hooks in named.items() if call["hook"] in hooks]
        before = margin(text, node)
        lines = [f"{before}{call['before']}{name}{call['arguments']}\n" for name in names]
        edits.append(Edit(node.start - len(before), node.end + 1, "".join(lines)))
    done = edit(text, edits)
    if left := sorted(calls(done) & _NAMES):
        raise ValueError(f"{left[0]}(): expected the call of a hook as a statement, its result assigned or not used")
    return done
