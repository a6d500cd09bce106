"""References, weights, parameters and bounds are set for all controllers of a batch, or for some of them.

The first axis of an array is that of the controllers: one row for each, or one row for all. It may be left out if no
axis of nodes follows:

    a number, (size,)     one value for all controllers and nodes
    (M, size), (1, size)  a value for each controller, for all of its nodes; (M,), (1,) if the value is a number
    (M, nodes, size)      a value for each node; (1, nodes, size) if it is the same for all controllers
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.access.telling import Telling
from nmpc_codegen.runtime.batch.struct_block import Structs

Array = NDArray[Any]


class Told(Telling):
    """The setters apply to the controllers of a batch with the numbers ``index``; None: to all."""

    def __init__(self, batch: Structs, index: ArrayLike | None) -> None:
        super().__init__(batch._package, batch._struct)
        self._batch = batch
        self._index = None if index is None else numbers(index, len(batch))
        self._count = len(batch) if self._index is None else len(self._index)

    def _number(self, i: int) -> int:
        """Return the number of a controller in the batch from its place in ``index``."""
        return i if self._index is None else int(self._index[i])

    def _name_row(self, i: int, nodes: int) -> str:
        return f"controller {self._number(i // nodes)}"

    def _copy_of(self, member: str) -> Array:
        view = self._view(member)
        found = np.array(view if self._index is None else view[self._index])
        return found[:, None] if member.endswith("_N") else found

    def _read_weights(self, W: ArrayLike, what: str, size: int, end: bool, lengths: Sequence[int]) -> Array:
        shape = np.shape(W) if given.ndim(W) >= 0 else ()
        if shape == (size, size) and size > 1 and self._count == size:
            raise ControllerError(
                f"weight has shape {shape}; expected W[None] for a matrix, W[:, None] for diagonals of the controllers"
            )
        diagonal = len(shape) < 3 or (shape[1] == 1 and size > 1)
        if diagonal and len(shape) == 3:
            W = np.asarray(W)[:, 0]
        flat = self._read(W, "weight", size if diagonal else size * size, [], matrix=None if diagonal else size)
        rows = self._check_weights(flat if diagonal else flat.reshape(len(flat), 1, size, size), "weight")
        if self._is_matrix(end) and diagonal:
            return np.asarray(np.einsum("ski,ij->skij", rows, np.eye(size, dtype=self._real)))
        if not self._is_matrix(end) and not diagonal:
            return given.weights(rows[:, 0], "weight", self._real, size, False, [len(rows)])[:, None]
        return rows

    def _read(
        self,
        value: ArrayLike,
        what: str,
        size: int,
        lengths: Sequence[int],
        finite: bool = True,
        spread: bool = True,
        matrix: int | None = None,
    ) -> Array:
        """Return values as (count or 1, 1 or one of ``lengths``, size); a single number is used for all elements.

        With ``matrix``, the elements are square matrices with ``matrix`` rows.
        """
        one: tuple[int, ...] = (size,) if matrix is None else (matrix, matrix)
        axes = [(), *((n,) for n in (self._count, 1)), *((n, k) for n in (self._count, 1) for k in lengths)]
        bare = axes if size == 1 else [()]  # numbers, without an axis of elements
        allowed = list(dict.fromkeys([*(bare if matrix is None else []), *((*a, *one) for a in axes)]))
        shape = np.shape(value) if given.ndim(value) >= 0 else None
        found = shape if shape in allowed and shape is not None else (self._count, *one)
        array = given.checked_array(value, what, self._real, found, finite, lambda: ", ".join(map(str, allowed)))
        if found == ():
            return np.full((1, 1, size), array)
        before = found if matrix is None and found in bare else found[: len(found) - len(one)]
        return array.reshape(*(before + (1, 1)[len(before) :] if before else (1, 1)), size)

    def _send(self, what: str, rows: Array, node: int | None, *leading: int) -> None:
        """Pass rows (count or 1, nodes, size) to a setter."""
        function, nodes, rows = f"set_{what}", rows.shape[1], rows.reshape(*rows.shape[:2], math.prod(rows.shape[2:]))
        if what.startswith("terminal"):
            operation, places = "SET", leading
        elif nodes == 1:
            operation, places = "SET_TWO" if leading else "SET_NODE", (*leading, self._node(node))
        else:
            operation, places = "SET_THREE" if leading else "SET_TWO", (*leading, 0, nodes)
            function = f"{function}_range"
        self._call(operation, function, what.replace("_", " "), rows, None, places)

    def _send_pair(self, call: str, row: int, first: Array, second: Array, node: int | None) -> None:
        what, count = f"row {self.names.rows[row]!r}", first.shape[1]
        if count == 1:
            self._call("SET_PAIR", call, what, first, second, (row, self._node(node)))
        else:
            self._call("SET_PAIRS", f"{call}_range", what, first, second, (row, 0, count))

    def _call(
        self, operation: str, function: str, what: str, first: Array, second: Array | None, places: Sequence[int]
    ) -> None:
        """Call a setter for each controller in ``index``; the data have been checked, so C does not refuse them."""
        ready = [None if a is None else np.ascontiguousarray(a, dtype=self._real) for a in (first, second)]
        status = self._batch.call(
            operation, function, index=self._index, first=ready[0], second=ready[1], places=places
        )
        if status.any():
            i = int(np.flatnonzero(status)[0])
            raise ControllerError(
                f"{self._package.name}.{function} of controller {self._number(i)} ({what}): {Status(status[i])}"
            )


def numbers(index: ArrayLike, count: int) -> NDArray[np.int64]:
    """Return the numbers of controllers from integers or from a mask (count,).

    Raises:
        ControllerError: there is no such controller, or a number occurs twice.
    """
    found = np.atleast_1d(np.asarray(index))
    if found.dtype == np.bool_ and found.shape == (count,):
        return np.flatnonzero(found)
    if found.ndim != 1 or (found.size and found.dtype.kind not in "iu"):
        raise ControllerError(f"index is {index!r:.60}; expected integers, or a mask of shape ({count},)")
    chosen = found.astype(np.int64)
    if ((chosen < -count) | (chosen >= count)).any():
        raise ControllerError(f"index names controller {chosen[(chosen < -count) | (chosen >= count)][0]} of {count}")
    chosen %= count
    if len(np.unique(chosen)) < len(chosen):
        raise ControllerError("index names a controller twice")
    return chosen
