"""Arguments that nothing reads leave: the macro or the function, and every call of it, stands without them.

A function that only gives a number is that number where it is called.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import accumulate

from nmpc_codegen.lowering.pruning.constants import Constants
from nmpc_codegen.lowering.pruning.expressions import expression, words
from nmpc_codegen.lowering.pruning.items import Item
from nmpc_codegen.lowering.pruning.reach import CALLED, Definition, Macros, calling, reach
from nmpc_codegen.lowering.pruning.scopes import (
    blank,
    function_of,
    in_line,
    names_in_code,
    readable,
    signature,
    split,
)
from nmpc_codegen.lowering.pruning.tree import WIDTH, wrap_line

#: Macro or function -> the places of arguments.
Places = Mapping[str, Sequence[int]]

_CALL = re.compile(r"(?<![.\w])(?<!->)([A-Za-z_]\w*)\(")
#: A number, a constant, or a number in the working precision.
_NUMBER = re.compile(r"return (\d+|[A-Z]\w*|R\([\d.]+\));")
_FACTOR = re.compile(r" \* R\(1\)(?=[;,)])")
_STATEMENT = re.compile(r"^ *(?:\(void\))?(\w+)\(", re.MULTILINE)


def without_unread(
    found: list[Item], kernels: Mapping[str, str], known: Sequence[Definition], constants: Constants
) -> tuple[list[Item], list[Definition]]:
    """Items and macros without arguments that nothing reads, calls of functions that do nothing, functions that are
    numbers, and macros that are functions."""
    called_by_kernels = {name for kernel in kernels.values() for name in CALLED.findall(kernel)}
    listed = {name for item in found if item.kind == "other" for name in names_in_code(item.text)}
    fixed = called_by_kernels | listed | {item.name for item in found if item.kind == "function" and not item.inner}
    pure = frozenset(item.name for item in found if item.kind == "function" and _is_pure(item.text))
    constants = replace(constants, pure=pure)
    while True:
        while places := unread_in_macros(known):
            found, known = _without(found, known, places)
        functions, _ = reach(found, kernels, Macros(known), constants)
        found = [_simple(item, functions) for item in found]
        if idle := {name for name, text in functions.items() if _is_empty(text)} - fixed - constants.kernels:
            constants = replace(constants, kernels=constants.kernels | idle)
            found = [item._replace(done=False) for item in found]
            continue
        bodies = [*map(_body, functions.values()), *(text for _, _, text in known)]
        free = {name: text for name, text in functions.items() if name not in fixed}
        if places := unread_in_functions(free, bodies, constants):
            found, known = _without(found, known, places)
        elif given := numbers(free, bodies):
            left = [item for item in found if item.name not in given]
            found, known = _change(left, known, partial(_with_numbers, given=given))
        else:
            given = synonyms(known)
            longer = [definition for definition in known if definition[0] not in given]
            return _change(found, longer, partial(_with_names, given=given))


def _simple(item: Item, functions: Mapping[str, str]) -> Item:
    """An item with its simplified text, if it is a function that is reached."""
    reached = item.kind == "function" and item.name in functions
    return item._replace(text=functions[item.name], simple=True, done=True) if reached else item


def _without(found: Sequence[Item], known: Sequence[Definition], places: Places) -> tuple[list[Item], list[Definition]]:
    """Items and macros without these arguments."""
    acting = calling(known)
    heads: dict[str, str | None] = {}
    for name, arguments, _ in known:
        kept = [a for i, a in enumerate(arguments.split(", ")) if i not in places.get(name, ())] if arguments else []
        heads[name] = ", ".join(kept) if kept or name in acting else None
    bare = {name for name, arguments in heads.items() if name in places and arguments is None}
    items, macros = _change(found, known, partial(without, places=places, bare=bare))
    return (
        [i._replace(text=with_void(i.text, i.name)) if i.name in places else i for i in items],
        [(name, heads[name], text) for name, _, text in macros],
    )


def _change(
    found: Sequence[Item], known: Sequence[Definition], change: Callable[[str], str]
) -> tuple[list[Item], list[Definition]]:
    """Items and macros with changed texts."""
    items = [_with(item, change(item.text)) for item in found]
    return items, [(name, arguments, change(text)) for name, arguments, text in known]


def _with(item: Item, text: str) -> Item:
    """An item with another text."""
    return item if text == item.text else item._replace(text=text, done=False)


def _with_numbers(text: str, given: Mapping[str, str]) -> str:
    """A text with numbers in place of calls of the functions that are these numbers; 1 is no factor."""
    return _FACTOR.sub("", replace_calls(text, given, lambda name, _: given[name]))


def _with_names(text: str, given: Mapping[str, str]) -> str:
    """A text with these functions in place of the macros that are their names."""
    return replace_calls(text, given, lambda name, arguments: given[name].format(", ".join(arguments)))


def synonyms(known: Sequence[Definition]) -> dict[str, str]:
    """Macro -> the call that it is, with {} for its own arguments, if it is no more than the call of a function."""
    found = {name: text for name, arguments, text in known if arguments == ""}
    for name, arguments, text in known:
        function, _, rest = text.partition("(")
        if arguments and rest == f"{arguments})":
            found[name] = f"{function}({{}})"
    return found


def calls(names: Collection[str], code: str) -> Iterator[tuple[str, int]]:
    """Name of these macros and functions, and the place behind its bracket, of every call; inner calls come first."""
    for found in reversed(list(_CALL.finditer(code))):
        if found[1] in names:
            yield found[1], found.end()


def closing(code: str, start: int) -> int:
    """The place of the bracket that closes one which was opened just before ``start``."""
    depths = accumulate(((c == "(") - (c == ")") for c in code[start:]), initial=1)
    return start + next(place for place, depth in enumerate(depths) if depth == 0) - 1


def replace_calls(text: str, names: Collection[str], call: Callable[[str, list[str]], str]) -> str:
    """A text with another text for every call of these names: that which ``call`` gives for name and arguments."""
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
    """A text whose calls of these macros and functions lack the arguments at these places; ``bare``: macros without
    arguments, which are names."""

    def call(name: str, given: list[str]) -> str:
        kept = ", ".join(argument for i, argument in enumerate(given) if i not in places[name])
        return name if name in bare else f"{name}({kept})"

    return replace_calls(text, places.keys(), call)


def with_void(text: str, name: str) -> str:
    """A function, or its prototype, that has no parameters."""
    at = blank(text).find(f"{name}()")
    return text if at < 0 else f"{text[: at + len(name)]}(void){text[at + len(name) + 2 :]}"


def unread_in_macros(known: Sequence[Definition]) -> dict[str, tuple[int, ...]]:
    """Macro -> the places of arguments that its text does not name."""
    found = {}
    for name, arguments, text in known:
        each = arguments.split(", ") if arguments else []
        if unread := tuple(i for i, argument in enumerate(each) if argument not in names_in_code(text)):
            found[name] = unread
    return found


@lru_cache(maxsize=16384)
def unread_parameters(text: str) -> tuple[tuple[int, str], ...]:
    """Place and name of the parameters that the body of a function does not read."""
    function = function_of(text)
    _, parameters = signature(text[slice(*function.head)])
    read = names_in_code(text[slice(*function.inside)])
    return tuple((place, name) for place, name in enumerate(parameters) if name not in read)


def unread_in_functions(
    functions: Mapping[str, str], bodies: Sequence[str], known: Constants
) -> dict[str, tuple[int, ...]]:
    """Function -> the places of parameters that it does not read; they stay where an argument in ``bodies`` acts."""
    found = {name: tuple(place for place, _ in unread_parameters(text)) for name, text in functions.items()}
    found = {name: places for name, places in found.items() if places}
    for text in bodies:
        for name, start in () if names_in_code(text).isdisjoint(found) else calls(found, text):
            given = split(text[start : closing(text, start)])
            acts = {i for i in found[name] if known.effects(expression(given[i]))}
            found[name] = tuple(place for place in found[name] if place not in acts)
    return {name: places for name, places in found.items() if places}


def numbers(functions: Mapping[str, str], bodies: Sequence[str]) -> dict[str, str]:
    """Function without parameters -> the number that it is, unless a statement of the ``bodies`` is its call."""
    found = {name: given for name, text in functions.items() if (given := _number(text))}
    idle = {match[1] for body in bodies for match in _STATEMENT.finditer(body)} if found else set()
    return {name: given for name, given in found.items() if name not in idle}


@lru_cache(maxsize=16384)
def _number(text: str) -> str:
    function = function_of(text)
    if signature(text[slice(*function.head)])[1]:
        return ""
    found = _NUMBER.fullmatch(in_line(text[slice(*function.inside)]))
    return found[1] if found else ""


@lru_cache(maxsize=16384)
def _is_pure(text: str) -> bool:
    """True for a function with a value whose pointers are to constants: it changes nothing, as there are no globals."""
    before, _, after = in_line(blank(text).partition("\n{\n")[0]).partition("(")
    parameters = split(after.rpartition(")")[0])
    return " void " not in before and all("*" not in p or p.strip().startswith("const ") for p in parameters)


@lru_cache(maxsize=16384)
def _is_empty(text: str) -> bool:
    return all(node.kind == "comment" for node in function_of(text).body)


@lru_cache(maxsize=16384)
def _body(text: str) -> str:
    """The code in the braces of a function."""
    return blank(text[slice(*function_of(text).inside)])
