"""An OCP returns symbols that can be keys of a dictionary, and whose comparisons raise a clear error.

Python evaluates a chained comparison before the OCP sees it: for ``-1 <= p <= 1`` it needs the truth value of ``-1 <=
p``.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import quote

COMPARISONS = {ca.OP_LE: "<=", ca.OP_LT: "<", ca.OP_EQ: "==", ca.OP_NE: "!="}


class Comparison(ca.SX):
    """A comparison is the SX of ``p <= 1``; its truth value raises a ProblemError that explains how to state a row."""

    __hash__ = ca.SX.__hash__

    def __bool__(self) -> bool:
        try:
            return bool(super().__bool__())
        except Exception as error:  # CasADi raises RuntimeError; a comparison of constants has a truth value
            first = self if self.is_scalar() else self[0]
            raise ProblemError(
                f"the truth value of {quote(first)} is not known before the problem is solved; state a row as "
                f"{row_call(self, 'subject_to') or 'subject_to(lower, expression, upper)'}, "
                "with both bounds in one call, and a case distinction as casadi.if_else(condition, then, otherwise)"
            ) from error


class Symbol(ca.SX):
    """A symbol is the SX symbol of a declared signal, and hashes by identity, so that vectors can be keys, too.

    A dictionary compares keys only if their hashes are equal, so it never compares two symbols symbolically.
    Expressions formed from a Symbol are plain SX.
    """

    __hash__ = object.__hash__

    def __lt__(self, other: Any) -> Any:
        return _compare(super().__lt__(other))

    def __le__(self, other: Any) -> Any:
        return _compare(super().__le__(other))

    def __gt__(self, other: Any) -> Any:
        return _compare(super().__gt__(other))

    def __ge__(self, other: Any) -> Any:
        return _compare(super().__ge__(other))


def _compare(result: Any) -> Any:
    return Comparison(result) if isinstance(result, ca.SX) else result


def is_comparison(expression: Any) -> bool:
    """Return True if an element of the SX is a comparison of two expressions."""
    elements = (expression[i] for i in range(expression.numel()))
    return any(not e.is_leaf() and e.op() in COMPARISONS for e in elements if e.is_scalar())


def row_call(expression: Any, method: str) -> str | None:
    """Return the call that states a comparison as a row; None if the expression is not a comparison."""
    if not isinstance(expression, ca.SX) or expression.numel() == 0 or not is_comparison(expression):
        return None
    first = ca.densify(expression)[0]
    if first.is_leaf() or first.op() not in COMPARISONS or first.op() == ca.OP_NE:
        return None
    left, right = first.dep(0), first.dep(1)
    equal = first.op() == ca.OP_EQ
    if left.is_constant():
        return f"{method}({left}, {right}, {left if equal else 'inf'})"
    if right.is_constant():
        return f"{method}({right if equal else '-inf'}, {left}, {right})"
    return f"{method}({'0' if equal else '-inf'}, {left - right}, 0)"


def require_three(lower: Any, expr: Any, upper: Any, what: str, method: str) -> None:
    """Raise ProblemError if a row is written as a comparison or one of its three parts is missing."""
    for part in (lower, expr, upper):
        call = row_call(part, method)
        if call:
            raise ProblemError(f"{what}: {quote(part)} is a comparison; the same row is {call}")
        if isinstance(part, ca.SX) and is_comparison(part):
            raise ProblemError(f"{what}: {quote(part)} is a comparison, not an expression with a lower and upper bound")
    if expr is None or upper is None:
        given = ", ".join(quote(part) for part in (lower, expr) if part is not None)
        raise ProblemError(
            f"{what}: got {given} only; it takes lower, expression, upper, where -inf and inf stand for no bound"
        )
