"""What the interface of a unit reaches: functions, simplified, and names, through macros, enumerations and kernels."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from nmpc_codegen.lowering.pruning.constants import Constants
from nmpc_codegen.lowering.pruning.items import Item, constants_in
from nmpc_codegen.lowering.pruning.passes import simplify, simplify_again
from nmpc_codegen.lowering.pruning.scopes import free_names, names_in_code

# (name, arguments or None, text)
Definition = tuple[str, str | None, str]

_ASSIGNS = re.compile(r"\+\+|--|(?<![=!<>])=(?!=)")
#: A call of a function.
CALLED = re.compile(r"\b[a-z]\w*(?=\()")


def calling(known: Iterable[Definition]) -> frozenset[str]:
    """Macros that call functions or assign, themselves or through others."""
    texts = {name: text for name, arguments, text in known if arguments}
    found = {name for name, text in texts.items() if CALLED.search(text) or _ASSIGNS.search(text)}
    while more := {name for name, text in texts.items() if not found.isdisjoint(names_in_code(text))} - found:
        found |= more
    return frozenset(found)


class Macros:
    """The macros of a unit: what their names stand for."""

    def __init__(self, known: Iterable[Definition]) -> None:
        self.texts = {name: text for name, _, text in known}

    def expand(self, names: Iterable[str]) -> set[str]:
        """Return the names, and all names in the texts of the macros among them."""
        found: set[str] = set()
        waiting = set(names)
        while waiting:
            found |= waiting
            inside = (names_in_code(self.texts[name]) for name in waiting if name in self.texts)
            waiting = set().union(*inside) - found
        return found


def reach(
    found: Sequence[Item], kernels: Mapping[str, str], macros: Macros, constants: Constants
) -> tuple[dict[str, str], set[str]]:
    """Simplified texts of the functions that the interface, and what is no function, reach; all names on the way."""
    functions: dict[str, Item] = {}
    for item in found:
        if item.kind == "function" and functions.setdefault(item.name, item).text != item.text:
            raise ValueError(f"{item.name}(): there are two functions with this name")
    waiting = {item.name for item in found if item.kind == "function" and not item.inner}
    for item in found:
        if item.kind == "other":
            waiting |= macros.expand(names_in_code(item.text))
    enumerations = [names_in_code(constants_in(item)) for item in found if item.kind == "enumeration"]
    texts: dict[str, str] = {}
    mentioned: set[str] = set()
    while waiting:
        mentioned |= waiting
        inside: set[str] = set()
        for name in waiting:
            if name in functions:
                texts[name] = _simplify(functions[name], constants)
                inside |= free_names(texts[name])
            elif name in kernels:
                inside.update(CALLED.findall(kernels[name]))
        inside = inside.union(*(names for names in enumerations if not names.isdisjoint(waiting)))
        waiting = macros.expand(inside) - mentioned
    return texts, mentioned


def _simplify(function: Item, constants: Constants) -> str:
    if function.done:
        return function.text
    try:
        return (simplify_again if function.simple else simplify)(function.text, constants)
    except ValueError as error:
        raise ValueError(f"{function.name}(): {error}") from error
