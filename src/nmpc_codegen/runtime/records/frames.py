"""Logs, flights and campaigns are converted to tables of pandas, xarray and Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.records.trace import COLUMNS, Record

#: Array of a log -> name of the dimension of its columns.
DIMENSIONS = {"x": "state", "u": "control", "z": "algebraic", "h": "row", "p": "parameter", "y": "residual"}
PER_SAMPLE = ("cost", "time_ns")


@dataclass(frozen=True, eq=False)
class Column:
    """A column (n,) of a table has the kind, name and unit of its quantity.

    Later rows of the table, if there are more, have no value in this column.
    """

    kind: str
    name: str = ""
    unit: str = ""
    values: Any = ()


def of_log(log: Record) -> list[Column]:
    """Return the quantities of a log as columns, with a row for each sample and one for its end."""
    groups = [(array, getattr(log, kind), getattr(log, array)) for array, kind in COLUMNS.items()]
    if (found := log.estimates) is not None:
        groups += [("xhat", found.states, found.x), ("std", found.states, found.std)]
        groups += [("measured", found.sensors, found.y)]
    columns = [
        Column(k, t.name, t.unit, v) for k, traces, table in groups for t, v in zip(traces, table.T, strict=True)
    ]
    columns.append(Column("status", values=np.array(_statuses(log), dtype=object)))
    return [*columns, *(Column(name, values=getattr(log, name)) for name in PER_SAMPLE)]


def to_dataframe(columns: Sequence[Column], index: Any, name: str, user: str) -> Any:
    """Return a DataFrame with the columns (kind, name); attrs["units"] has their units."""
    pandas = extra("pandas", user)
    rows = pandas.Index(index, name=name)
    series = {(c.kind, c.name): pandas.Series(c.values, rows[: len(c.values)]) for c in columns}
    frame = pandas.DataFrame(series, index=rows)
    frame.attrs["units"] = {(c.kind, c.name): c.unit for c in columns if c.name}
    return frame


def to_parquet(columns: Sequence[Column], file: Any, user: str) -> None:
    """Write the columns as kind.name, with units as metadata, to a file or file object."""
    arrow, parquet = extra("pyarrow", user), extra("pyarrow.parquet", user)
    rows, arrays, fields = max((len(c.values) for c in columns), default=0), [], []
    for c in columns:
        known = arrow.array(c.values if c.values.dtype == object else np.ascontiguousarray(c.values))
        arrays.append(arrow.concat_arrays([known, arrow.nulls(rows - len(c.values), known.type)]))
        name = f"{c.kind}.{c.name}" if c.name else c.kind
        fields.append(arrow.field(name, known.type, metadata={"unit": c.unit} if c.unit else None))
    parquet.write_table(arrow.table(arrays, schema=arrow.schema(fields)), file)


def to_xarray(log: Record) -> Any:
    """Convert a log; see Log.to_xarray()."""
    xarray = extra("xarray", "Log.to_xarray()")
    coordinates: dict[str, Any] = {"time": ("time", log.t, {"units": log.time_unit})}
    variables: dict[str, Any] = {"status": ("time", np.array([*_statuses(log), ""], dtype=np.str_))}
    variables |= {name: ("time", _pad(getattr(log, name))) for name in PER_SAMPLE}
    variables["time_ns"] = (*variables["time_ns"], {"units": "ns"})
    for array, kind in COLUMNS.items():
        traces, values, dimension = getattr(log, kind), getattr(log, array), DIMENSIONS[array]
        if traces:
            variables[array] = (("time", dimension), values if array == "x" else _pad(values))
            coordinates[dimension] = np.array([trace.name for trace in traces], dtype=np.str_)
            coordinates[f"{dimension}_unit"] = (dimension, np.array([trace.unit for trace in traces], dtype=np.str_))
    return xarray.Dataset(variables, coordinates, {"name": log.name})


def _pad(values: Any) -> Any:
    """Append NaN for the end of the loop to values per sample."""
    return np.append(values, np.full((1, *values.shape[1:]), np.nan), axis=0)


def _statuses(log: Record) -> list[str]:
    return [Status(status).name for status in log.status]
