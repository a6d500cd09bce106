"""Setters change the data of a controller while it runs: references, weights, parameters, bounds, penalties, time.

A setter takes one value for all nodes, an array with a row for each node, or {name: one of these}, with the name of an
element or of a vector. An array takes one call of the C package. Refused data change nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import Soft
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.access.addressing import EVERY_NODE
from nmpc_codegen.runtime.access.telling import Named, Telling
from nmpc_codegen.runtime.memory import Memory

__all__ = ["EVERY_NODE", "Setters"]

Array = NDArray[Any]
Penalty = float | tuple[ArrayLike, ArrayLike]


class Setters(Memory, Telling):
    """The setters of the data of a controller that can be changed at run time."""

    # -- references and weights ---------------------------------------------------------------------------------------

    def set_reference(self, y: ArrayLike | Named, node: int | None = None) -> None:
        """Set the references of residuals.

        Args:
            y: (ny,) for the path residual at all nodes; (N, ny), one row per node; (N+1, ny) if the terminal residual
                consists of residuals of the path; (N,) and (N+1,) if ny = 1. Or {name of a residual or of a vector of
                them: value}: a number, or one per element, sets it at every node, and at the end if the terminal
                residual has that name; an array has a row per node as above. Residuals that are not named keep their
                references.
            node: 0..N-1, N for the terminal residual, None for every node. With Online(reference="shared") only None
                and N are allowed, and no rows per node.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.

        Examples:
            >>> from nmpc_codegen import build
            >>> controller = build(ocp)
            >>> controller.set_reference({"h": 0.8})
            >>> controller.set_reference(np.linspace(0.5, 0.8, 10)[:, None])
        """
        self._tell_residuals("reference", y, node)

    def set_terminal_reference(self, y: ArrayLike | Named) -> None:
        """Set the reference of the terminal residual.

        Args:
            y: (ny_N,), or {name: value}.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        self._tell_residuals("reference", y, self.dims.N)

    def set_weight(self, W: ArrayLike | Named, node: int | None = None) -> None:
        """Set the weights of residuals, symmetric positive semidefinite up to rounding; (W + W') / 2 is stored.

        If residuals were stated with scale_with_dt, their rows and columns are multiplied by dt_k wherever W is used,
        so give the same weights as in least_squares().

        Args:
            W: the diagonal (ny,) or the matrix (ny, ny) of the path residual; (N, ny) or (N, ny, ny), one per node; N+1
                rows as for set_reference(). If N = ny, (ny, ny) is a matrix. Or {name: entries of the diagonal}: a
                number sets the path only; N+1 rows, or node=N, set the end. Off-diagonal entries require a weight that
                    was declared with such entries, or Online(dense_weight=True).
            node: 0..N-1, N for the terminal residual, None for every node. With Online(weight="shared") only None and N
                are allowed, and no rows per node.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        self._tell_residuals("weight", W, node)

    def set_terminal_weight(self, W: ArrayLike | Named) -> None:
        """Set the weight of the terminal residual.

        Args:
            W: the diagonal (ny_N,) or the matrix (ny_N, ny_N), or {name: entry of the diagonal}.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        self._tell_residuals("weight", W, self.dims.N)

    # -- parameters and bounds ----------------------------------------------------------------------------------------

    def set_parameter(self, name: str, value: ArrayLike, node: int | None = None) -> None:
        """Set the value of a parameter.

        Args:
            name: name of a declared number or vector, or of an element of a vector, "r[1]".
            value: a number or (size,); one row per node, (N+1, size), or (N, size) for the nodes before the end; (N+1,)
                and (N,) if size = 1. A value outside the declared bounds of the parameter is an error.
            node: 0..N, or None for every node. With Online(parameter="shared") only None and N are allowed, and no rows
                per node.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.

        Examples:
            >>> from nmpc_codegen import build
            >>> controller = build(ocp)
            >>> controller.set_parameter("drain", 0.12)
            >>> controller.set_parameter("drain", np.linspace(0.1, 0.2, 11))
        """
        self._tell_parameters({name: value}, node)

    def set_parameters(self, values: Named | None = None, /, *, node: int | None = None, **more: ArrayLike) -> None:
        """Set several parameters, set_parameters(m=0.8, k=[1.0, 2.0]): all of them, or none if one is wrong.

        Args:
            values: {name: value}, for names that cannot be keywords: elements of vectors, a parameter called node.
            node: as in set_parameter().
            more: name=value.

        Raises:
            ControllerError: a name, a node, a shape or a number is wrong, or these data cannot be set; nothing changes.
        """
        if values is not None and not isinstance(values, Mapping):
            raise ControllerError(f"set_parameters: {values!r} is no {{name: value}}")
        self._tell_parameters({**(values or {}), **more}, node)

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
            lower: a number or one per row; -inf: no bound. Or one entry per node, (N+1, rows), or (N+1,) for one row;
                entries of nodes where the row does not hold are ignored; (N, rows) or (N,) if it does not hold at the
                end.
            upper: in the same forms; +inf: no bound.
            node: a node of the row, or None for all its nodes. With Online(bounds="shared") only None and N are
                allowed, and no rows per node.

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
            stated = [(n, *given.pair(both, f"bounds of {n!r}")) for n, both in name.items()]
        elif lower is None or upper is None:
            raise ControllerError(f"bounds of {name!r}: expected a lower and an upper one; -inf and inf: no bound")
        else:
            stated = [(name, lower, upper)]
        self._tell_bounds(stated, node)

    def set_soft(
        self, name: str | Mapping[str, Penalty | Soft], soft: Penalty | Soft | None = None, node: int | None = None
    ) -> None:
        """Set the penalties l1 v + l2/2 v^2 of violations v of a soft row, or of several rows by name.

        All penalties are set, or none if one is wrong.

        Args:
            name: name of the row, or of a vector of rows; or {name: penalties}.
            soft: (l1, l2) or l1 for both sides; Soft(lower=(l1, l2), upper=(l1, l2)) by side, where a side that is None
                keeps its penalties. l1 and l2 are numbers, or one per node, (N+1,), or (N,) if the row does not hold at
                the end. An infinite l1, which makes the row hard, requires a row that was declared with one; a declared
                l2 = 0 must stay 0, a positive l2 positive.
            node: a node of the row, or None for all its nodes. With Online(soft="shared") only None and N are allowed,
                and no rows per node.

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
        """Set the control that the actuator has applied, if it differs from the control that step() returned.

        Call it after step() or feedback(), which store the control that they return.

        Args:
            u: (nu,).

        Raises:
            ControllerError: the problem contains neither previous() nor rate().
        """
        self._needs("previous")
        value = self._array("previous control", u, (self.dims.nu,))
        self._expect(self._call("set_previous", self._s, self._pointer(value)), "set_previous")

    def set_time(self, time: float) -> None:
        """Set the time of the next sample, which step() and feedback() advance by the sampling time.

        If the sample is already prepared, it takes the change into account to first order.

        Args:
            time: the time in the unit of the problem.

        Raises:
            ControllerError: the problem does not contain ocp.time.
        """
        self._needs("time")
        value = float(self._array("time", time, ()))
        self._expect(self._call("set_time", self._s, value), "set_time")

    # -- inner --------------------------------------------------------------------------------------------------------

    def _checked_soft(
        self, name: str, soft: Penalty | Soft | None, node: int | None
    ) -> Iterator[tuple[int, Array, Array]]:
        """Yield (row, l1, l2) for every row of that name, (1, nodes) each."""
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
            l1, l2 = (given.rows(value, what, self._real, 1, lengths, finite=False).T for value in pair)
            l1, l2 = given.broadcast_rows(l1, l2, what)
            given.check_penalties(l1, l2, row.soft, what)
            yield number, l1, l2

    def _send_pair(self, call: str, row: int, first: Array, second: Array, node: int | None) -> None:
        if first.shape[1] == 1:
            status = self._call(call, self._s, row, self._node(node), float(first[0, 0]), float(second[0, 0]))
        else:
            both = self._pointer(first), self._pointer(second)
            status = self._call(f"{call}_range", self._s, row, 0, first.shape[1], *both)
        self._expect(status, call, f"row {self.names.rows[row]!r}, node {node}")

    def _expect_alone(self, call: str, *others: object) -> None:
        """Raise ControllerError if further values are given beside a mapping."""
        if any(other is not None for other in others):
            raise ControllerError(f"{call}: {{name: values}} takes no further values")

    def _read(
        self,
        value: ArrayLike,
        what: str,
        size: int,
        lengths: Sequence[int],
        finite: bool = True,
        spread: bool = True,
    ) -> Array:
        return given.rows(value, what, self._real, size, lengths, finite, spread)[None]

    def _read_weights(self, W: ArrayLike, what: str, size: int, end: bool, lengths: Sequence[int]) -> Array:
        return given.weights(W, what, self._real, size, self._is_matrix(end), lengths)[None]

    def _copy_of(self, member: str) -> Array:
        stored = np.array(self._view(member))
        return stored[None, None] if member.endswith("_N") else stored[None]

    def _name_row(self, i: int, nodes: int) -> str:
        return f"node {i}"

    def _send(self, what: str, rows: Array, node: int | None, *leading: int) -> None:
        call = f"set_{what}"
        if what.startswith("terminal"):
            status = self._call(call, self._s, self._pointer(rows))
        elif rows.shape[1] == 1:
            status = self._call(call, self._s, *leading, self._node(node), self._pointer(rows))
        else:
            status = self._call(f"{call}_range", self._s, *leading, 0, rows.shape[1], self._pointer(rows))
        if status:
            self._expect(status, call, "every node" if node is None else f"node {node}")
