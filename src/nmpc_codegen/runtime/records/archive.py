"""Logs as .npz archives: arrays as they are, everything else as one text in JSON."""

from __future__ import annotations

import json
import os
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.program import EDGES, Program
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.records.stream import is_recording
from nmpc_codegen.runtime.records.trace import COLUMNS, Estimates, Limit, Plans, Record, Trace

FORMAT = "nmpc_codegen log 4"
ARRAYS = ("t", *COLUMNS, "status", "cost", "time_ns", "lower", "upper", "residual", "began_ns")

#: Arrays of estimates, with the field of the traces of their columns, and the prefix of their names in the archive.
OF_ESTIMATES = {"x": "states", "std": "states", "y": "sensors", "p": "", "status": "", "time_ns": ""}
ESTIMATED = "estimates_"

#: Arrays of plans, and the prefix of their names in the archive.
OF_PLANS = ("sample", "t", "x", "u", "distance", "multiplier", "active", "rounding")
PLANNED = "plans_"

#: What files that are no archives make NumPy raise.
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, msgspec.ValidationError)


def write(log: Record, file: str | os.PathLike[str] | IO[bytes]) -> None:
    """Write a log."""
    text = {
        "format": FORMAT,
        "name": log.name,
        "time_unit": log.time_unit,
        "traces": {kind: [asdict(trace) for trace in getattr(log, kind)] for kind in COLUMNS.values()},
        "reasons": {status.name: reason for status, reason in log.reasons.items()},
        "limits": [asdict(limit) for limit in log.limits],
        "program": asdict(log.program),
        "dt": log.dt,
        "remarks": list(log.remarks),
    }
    content = {name: getattr(log, name) for name in ARRAYS}
    if (found := log.estimates) is not None:
        text["estimates"] = {kind: [asdict(t) for t in getattr(found, kind)] for kind in ("states", "sensors")}
        content |= {f"{ESTIMATED}{name}": getattr(found, name) for name in OF_ESTIMATES}
    if (kept := log.plans) is not None:
        text["plans"] = [asdict(trace) for trace in kept.rows]
        content |= {f"{PLANNED}{name}": getattr(kept, name) for name in OF_PLANS}
    content["description"] = np.array(json.dumps(text))
    write_arrays(file, np.savez_compressed, content)


def write_arrays(
    file: str | os.PathLike[str] | IO[bytes], save: Callable[..., None], content: Mapping[str, NDArray[Any]]
) -> None:
    """Write arrays by numpy.savez or savez_compressed, which would append .npz to the name of a file."""
    if isinstance(file, str | os.PathLike):
        with Path(file).open("wb") as stream:
            save(stream, allow_pickle=False, **content)
    else:
        save(file, allow_pickle=False, **content)


def read(file: str | os.PathLike[str] | IO[bytes]) -> dict[str, Any]:
    """The fields of a Record.

    Raises:
        ControllerError: the file is no log.
    """
    if isinstance(file, str | os.PathLike) and is_recording(file):
        raise ControllerError(f"{file} is a recording; open_recording() opens it")
    try:
        with np.load(file, allow_pickle=False) as found:
            if "description" not in found:
                raise ValueError("it lacks a description")
            text = json.loads(str(found["description"]))
            if text["format"] != FORMAT:
                raise ValueError(f"its format is {text['format']!r}, not {FORMAT!r}")
            lacking = [name for name in ARRAYS if name not in found]
            if lacking:
                raise ValueError(f"it lacks {', '.join(lacking)}")
            arrays = {name: found[name] for name in ARRAYS}
            of_plans = {n: found[f"{PLANNED}{n}"] for n in OF_PLANS} if "plans" in text else None
            of_estimates = {n: found[f"{ESTIMATED}{n}"] for n in OF_ESTIMATES} if "estimates" in text else None
        traces = {kind: tuple(_trace(**entry) for entry in text["traces"][kind]) for kind in COLUMNS.values()}
        limits = tuple(Limit(**entry) for entry in text["limits"])
        _check(arrays, traces, limits)
        reasons = {Status[name]: str(reason) for name, reason in text["reasons"].items()}
        program = msgspec.convert(text["program"], Program)
        program.check([sys.maxsize] * 3, len(program.rows), EDGES)
        for limit in limits:
            if not (0 <= limit.column < arrays[limit.array].shape[1] and 0 <= limit.row < len(program.rows)):
                raise ValueError(f"{limit} limits nothing")
        plans = None if of_plans is None else _plans(of_plans, text["plans"], arrays)
        more = {"limits": limits, "program": program, "dt": float(text["dt"]), "plans": plans}
        more |= {"remarks": tuple(map(str, text["remarks"]))}
        more |= {"estimates": None if of_estimates is None else _estimates(of_estimates, text["estimates"], arrays)}
        return {"name": text["name"], "time_unit": text["time_unit"], "reasons": reasons, **arrays, **traces, **more}
    except (ValueError, KeyError, TypeError, AttributeError, *BROKEN) as error:
        what = (
            f"{error} is missing"
            if isinstance(error, KeyError)
            else (str(error) or type(error).__name__).splitlines()[0]
        )
        raise ControllerError(f"{file} is not a log that Log.save() wrote: {what}") from error


def _check(arrays: Mapping[str, Any], traces: Mapping[str, tuple[Trace, ...]], limits: tuple[Limit, ...]) -> None:
    """ValueError unless lengths and numbers of columns fit together, and every status is one."""
    steps = len(arrays["u"])
    for name in ARRAYS:
        rows = steps + (name in ("t", "x"))
        expected: tuple[int, ...] = (rows, len(traces[COLUMNS[name]])) if name in COLUMNS else (rows,)
        if name in ("lower", "upper"):
            expected = steps, len(limits)
        if name == "began_ns" and not len(arrays[name]):
            continue
        if arrays[name].shape != expected:
            raise ValueError(f"{name} has the shape {arrays[name].shape}, not {expected}")
    for status in np.unique(arrays["status"]):
        Status(int(status))


def _estimates(arrays: Mapping[str, Any], text: Mapping[str, Any], log: Mapping[str, Any]) -> Estimates:
    """ValueError unless there is an entry for every sample and trace."""
    traces = {kind: tuple(_trace(**entry) for entry in text[kind]) for kind in ("states", "sensors")}
    fields: dict[str, Any] = {**arrays, **traces}
    for name, kind in OF_ESTIMATES.items():
        columns = (len(traces[kind]),) if kind else arrays[name].shape[1:]
        if arrays[name].shape != (len(log["u"]), *columns):
            raise ValueError(f"{ESTIMATED}{name} has the shape {arrays[name].shape}")
    return Estimates(**fields)


def _plans(arrays: Mapping[str, Any], rows: list[dict[str, Any]], log: Mapping[str, Any]) -> Plans:
    """ValueError unless plans belong to samples and have the columns of the log."""
    n, nodes = len(arrays["sample"]), len(arrays["t"])
    shapes: dict[str, tuple[int, ...]] = {"x": (n, nodes, log["x"].shape[1]), "u": (n, nodes - 1, log["u"].shape[1])}
    shapes |= dict.fromkeys(("distance", "multiplier", "active"), (n, len(rows)))
    shapes["rounding"] = (len(rows),)
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{PLANNED}{name} has the shape {arrays[name].shape}, not {shape}")
    if n and not 0 <= arrays["sample"].min() <= arrays["sample"].max() < len(log["u"]):
        raise ValueError("a plan belongs to no sample")
    return Plans(**arrays, rows=tuple(_trace(**row) for row in rows))


def _trace(name: str, unit: str, signal: str) -> Trace:
    return Trace(name, unit, signal)
