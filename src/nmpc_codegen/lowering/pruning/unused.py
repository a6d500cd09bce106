"""The unit of a package without what the package does not need.

A part is written for every problem, with all its rows, bounds and components. Removed are loops over nothing and
branches that the sizes exclude (fold.py), calls of functions that have nothing to do, functions that nothing calls,
local variables and parameters that nothing reads, and enumerations of which nothing is used. A variable is read if its
name is left once the macros of the unit are expanded. Functions of the interface keep their parameters: an unread one
gets a statement, (void)u.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from nmpc_codegen.lowering.pruning.fold import Constants, folded, wrapped
from nmpc_codegen.lowering.pruning.text import (
    IDENTIFIER,
    arguments,
    blanked,
    calls,
    check_dialect,
    has_effects,
    indent,
    without_comment_above,
)

# (name, arguments or None, text)
Definition = tuple[str, str | None, str]

_ATTRIBUTE = re.compile(r"__attribute__\(\(\w+\)\) ")
_SIGNATURE = re.compile(r"(?P<name>API\(\w+\)|\b\w+)\((?P<parameters>.*)\)(?:\)\[\w+\])?$")
_PROTOTYPE = re.compile(r"^static [^{}=]*?\b(?P<name>\w+)\([^{}]*\)(?:\)\[\w+\])?;$", re.DOTALL)
_ENUMERATION = re.compile(r"^enum \{(?P<names>.*)\};[^\n]*$", re.DOTALL | re.MULTILINE)
_DECLARATION = re.compile(
    r"(?P<indent> +)(?P<type>(?:static )?(?:const )?(?:int|int32_t|ptrdiff_t|\w+_t) )(?P<rest>.*);"
)
_VARIABLE = re.compile(r" ?\**(?P<name>\w+)(?:\[[^\]]*\])*(?: = .*)?")
_NAMED = re.compile(r"(?<![.\w])(?<!->)[A-Za-z_]\w*\b(?!\()")
_MARK = re.compile(r" *\(void\)\w+;")
#: A result that every call of a function has.
_RESULT = re.compile(r" *return (?P<value>-?\d+|R\(\d+\)|[A-Z][A-Z_]*|\w+);")
#: What needs no parentheses around it in an expression.
_OPERAND = re.compile(r"[\w.]+(?:(?:->|\.)\w+|\[\w+\])*|R\(\d+\)")
#: A statement that leaves everything as it is: x = x; or x += R(0);
_NOTHING = re.compile(r" *(?P<place>\S+) (?:= (?P=place)|(?:\+=|-=|\|=) (?:R\(0\)|0));")
#: A pointer to a struct: const qp_t *q.
_POINTER = re.compile(r"\b(\w+)_t \*(?:const )?(\w+)")
#: Heads of functions that only this unit calls.
_INNER = ("static ", "LANES_INLINE ")


@dataclass(frozen=True)
class _Function:
    """Lines of a function: its comment, its signature, and its block without braces."""

    comment: tuple[str, ...]
    signature: tuple[str, ...]
    block: tuple[str, ...]
    name: str
    parameters: tuple[str, ...]
    inner: bool

    @property
    def lines(self) -> tuple[str, ...]:
        return (*self.comment, *self.signature, "{", *self.block, "}")

    @cached_property
    def code(self) -> str:
        """Its block with blanks for comments."""
        return blanked("\n".join(self.block))

    @cached_property
    def statements(self) -> list[str]:
        """Its lines of code."""
        lines = self.code.split("\n")
        return [line.rstrip() for line in lines if line.strip() and not _MARK.fullmatch(line.rstrip())]

    @cached_property
    def named(self) -> frozenset[str]:
        """What it names without calling it."""
        return frozenset(_NAMED.findall(self.code))


@dataclass(frozen=True)
class _Change:
    """What becomes of the calls of a function: nothing, a value that all of them have, or fewer arguments."""

    gone: bool = False
    value: str = ""
    dropped: tuple[int, ...] = ()


def without_unused(unit: str, known: Sequence[Definition], constants: Constants | None = None) -> str:
    """The text of a unit, whose macros are ``known``, without unused functions and variables; ``constants``: what the
    package decides."""
    return _Pruned(unit, _Macros(known), constants or Constants()).text()


class _Macros:
    """The macros of a unit, and what is left of a text once they are expanded."""

    def __init__(self, known: Sequence[Definition]) -> None:
        self.plain = {name: text for name, arguments, text in known if arguments is None}
        self.parametric = {name: (arguments.split(", "), text) for name, arguments, text in known if arguments}
        self.mentioned = {word for _, _, text in known for word in IDENTIFIER.findall(text)}
        self._expanded: dict[str, frozenset[str]] = {}
        self._words: dict[str, set[str]] = {}

    def words(self, code: str) -> set[str]:
        """Identifiers of a text without comments; those in arguments that a macro drops do not count."""
        if code not in self._words:
            self._words[code] = self._found(code)
        return self._words[code]

    def _found(self, code: str) -> set[str]:
        found = set(IDENTIFIER.findall(code))
        if found.isdisjoint(self.parametric):
            return found.union(*(self._of_macro(name, self.plain[name]) for name in found & self.plain.keys()))
        found = set()
        position = 0
        while match := IDENTIFIER.search(code, position):
            name, position = match[0], match.end()
            found.add(name)
            if name in self.plain:
                found |= self._of_macro(name, self.plain[name])
            elif name in self.parametric and code.startswith("(", position):
                names, text = self.parametric[name]
                inside = self._of_macro(name, text)
                found |= inside - set(names)
                given, position = arguments(code, position)
                for argument, value in zip(names, given, strict=True):
                    if argument in inside:
                        found |= self.words(value)
        return found

    def have_effects(self, code: str) -> bool:
        """A text, or a macro in it, may do more than give a number."""
        texts = [self.parametric[name][1] for name in IDENTIFIER.findall(code) if name in self.parametric]
        return has_effects(code) or any(map(self.have_effects, texts))

    def _of_macro(self, name: str, text: str) -> frozenset[str]:
        if name not in self._expanded:
            self._expanded[name] = frozenset()  # a macro is not expanded inside itself
            self._expanded[name] = frozenset(self.words(text))
        return self._expanded[name]


class _Pruned:
    """The items of a unit, functions and what stands between them, while they lose what nothing needs."""

    def __init__(self, unit: str, macros: _Macros, constants: Constants) -> None:
        self.macros, self.constants = macros, constants
        self.items: list[_Function | str] = list(_items(unit))
        for item in self.items:
            if isinstance(item, _Function):
                check_dialect(item.name, item.block)
        self.changed = {item.name for item in self.items if isinstance(item, _Function)}
        self.headings = _headings(self.items)

    def text(self) -> str:
        while self.changed:
            changed, self.changed = self.changed, set()
            for place, item in enumerate(self.items):
                if isinstance(item, _Function) and item.name in changed:
                    self.items[place] = self._simplified(item)
            reached = self._reached()
            self.items = [item for item in self.items if self._stays(item, reached)]
            self._change_calls(self._changes(changed))
        left = {item if isinstance(item, str) else item.name for item in self.items}
        spare = {heading for heading, names in self.headings.items() if names and not names & left}
        kept = [item for item in self.items if item not in spare]
        return "\n".join(line for item in kept for line in self._lines(item)) + "\n"

    def _lines(self, item: _Function | str) -> Sequence[str]:
        return [item] if isinstance(item, str) else _with_parameters_read(item, self.macros).lines

    def _simplified(self, function: _Function) -> _Function:
        block = list(function.block)
        types = _types(function)
        while (shorter := _pass(folded(block, self.constants, types), self.macros)) != block:
            block = shorter
        return replace(function, block=tuple(_without_empty_lines(block)))

    def _words(self, function: _Function) -> set[str]:
        return self.macros.words(function.code)

    def _reached(self) -> set[str]:
        """Names of the functions that something outside all functions, or a reached function, mentions."""
        functions = {item.name: item for item in self.items if isinstance(item, _Function)}
        outside = [item for item in self.items if isinstance(item, str) and not _declares(item)]
        self.outside = self.macros.words(blanked("\n".join(outside)))
        waiting = self.outside & functions.keys()
        waiting |= {name for name, function in functions.items() if not function.inner}
        reached: set[str] = set()
        while waiting:
            name = waiting.pop()
            reached.add(name)
            waiting |= (self._words(functions[name]) & functions.keys()) - reached
        signatures = (" ".join(functions[name].signature) for name in reached)
        self.used = self.outside.union(
            *(self._words(functions[name]) for name in reached), *map(self.macros.words, signatures)
        )
        return reached

    def _stays(self, item: _Function | str, reached: Collection[str]) -> bool:
        if isinstance(item, _Function):
            return not item.inner or item.name in reached
        if enumeration := _ENUMERATION.search(item):
            return not self.used.isdisjoint(IDENTIFIER.findall(blanked(enumeration["names"])))
        prototype = _PROTOTYPE.match(item)
        return prototype is None or prototype["name"] in reached

    def _changes(self, changed: Collection[str]) -> dict[str, _Change]:
        """What becomes of the calls of those functions that have changed."""
        found: dict[str, _Change] = {}
        functions = [item for item in self.items if isinstance(item, _Function)]
        # called by a macro, or from outside, or with an address that may be stored
        fixed = self.macros.mentioned.union(self.outside, *(function.named for function in functions))
        for place, item in enumerate(self.items):
            if not isinstance(item, _Function) or item.name not in changed or not item.inner:
                continue
            if item.name in fixed:
                continue
            if not item.statements:
                found[item.name] = _Change(gone=True)
            elif result := _only_result(item):
                found[item.name] = _Change(value=result)
            else:
                unread = tuple(i for i, name in enumerate(item.parameters) if name not in self._words(item))
                if unread and self._may_lose(item.name, unread):
                    found[item.name] = _Change(dropped=unread)
                    self.items[place] = _with_fewer_parameters(item, unread)
        return found

    def _may_lose(self, name: str, places: Sequence[int]) -> bool:
        """True if the arguments at these places of all calls have no effects."""
        for item in self.items:
            if isinstance(item, _Function) and name in self._words(item):
                for start in calls(item.code, name):
                    given, _ = arguments(item.code, start)
                    if any(self.macros.have_effects(given[i]) for i in places):
                        return False
        return True

    def _change_calls(self, changes: Mapping[str, _Change]) -> None:
        parameters = {item.name: item.parameters for item in self.items if isinstance(item, _Function)}
        for place, item in enumerate(self.items):
            if isinstance(item, str):
                self.items[place] = _with_changed_prototype(item, changes)
                continue
            item = self.items[place] = replace(item, block=_with_changed_bounds(item.block, changes))
            if called := sorted(changes.keys() & self._words(item)):
                text = "\n".join(item.block) + "\n"
                for name in called:
                    text = _with_changed_calls(text, name, changes[name], parameters[name])
                if text != "\n".join(item.block) + "\n":
                    self.items[place] = replace(
                        item, block=tuple(text.rstrip("\n").split("\n")) if text.strip() else ()
                    )
                    self.changed.add(item.name)
        for name, change in changes.items():
            if change.dropped:
                self.changed.add(name)


def _types(function: _Function) -> dict[str, str]:
    """Pointer of a function -> the struct to which it points.

    Raises:
        ValueError: pointers to different structs have the same name, so that a member does not tell its struct.
    """
    found: dict[str, str] = {}
    for struct, name in _POINTER.findall(blanked("\n".join([*function.signature, *function.block]))):
        if found.setdefault(name, struct) != struct:
            raise ValueError(
                f"{function.name}(): {name} points to {found[name]}_t and to {struct}_t; expected a name for each"
            )
    return found


def _only_result(function: _Function) -> str:
    """The value that every call has: a constant, or a parameter of the type of the result; "" if there is none."""
    statements, head = function.statements, " ".join(function.signature)
    result = _RESULT.fullmatch(statements[0]) if len(statements) == 1 else None
    if result is None:
        return ""
    value, of_real = result["value"], bool(re.search(rf"\breal_t {function.name}\(", head))
    if value in function.parameters:
        types = re.findall(rf"(\w+) (?:{function.name}\(|{value}\b)", head)
        return value if len(types) == 2 and types[0] == types[1] else ""
    return "" if value[-1].islower() or (of_real and value[-1].isdigit()) else value


def _with_changed_bounds(block: Sequence[str], changes: Mapping[str, _Change]) -> tuple[str, ...]:
    """A block whose comments on the passes of loops name the constant result of a function instead of its call."""
    lines = list(block)
    for name, change in changes.items():
        if change.value and change.value[0].isupper():
            for number, line in enumerate(lines):
                if f"/* at most {name}(" in line:
                    lines[number] = re.sub(rf"(/\* at most ){name}\(\w*\)", rf"\g<1>{change.value}", line)
    return tuple(lines)


def _with_changed_calls(text: str, name: str, change: _Change, parameters: Sequence[str]) -> str:
    """A block with the calls of a function as ``change`` says."""
    for start in calls(blanked(text), name):
        code = blanked(text)
        given, end = arguments(code, start)
        first = start - len(name)
        if change.dropped:
            kept = ", ".join(" ".join(a.split()) for i, a in enumerate(given) if i not in change.dropped)
            text = _spliced(text, start + 1, end - 1, kept)
        elif any(map(has_effects, given)):
            continue
        elif change.gone:
            text = _without_statement(text, first, end)
        else:
            value = given[parameters.index(change.value)].strip() if change.value in parameters else change.value
            text = _spliced(text, first, end, value if _OPERAND.fullmatch(value) else f"({value})")
            begin, last = text.rfind("\n", 0, first) + 1, text.find("\n", first) + 1
            idle = _NOTHING.fullmatch(text[begin : last - 1])
            if idle and not has_effects(idle["place"]):
                text = text[:begin] + text[last:]
    return text


def _spliced(text: str, first: int, end: int, middle: str) -> str:
    """The text with other characters between two places; the line is wrapped anew if it has become one."""
    begin = text.rfind("\n", 0, first) + 1
    last = text.find("\n", end)
    line = text[begin:first] + middle + text[end:last]
    return text[:begin] + "\n".join(wrapped(line)) + text[last:]


def _without_statement(text: str, first: int, end: int) -> str:
    """The text without the statement that is a call."""
    begin = text.rfind("\n", 0, first) + 1
    if text[begin:first].strip() not in ("", "(void)") or not text.startswith(";", end):
        return text
    above = text[:begin].rstrip("\n").split("\n")
    without_comment_above(above)
    before = "\n".join(above)
    return (f"{before}\n" if before else "") + text[text.find("\n", end) + 1 :]


def _without_empty_lines(block: Sequence[str]) -> list[str]:
    """The block without empty lines at its ends, and at the ends of blocks in it."""
    kept: list[str] = []
    for line in block:
        if line.strip():
            if line.lstrip().startswith("}") and kept and not kept[-1]:
                kept.pop()
            kept.append(line)
        elif kept and kept[-1] and not kept[-1].endswith("{"):
            kept.append("")
    return kept[:-1] if kept and not kept[-1] else kept


def _items(unit: str) -> Iterator[_Function | str]:
    """Functions, prototypes, enumerations, and the lines between them."""
    lines = unit.rstrip("\n").split("\n")
    start = 0
    while start < len(lines):
        opening = next((i for i in range(start, len(lines)) if lines[i] == "{"), None)
        if opening is None:
            yield from _between(lines[start:])
            return
        closing = lines.index("}", opening)
        signature = _above(lines, opening, start)
        comment = _comment(lines, signature, start)
        yield from _between(lines[start:comment])
        head = _ATTRIBUTE.sub("", " ".join(line.strip() for line in lines[signature:opening]))
        match = _SIGNATURE.search(head)
        if match is None:
            raise ValueError(f"no signature of a function: {head!r}")
        names = tuple(_declared(p) for p in arguments(f"({match['parameters']})", 0)[0] if p.strip() != "void")
        text = (tuple(lines[comment:signature]), tuple(lines[signature:opening]), tuple(lines[opening + 1 : closing]))
        yield _Function(*text, match["name"], names, head.startswith(_INNER))
        start = closing + 1


def _between(lines: Sequence[str]) -> Iterator[str]:
    """The lines; those of one prototype together, of a comment, and of an enumeration with its comment."""
    number = 0
    while number < len(lines):
        end = number
        if lines[number].startswith("/*"):
            end = next((i for i in range(number, len(lines)) if lines[i].rstrip().endswith("*/")), number)
            if lines[end + 1 : end + 2] and lines[end + 1].startswith("enum {"):
                end += 1
        if lines[end].startswith("enum {"):
            end = next((i for i in range(end, len(lines)) if "};" in lines[i]), end)
        elif lines[number].startswith("static ") and "(" in lines[number] and "=" not in lines[number]:
            end = next((i for i in range(number, len(lines)) if lines[i].endswith(";")), number)
        yield "\n".join(lines[number : end + 1])
        number = end + 1


def _declares(item: str) -> bool:
    """True for a prototype and an enumeration, whose names are no use of them."""
    return bool(_PROTOTYPE.match(item) or _ENUMERATION.search(item))


def _headings(items: Sequence[_Function | str]) -> dict[str, set[str]]:
    """Comments that stand alone -> the functions between them and the next one."""
    found: dict[str, set[str]] = {}
    names: set[str] = set()
    for item, after in zip(items, [*items[1:], ""], strict=True):
        if isinstance(item, _Function):
            names.add(item.name)
        elif item.startswith("/*") and not item.startswith("/* ==") and item.endswith("*/") and after == "":
            names = found.setdefault(item, set())
        elif item and not _declares(item):
            names.add(item)
    return found


def _above(lines: Sequence[str], end: int, start: int) -> int:
    """First line of the signature that ends before the line ``end``."""
    first = end
    while first > start and lines[first - 1] and not lines[first - 1].endswith(("*/", "}", ";")):
        if lines[first - 1].startswith("#"):
            break
        first -= 1
    return first


def _comment(lines: Sequence[str], end: int, start: int) -> int:
    """First line of the comment that ends just before the line ``end``; ``end`` if there is none."""
    first = end
    while first > start and lines[first - 1]:
        first -= 1
        if lines[first].startswith("/*"):
            return first if lines[end - 1].endswith("*/") else end
    return end


def _declared(parameter: str) -> str:
    """The name in the declaration of a parameter: const real_t *x, real_t (*Q)[NZ], real_t u[NU]."""
    names: list[str] = IDENTIFIER.findall(re.sub(r"\[[^\]]*\]", "", parameter))
    return names[-1]


def _pass(block: Sequence[str], macros: _Macros) -> list[str]:
    """The block without variables that nothing reads."""
    code = blanked("\n".join(block)).split("\n")
    words, indents = _words_by_line(code, macros), [_depth(line) for line in code]
    kept = []
    for number, line in enumerate(block):
        declaration = _DECLARATION.fullmatch(code[number].rstrip())
        if declaration is None:
            kept.append(line)
            continue
        declarators = arguments(f"({declaration['rest']})", 0)[0]
        read = [_is_used(place, declarators, words, indents, number) for place in range(len(declarators))]
        values = [declarator.partition(" = ")[2] for declarator in declarators]
        effects = [macros.have_effects(value) for value in values]
        needed = [d for d, used, effect in zip(declarators, read, effects, strict=True) if used or effect]
        if len(declarators) == 1 and effects[0] and not read[0]:
            kept.append(f"{declaration['indent']}(void){values[0]};")
        elif len(needed) == len(declarators):
            kept.append(line)
        elif needed:
            kept.append(f"{declaration['indent']}{declaration['type']}{','.join(needed).lstrip()};")
    return kept


def _is_used(
    place: int, declarators: Sequence[str], words: Sequence[set[str]], indents: Sequence[int], number: int
) -> bool:
    """True if something reads a variable of a declaration; also for what is no plain variable."""
    plain = _VARIABLE.fullmatch(declarators[place])
    if plain is None or _is_read(plain["name"], words, indents, number):
        return True
    return plain["name"] in IDENTIFIER.findall(",".join(declarators[place + 1 :]))


def _words_by_line(code: Sequence[str], macros: _Macros) -> list[set[str]]:
    """The words of the statement that begins in every line; none where a line continues a statement."""
    found: list[set[str]] = [set() for _ in code]
    first = 0
    for number, line in enumerate(code):
        if line.rstrip().endswith((";", "{", "}", ":")) or number == len(code) - 1:
            found[first] = macros.words("\n".join(code[first : number + 1]))
            first = number + 1
    return found


def _depth(line: str) -> int:
    """Columns before the first word; directives, which begin at the margin, and empty lines belong to any block."""
    bare = line.strip()
    return len(indent(line)) if bare and not bare.startswith("#") else sys.maxsize


def _is_read(name: str, words: Sequence[set[str]], indents: Sequence[int], number: int) -> bool:
    """True if a line after the line ``number``, in the same block, has this word."""
    for later in range(number + 1, len(words)):
        if indents[later] < indents[number]:
            return False
        if name in words[later]:
            return True
    return False


def _with_parameters_read(function: _Function, macros: _Macros) -> _Function:
    """The function with a statement for every parameter that it does not read."""
    words = macros.words(function.code)
    unread = tuple(f"    (void){name};" for name in function.parameters if name not in words)
    return replace(function, block=(*unread, *function.block))


def _with_fewer_parameters(function: _Function, places: Collection[int]) -> _Function:
    parameters = tuple(name for i, name in enumerate(function.parameters) if i not in places)
    text = _fewer_in_signature("\n".join(function.signature), function.name, places)
    return replace(function, signature=tuple(text.split("\n")), parameters=parameters)


def _with_changed_prototype(text: str, changes: Mapping[str, _Change]) -> str:
    prototype = _PROTOTYPE.match(text)
    change = changes.get(prototype["name"]) if prototype else None
    if prototype is None or change is None or not change.dropped:
        return text
    return _fewer_in_signature(text, prototype["name"], change.dropped)


def _fewer_in_signature(text: str, name: str, places: Collection[int]) -> str:
    """A head without the parameters at these places."""
    start = text.index(f"{name}(") + len(name)
    given, end = arguments(text, start)
    kept = [" ".join(parameter.split()) for i, parameter in enumerate(given) if i not in places]
    line = f"{text[: start + 1]}{', '.join(kept) or 'void'}{text[end - 1 :]}"
    return "\n".join(wrapped(line))
