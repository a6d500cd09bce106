"""A name and a node are resolved to the stored data (references, weights, parameters, bounds) that they denote."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import Kind, members
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.access.iterate import Iterate

Array = NDArray[Any]

EVERY_NODE = -1  # <NAME>_ALL of the C package


class Checked(NamedTuple):
    """A checked value of a parameter has its index, the element of the vector (None: all), and rows of values."""

    number: int
    column: int | None
    rows: Array  # (..., n, size)


class Addressing(Iterate):
    """An object that resolves names and nodes to the data of a package that can be changed at run time."""

    def _elements_of(self, name: str, node: int | None) -> list[str]:
        """Return the names of the residuals that ``name`` denotes, at one node or (None) at all nodes."""
        N = self.dims.N
        known = list(
            dict.fromkeys((*(self.names.y if node != N else ()), *(self.names.y_N if node in (None, N) else ())))
        )
        return [known[i] for i in self._members(name, known, "residual")]

    def _size_of_residual(self, end: bool) -> int:
        """Return the number of terminal (``end``) or path residuals; raise ControllerError if it is 0."""
        size = self.dims.ny_N if end else self.dims.ny
        if not size:
            raise ControllerError(f"{self._package.name} has no {'terminal' if end else 'path'} residual")
        return size

    def _is_matrix(self, end: bool) -> bool:
        """Return True if the weight is stored as a full matrix, not as a diagonal."""
        members = self.description.members("solver")
        found = members["W_N" if end else "W"]
        return len(found.values) == (2 if end else 3)

    def _rows_of(self, name: str) -> list[list[int]]:
        """Return the scalar rows called ``name``, one list for each row that the user stated.

        A row whose two sides have different penalties is stored as two rows.
        """
        if name in self.names.rows:
            return [[self.names.rows.index(name)]]
        of_rows = [row.user_name for row in self.description.rows]
        known = list(dict.fromkeys(of_rows))
        return [
            [i for i, stated in enumerate(of_rows) if stated == known[k]] for k in self._members(name, known, "row")
        ]

    def _lengths_of_rows(
        self, kind: Kind, name: str, groups: Sequence[Sequence[int]], node: int | None
    ) -> tuple[int, ...]:
        """Return _lengths() for rows: without node N only if none of them holds there.

        All rows must hold at ``node``.
        """
        lengths = self._lengths(
            kind, f"the {kind} of {name!r}" if kind == "bounds" else f"the penalty of {name!r}", node
        )
        rows = [self.description.rows[group[0]] for group in groups]
        for row in rows:
            own = list(row.nodes[-1:] if row.is_coupled else row.nodes)
            if node is not None and node not in own:
                raise ControllerError(f"{row.user_name!r} does not hold at node {node}, but at {own}")
        at_end = any(self.dims.N in row.nodes for row in rows)
        return tuple(n for n in lengths if n > self.dims.N) if at_end else lengths

    def _lengths(self, kind: Kind, what: str, node: int | None) -> tuple[int, ...]:
        """Return the allowed numbers of rows of a value with one row for each node; () if only one row is allowed.

        One row is allowed for a single node, and for data that all nodes share.

        Raises:
            ControllerError: this kind of data cannot be set, or not at this node.
        """
        layout, k, N = self.description.online[kind], self._node(node), self.dims.N
        if layout == "fixed":
            raise ControllerError(
                f'{self._package.name}: {what} cannot be set: it was generated with Online({kind}="fixed"); '
                f'generate it with "shared" or "node"'
            )
        if layout == "shared" and k not in (EVERY_NODE, N):
            raise ControllerError(
                f"{self._package.name}: {what} cannot be set at node {node}; expected node None or {N}: "
                f'it was generated with Online({kind}="shared")'
            )
        return tuple(n for n in (N, N + 1) if n > 1) if layout == "node" and node is None else ()

    def _node(self, node: int | None) -> int:
        """Return the number of a node in C, where EVERY_NODE stands for None.

        The C code checks whether the data of this node can be set.
        """
        if node is None:
            return EVERY_NODE
        if not given.is_integer(node) or not 0 <= node <= self.dims.N:
            raise ControllerError(f"node is {node!r}; expected None or an integer in 0..{self.dims.N}")
        return int(node)

    def _lookup(self, name: str, known: Sequence[str], kind: str) -> int:
        if name not in known:
            there = ", ".join(map(repr, known)) or "none"
            raise ControllerError(f"{self._package.name} has no {kind} {name!r}; those that exist: {there}")
        return known.index(name)

    def _members(self, name: str, known: Sequence[str], kind: str) -> list[int]:
        """Return the indices of the element ``name``, or of all elements ``name[i]`` of a vector."""
        return members(name, known) or [self._lookup(name, known, kind)]

    def _checked_parameter(self, name: str, value: ArrayLike, node: int | None) -> Checked:
        signals = self.description.parameters
        names = [p.name for p in signals]
        base = name.rpartition("[")[0] if isinstance(name, str) and name not in names else ""
        index = self._lookup(base if base in names else name, names, "parameter")
        signal, what = signals[index], f"parameter {name!r}"
        lengths = self._lengths("parameter", what, node)
        column = None if name == signal.name else self._lookup(name, signal.elements, "parameter")
        rows = self._read(value, what, signal.size if column is None else 1, lengths)
        if signal.low:
            own = slice(None) if column is None else slice(column, column + 1)
            given.check_range(rows, signal.low[own], signal.high[own], what)
        return Checked(index, column, rows)

    def _checked_bounds(
        self, name: str, lower: ArrayLike, upper: ArrayLike, node: int | None
    ) -> Iterator[tuple[int, Array, Array]]:
        """Yield (row, lower, upper) for every row called ``name``; the last axis has one number, or one per node."""
        groups = self._rows_of(name)
        lengths = self._lengths_of_rows("bounds", name, groups, node)
        low, high = (
            self._read(value, f"{which} bound of {name!r}", len(groups), lengths, finite=False)
            for which, value in (("lower", lower), ("upper", upper))
        )
        yield from self._bounds_of_rows(name, groups, *given.broadcast_rows(low, high, f"bounds of {name!r}"))

    def _bounds_of_rows(
        self, name: str, groups: Sequence[Sequence[int]], low: Array, high: Array
    ) -> Iterator[tuple[int, Array, Array]]:
        """Yield (row, lower, upper) from bounds (..., n, groups); raise ControllerError if they are crossed or NaN."""
        for i, group in enumerate(groups):
            row = self.description.rows[group[0]]
            one_low, one_high = low[..., i], high[..., i]
            if not ((one_low <= one_high) & (one_low < np.inf) & (one_high > -np.inf)).all():
                for low_of, high_of in zip(*(b.reshape(-1, b.shape[-1]) for b in (one_low, one_high)), strict=True):
                    given.check_bounds(low_of, high_of, row)
            for number in group:
                side = self.description.rows[number].side if name != self.names.rows[number] or len(group) == 1 else ""
                other = {"lower": one_high < np.inf, "upper": one_low > -np.inf}.get(side)
                if len(group) == 1 and other is not None and other.any():
                    raise ControllerError(
                        f"bounds of {name!r}: it has the {side} side alone; state it with both bounds, or with "
                        "soft=Soft(lower=(l1, l2), upper=(l1, l2))"
                    )
                yield (
                    number,
                    np.full_like(one_low, -np.inf) if side == "upper" else one_low,
                    np.full_like(one_high, np.inf) if side == "lower" else one_high,
                )

    def _read(
        self,
        value: ArrayLike,
        what: str,
        size: int,
        lengths: Sequence[int],
        finite: bool = True,
        spread: bool = True,
    ) -> Array:
        """Return values that a user gives for nodes, (structs or 1, n, size), where n is 1 or one of ``lengths``.

        With ``spread``, a single number is used for all elements.
        """
        raise NotImplementedError
