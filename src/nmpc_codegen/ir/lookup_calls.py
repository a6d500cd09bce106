"""Look-up tables inside CasADi expressions are calls that nothing expands and whose derivatives are 0.

A piecewise polynomial is a sum of products of entries and powers of the distance from a point of its grid. Interval and
entries are constant between jumps, so the rules of sums and products give all its derivatives. The first argument of
every call is the key of its table. CasADi adds calls for derivatives, which have more arguments and the value 0.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca

from nmpc_codegen.ir.casadi_types import Function
from nmpc_codegen.package.lookup import Lookup

#: Key -> table that an expression of this process contains.
_KNOWN: dict[float, Lookup] = {}


def look_up(table: Lookup, operand: Any) -> Any:
    """Return the value of a table as an expression, SX or MX."""
    if table.key not in _KNOWN:
        _KNOWN[table.key] = table
    return _function(table.key)(table.key, operand)


def known_lookup(key: float) -> Lookup:
    """Return the table with a key that an expression contains."""
    return _KNOWN[key]


def called_lookup(key: float | None, arguments: int) -> Lookup | None:
    """Return the table that a call with this first argument reads; None for a derivative, which is 0.

    Raises:
        KeyError: the call reads no table.
    """
    if key is None or key not in _KNOWN:
        raise KeyError(key)
    return _KNOWN[key] if arguments == 2 else None


@lru_cache(maxsize=256)
def _function(of: float) -> Function:
    """Return (key, operand) -> value of the table with that key; its derivatives are 0."""
    table = _KNOWN[of]
    key, x, value = ca.MX.sym("key"), ca.MX.sym("x"), ca.MX.sym("value")
    data = ca.MX(ca.DM(list(table.values)))
    found = ca.low(data, x) if table.part == "interval" else data[x]
    zero = ca.Function(f"jac_{table.function}", [key, x, value], [ca.MX(1, 1), ca.MX(1, 1)])
    return ca.Function(table.function, [key, x], [found], {"never_inline": True, "custom_jacobian": zero})
