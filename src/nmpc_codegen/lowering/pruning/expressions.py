"""Expressions of C: their tree, whether they have effects, and the range of their values where constants decide it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d[\w.]*)|(?P<name>[A-Za-z_]\w*)|(?P<other>\"(?:\\.|[^\"])*\"|'(?:\\.|[^'])*')"
    r"|(?P<operator>->|\+\+|--|<<=|>>=|[-+*/%&|^=!<>]=|&&|\|\||<<|>>|[-+*/%&|^~!<>=?:,.()\[\]{};]))"
)
_WORD = re.compile(r"\w+")
_LEVELS = [",", "= += -= *= /= |= &= ^= %= <<= >>=", "?", "||", "&&", "|", "^", "&", "== !=", "< <= > >="]
_LEVELS += ["<< >>", "+ -", "* / %"]
_BINDING = {operator: level for level, operators in enumerate(_LEVELS, 1) for operator in operators.split()}
_ASSIGNING, _UNARY = 2, len(_LEVELS) + 1
#: A type in parentheses, which is that of a cast.
_TYPE = re.compile(r"\(\s*(?:const )?(?:unsigned |signed )?(?:\w+_t|int|long|double|float|char|void)\b[^()]*\)")

#: Least and greatest value of an expression of integers.
Range = tuple[int, int]
#: What is known of a name: the kind of knowledge, the name or (struct, member), the value.
Fact = tuple[str, Any, Any]


class Expression(NamedTuple):
    """An expression: what it is, its place in the text, its operator or name, its operands.

    ``kind``: name, number, call (of a name), index, member, unary, binary, assign, group (in parentheses) or other.
    """

    kind: str
    start: int
    end: int
    word: str = ""
    operands: tuple[Expression, ...] = ()


@lru_cache(maxsize=16384)
def words(text: str) -> frozenset[str]:
    """All identifiers and numbers of a text."""
    return frozenset(_WORD.findall(text))


@lru_cache(maxsize=16384)
def expression(text: str) -> Expression:
    """The tree of a text without comments.

    Raises:
        ValueError: it is no expression.
    """
    parser = _Parser(text)
    found = parser.binary(1)
    if parser.word:
        raise ValueError(f"{text.strip()!r}: expected an expression, found {parser.word!r} in it")
    return found


class _Parser:
    """Precedence climbing; ``word`` is the token at hand, "" at the end."""

    def __init__(self, text: str) -> None:
        self.text, self.end = text, 0
        self.step()

    def step(self) -> int:
        """Go to the next token; returns the end of the present one."""
        before = self.end
        found = _TOKEN.match(self.text, self.end)
        if found is None:
            if self.text[self.end :].strip():
                raise ValueError(f"{self.text.strip()!r}: expected an expression")
            self.word, self.kind, self.start = "", "", len(self.text)
        else:
            self.kind = found.lastgroup or ""
            self.word, self.start, self.end = found[self.kind], found.start(self.kind), found.end()
        return before

    def take(self, word: str) -> int:
        """Go behind this token; returns its end."""
        if self.word != word:
            raise ValueError(f"{self.text.strip()!r}: expected {word!r} in place of {self.word!r}")
        return self.step()

    def binary(self, least: int) -> Expression:
        left = self.unary()
        while (level := _BINDING.get(self.word, 0)) >= least:
            word = self.word
            self.step()
            if word == "?":
                middle = self.binary(1)
                self.take(":")
                right = self.binary(level)
                left = Expression("other", left.start, right.end, word, (left, middle, right))
                continue
            right = self.binary(level if level == _ASSIGNING else level + 1)
            left = Expression("assign" if level == _ASSIGNING else "binary", left.start, right.end, word, (left, right))
        return left

    def unary(self) -> Expression:
        start, word = self.start, self.word
        if word in ("!", "-", "+", "~", "*", "&", "++", "--", "sizeof"):
            self.step()
            if word == "sizeof" and (cast := _TYPE.match(self.text, self.start)):
                self.end = cast.end()
                self.step()
                return Expression("other", start, cast.end())
            operand = self.unary()
            return Expression("assign" if word in ("++", "--") else "unary", start, operand.end, word, (operand,))
        if word == "(" and (cast := _TYPE.match(self.text, start)):
            self.end = cast.end()
            self.step()
            operand = self.unary()
            return Expression("other", start, operand.end, "cast", (operand,))
        return self.postfix(self.primary())

    def primary(self) -> Expression:
        start, kind, word = self.start, self.kind, self.word
        if word in ("(", "{"):
            self.step()
            closing = ")" if word == "(" else "}"
            inner = () if self.word == closing else (self.binary(1),)
            return Expression("group" if word == "(" else "other", start, self.take(closing), word, inner)
        if kind not in ("number", "name", "other"):
            raise ValueError(f"{self.text.strip()!r}: expected an operand in place of {word!r}")
        return Expression(kind, start, self.step(), word)

    def postfix(self, found: Expression) -> Expression:
        while self.word in ("(", "[", ".", "->", "++", "--"):
            word = self.word
            self.step()
            if word in (".", "->"):
                name = self.word
                found = Expression("member", found.start, self.step(), name, (found,))
            elif word in ("++", "--"):
                found = Expression("assign", found.start, self.before, word, (found,))
            else:
                closing = ")" if word == "(" else "]"
                inner = () if self.word == closing else (self.binary(1),)
                name = found.word if found.kind == "name" else ""
                kind = "call" if word == "(" else "index"
                found = Expression(kind, found.start, self.take(closing), name, (found, *inner))
        return found

    @property
    def before(self) -> int:
        """The end of the token before the present one."""
        return len(self.text[: self.start].rstrip())


#: Functions of the C library that give a number and do no more.
PURE = frozenset({"isfinite"})


@dataclass(frozen=True, eq=False)
class Constants:
    """What a package decides.

    ``sizes``: values of sizes and features. ``ranges``: least and greatest value of the entries of tables and of what
    functions return. ``absent``: (struct, member) that no struct has. ``types``: (struct, member) -> its struct.
    ``kernels``: macros of kernels that have nothing to compute. ``calling``: macros that call functions.
    """

    sizes: Mapping[str, int] = field(default_factory=dict)
    ranges: Mapping[str, Range] = field(default_factory=dict)
    absent: frozenset[tuple[str, str]] = frozenset()
    types: Mapping[tuple[str, str], str] = field(default_factory=dict)
    kernels: frozenset[str] = frozenset()
    calling: frozenset[str] = frozenset()

    @cached_property
    def members(self) -> Mapping[str, frozenset[Fact]]:
        """Word of a statement -> what is known of members and kernels with this name."""
        found: dict[str, set[Fact]] = {name: {("kernel", name, None)} for name in self.kernels}
        for name in self.calling:
            found.setdefault(name, set()).add(("calling", name, None))
        for member in self.absent:
            found.setdefault(member[1], set()).add(("absent", member, None))
        for member, struct in self.types.items():
            found.setdefault(member[1], set()).add(("type", member, struct))
        return {name: frozenset(facts) for name, facts in found.items()}

    def facts(self, heads: frozenset[str], loops: frozenset[str], text: frozenset[str]) -> frozenset[Fact]:
        """What is known of words of conditions, of sizes of which the sign counts, of members that a text names."""
        found: set[Fact] = {("size", name, self.sizes[name]) for name in heads & self.sizes.keys()}
        found |= {("size", name, min(1, self.sizes[name])) for name in loops & self.sizes.keys()}
        found |= {("range", name, self.ranges[name]) for name in heads & self.ranges.keys()}
        return frozenset(found.union(*(self.members[word] for word in text & self.members.keys())))

    @staticmethod
    @lru_cache(maxsize=4096)
    def of(facts: frozenset[Fact]) -> Constants:
        """The constants with these facts alone."""

        def named(kind: str) -> dict[Any, Any]:
            return {name: value for of, name, value in facts if of == kind}

        sizes, ranges, types = named("size"), named("range"), named("type")
        return Constants(
            sizes, ranges, frozenset(named("absent")), types, frozenset(named("kernel")), frozenset(named("calling"))
        )

    def range(self, found: Expression, loop: Mapping[str, Range] | None = None) -> Range | None:
        """Least and greatest value of an expression, None if it depends on data; ``loop``: ranges of variables."""
        if found.kind == "number":
            return (int(found.word),) * 2 if found.word.isdigit() else None
        if found.kind == "name":
            if loop and found.word in loop:
                return loop[found.word]
            return (self.sizes[found.word],) * 2 if found.word in self.sizes else None
        if found.kind in ("call", "index"):
            return self.ranges.get(found.word) if not any(map(self.effects, found.operands[1:])) else None
        if found.kind == "group":
            return self.range(found.operands[0], loop)
        values = [self.range(operand, loop) for operand in found.operands]
        if found.kind == "unary" and values[0] is not None:
            least, most = values[0]
            return {"-": (-most, -least), "!": _truth_range(_negated(_truth(values[0])))}.get(found.word)
        if found.kind == "binary" and found.word in ("&&", "||"):
            return _truth_range(_joined(found.word, values))
        if found.kind == "binary" and values[0] is not None and values[1] is not None:
            return _combined(found.word, values[0], values[1])
        return None

    def names(self, text: str) -> bool:
        """True if a text names a size, a table or a function of which the range is known."""
        return any(word in self.sizes or word in self.ranges for word in words(text))

    def effects(self, found: Expression) -> bool:
        """True if it assigns, counts or calls a function, unless that only gives a number."""
        if found.kind == "assign":
            return True
        if found.kind == "call" and found.word not in self.ranges and found.word not in PURE:
            calls = not found.word.isupper() or found.word in self.calling
        else:
            calls = False
        return calls or any(map(self.effects, found.operands))

    def truth(self, found: Expression, loop: Mapping[str, Range] | None = None) -> bool | None:
        """True or False where constants decide an expression without effects."""
        return None if self.effects(found) else _truth(self.range(found, loop))

    def reduced(self, text: str) -> bool | str:
        """A condition without the operands that constants decide; True or False if they decide it."""
        found = expression(text)
        left = self._reduced(text, found)
        if isinstance(left, bool) or found.kind == "group" or (bare := expression(left)).kind != "group":
            return left
        return left[bare.start + 1 : bare.end - 1]

    def _reduced(self, text: str, found: Expression) -> bool | str:
        value = self.truth(found)
        if value is not None:
            return value
        if found.kind == "binary" and found.word in ("&&", "||"):
            left, right = (self._reduced(text, operand) for operand in found.operands)
            decisive = found.word == "||"
            if right is decisive and not self.effects(found.operands[0]):
                return decisive
            if left is decisive or left is (not decisive):
                return decisive if left is decisive else right
            if right is (not decisive):
                return left
            first, second = found.operands
            new = [text[o.start : o.end] if isinstance(n, bool) else n for o, n in ((first, left), (second, right))]
            return new[0] + text[first.end : second.start] + new[1]
        if found.kind == "unary" and found.word == "!":
            inner = self._reduced(text, found.operands[0])
            return not inner if isinstance(inner, bool) else f"!{inner}" if _is_operand(inner) else f"!({inner})"
        if found.kind == "group":
            inner = self._reduced(text, found.operands[0])
            before = text[found.operands[0].start : found.operands[0].end]
            return inner if isinstance(inner, bool) or (inner != before and _is_operand(inner)) else f"({inner})"
        return text[found.start : found.end]


def _is_operand(text: str) -> bool:
    return expression(text).kind not in ("binary", "assign", "other")


def _truth(values: Range | None) -> bool | None:
    if values is None or values[0] <= 0 <= values[1]:
        return False if values == (0, 0) else None
    return True


def _negated(value: bool | None) -> bool | None:
    return None if value is None else not value


def _truth_range(value: bool | None) -> Range | None:
    return None if value is None else (int(value),) * 2


def _joined(word: str, values: list[Range | None]) -> bool | None:
    decisive = word == "||"
    found = [_truth(value) for value in values]
    if decisive in found:
        return decisive
    return None if None in found else not decisive


def _combined(word: str, left: Range, right: Range) -> Range | None:
    """Interval arithmetic; a comparison that holds, or fails, for all values."""
    (a, b), (c, d) = left, right
    if word in ("+", "-"):
        return (a + c, b + d) if word == "+" else (a - d, b - c)
    if word == "*":
        products = (a * c, a * d, b * c, b * d)
        return min(products), max(products)
    always, never = {
        "<": (b < c, a >= d),
        "<=": (b <= c, a > d),
        ">": (a > d, b <= c),
        ">=": (a >= d, b < c),
        "==": (a == b == c == d, b < c or d < a),
        "!=": (b < c or d < a, a == b == c == d),
    }.get(word, (False, False))
    return (1, 1) if always else (0, 0) if never else None
