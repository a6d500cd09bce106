"""Arithmetic of intervals of integers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

#: Least and largest value; None: unknown.
Range = tuple[int, int] | None


def entries(table: Sequence[int], index: Range) -> Range:
    """Entries of a table at these indices."""
    known = index is not None and 0 <= index[0] <= index[1] < len(table)
    among = table[index[0] : index[1] + 1] if known and index is not None else table
    return (min(among), max(among)) if among else None


def union(ranges: Sequence[Range]) -> Range:
    """An interval that contains all of them."""
    known = [r for r in ranges if r is not None]
    if not known or len(known) < len(ranges):
        return None
    return min(low for low, _ in known), max(high for _, high in known)


def truth(value: Range) -> bool | None:
    """Whether a condition with these values holds; None: unknown."""
    if value is None or value[0] <= 0 <= value[1]:
        return False if value == (0, 0) else None
    return True


def combine(op: str, a: Range, b: Range) -> Range:
    """Values of ``a op b``."""
    if op in ("&&", "||"):
        left, right = truth(a), truth(b)
        decided = op == "||"
        if decided in (left, right):
            return (int(decided),) * 2
        return (0, 1) if None in (left, right) else (int(not decided),) * 2
    if a is None or b is None:
        return (0, 1) if op in COMPARISONS else None
    if op in COMPARISONS:
        found = {COMPARISONS[op](x, y) for x, y in _extremes(op, a, b)}
        return (int(min(found)), int(max(found)))
    if op == "+":
        return a[0] + b[0], a[1] + b[1]
    if op == "-":
        return a[0] - b[1], a[1] - b[0]
    if op == "*":
        products = [x * y for x in a for y in b]
        return min(products), max(products)
    if op == "/" and b[0] == b[1] > 0 and a[0] >= 0:
        return a[0] // b[0], a[1] // b[0]
    if op == "&" and b == (1, 1):
        return (a[0] & 1,) * 2 if a[0] == a[1] else (0, 1)
    if op == "%" and b[0] == b[1] > 0 and a[0] >= 0:
        return (a[0] % b[0],) * 2 if a[0] == a[1] else (0, b[0] - 1)
    return None


def _extremes(op: str, a: tuple[int, int], b: tuple[int, int]) -> list[tuple[int, int]]:
    """Pairs between which a comparison takes all its values."""
    pairs = [(x, y) for x in a for y in b]
    if op in ("==", "!=") and max(a[0], b[0]) <= min(a[1], b[1]):
        pairs.append((max(a[0], b[0]),) * 2)
    return pairs


COMPARISONS: Mapping[str, Callable[[int, int], bool]] = {
    "<": lambda x, y: x < y,
    "<=": lambda x, y: x <= y,
    ">": lambda x, y: x > y,
    ">=": lambda x, y: x >= y,
    "==": lambda x, y: x == y,
    "!=": lambda x, y: x != y,
}
