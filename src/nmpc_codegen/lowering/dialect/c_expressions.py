"""Expressions of C are parsed to trees."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple

_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d[\w.]*)|(?P<name>[A-Za-z_]\w*)|(?P<other>\"(?:\\.|[^\"])*\"|'(?:\\.|[^'])*')"
    r"|(?P<operator>->|\+\+|--|<<=|>>=|[-+*/%&|^=!<>]=|&&|\|\||<<|>>|[-+*/%&|^~!<>=?:,.()\[\]{};]))"
)
_WORD = re.compile(r"\w+")
_LEVELS = [",", "= += -= *= /= |= &= ^= %= <<= >>=", "?", "||", "&&", "|", "^", "&", "== !=", "< <= > >="]
_LEVELS += ["<< >>", "+ -", "* / %"]
_BINDING = {operator: level for level, operators in enumerate(_LEVELS, 1) for operator in operators.split()}
_ASSIGNING, _UNARY = 2, len(_LEVELS) + 1
#: A type in parentheses, which makes a cast.
_TYPE = re.compile(
    r"\(\s*(?:const )?(?:unsigned |signed )?(?:\w+_t|int|long|double|float|char|void)\b[^()]*(?:\(\*\)[^()]*)?\)"
)


class Expression(NamedTuple):
    """A C expression has a kind, a place in the text, an operator or name, and operands.

    ``kind`` is name, number, call (of a name), index, member, unary, binary, assign, group (in parentheses) or other.
    """

    kind: str
    start: int
    end: int
    word: str = ""
    operands: tuple[Expression, ...] = ()


@lru_cache(maxsize=16384)
def words(text: str) -> frozenset[str]:
    """Return all identifiers and numbers of a text."""
    return frozenset(_WORD.findall(text))


@lru_cache(maxsize=16384)
def expression(text: str) -> Expression:
    """Return the tree of a text without comments.

    Raises:
        ValueError: the text is no expression.
    """
    parser = _Parser(text)
    found = parser.binary(1)
    if parser.word:
        raise ValueError(f"{text.strip()!r}: expected an expression, found {parser.word!r} in it")
    return found


class _Parser:
    """The parser climbs precedences; ``word`` is the current token, "" at the end."""

    def __init__(self, text: str) -> None:
        self.text, self.end = text, 0
        self.step()

    def step(self) -> int:
        """Go to the next token and return the end of the current one."""
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
        """Consume this token and return its end."""
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
        """Return the end of the token before the current one."""
        return len(self.text[: self.start].rstrip())
