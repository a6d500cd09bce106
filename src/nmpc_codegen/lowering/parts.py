"""Plain C parts: `#include "part.c"` is inlined and `#if` over sizes is resolved; nothing else is rewritten.

A part is C that compiles as it stands once its preamble is there (preamble.py), so what is linted is what ships. A
condition is an integer expression of C in the sizes and switches of the package (0: absent); a name that the package
does not define is an error, as it is for a compiler under -Wundef.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

_INCLUDE = re.compile(r'#include "([\w/]+\.c)"')
_DIRECTIVE = re.compile(r"#(if|elif|else|endif)\b\s*(.*)")
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
    """Text of a part below templates/, with the parts that it includes; ``generated`` has those of this package."""
    lines = (template_directory() / path).read_text(encoding="utf-8").splitlines()
    return "\n".join(text for line in lines for text in _inlined(line, generated)) + "\n"


def _inlined(line: str, generated: Callable[[str], str]) -> Iterator[str]:
    include = _INCLUDE.match(line)
    if include is None:
        yield line
    elif include[1].startswith("generated/"):
        yield from generated(include[1]).splitlines()
    else:
        yield from read_part(include[1], generated).splitlines()


def resolve(text: str, sizes: Mapping[str, int]) -> str:
    """The text with every `#if` decided: lines that a compiler would skip are gone, and so are the directives.

    Raises:
        ValueError: a condition that is no integer expression, a name without a value, directives that do not match.
    """
    kept: list[str] = []
    stack: list[tuple[bool, bool]] = []  # of every open #if: this branch counts, one branch has counted
    for line in text.splitlines():
        directive = _DIRECTIVE.match(line)
        if directive is None:
            if all(active for active, _ in stack):
                kept.append(line)
            continue
        word, condition = directive.groups()
        if word == "if":
            holds = all(active for active, _ in stack) and evaluate(condition, sizes)
            stack.append((holds, holds))
            continue
        if not stack:
            raise ValueError(f"#{word} without #if")
        _, done = stack.pop()
        if word != "endif":
            holds = not done and all(a for a, _ in stack) and (word == "else" or evaluate(condition, sizes))
            stack.append((holds, done or holds))
    if stack:
        raise ValueError("#if without #endif")
    return "\n".join(kept) + "\n"


def evaluate(condition: str, sizes: Mapping[str, int]) -> bool:
    """Value of an integer expression of C with the operators + - * == != < <= > >= ! && || and parentheses."""
    text = re.sub(r"/\*.*?\*/", "", condition).replace("&&", " and ").replace("||", " or ")
    text = re.sub(r"!\s*(\w+)", r"(not \1)", text)
    text = re.sub(r"!(?!=)", " not ", text)
    try:
        return bool(_value(ast.parse(text.strip(), mode="eval").body, sizes))
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
        case ast.UnaryOp(op=ast.Not(), operand=operand):
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
