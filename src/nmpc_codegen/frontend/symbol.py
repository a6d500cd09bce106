"""The symbols that an OCP hands out: SX that can be keys of a dictionary, and comparisons that explain themselves.

Python sees a row written as a comparison before the OCP does: ``-1 <= p <= 1`` asks for the truth of ``-1 <= p``.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import quote

COMPARISONS = {ca.OP_LE: "<=", ca.OP_LT: "<", ca.OP_EQ: "==", ca.OP_NE: "!="}


class Comparison(ca.SX):
    """The SX of ``p <= 1``; asked for its truth, it says how a row is stated."""

    __hash__ = ca.SX.__hash__

    def __bool__(self) -> bool:
        try:
            return bool(super().__bool__())
        except Exception as error:  # CasADi raises RuntimeError; a comparison of constants has a truth
            first = self if self.is_scalar() else self[0]
            raise ProblemError(
                f"the truth of {quote(first)} is not known before the problem is solved; state a row as "
                f"{row_call(self, 'subject_to') or 'subject_to(lower, expression, upper)'}, "
                "both sides of it in one call, and a case as casadi.if_else(condition, then, otherwise)"
            ) from error


class Symbol(ca.SX):
    """The SX symbol of a declared signal. It hashes by identity, so vectors are keys too; what is made of it is SX.

    Dictionaries compare keys only if their hashes are equal, so two symbols are never compared symbolically there.
    """

    __hash__ = object.__hash__

    def __lt__(self, other: Any) -> Any:
        return _compared(super().__lt__(other))

    def __le__(self, other: Any) -> Any:
        return _compared(super().__le__(other))

    def __gt__(self, other: Any) -> Any:
        return _compared(super().__gt__(other))

    def __ge__(self, other: Any) -> Any:
        return _compared(super().__ge__(other))


def _compared(result: Any) -> Any:
    return Comparison(result) if isinstance(result, ca.SX) else result


def is_comparison(expression: Any) -> bool:
    """True if an element of the SX is a comparison of two expressions."""
    elements = (expression[i] for i in range(expression.numel()))
    return any(not e.is_leaf() and e.op() in COMPARISONS for e in elements if e.is_scalar())


def row_call(expression: Any, method: str) -> str | None:
    """The call lower, expression, upper that states a comparison as a row; None for what is no comparison."""
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
