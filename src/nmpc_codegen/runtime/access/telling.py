"""References, weights, parameters and bounds are checked here and written to the structs of one controller or of many.

Arrays have the axes (structs, nodes, elements); a first axis of length 1 holds the same values for all structs.
Subclasses own the structs: they define how values are read and how they are passed to C.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import Kind
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.access.addressing import Addressing

Array = NDArray[Any]
Named = Mapping[str, ArrayLike]


class Telling(Addressing):
    """The base class checks data, completes them from stored data and passes them to C.

    Refused data change nothing.
    """

    def _tell_residuals(self, kind: Literal["reference", "weight"], value: ArrayLike | Named, node: int | None) -> None:
        """Set references or weights: of the path, of the end (node N), or by the names of residuals."""
        N, lengths = self.dims.N, self._lengths(kind, f"the {kind}", node)
        if isinstance(value, Mapping):
            self._tell_by_name(kind, value, node, lengths)
            return
        end = node is not None and node == N
        size, what = self._size_of_residual(end), f"terminal {kind}" if end else kind
        if self._path_of_end is None:
            lengths = tuple(n for n in lengths if n == N)
        if kind == "reference":
            rows = self._read(value, what, size, lengths, spread=False)
        else:
            rows = self._read_weights(value, what, size, end, lengths)
        if end:
            self._send(f"terminal_{kind}", rows, None)
            return
        at_end = self._at_end(kind, rows) if rows.shape[1] > N else None
        self._send(kind, rows[:, :N], node)
        if at_end is not None:
            self._send(f"terminal_{kind}", at_end, None)

    def _at_end(self, kind: str, rows: Array) -> Array:
        """Return the terminal reference or weight, as stored, from the terminal residual's entries of the last row."""
        places = self._path_of_end or []
        if kind == "reference":
            return rows[:, -1:, places]
        row = rows[0, -1]  # weights of nodes are the same for all
        part = np.diag(row[places]) if row.ndim == 1 else row[np.ix_(places, places)]
        return given.weights(part, "terminal weight", self._real, len(part), self._is_matrix(end=True))[None]

    def _tell_by_name(self, kind: Kind, values: Named, node: int | None, lengths: tuple[int, ...]) -> None:
        """Replace the named entries of references, or of the diagonals of weights."""
        N, matrices, path_name = self.dims.N, kind == "weight", "yref" if kind == "reference" else "W"
        path, end = self._copy_of(path_name), self._copy_of(f"{path_name}_N")
        sent = [False, False]
        for name, value in values.items():
            what, elements = f"{kind} of {name!r}", self._elements_of(name, node)
            rows = self._read(value, what, len(elements), lengths)
            if matrices and (rows < 0).any():
                raise ControllerError(f"weight of {name!r} is {rows.min():g}; expected numbers >= 0")
            for element, column in zip(elements, np.moveaxis(rows, -1, 0), strict=True):
                count = column.shape[1]
                here, there = self._places_of(element, what, count)
                every = node is None and count == 1 and (kind == "reference" or here is None)
                if here is not None and node != N:
                    nodes = slice(None) if node is None else slice(node, node + 1)
                    _diagonal(path)[:, nodes, here] = column[:, :N]
                    sent[0] = True
                if there is not None and (node == N or count > N or every):
                    _diagonal(end)[:, 0, there] = column[:, -1]
                    sent[1] = True
        ready: dict[str, Array] = {kind: path} if sent[0] else {}
        ready |= {f"terminal_{kind}": end} if sent[1] else {}
        if matrices:
            ready = {what: self._check_weights(W, what.replace("_", " ")) for what, W in ready.items()}
        for what, rows in ready.items():
            self._send(what, rows, None)

    def _places_of(self, element: str, what: str, rows: int) -> tuple[int | None, int | None]:
        """Return the index of a residual in the path and in the end; None where it does not occur.

        Raises:
            ControllerError: it occurs in neither, or N + 1 rows are given for one that is no terminal residual.
        """
        here = self.names.y.index(element) if element in self.names.y else None
        there = self.names.y_N.index(element) if element in self.names.y_N else None
        if rows > self.dims.N and there is None:
            raise ControllerError(f"{what}: N + 1 rows, but {element!r} is no terminal residual")
        if rows == self.dims.N > 1 and here is None:
            raise ControllerError(f"{what}: N rows, but {element!r} is a terminal residual only")
        return here, there

    @cached_property
    def _path_of_end(self) -> list[int] | None:
        """Return the index in the path residual of every terminal residual; None unless all of them occur there."""
        places = [self.names.y.index(name) for name in self.names.y_N if name in self.names.y]
        return places if places and len(places) == self.dims.ny_N else None

    def _check_weights(self, W: Array, what: str) -> Array:
        """Return checked weights, (structs, nodes, size) or (structs, nodes, size, size)."""
        rows = W.reshape(W.shape[0] * W.shape[1], *W.shape[2:])
        return given.check_weights(rows, what, self._real, lambda i: self._name_row(i, W.shape[1])).reshape(W.shape)

    def _tell_parameters(self, values: Named, node: int | None) -> None:
        """Set parameters, or elements of vectors, whose other elements keep their values."""
        checked = [self._checked_parameter(name, value, node) for name, value in values.items()]
        shared = self.description.online["parameter"] == "shared"
        for number in dict.fromkeys(one.number for one in checked):
            signal, mine = self.description.parameters[number], [one for one in checked if one.number == number]
            rows = mine[0].rows
            if len(mine) > 1 or mine[0].column is not None:
                stored = self._copy_of("p")[..., signal.offset : signal.offset + signal.size]
                for _, column, rows in mine:
                    count = rows.shape[1] if rows.shape[1] > 1 else stored.shape[1]
                    nodes = slice(count) if node is None else slice(-1, None) if shared else slice(node, node + 1)
                    stored[:, nodes, slice(None) if column is None else slice(column, column + 1)] = rows
                rows = stored if node is None else stored[:, nodes]
            if shared and node is None and rows.shape[1] > 1:
                self._send("parameter", rows[:, :1], None, number)
                self._send("parameter", rows[:, 1:], self.dims.N, number)
            else:
                self._send("parameter", rows, node, number)

    def _tell_bounds(self, bounds: Iterable[tuple[str, ArrayLike, ArrayLike]], node: int | None) -> None:
        """Set the bounds of rows, or of all rows of a vector."""
        for row, low, high in [
            one for name, *both in bounds for one in self._checked_bounds(name, both[0], both[1], node)
        ]:
            self._send_pair("set_bounds", row, low, high, node)

    # -- of those who own the structs ---------------------------------------------------------------------------------

    def _read_weights(self, W: ArrayLike, what: str, size: int, end: bool, lengths: Sequence[int]) -> Array:
        """Return checked weights, (structs or 1, nodes, size) or (structs or 1, nodes, size, size), for storage."""
        raise NotImplementedError

    def _send(self, what: str, rows: Array, node: int | None, *leading: int) -> None:
        """Pass rows to the setter of ``what``: one for a node, one for all nodes, or one for each node from 0 on."""
        raise NotImplementedError

    def _send_pair(self, call: str, row: int, first: Array, second: Array, node: int | None) -> None:
        """Pass two numbers of a row, (structs or 1, nodes) each, to a setter: for one node, for all, or for each."""
        raise NotImplementedError

    def _copy_of(self, member: str) -> Array:
        """Return a copy of the stored values, (structs, nodes, ...)."""
        raise NotImplementedError

    def _name_row(self, i: int, nodes: int) -> str:
        """Return the name of the node or struct to which row ``i`` belongs, with ``nodes`` rows for each struct."""
        raise NotImplementedError


def _diagonal(values: Array) -> Array:
    """Return a writable view on (structs, nodes, size), or on the diagonals of (structs, nodes, size, size)."""
    return np.einsum("skii->ski", values) if values.ndim == 4 else values
