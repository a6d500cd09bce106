"""Logs as tables of pandas and xarray."""

from __future__ import annotations

from typing import Any

import numpy as np

from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.records.trace import COLUMNS, Record

#: Array of a log -> the name of the dimension of its columns.
DIMENSIONS = {"x": "state", "u": "control", "z": "algebraic", "h": "row", "p": "parameter", "y": "residual"}
PER_SAMPLE = ("cost", "time_ns")


def to_dataframe(log: Record) -> Any:
    """See Log.to_dataframe()."""
    pandas = extra("pandas", "Log.to_dataframe()")
    index = pandas.Index(log.t, name=f"time [{log.time_unit}]")
    columns: dict[tuple[str, str], Any] = {}
    units = {}
    for array, kind in COLUMNS.items():
        for trace, values in zip(getattr(log, kind), getattr(log, array).T, strict=True):
            columns[array, trace.name] = pandas.Series(values, index[: len(values)])
            units[array, trace.name] = trace.unit
    if (found := log.estimates) is not None:
        for array, traces in (("xhat", found.states), ("std", found.states), ("measured", found.sensors)):
            values = {"xhat": found.x, "std": found.std, "measured": found.y}[array]
            for trace, column in zip(traces, values.T, strict=True):
                columns[array, trace.name] = pandas.Series(column, index[:-1])
                units[array, trace.name] = trace.unit
    columns["status", ""] = pandas.Series(_statuses(log), index[:-1], dtype=object)
    for name in PER_SAMPLE:
        columns[name, ""] = pandas.Series(getattr(log, name), index[:-1])
    frame = pandas.DataFrame(columns, index=index)
    frame.attrs["units"] = units
    return frame


def to_xarray(log: Record) -> Any:
    """See Log.to_xarray()."""
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
    """Values per sample and NaN for the end of the loop."""
    return np.append(values, np.full((1, *values.shape[1:]), np.nan), axis=0)


def _statuses(log: Record) -> list[str]:
    return [Status(status).name for status in log.status]
