"""Rows of an OCP are stated as lower <= h(x, z, u, p) <= upper and lower <= r(x_0, x_N) <= upper."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.algebra.equations import Algebraic
from nmpc_codegen.frontend.checks import checked_soft, identifier, integer, quote, vector
from nmpc_codegen.frontend.problem import Array, c_identifier
from nmpc_codegen.frontend.statement import At, Penalty, Side, Statement, intersection
from nmpc_codegen.package.signals import Soft


class Constraints(Algebraic):
    """This part of OCP states rows."""

    _unnamed = 0  # number of rows with default names

    def _add_rows(
        self, lower: Any, h: Any, upper: Any, at: At | None, soft: Any, name: str | None, suffix: str, what: str
    ) -> None:
        n = h.numel()
        if n == 0:
            raise ProblemError(f"{what}: the expression is empty")
        lb, ub = (vector(v, n, f"{what}: {w}", finite=False) for v, w in ((lower, "lower"), (upper, "upper")))
        for i in range(n):
            if lb[i] > ub[i]:
                raise ProblemError(f"{what}: row {i} has lower {lb[i]:g} > upper {ub[i]:g}")
            if lb[i] == np.inf or ub[i] == -np.inf:
                raise ProblemError(f"{what}: row {i} has bounds {lb[i]:g}, {ub[i]:g}, which nothing can satisfy")
        penalty = checked_soft(soft, what)
        stated, unnamed = self._row_names(h, name, suffix, what)
        places = []
        for side, which, low, high, of_side in _sides(lb, ub, penalty):
            names = tuple(stated[i] for i in which)
            new = Statement(low, h[which], high, at, of_side, names, penalty.scale_with_dt, *side)
            places.append(self._find_place(new, what))
        self._refuse_clashes(places, what)
        _refuse_crossed(places, what)
        for place in places:
            place.take()
        self.statements.extend(new for place in places for new in place.left)
        self._unnamed += unnamed

    def _find_place(self, new: Statement, what: str) -> _Place:
        """Return where new rows are stored: in existing rows or in a new statement.

        The bounds of an existing row become the intersection of both.
        """
        earlier = {i: self._earlier(new, i) for i in range(new.expression.numel())}
        taken = tuple(
            (*there, *intersection(new, i, *there, what)) for i, there in earlier.items() if there is not None
        )
        left = [i for i, there in earlier.items() if there is None]
        parts = {"lower": new.lower[left], "expression": new.expression[left], "upper": new.upper[left]}
        rest = replace(new, **parts, stated=tuple(new.stated[i] for i in left))
        return _Place(taken, (rest,) if left else ())

    def _earlier(self, new: Statement, i: int) -> tuple[Statement, int] | None:
        """Return the earlier row with the same name, state or control, nodes and penalty; None if there is none."""
        element = self.element(new.expression[i])
        for s in self.statements:
            if element is None or (s.at, s.soft, s.scaled) != (new.at, new.soft, new.scaled):
                continue
            for j, name in enumerate(s.names):
                if name == new.names[i] and self.element(s.expression[j]) == element:
                    return s, j
        return None

    def _row_names(self, h: Any, name: str | None, suffix: str, what: str) -> tuple[tuple[str, ...], int]:
        """Return the names of the rows, and the number of default names row_i among them."""
        n, unnamed = h.numel(), 0
        if name is not None:
            identifier(name, what)
            names = [name] if n == 1 else [f"{name}[{i}]" for i in range(n)]
        else:
            names = []
            for i in range(n):
                element = self.element(h[i])
                if element is None or element.kind not in ("state", "control", "algebraic"):
                    names.append(f"row_{self._unnamed + unnamed}")
                    unnamed += 1
                else:
                    names.append(element.name)
        return tuple(f"{row}{suffix}" for row in names), unnamed

    def _refuse_clashes(self, places: Sequence[_Place], what: str) -> None:
        """Raise ProblemError if the name of a new row is already in use.

        If a row is one side of a two-sided row, the name of the latter counts as well.
        """
        taken = {c_identifier(name): name for s in self.statements for name in (*s.names, *s.stated)}
        new = dict.fromkeys(name for place in places for s in place.left for name in (*s.names, *s.stated))
        known = {name for place in places for s, j, *_ in place.taken for name in (s.stated[j],)}
        for row in new:
            key = c_identifier(row)
            if key in taken and row not in known:
                raise ProblemError(
                    f"{what}: the row name '{row}' clashes with '{taken[key]}' (both are ROW_{key.upper()} in C); "
                    "give name="
                )
            taken[key] = row

    def _at(self, at: Any, what: str) -> At:
        if isinstance(at, str):
            if at not in ("path", "start", "end"):
                raise ProblemError(f"{what}: at={at!r}, expected 'path', 'start', 'end' or an iterable of nodes")
            return at  # type: ignore[return-value]
        if not isinstance(at, Iterable):
            raise ProblemError(f"{what}: at={quote(at)}, expected 'path', 'start', 'end' or an iterable of nodes")
        try:
            listed = list(at)
        except Exception as error:
            raise ProblemError(f"{what}: at={quote(at)} is no iterable of nodes") from error
        nodes = sorted({integer(k, f"{what}: node in at=", 0) for k in listed})
        if not nodes:
            raise ProblemError(f"{what}: at= names no node")
        if nodes[-1] > self.N:
            raise ProblemError(f"{what}: node {nodes[-1]} in at= is out of range 0..{self.N}")
        return tuple(nodes)


@dataclass(frozen=True, eq=False)
class _Place:
    """New rows are stored in existing rows with new bounds, (statement, index, lower, upper), or in new statements."""

    taken: tuple[tuple[Statement, int, float, float], ...]
    left: tuple[Statement, ...]

    def take(self) -> None:
        for statement, j, lower, upper in self.taken:
            statement.lower[j], statement.upper[j] = lower, upper


def _refuse_crossed(places: Sequence[_Place], what: str) -> None:
    """Raise ProblemError if the two sides of a row contradict each other."""
    lowest: dict[str, float] = {}
    for place in places:
        rows = [(s.stated[j], lower, upper) for s, j, lower, upper in place.taken]
        rows += [r for s in place.left for r in zip(s.stated, map(float, s.lower), map(float, s.upper), strict=True)]
        for name, lower, upper in rows:
            if lowest.setdefault(name, lower) > upper:
                raise ProblemError(
                    f"{what}: the row '{name}' contradicts that stated before: {lowest[name]:g} > {upper:g}"
                )


def _sides(
    lower: Array, upper: Array, soft: Soft
) -> Iterator[tuple[tuple[Side, bool], list[int], Array, Array, Penalty]]:
    """Yield ((side, `alone`), rows, lower, upper, penalty): statements of rows, by side if penalties differ.

    A side without a bound and without a penalty is left out.
    """
    below: Any = soft.lower
    above: Any = soft.upper
    both, none = np.full(len(lower), below == above), np.full(len(lower), np.inf)
    no_lower, no_upper = ~both & (below is None) & (lower == -np.inf), ~both & (above is None) & (upper == np.inf)
    two = ~(both | no_lower | no_upper)
    for side, which, low, high, penalty in (
        (("", True), both, lower, upper, below),
        (("lower", True), no_upper, lower, upper, below),
        (("upper", True), no_lower, lower, upper, above),
        (("lower", False), two, lower, none, below),
        (("upper", False), two, -none, upper, above),
    ):
        rows = [int(i) for i in np.flatnonzero(which)]
        if rows:
            yield side, rows, low[rows], high[rows], penalty  # type: ignore[misc]
