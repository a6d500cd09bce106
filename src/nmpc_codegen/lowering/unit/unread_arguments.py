"""Unused arguments are removed from a macro or a function, and from every call of it.

A function that only returns a number is replaced by that number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import accumulate

from nmpc_codegen.lowering.dialect.c_expressions import expression, words
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import (
    blank,
    function_of,
    in_line,
    names_in_code,
    readable,
    signature,
    split,
)
from nmpc_codegen.lowering.dialect.tree import WIDTH, wrap_line
from nmpc_codegen.lowering.simplify.idle import without_idle
from nmpc_codegen.lowering.unit.item import Item

#: Macro or function -> places of arguments.
Places = Mapping[str, Sequence[int]]

_CALL = re.compile(r"(?<![.\w])(?<!->)([A-Za-z_]\w*)\(")
_VALUE = re.compile(r"(?<![.\w])(?<!->)[A-Za-z_]\w*+(?!\()")
#: A number, a constant, or a number in the working precision.
_NUMBER = re.compile(r"return (\d+|[A-Z]\w*|R\([\d.]+\));")
_STATEMENT = re.compile(r"^ *(?:\(void\))?(\w+)\(", re.MULTILINE)


def drop_arguments_of_macros(items: Sequence[Item], known: Constants) -> tuple[Item, ...]:
    """Remove the arguments of macros that their texts do not name."""
    found: dict[str, tuple[int, ...]] = {}
    for item in items:
        each = item.arguments.split(", ") if item.kind == "macro" and item.arguments else []
        if unread := tuple(i for i, argument in enumerate(each) if argument not in names_in_code(item.text)):
            found[item.name] = unread
    return _without(items, found, known) if found else tuple(items)


def drop_parameters(items: Sequence[Item], known: Constants) -> tuple[Item, ...]:
    """Remove unused parameters from functions of this unit, unless the argument of a call has effects."""
    found = {item.name: tuple(place for place, _ in unread_parameters(item.text)) for item in _free(items)}
    found = {name: places for name, places in found.items() if places}
    for text in _bodies(items):
        for name, start in () if names_in_code(text).isdisjoint(found) else calls(found, text):
            given = split(text[start : closing(text, start)])
            acts = {i for i in found[name] if known.effects(expression(given[i]))}
            found[name] = tuple(place for place in found[name] if place not in acts)
    found = {name: places for name, places in found.items() if places}
    return _without(items, found, known) if found else tuple(items)


def put_in_numbers(items: Sequence[Item], _: Constants) -> tuple[Item, ...]:
    """Replace calls of functions that only return a number by that number, unless the call is a statement."""
    given = {item.name: number for item in _free(items) if (number := _number(item.text))}
    for body in _bodies(items) if given else ():
        for statement in _STATEMENT.finditer(body):
            given.pop(statement[1], None)
    if not given:
        return tuple(items)
    return _change([item for item in items if item.name not in given], partial(_with_numbers, given=given))


def put_in_calls(items: Sequence[Item], _: Constants) -> tuple[Item, ...]:
    """Replace macros that are only the call of a function by that call."""
    given = _synonyms(items)
    longer = [item for item in items if item.kind != "macro" or item.name not in given]
    return _change(longer, partial(_with_calls, given=given))


def macros_that_act(items: Iterable[Item]) -> frozenset[str]:
    """Return the macros that call functions or assign, directly or through others."""
    texts = {item.name: item.text for item in items if item.kind == "macro" and item.arguments}
    texts |= {name: text for i in items if i.kind == "directive" for name, text in _DEFINITION.findall(blank(i.text))}
    found = {name for name, text in texts.items() if _CALLED.search(text) or _ASSIGNS.search(text)}
    while more := {name for name, text in texts.items() if not found.isdisjoint(names_in_code(text))} - found:
        found |= more
    return frozenset(found)


_ASSIGNS = re.compile(r"\+\+|--|(?<![=!<>])=(?!=)")
_CALLED = re.compile(r"\b[a-z]\w*(?=\()")
_DEFINITION = re.compile(r"^#define (\w+)\([^)]*\)((?:[^\\\n]|\\.)*)", re.MULTILINE | re.DOTALL)
_POINTER = re.compile(r"[*\[]")


def pure_functions(items: Iterable[Item]) -> frozenset[str]:
    """Return the non-void functions whose pointer parameters all point to constants.

    They have no side effects, as generated code has no global variables.
    """
    return frozenset(item.name for item in items if item.is_prunable and _is_pure(item.text))


def functions_without_effect(items: Sequence[Item]) -> frozenset[str]:
    """Return the functions of this unit that do nothing."""
    return frozenset(item.name for item in _free(items) if _is_empty(item.text))


def _free(items: Sequence[Item]) -> list[Item]:
    """Return the functions that may be changed, because only functions of parts call them."""
    fixed = {name for item in items if item.state == "ready" for name in item.calls}
    fixed |= {name for item in items if item.kind in ("table", "directive", "type") for name in item.reads}
    fixed = fixed.union(*(_uncalled_names(item.text) for item in items))
    functions = (item for item in items if item.is_prunable)
    return [item for item in functions if item.name not in fixed and not item.is_entry]


@lru_cache(maxsize=16384)
def _uncalled_names(text: str) -> frozenset[str]:
    """Return the names that a text uses without a call; a function among them is used as a pointer."""
    return frozenset(_VALUE.findall(blank(text)))


def _bodies(items: Sequence[Item]) -> list[str]:
    """Return the code in functions of parts and in macros."""
    found = [_body(item.text) for item in items if item.is_prunable]
    return found + [item.text for item in items if item.kind == "macro"]


def _without(items: Sequence[Item], places: Places, known: Constants) -> tuple[Item, ...]:
    """Return items without these arguments of macros and functions."""
    heads: dict[str, str | None] = {}
    for item in items:
        if item.kind == "macro" and item.name in places and item.arguments:
            kept = [a for i, a in enumerate(item.arguments.split(", ")) if i not in places[item.name]]
            heads[item.name] = ", ".join(kept) if kept or item.name in known.calling else None
    bare = {name for name, arguments in heads.items() if arguments is None}
    changed = _change(items, partial(without, places=places, bare=bare))
    return tuple(
        replace(item, arguments=heads[item.name])
        if item.kind == "macro" and item.name in heads
        else replace(item, text=with_void(item.text, item.name))
        if item.name in places
        else item
        for item in changed
    )


def _change(items: Iterable[Item], change: Callable[[str], str]) -> tuple[Item, ...]:
    """Return items with changed texts."""
    return tuple(item if item.state == "ready" else item.with_text(change(item.text)) for item in items)


def _with_numbers(text: str, given: Mapping[str, str]) -> str:
    """Return a text with numbers instead of calls of the functions that return them.

    Factors 1 and terms 0 are removed.
    """
    return without_idle(replace_calls(text, given, lambda name, _: given[name]))


def _with_calls(text: str, given: Mapping[str, str]) -> str:
    """Return a text with these functions instead of the macros that stand for them."""
    return replace_calls(text, given, lambda name, arguments: given[name].format(", ".join(arguments)))


def _synonyms(items: Iterable[Item]) -> dict[str, str]:
    """Return {macro: call that it stands for}, with {} for its arguments, for macros whose text is only a call."""
    macros = [item for item in items if item.kind == "macro"]
    found = {item.name: item.text for item in macros if item.arguments == ""}
    for item in macros:
        function, _, rest = item.text.partition("(")
        if item.arguments and rest == f"{item.arguments})":
            found[item.name] = f"{function}({{}})"
    return found


def calls(names: Collection[str], code: str) -> Iterator[tuple[str, int]]:
    """Yield (name, place after the opening bracket) of every call of these names, the last call first."""
    for found in reversed(list(_CALL.finditer(code))):
        if found[1] in names:
            yield found[1], found.end()


def closing(code: str, start: int) -> int:
    """Return the place of the bracket that closes the one opened just before ``start``."""
    depths = accumulate(((c == "(") - (c == ")") for c in code[start:]), initial=1)
    return start + next(place for place, depth in enumerate(depths) if depth == 0) - 1


def replace_calls(text: str, names: Collection[str], call: Callable[[str, list[str]], str]) -> str:
    """Replace every call of these names by the text that ``call`` returns for name and arguments."""
    if words(text).isdisjoint(names):
        return text
    before = set(text.split("\n"))
    for name, start in calls(names, readable(text)):
        end = closing(readable(text), start)
        given = [" ".join(argument.split()) for argument in split(text[start:end])]
        text = text[: start - len(name) - 1] + call(name, given) + text[end + 1 :]
    lines = ([line] if len(line) <= WIDTH or line in before else wrap_line(line) for line in text.split("\n"))
    return "\n".join(part for parts in lines for part in parts)


def without(text: str, places: Places, bare: Collection[str] = ()) -> str:
    """Remove the arguments at these places from calls; macros in ``bare`` become names without arguments."""

    def call(name: str, given: list[str]) -> str:
        kept = ", ".join(argument for i, argument in enumerate(given) if i not in places[name])
        return name if name in bare else f"{name}({kept})"

    return replace_calls(text, places.keys(), call)


def with_void(text: str, name: str) -> str:
    """Return a function, or its prototype, without parameters as name(void)."""
    at = blank(text).find(f"{name}()")
    return text if at < 0 else f"{text[: at + len(name)]}(void){text[at + len(name) + 2 :]}"


@lru_cache(maxsize=16384)
def unread_parameters(text: str) -> tuple[tuple[int, str], ...]:
    """Return place and name of the parameters that the body of a function does not read."""
    function = function_of(text)
    _, parameters = signature(text[slice(*function.head)])
    read = names_in_code(text[slice(*function.inside)])
    return tuple((place, name) for place, name in enumerate(parameters) if name not in read)


@lru_cache(maxsize=16384)
def _number(text: str) -> str:
    function = function_of(text)
    if signature(text[slice(*function.head)])[1]:
        return ""
    found = _NUMBER.fullmatch(in_line(text[slice(*function.inside)]))
    return found[1] if found else ""


@lru_cache(maxsize=16384)
def _is_pure(text: str) -> bool:
    """Return True for a non-void function whose pointer parameters all point to constants."""
    before, _, after = in_line(blank(text).partition("\n{\n")[0]).partition("(")
    parameters = split(after.rpartition(")")[0])
    return " void " not in before and all(not _POINTER.search(p) or p.strip().startswith("const ") for p in parameters)


@lru_cache(maxsize=16384)
def _is_empty(text: str) -> bool:
    return all(node.kind == "comment" for node in function_of(text).body)


@lru_cache(maxsize=16384)
def _body(text: str) -> str:
    """Return the code in the braces of a function."""
    return blank(text[slice(*function_of(text).inside)])
