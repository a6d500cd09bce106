"""Plain C parts: `#include "part.c"` is inlined and `#if` over sizes is resolved; nothing else is rewritten.

A part compiles unchanged after its preamble (preamble.py), so that linters check the code that is shipped. A condition
is an integer expression of C in the sizes and switches of the package (0: absent); a name that the package does not
define is an error, as it is for a compiler with -Wundef.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import NamedTuple

_INCLUDE = re.compile(r'^#include "([\w/]+\.c)".*\n', re.MULTILINE)
_DIRECTIVE = re.compile(r"#(if|elif|else|endif)\b\s*(.*)")
_ANY_DIRECTIVE = re.compile(r"\s*#\s*(?:if|elif|else|endif)")
_NO_CODE = re.compile(r"/\*.*?\*/|//[^\n]*|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'", re.DOTALL)
_WORD = re.compile(r"[A-Za-z_]\w*")
_DEFINITION = re.compile(
    r"^#define (\w+)|^typedef \w+ (\w+);|^(?:static|LANES_INLINE) [\w *]*?\b(\w+)[(\[]", re.MULTILINE
)
_BRACES = re.compile(r"[{}]")
_WORDS = re.compile(r"\b(?:and|or|not|if|else|in|is|lambda|True|False|None)\b")
_BINARY: dict[type[ast.AST], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


def template_directory() -> Path:
    """Templates inside the installed package, or at the top of a source checkout."""
    here = Path(__file__).resolve()
    packaged = here.parents[1] / "templates"
    return packaged if packaged.is_dir() else here.parents[3] / "templates"


def read_part(path: str, generated: Callable[[str], str]) -> str:
    """Text of a part below templates/, with the parts that it includes; ``generated`` returns the generated ones."""
    text, *included = _pieces(path)
    for include, following in zip(included[::2], included[1::2], strict=True):
        inner = generated(include) if include.startswith("generated/") else read_part(include, generated)
        text += inner.rstrip("\n") + "\n" + following
    return text


@cache
def _pieces(path: str) -> tuple[str, ...]:
    """Text of a file below templates/, the path of the part that follows, text after it, and so on."""
    return tuple(_INCLUDE.split((template_directory() / path).read_text(encoding="utf-8").rstrip("\n") + "\n"))


def needed(text: str, names: Collection[str]) -> str:
    """The paragraphs of a text that define these names, or names in such paragraphs, in the order of the text."""
    paragraphs = [p for p in text.strip("\n").split("\n\n") if p]
    defined = {name: i for i, p in enumerate(paragraphs) for name in _defined(p)}
    kept: set[int] = set()
    found = {defined[name] for name in names if name in defined}
    while found:
        kept |= found
        words = {word for i in found for word in _WORD.findall(without_comments(paragraphs[i]))}
        found = {defined[word] for word in words if word in defined} - kept
    return "\n\n".join(paragraphs[i].strip("\n") for i in sorted(kept))


@lru_cache(maxsize=4096)
def _defined(paragraph: str) -> tuple[str, ...]:
    """Names of the macros, types, tables and functions that a paragraph defines."""
    return tuple(next(filter(None, found)) for found in _DEFINITION.findall(paragraph))


class _Line(NamedTuple):
    """A line, what of it is a directive ("" if none is), and its braces of code."""

    text: str
    directive: str
    braces: tuple[str, ...]


@dataclass
class _Open:
    """An open `#if`: is its present branch kept, was one kept, did `#else` occur; depth of the braces around it."""

    counts: bool
    done: bool
    last: bool
    depth: int


def resolve(text: str, sizes: Mapping[str, int]) -> str:
    """The text with every `#if` resolved: the directives and all lines that a compiler would skip are removed.

    Raises:
        ValueError: a condition is not an integer expression; a name has no value; conditional directives other than
            `#if`, `#elif`, `#else`, `#endif` occur or do not match; a branch opens a brace without closing it or closes
            one that it has not opened.
    """
    kept: list[str] = []
    stack: list[_Open] = []
    depth = 0
    for number, line in enumerate(_scanned(text), 1):
        try:
            if line.directive:
                _decide(line.directive, stack, depth, sizes)
                continue
            for brace in line.braces:
                depth += 1 if brace == "{" else -1
                if stack and depth < stack[-1].depth:
                    raise ValueError("a branch of an #if closes a brace that it has not opened")
        except ValueError as error:
            raise ValueError(f"line {number}, {line.text.strip()!r}: {error}") from error
        if not stack or stack[-1].counts:  # a branch counts only if those around it do
            kept.append(line.text)
    if stack:
        raise ValueError("#if without #endif")
    return "\n".join(kept) + "\n"


@lru_cache
def _scanned(text: str) -> tuple[_Line, ...]:
    """The lines of a part; most parts are the same in every package."""
    pairs = zip(text.splitlines(), without_comments(text).splitlines(), strict=True)
    return tuple(
        _Line(line, code if _ANY_DIRECTIVE.match(code) else "", tuple(_BRACES.findall(code))) for line, code in pairs
    )


def without_comments(text: str) -> str:
    """C text without comments, strings and characters, line by line."""
    return _NO_CODE.sub(lambda found: " " + "\n" * found[0].count("\n"), text)


def _decide(line: str, stack: list[_Open], depth: int, sizes: Mapping[str, int]) -> None:
    """Open a branch, or end one and begin the next."""
    directive = _DIRECTIVE.match(line)
    if directive is None:
        raise ValueError("expected #if, #elif, #else or #endif at the start of a line")
    word, condition = directive.groups()
    if word in ("else", "endif") and condition.strip():
        raise ValueError(f"expected nothing after #{word}")
    if word == "if":
        holds = all(branch.counts for branch in stack) and evaluate(condition, sizes)
        stack.append(_Open(holds, holds, False, depth))
        return
    if not stack:
        raise ValueError(f"#{word} without #if")
    branch = stack.pop()
    if depth != branch.depth:
        raise ValueError("the branch of an #if that ends here opens a brace without closing it")
    if word == "endif":
        return
    if branch.last:
        raise ValueError(f"#{word} after #else")
    open_ = not branch.done and all(outer.counts for outer in stack)
    holds = open_ and (word == "else" or evaluate(condition, sizes))
    stack.append(_Open(holds, branch.done or holds, word == "else", depth))


def evaluate(condition: str, sizes: Mapping[str, int]) -> bool:
    """Value of an integer expression of C with the operators + - * == != < <= > >= ! && || and parentheses.

    Python parses it, with `!` replaced by `~`, which binds as tightly; C's own `~` is not allowed here.
    """
    return bool(_value(_expression(condition), sizes))


@lru_cache(maxsize=1024)
def _expression(condition: str) -> ast.expr:
    """The condition as Python reads it; most conditions are the same in every package."""
    text = re.sub(r"/\*.*?\*/", "", condition).strip()
    if "~" in text or _WORDS.search(text):
        raise ValueError(f"#if {condition}: not an integer expression")
    text = re.sub(r"!(?!=)", "~", text).replace("&&", " and ").replace("||", " or ")
    try:
        return ast.parse(text, mode="eval").body
    except SyntaxError as error:
        raise ValueError(f"#if {condition}: not an integer expression") from error


def _value(node: ast.AST, sizes: Mapping[str, int]) -> int:
    match node:
        case ast.Constant(value=int(number)):
            return number
        case ast.Name(id=name):
            if name not in sizes:
                raise ValueError(f"#if: {name} has no value in this package")
            return sizes[name]
        case ast.UnaryOp(op=ast.Invert(), operand=operand):
            return int(not _value(operand, sizes))
        case ast.BoolOp(op=ast.And(), values=values):
            return int(all(_value(v, sizes) for v in values))
        case ast.BoolOp(op=ast.Or(), values=values):
            return int(any(_value(v, sizes) for v in values))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _BINARY[type(op)](_value(left, sizes), _value(right, sizes))
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _BINARY:
            return int(_BINARY[type(op)](_value(left, sizes), _value(right, sizes)))
    raise ValueError(f"#if: {ast.unparse(node)} is not supported")
