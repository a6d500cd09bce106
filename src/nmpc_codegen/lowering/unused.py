"""The unit of a package without what the package does not need.

A part is written for every problem. In a problem whose dynamics have no control, say, a function of a part has a
parameter that nothing reads. Removed are functions that nothing calls and local variables that nothing reads; unread
parameters get a statement, (void)u. A variable is read if its name is left once the macros of the unit are expanded.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from nmpc_codegen.lowering.parts import without_comments

# (name, arguments or None, text)
Definition = tuple[str, str | None, str]

#: An identifier that is no member of a struct.
_IDENTIFIER = re.compile(r"(?<![.\w])(?<!->)[A-Za-z_]\w*")
_ATTRIBUTE = re.compile(r"__attribute__\(\(\w+\)\) ")
_SIGNATURE = re.compile(r"(?P<name>API\(\w+\)|\b\w+)\((?P<parameters>.*)\)(?:\)\[\w+\])?$")
_DECLARATION = re.compile(
    r"(?P<indent> +)(?P<type>(?:static )?(?:const )?(?:int|int32_t|ptrdiff_t|\w+_t) )(?P<rest>.*);"
)
_VARIABLE = re.compile(r" ?\**(?P<name>\w+)(?:\[[^\]]*\])*(?: = .*)?")
#: What an initial value may do besides giving a number: call a function, count.
_EFFECT = re.compile(r"\b[a-z_]\w*\(|\bAPI\(|\+\+|--")
#: Heads of functions that only this unit calls.
_INNER = ("static ", "LANES_INLINE ")


@dataclass(frozen=True)
class _Function:
    """Lines of a function: its comment and signature, and its block without braces."""

    head: tuple[str, ...]
    block: tuple[str, ...]
    name: str
    parameters: tuple[str, ...]
    inner: bool

    @property
    def lines(self) -> tuple[str, ...]:
        return (*self.head, "{", *self.block, "}")


def without_unused(unit: str, known: Sequence[Definition]) -> str:
    """The text of a unit, whose macros are ``known``, without unused functions and variables."""
    macros = _Macros(known)
    items = [_without_locals(item, macros) if isinstance(item, _Function) else item for item in _items(unit)]
    reached = _reached(items, macros)
    kept: list[str] = []
    for item in items:
        if isinstance(item, str):
            kept.append(item)
        elif not item.inner or item.name in reached:
            kept += _with_parameters_read(item, macros).lines
    return "\n".join(kept) + "\n"


class _Macros:
    """The macros of a unit, and what is left of a text once they are expanded."""

    def __init__(self, known: Sequence[Definition]) -> None:
        self.plain = {name: text for name, arguments, text in known if arguments is None}
        self.parametric = {name: (arguments.split(", "), text) for name, arguments, text in known if arguments}
        self._expanded: dict[str, frozenset[str]] = {}
        self._words: dict[str, set[str]] = {}

    def words(self, code: str) -> set[str]:
        """Identifiers of a text without comments; those in arguments that a macro drops do not count."""
        if code not in self._words:
            self._words[code] = self._found(code)
        return self._words[code]

    def _found(self, code: str) -> set[str]:
        found = set(_IDENTIFIER.findall(code))
        if found.isdisjoint(self.parametric):
            return found.union(*(self._of_macro(name, self.plain[name]) for name in found & self.plain.keys()))
        found = set()
        position = 0
        while match := _IDENTIFIER.search(code, position):
            name, position = match[0], match.end()
            found.add(name)
            if name in self.plain:
                found |= self._of_macro(name, self.plain[name])
            elif name in self.parametric and code.startswith("(", position):
                names, text = self.parametric[name]
                inside = self._of_macro(name, text)
                found |= inside - set(names)
                given, position = _arguments(code, position)
                for argument, value in zip(names, given, strict=True):
                    if argument in inside:
                        found |= self.words(value)
        return found

    def have_effects(self, code: str) -> bool:
        """A text, or a macro in it, may do more than give a number."""
        texts = [self.parametric[name][1] for name in _IDENTIFIER.findall(code) if name in self.parametric]
        return bool(_EFFECT.search(code)) or any(map(self.have_effects, texts))

    def _of_macro(self, name: str, text: str) -> frozenset[str]:
        if name not in self._expanded:
            self._expanded[name] = frozenset()  # a macro is not expanded inside itself
            self._expanded[name] = frozenset(self.words(text))
        return self._expanded[name]


def _arguments(code: str, start: int) -> tuple[list[str], int]:
    """The arguments of the call whose parenthesis is at ``start``, and the position after it."""
    depth, first, found = 0, start + 1, []
    for position in range(start, len(code)):
        character = code[position]
        if character in "([{":
            depth += 1
        elif character in ")]}":
            depth -= 1
        if depth == 0 or (depth == 1 and character == ","):
            found.append(code[first:position])
            first = position + 1
        if depth == 0:
            return found, position + 1
    raise ValueError(f"unbalanced parentheses: {code[start : start + 60]!r}")


def _items(unit: str) -> Iterator[_Function | str]:
    """Functions, and the lines between them."""
    lines = unit.rstrip("\n").split("\n")
    start = 0
    while start < len(lines):
        opening = next((i for i in range(start, len(lines)) if lines[i] == "{"), None)
        if opening is None:
            yield from lines[start:]
            return
        closing = lines.index("}", opening)
        signature = _above(lines, opening, start)
        comment = _comment(lines, signature, start)
        yield from lines[start:comment]
        head = _ATTRIBUTE.sub("", " ".join(line.strip() for line in lines[signature:opening]))
        match = _SIGNATURE.search(head)
        if match is None:
            raise ValueError(f"no signature of a function: {head!r}")
        names = tuple(_declared(p) for p in _arguments(f"({match['parameters']})", 0)[0] if p.strip() != "void")
        block = tuple(lines[opening + 1 : closing])
        yield _Function(tuple(lines[comment:opening]), block, match["name"], names, head.startswith(_INNER))
        start = closing + 1


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
    names: list[str] = _IDENTIFIER.findall(re.sub(r"\[[^\]]*\]", "", parameter))
    return names[-1]


def _without_locals(function: _Function, macros: _Macros) -> _Function:
    """The function without variables that nothing reads, and those that only their initial values read."""
    block = list(function.block)
    while True:
        shorter = _pass(block, macros)
        if shorter == block:
            return replace(function, block=tuple(block))
        block = shorter


def _pass(block: Sequence[str], macros: _Macros) -> list[str]:
    code = without_comments("\n".join(block)).split("\n")
    words, indents = _words_by_line(code, macros), [_indent(line) for line in code]
    kept = []
    for number, line in enumerate(block):
        declaration = _DECLARATION.fullmatch(code[number].rstrip())
        if declaration is None:
            kept.append(line)
            continue
        declarators = _arguments(f"({declaration['rest']})", 0)[0]
        needed = [
            declarator
            for i, declarator in enumerate(declarators)
            if (plain := _VARIABLE.fullmatch(declarator)) is None
            or macros.have_effects(declarator)
            or _is_read(plain["name"], words, indents, number)
            or plain["name"] in _IDENTIFIER.findall(",".join(declarators[i + 1 :]))
        ]
        if len(needed) == len(declarators):
            kept.append(line)
        elif needed:
            kept.append(f"{declaration['indent']}{declaration['type']}{','.join(needed).lstrip()};")
    return kept


def _words_by_line(code: Sequence[str], macros: _Macros) -> list[set[str]]:
    """The words of the statement that begins in every line; none where a line continues a statement."""
    found: list[set[str]] = [set() for _ in code]
    first = 0
    for number, line in enumerate(code):
        if line.rstrip().endswith((";", "{", "}", ":")) or number == len(code) - 1:
            found[first] = macros.words("\n".join(code[first : number + 1]))
            first = number + 1
    return found


def _indent(line: str) -> int:
    """Columns before the first word; directives, which begin at the margin, and empty lines belong to any block."""
    bare = line.lstrip()
    return len(line) - len(bare) if bare and not bare.startswith("#") else sys.maxsize


def _is_read(name: str, words: Sequence[set[str]], indents: Sequence[int], number: int) -> bool:
    """True if a line after the line ``number``, in the same block, has this word."""
    for later in range(number + 1, len(words)):
        if indents[later] < indents[number]:
            return False
        if name in words[later]:
            return True
    return False


def _reached(items: Sequence[_Function | str], macros: _Macros) -> set[str]:
    """Names of the functions that something outside all functions, or a reached function, mentions."""
    functions = {item.name: item for item in items if isinstance(item, _Function)}
    outside = without_comments("\n".join(item for item in items if isinstance(item, str)))
    waiting = macros.words(outside) & functions.keys()
    waiting |= {name for name, function in functions.items() if not function.inner}
    reached: set[str] = set()
    while waiting:
        name = waiting.pop()
        reached.add(name)
        block = without_comments("\n".join(functions[name].block))
        waiting |= (macros.words(block) & functions.keys()) - reached
    return reached


def _with_parameters_read(function: _Function, macros: _Macros) -> _Function:
    """The function with a statement for every parameter that it does not read."""
    words = macros.words(without_comments("\n".join(function.block)))
    unread = tuple(f"    (void){name};" for name in function.parameters if name not in words)
    return replace(function, block=(*unread, *function.block))
