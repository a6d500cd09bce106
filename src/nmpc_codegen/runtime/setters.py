"""What a controller is told while it runs: references, weights, parameters, bounds, the control and time of the plant.

Every setter takes one value for all nodes, an array with a row for each node, or {name: one of these}, where a name is
that of an element or of a vector. Arrays are one call of the C package; what is refused changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import Kind, Soft
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.access.addressing import EVERY_NODE, Addressing, Checked
from nmpc_codegen.runtime.memory import Memory

__all__ = ["EVERY_NODE", "Setters"]

Array = NDArray[Any]
Named = Mapping[str, ArrayLike]
Penalty = float | tuple[ArrayLike, ArrayLike]


class Setters(Memory, Addressing):
    """The data of a controller that can be changed at run time."""

    # -- references and weights ---------------------------------------------------------------------------------------

    def set_reference(self, y: ArrayLike | Named, node: int | None = None) -> None:
        """Set references of residuals.

        Args:
            y: (ny,), the path residual; (N, ny), one row per node, or (N+1, ny) if the terminal residual consists of
                residuals of the path; (N,) and (N+1,) if ny = 1. Or {name: value}, where a name is that of a residual
                or of a vector of them: a number, or one per element, sets it at every node, at the end too if the
                terminal residual has that name; an array with a row per node as above. Others stay.
            node: 0..N-1, N for the terminal residual, None for every node. Online(reference="shared") allows None and
                N, and no rows per node.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.

        Examples:
            >>> from nmpc_codegen import build
            >>> controller = build(ocp)
            >>> controller.set_reference({"h": 0.8})
            >>> controller.set_reference(np.linspace(0.5, 0.8, 10)[:, None])
        """
        self._set_residuals("reference", y, node)

    def set_terminal_reference(self, y: ArrayLike | Named) -> None:
        """Set the reference of the terminal residual.

        Args:
            y: (ny_N,), or {name: value}.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        self._set_residuals("reference", y, self.dims.N)

    def set_weight(self, W: ArrayLike | Named, node: int | None = None) -> None:
        """Set weights of residuals, symmetric positive semidefinite up to rounding; (W + W') / 2 is stored.

        Rows and columns of residuals that were stated with scale_with_dt are multiplied by dt_k wherever W is used, so
        give them as in least_squares().

        Args:
            W: the diagonal (ny,) or the matrix (ny, ny) of the path residual; or (N, ny) and (N, ny, ny), one per node,
                and with N+1 rows as for set_reference(); (ny, ny) is a matrix if N = ny, too. Or {name: value}:
                entries of the diagonal. A number sets those of the path, as weights of the end are other ones; N+1
                rows and node=N set the end.
                Off-diagonal entries require a weight that was declared with some, or Online(dense_weight=True).
            node: 0..N-1, N for the terminal residual, None for every node. Online(weight="shared") allows None and N,
                and no rows per node.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        self._set_residuals("weight", W, node)

    def set_terminal_weight(self, W: ArrayLike | Named) -> None:
        """Set the weight of the terminal residual.

        Args:
            W: the diagonal (ny_N,) or the matrix (ny_N, ny_N), or {name: entry of the diagonal}.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        self._set_residuals("weight", W, self.dims.N)

    # -- parameters and bounds ----------------------------------------------------------------------------------------

    def set_parameter(self, name: str, value: ArrayLike, node: int | None = None) -> None:
        """Set the value of a parameter.

        Args:
            name: the declared name of a number or vector, or of an element of a vector, r[1].
            value: a number, or (size,); or one row per node, (N+1, size), or (N, size) for the nodes before the end;
                (N+1,) and (N,) if size = 1. A value outside of the bounds that the parameter was declared with is an
                error.
            node: 0..N, or None for every node. Online(parameter="shared") allows None and N, and no rows per node.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.

        Examples:
            >>> from nmpc_codegen import build
            >>> controller = build(ocp)
            >>> controller.set_parameter("drain", 0.12)
            >>> controller.set_parameter("drain", np.linspace(0.1, 0.2, 11))
        """
        one = self._checked_parameter(name, value, node)
        if one.column is None:
            self._send("set_parameter", one.rows, node, one.number)
        else:
            self._send_elements([one], node)

    def set_parameters(self, values: Named | None = None, /, *, node: int | None = None, **more: ArrayLike) -> None:
        """Set several parameters, set_parameters(m=0.8, k=[1.0, 2.0]): all of them, or none if one is wrong.

        Args:
            values: {name: value}, for names that are no keywords: elements of vectors, a parameter named node.
            node: as in set_parameter().
            more: name=value.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        if values is not None and not isinstance(values, Mapping):
            raise ControllerError(f"set_parameters: {values!r} is no {{name: value}}")
        named = {**(values or {}), **more}
        self._send_elements([self._checked_parameter(n, v, node) for n, v in named.items()], node)

    def set_bounds(
        self,
        name: str | Mapping[str, tuple[ArrayLike, ArrayLike]],
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        node: int | None = None,
    ) -> None:
        """Set the bounds of a row, or of all rows of a vector by its base name: all of them, or none if one is wrong.

        Args:
            name: name of the row, e.g. "swing" or "r[1]"; or "r" for r[0], r[1], ...; or {name: (lower, upper)}.
            lower: a number or one per row; -inf: no bound. Or one row per node, (N+1, rows), (N+1,) for one row, where
                nodes at which the row does not hold count nothing; with N rows if it does not hold at the end.
            upper: the same; +inf: no bound.
            node: a node of the row, or None for all of them. Online(bounds="shared") allows None and N, and no rows
                per node.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.

        Examples:
            >>> from nmpc_codegen import build
            >>> controller = build(ocp)
            >>> controller.set_bounds("q", 0, 0.1)
            >>> controller.set_bounds({"q": (0, 0.15)})
        """
        if isinstance(name, Mapping):
            self._expect_alone("set_bounds", lower, upper)
            pairs = [(n, given.pair(both, f"bounds of {n!r}")) for n, both in name.items()]
        elif lower is None or upper is None:
            raise ControllerError(f"bounds of {name!r}: expected a lower and an upper one; -inf and inf: no bound")
        else:
            pairs = [(name, (lower, upper))]
        checked = [one for n, both in pairs for one in self._checked_bounds(n, *both, node)]
        for row, low, high in checked:
            self._send_pair("set_bounds", row, low, high, node)

    def set_soft(
        self, name: str | Mapping[str, Penalty | Soft], soft: Penalty | Soft | None = None, node: int | None = None
    ) -> None:
        """Set the penalties l1 v + l2/2 v^2 of violations of a soft row: all that are named, or none if one is wrong.

        Args:
            name: name of the row, or of a vector of rows; or {name: penalties}.
            soft: (l1, l2) or l1 for both sides; Soft(lower=(l1, l2), upper=(l1, l2)) by side, where a side that is
                None stays as it is. l1 and l2 are numbers, or one per node, (N+1,), or (N,) if the row does not hold at
                the end. An infinite l1, for a hard row, is for rows that were declared with one; a declared l2 = 0
                stays 0, a positive one positive.
            node: a node of the row, or None for all of them. Online(soft="shared") allows None and N, and no rows per
                node.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        if isinstance(name, Mapping):
            self._expect_alone("set_soft", soft)
        pairs = list(name.items()) if isinstance(name, Mapping) else [(name, soft)]
        checked = [one for n, value in pairs for one in self._checked_soft(n, value, node)]
        for row, l1, l2 in checked:
            self._send_pair("set_soft", row, l1, l2, node)

    # -- the plant ----------------------------------------------------------------------------------------------------

    def set_previous(self, u: ArrayLike) -> None:
        """Set the control that was applied last: what the actuator did, where it is not what step() returned.

        Call it after step() or feedback(), which set it to the control that they return.

        Args:
            u: (nu,).

        Raises:
            ControllerError: the problem contains neither previous() nor rate().
        """
        self._needs("previous")
        value = self._array("previous control", u, (self.dims.nu,))
        self._expect(self._call("set_previous", self._s, self._pointer(value)), "set_previous")

    def set_time(self, time: float) -> None:
        """Set the time of the next sample, which step() and feedback() move on by the sampling time.

        A sample that has been prepared sees the change to first order.

        Args:
            time: in the unit of the problem.

        Raises:
            ControllerError: the problem does not contain ocp.time.
        """
        self._needs("time")
        value = float(self._array("time", time, ()))
        self._expect(self._call("set_time", self._s, value), "set_time")

    # -- inner: residuals ---------------------------------------------------------------------------------------------

    def _set_residuals(self, kind: Literal["reference", "weight"], value: ArrayLike | Named, node: int | None) -> None:
        lengths = self._lengths(kind, f"the {kind}", node)
        if isinstance(value, Mapping):
            self._set_by_name(kind, value, node, lengths)
            return
        d, end = self.dims, node is not None and node == self.dims.N
        size = self._size_of_residual(end)
        what = f"terminal {kind}" if end else kind
        if self._path_of_end is None:
            lengths = tuple(n for n in lengths if n == d.N)
        if kind == "reference":
            rows = given.rows(value, what, self._real, size, lengths, spread=False)
        else:
            rows = given.weights(value, what, self._real, size, self._is_matrix(end), lengths)
        if end:
            self._send(f"set_terminal_{kind}", rows, None)
            return
        at_end = self._row_at_end(kind, rows[-1]) if len(rows) > d.N else None
        self._send(f"set_{kind}", rows[: d.N], node)
        if at_end is not None:
            self._send(f"set_terminal_{kind}", at_end, None)

    def _row_at_end(self, kind: str, row: Array) -> Array:
        """The part of a row of the path that is the terminal residual's, as it is stored."""
        places = self._path_of_end or []
        if kind == "reference":
            return row[None, places]
        part = np.diag(row[places]) if row.ndim == 1 else row[np.ix_(places, places)]
        return given.weights(part, "terminal weight", self._real, len(part), self._is_matrix(end=True))

    def _set_by_name(self, kind: Kind, values: Named, node: int | None, lengths: tuple[int, ...]) -> None:
        """Replace entries of references, or of the diagonals of weights."""
        N, matrices, path_name = self.dims.N, kind == "weight", "yref" if kind == "reference" else "W"
        path, end = (np.array(self._view(name)) for name in (path_name, f"{path_name}_N"))
        sent = [False, False]
        for name, value in values.items():
            elements = self._elements_of(name, node)
            rows = given.rows(value, f"{kind} of {name!r}", self._real, len(elements), lengths)
            if matrices and (rows < 0).any():
                raise ControllerError(f"weight of {name!r} is {rows.min():g}; expected numbers >= 0")
            for element, column in zip(elements, rows.T, strict=True):
                here, there = self._places_of(element, f"{kind} of {name!r}", len(column))
                every = node is None and len(column) == 1 and (kind == "reference" or here is None)
                if here is not None and node != N:
                    nodes = slice(None) if node is None else slice(node, node + 1)
                    _diagonal(path, matrices and path.ndim == 3)[nodes, here] = column[:N]
                    sent[0] = True
                if there is not None and (node == N or len(column) > N or every):
                    _diagonal(end[None], matrices and end.ndim == 2)[0, there] = column[-1]
                    sent[1] = True
        if matrices:
            for W, word in ((path, "weight"), (end[None], "terminal weight")):
                W[...] = given.check_weights(W, word, self._real)
        if sent[0]:
            self._send(f"set_{kind}", path, None)
        if sent[1]:
            self._send(f"set_terminal_{kind}", end[None], None)

    def _places_of(self, element: str, what: str, rows: int) -> tuple[int | None, int | None]:
        """Places of a residual in those of the path and of the end, None: it is none there; ControllerError unless so
        many rows fit."""
        here = self.names.y.index(element) if element in self.names.y else None
        there = self.names.y_N.index(element) if element in self.names.y_N else None
        if rows > self.dims.N and there is None:
            raise ControllerError(f"{what}: N + 1 rows, but {element!r} is no terminal residual")
        if rows == self.dims.N > 1 and here is None:
            raise ControllerError(f"{what}: N rows, but {element!r} is a terminal residual only")
        return here, there

    @cached_property
    def _path_of_end(self) -> list[int] | None:
        """For every terminal residual its place in that of the path; None if one is missing there, or there is none."""
        places = [self.names.y.index(name) for name in self.names.y_N if name in self.names.y]
        return places if places and len(places) == self.dims.ny_N else None

    # -- inner: parameters and bounds ---------------------------------------------------------------------------------

    def _send_elements(self, checked: Sequence[Checked], node: int | None) -> None:
        """Send parameters of which some are elements of vectors, whose others stay as they are."""
        signals, stored = self.description.parameters, np.array(self._view("p"))
        shared = self.description.online["parameter"] == "shared"
        for index, column, rows in checked:
            first = signals[index].offset + (column or 0)
            columns = slice(first, first + rows.shape[1])
            count = len(rows) if len(rows) > 1 else len(stored)
            nodes = slice(count) if node is None else slice(-1, None) if shared else slice(node, node + 1)
            stored[nodes, columns] = rows
        for index in dict.fromkeys(one.number for one in checked):
            signal = signals[index]
            rows = stored[:, signal.offset : signal.offset + signal.size]
            if shared and node is None:
                self._send("set_parameter", rows[:1], None, index)
                self._send("set_parameter", rows[1:], self.dims.N, index)
            elif node is None:
                self._send("set_parameter", rows, None, index)
            else:
                self._send("set_parameter", rows[[-1 if shared else node]], node, index)

    def _checked_soft(
        self, name: str, soft: Penalty | Soft | None, node: int | None
    ) -> Iterator[tuple[int, Array, Array]]:
        """(row, l1, l2) for every row of that name: one number, or one per node."""
        groups = self._rows_of(name)
        lengths = self._lengths_of_rows("soft", name, groups, node)
        for number in (number for group in groups for number in group):
            row = self.description.rows[number]
            what = f"penalty of {row.name!r}"
            if row.soft is None:
                raise ControllerError(f"{row.name!r} is hard: state it with soft=(l1, l2), l1 = inf: hard at first")
            pair = given.penalty_of_row(soft, row, what)
            if pair is None and (len(groups) == len(groups[0]) == 1):
                raise ControllerError(f"{what}: it has the {row.side} side alone")
            if pair is None:
                continue
            l1, l2 = (given.rows(value, what, self._real, 1, lengths, finite=False)[:, 0] for value in pair)
            l1, l2 = given.alike(l1, l2, what)
            given.check_penalties(l1, l2, row.soft, what)
            yield number, l1, l2

    def _send_pair(self, call: str, row: int, first: Array, second: Array, node: int | None) -> None:
        """Send two numbers of a row, for a node or for all, or two for each node from node 0 on."""
        if len(first) == 1:
            status = self._call(call, self._s, row, self._node(node), float(first[0]), float(second[0]))
        else:
            both = self._pointer(first), self._pointer(second)
            status = self._call(f"{call}_range", self._s, row, 0, len(first), *both)
        self._expect(status, call, f"row {self.names.rows[row]!r}, node {node}")

    def _expect_alone(self, call: str, *others: object) -> None:
        """Raise ControllerError if more is given beside a mapping."""
        if any(other is not None for other in others):
            raise ControllerError(f"{call}: {{name: values}} takes no further values")

    # -- inner: all kinds ---------------------------------------------------------------------------------------------

    def _read(self, value: ArrayLike, what: str, size: int, lengths: Sequence[int], finite: bool = True) -> Array:
        return given.rows(value, what, self._real, size, lengths, finite)

    def _send(self, call: str, rows: Array, node: int | None, *leading: int) -> None:
        """Send one row for a node or for all, or one row per node from node 0 on."""
        if call.startswith("set_terminal"):
            status = self._call(call, self._s, self._pointer(rows))
        elif len(rows) == 1:
            status = self._call(call, self._s, *leading, self._node(node), self._pointer(rows))
        else:
            status = self._call(f"{call}_range", self._s, *leading, 0, len(rows), self._pointer(rows))
        if status:
            self._expect(status, call, "every node" if node is None else f"node {node}")


def _diagonal(values: Array, matrices: bool) -> Array:
    """A view on rows (n, size), or on the diagonals of matrices (n, size, size), that can be written to."""
    return np.einsum("kii->ki", values) if matrices else values
