"""Constants of a package determine expressions: their range, their truth, whether they have effects."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from nmpc_codegen.lowering.dialect.c_expressions import Expression, expression, words

#: Least and greatest value of an integer expression.
Range = tuple[int, int]

_DECIMAL = re.compile(r"0|[1-9]\d*")
#: Functions of the C library without side effects.
PURE = frozenset({"isfinite"})
#: (operator, operands) -> function; results at the ends of ranges enclose those in between.
_MONOTONE: Mapping[tuple[str, int], Callable[..., Any]] = {
    ("+", 2): operator.add,
    ("-", 2): operator.sub,
    ("*", 2): operator.mul,
    ("<", 2): operator.lt,
    ("<=", 2): operator.le,
    (">", 2): operator.gt,
    (">=", 2): operator.ge,
    ("&&", 2): min,
    ("||", 2): max,
    ("-", 1): operator.neg,
    ("!", 1): operator.not_,
}


@dataclass(frozen=True, eq=False)
class Constants:
    """Constants are the facts that a package knows at export.

    sizes: values of sizes and features; ranges: least and greatest value of entries of tables and of results of
    functions; absent: (struct, member) that no struct has; types: (struct, member) -> its struct; kernels: macros and
    functions that have nothing to do; calling: macros that call functions; pure: functions without side effects.
    """

    sizes: Mapping[str, int] = field(default_factory=dict)
    ranges: Mapping[str, Range] = field(default_factory=dict)
    absent: frozenset[tuple[str, str]] = frozenset()
    types: Mapping[tuple[str, str], str] = field(default_factory=dict)
    kernels: frozenset[str] = frozenset()
    calling: frozenset[str] = frozenset()
    pure: frozenset[str] = frozenset()

    def names(self, text: str) -> bool:
        """Return True if a text names a size, a table or a function with a known range."""
        return any(word in self.sizes or word in self.ranges for word in words(text))

    def effects(self, found: Expression) -> bool:
        """Return True if the expression assigns, counts or calls a function with side effects."""
        if found.kind == "call" and not any(found.word in known for known in (self.ranges, self.pure, PURE)):
            calls = not found.word.isupper() or found.word in self.calling
        else:
            calls = found.kind == "assign"
        return calls or any(map(self.effects, found.operands))

    def range(self, found: Expression, variables: Mapping[str, Range]) -> Range | None:
        """Return least and greatest value of an expression; None if it depends on data.

        ``variables`` holds the ranges of the expression's variables.
        """
        match found.kind:
            case "number":
                return (int(found.word),) * 2 if _DECIMAL.fullmatch(found.word) else None
            case "name":
                size = self.sizes.get(found.word)
                return variables.get(found.word) if size is None else (size, size)
            case "call" | "index":
                return self.ranges.get(found.word)
            case "group":
                return self.range(found.operands[0], variables)
            case "unary" | "binary":
                return apply_operator(found.word, *(self.range(operand, variables) for operand in found.operands))
        return None

    def truth(self, found: Expression, variables: Mapping[str, Range] | None = None) -> bool | None:
        """Return True or False if constants decide an expression without effects, else None."""
        values = None if self.effects(found) else _truths(self.range(found, variables or {}))
        return None if values is None or values[0] < values[1] else bool(values[0])

    def reduce(self, text: str) -> bool | str:
        """Return a condition without operands of known value.

        True or False if the condition itself has a known value.
        """
        found = expression(text)
        left = self._reduce(text, found)
        if isinstance(left, bool) or found.kind == "group" or (bare := expression(left)).kind != "group":
            return left
        return left[bare.start + 1 : bare.end - 1]

    def _reduce(self, text: str, found: Expression) -> bool | str:
        before = text[found.start : found.end]
        value = self.truth(found)
        if value is not None:
            return value
        if found.word in ("&&", "||"):
            return self._reduce_pair(text, found)
        if found.kind not in ("group", "unary") or found.word not in ("(", "!"):
            return before
        inner = self._reduce(text, found.operands[0])
        if isinstance(inner, bool):
            return inner if found.kind == "group" else not inner
        bare = inner != text[slice(*found.operands[0][1:3])] and _is_operand(inner)
        if found.kind == "group":
            return inner if bare else f"({inner})"
        return f"!{inner}" if bare or _is_operand(inner) else f"!({inner})"

    def _reduce_pair(self, text: str, found: Expression) -> bool | str:
        first, second = found.operands
        left, right = self._reduce(text, first), self._reduce(text, second)
        decisive = found.word == "||"
        if left is decisive or (right is decisive and not self.effects(first)):
            return decisive
        if isinstance(left, bool):
            return right
        if right is (not decisive):
            return left
        kept = text[second.start : second.end] if isinstance(right, bool) else right
        return left + text[first.end : second.start] + kept


def _is_operand(text: str) -> bool:
    """Return True if a text needs no parentheses as an operand."""
    return expression(text).kind not in ("binary", "assign", "other")


def truth(values: Range | None) -> bool | None:
    """Return whether an expression with these values is true; None: unknown."""
    least, most = _truths(values)
    return None if least < most else bool(least)


def _truths(values: Range | None) -> Range:
    """Return least and greatest truth value of an expression."""
    if values is None or values[0] <= 0 <= values[1]:
        return (0, int(values != (0, 0)))
    return (1, 1)


def apply_operator(word: str, *values: Range | None) -> Range | None:
    """Return the range of an operator applied to ranges; None: unknown."""
    if word in ("==", "!=") and None not in values:
        equal = _truths(apply_operator("-", *values))
        return equal if word == "!=" else apply_operator("!", equal)
    if word in ("!", "&&", "||"):
        values = tuple(map(_truths, values))
    if None in values:
        return None
    if word in ("/", "%", "&"):
        return _range_of_quotient(word, *values)  # type: ignore[arg-type]
    if (word, len(values)) not in _MONOTONE:
        return None
    results = [int(_MONOTONE[word, len(values)](*ends)) for ends in product(*values)]  # type: ignore[arg-type]
    return min(results), max(results)


def _range_of_quotient(word: str, a: Range, b: Range) -> Range | None:
    """Return the range of a quotient or remainder, or of the last bit of a number.

    The dividend must be nonnegative, the divisor a positive constant.
    """
    if b[0] != b[1] or (word != "&" and not (a[0] >= 0 and b[0] > 0)) or (word == "&" and b[0] != 1):
        return None
    if word == "/":
        return a[0] // b[0], a[1] // b[0]
    by = 2 if word == "&" else b[0]
    return (a[0] % by,) * 2 if a[0] == a[1] else (0, by - 1)
