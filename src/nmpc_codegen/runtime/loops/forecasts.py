"""Tables over the samples of closed loops hold data known in advance: forecasts, tariffs, trajectories, limits.

A table has a row for each sample, and before that an axis of flights if they differ:

    a number; (n,), (flights, n) for a number; (n, size), (flights, n, size) for a vector

If the axis of flights has length 1, all flights share the values. At sample k, a node that is t_j later takes the row
of the last sample at or before its time, so that a forecast moves along by itself; the last row holds for all later
times.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import Kind, members
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.access.addressing import Addressing
from nmpc_codegen.runtime.batch.struct_block import Structs

Array = NDArray[Any]
Tables = Mapping[str, ArrayLike]
Bounds = Mapping[str, tuple[ArrayLike, ArrayLike]]


#: Setter -> kind of its data.
_KINDS: dict[str, Kind] = {
    "PARAMETER": "parameter",
    "REFERENCE": "reference",
    "TERMINAL_REFERENCE": "reference",
    "BOUNDS": "bounds",
}


@dataclass(frozen=True, eq=False)
class TableColumn:
    """A column has the values of one element over the samples: (1 or flights, n)."""

    place: int
    values: Array


@dataclass(frozen=True, eq=False)
class SetterData:
    """The data of one setter are columns of parameter or row ``number``, or of references.

    ``offset`` is the number of the first column. Bounds have two columns, the lower and the upper one.
    """

    setter: str
    number: int
    member: str
    offset: int
    width: int
    columns: list[TableColumn] = field(default_factory=list)


def parameter_data(where: Addressing, tables: Tables | None, flights: int, what: str) -> list[SetterData]:
    """Return tables of parameters, given by name, as setter data."""
    if tables is None:
        return []
    found: dict[int, SetterData] = {}
    for name, value in mapping(what, tables).items():
        where._lengths("parameter", f"parameter {name!r}", None)
        signals = where.description.parameters
        whole = [i for i, s in enumerate(signals) if s.name == name]
        elements = [(i, j) for i, s in enumerate(signals) for j, e in enumerate(s.elements) if e == name or i in whole]
        if not elements:
            where._lookup(name, [s.name for s in signals], "parameter")
        table = _table(f"{what}: {name!r}", value, len(elements), flights, where._real)
        for (i, j), values in zip(elements, table, strict=True):
            signal = signals[i]
            if signal.low:
                given.check_range(values[..., None], signal.low[j : j + 1], signal.high[j : j + 1], f"{what}: {name!r}")
            data = found.setdefault(i, SetterData("PARAMETER", i, "p", signal.offset, signal.size))
            _append(data, TableColumn(j, values), f"{what}: {name!r}")
    return list(found.values())


def reference_data(where: Addressing, references: ArrayLike | Tables | None, flights: int) -> list[SetterData]:
    """Return tables of references, given by the names of residuals or for the whole path residual, as setter data."""
    if references is None:
        return []
    where._lengths("reference", "references", None)
    y, y_N = where.names.y, where.names.y_N
    known = list(dict.fromkeys((*y, *y_N)))
    path = SetterData("REFERENCE", 0, "yref", 0, len(y))
    end = SetterData("TERMINAL_REFERENCE", 0, "yref_N", 0, len(y_N))
    named = references if isinstance(references, Mapping) else {"": references}
    for name, value in named.items():
        elements = [known[i] for i in (members(name, known) or [where._lookup(name, known, "residual")])] if name else y
        what = f"references: {name!r}" if name else "references"
        table = _table(what, value, len(elements), flights, where._real, vector=not name)
        for element, values in zip(elements, table, strict=True):
            for data, names in ((path, y), (end, y_N)):
                if element in names:
                    _append(data, TableColumn(names.index(element), values), f"references: {element!r}")
    return [data for data in (path, end) if data.columns]


def bounds_data(where: Addressing, bounds: Bounds | None, flights: int) -> list[SetterData]:
    """Return tables of bounds, given by the names of rows as (lower, upper), as setter data."""
    found: list[SetterData] = []
    for name, value in mapping("bounds", {} if bounds is None else bounds).items():
        groups = where._rows_of(name)
        where._lengths("bounds", f"the bounds of {name!r}", None)
        sides = given.pair(value, f"bounds of {name!r}")
        what = f"bounds: {name!r}"
        tables = [_table(what, side, len(groups), flights, where._real, finite=False) for side in sides]
        low, high = (np.stack(np.broadcast_arrays(*columns), axis=-1)[..., None, :] for columns in tables)
        n = max(low.shape[1], high.shape[1])
        both = np.broadcast_arrays(_first_rows(low, n), _first_rows(high, n))
        for row, lower, upper in where._bounds_of_rows(name, groups, *both):
            data = SetterData("BOUNDS", row, "lower", row, 2)
            data.columns.extend(TableColumn(i, side[..., 0]) for i, side in enumerate((lower, upper)))
            if any(other.number == row for other in found):
                raise ControllerError(f"{what} is given twice")
            found.append(data)
    return found


def replace_in(base: list[SetterData], new: list[SetterData]) -> list[SetterData]:
    """Return the parameters in ``base`` with those in ``new`` replacing or added to them."""
    found = {data.number: data for data in new}
    for data in base:
        if data.setter == "PARAMETER":
            into = found.setdefault(data.number, replace(data, columns=[]))
            known = {column.place for column in into.columns}
            into.columns.extend(column for column in data.columns if column.place not in known)
    return list(found.values())


def _append(data: SetterData, column: TableColumn, what: str) -> None:
    """Append a column; raise ControllerError if its element already has one."""
    if any(column.place == other.place for other in data.columns):
        raise ControllerError(f"{what} is given twice")
    data.columns.append(column)


def in_c(batch: Structs, where: Addressing, data: list[SetterData], ahead: NDArray[np.int64], keep: list[Any]) -> Any:
    """Return the data as batch_data_t[]; ``keep`` receives the arrays that it points to."""
    driver = batch.driver
    found = driver.ffi.new("batch_data_t[]", max(1, len(data)))
    itemsize = where._real.itemsize
    for c, one in zip(found, data, strict=False):
        kind = _KINDS[one.setter]
        by_node = where.description.online[kind] == "node"
        name = f"set_{one.setter.lower()}"
        fields: Any = where._package.dtype.fields
        layout = fields[one.member]
        stored, end = layout[0].shape, one.setter == "TERMINAL_REFERENCE"
        nodes = 1 if end else stored[0]
        times = (ahead[-1:] if end else ahead[:nodes]) if by_node else np.zeros(nodes, np.int64)
        columns = driver.ffi.new("batch_column_t[]", len(one.columns))
        for column, of in zip(columns, one.columns, strict=True):
            values = np.ascontiguousarray(of.values)
            column.column, column.rows, column.values = of.place, values.shape[1], batch.reach(values, keep)
            column.flight_step = 0 if len(values) == 1 else values.strides[0]
        c.setter, c.number, c.nodes, c.width = getattr(driver.lib, f"BATCH_{one.setter}"), one.number, nodes, one.width
        c.end, c.set = where.dims.N, driver.address(name, where._package)
        if by_node and not end:
            c.set_range = driver.address(f"{name}_range", where._package)
        c.offset, c.row_step = layout[1] + one.offset * itemsize, stored[-1] * itemsize
        c.ahead, c.count = driver.ffi.cast("int64_t *", batch.reach(times, keep)), len(one.columns)
        c.columns = batch.reach_structs(columns, keep)
    return batch.reach_structs(found, keep)


def at_samples(data: list[SetterData], flights: slice, steps: int, stored: Array) -> Array:
    """Return the data of node 0 at every sample, (flights, steps, width): the tables where given, else ``stored``."""
    found = np.repeat(stored[:, None, :], steps, axis=1).astype(np.float64)
    for one in data:
        for column in one.columns:
            found[:, :, one.offset + column.place] = _over_samples(column, flights, steps)
    return found


def bounds_at(data: list[SetterData], side: int, flights: slice, steps: int, stored: Array) -> Array:
    """Return the bounds of rows at every sample, (flights, steps, rows): the tables where given, else ``stored``.

    ``side`` is 0 for lower and 1 for upper bounds; ``stored`` has the shape (flights, 1, rows).
    """
    found = np.repeat(stored, steps, axis=1)
    for one in data:
        found[:, :, one.number] = _over_samples(one.columns[side], flights, steps)
    return found


def _over_samples(column: TableColumn, flights: slice, steps: int) -> Array:
    """Return the values of a column at every sample, (1 or flights, steps)."""
    return _first_rows(column.values if len(column.values) == 1 else column.values[flights], steps)


def _first_rows(table: Array, n: int) -> Array:
    """Return the rows of the first n samples of a table (flights, rows, ...); its last row holds for later samples."""
    return np.asarray(table[:, np.minimum(np.arange(n), table.shape[1] - 1)])


def _table(
    what: str,
    value: ArrayLike,
    size: int,
    flights: int,
    real: np.dtype[Any],
    vector: bool = False,
    finite: bool = True,
) -> list[Array]:
    """Return the columns (1 or flights, n) of the elements; if ``vector``, one element also has an axis of elements."""
    shape = np.shape(value) if given.ndim(value) >= 0 else ()
    vector = vector or size > 1
    if not vector and flights == 1 and len(shape) == 2 and shape[1] == 1:  # a column
        value, shape = np.reshape(value, -1), shape[:1]
    axes = shape[:-1] if vector and shape else shape
    known = len(axes) in (1, 2) and (not vector or shape[-1] == size) and (len(axes) < 2 or axes[0] in (1, flights))
    if (shape and not known) or 0 in shape:
        row = f", {size}" if vector else ","
        many = f", or ({flights}, n{row.rstrip(',')}), a table for each of the {flights} flights" if flights > 1 else ""
        raise ControllerError(f"{what} has shape {shape}; expected a number or (n{row}), a row for each sample{many}")
    array = given.checked_array(value, what, real, shape, finite)
    if not shape:
        return [array.reshape(1, 1)] * size
    whole = array.reshape(*((1,) if len(axes) < 2 else ()), *axes, size)
    return [whole[..., j] for j in range(size)]


def mapping(what: str, value: Any) -> Mapping[str, Any]:
    """Return ``value`` if it is a mapping, else raise ControllerError."""
    if not isinstance(value, Mapping):
        raise ControllerError(f"{what} is {type(value).__name__}; expected {{name: table over the samples}}")
    return value
