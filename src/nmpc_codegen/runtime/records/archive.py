"""Logs as .npz archives: arrays as they are, everything else as one text in JSON."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.records.trace import COLUMNS, Bound, Estimates, Record, Trace

FORMAT = "nmpc_codegen log 3"
ARRAYS = ("t", *COLUMNS, "status", "cost", "time_ns")

#: Arrays of estimates, with the field of the traces of their columns, and the prefix of their names in the archive.
OF_ESTIMATES = {"x": "states", "std": "states", "y": "sensors", "p": "", "status": "", "time_ns": ""}
ESTIMATED = "estimates_"


def write(log: Record, file: str | os.PathLike[str] | IO[bytes]) -> None:
    """Write a log."""
    text = {
        "format": FORMAT,
        "name": log.name,
        "time_unit": log.time_unit,
        "traces": {kind: [asdict(trace) for trace in getattr(log, kind)] for kind in COLUMNS.values()},
        "reasons": {status.name: reason for status, reason in log.reasons.items()},
    }
    content = {name: getattr(log, name) for name in ARRAYS}
    if (found := log.estimates) is not None:
        text["estimates"] = {kind: [asdict(t) for t in getattr(found, kind)] for kind in ("states", "sensors")}
        content |= {f"{ESTIMATED}{name}": getattr(found, name) for name in OF_ESTIMATES}
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
    try:
        with np.load(file, allow_pickle=False) as found:
            lacking = [name for name in (*ARRAYS, "description") if name not in found]
            if lacking:
                raise ValueError(f"it lacks {', '.join(lacking)}")
            arrays = {name: found[name] for name in ARRAYS}
            text = json.loads(str(found["description"]))
            of_estimates = {n: found[f"{ESTIMATED}{n}"] for n in OF_ESTIMATES} if "estimates" in text else None
        if text["format"] != FORMAT:
            raise ValueError(f"its format is {text['format']!r}, not {FORMAT!r}")
        traces = {kind: tuple(_trace(**entry) for entry in text["traces"][kind]) for kind in COLUMNS.values()}
        _check(arrays, traces)
        reasons = {Status[name]: str(reason) for name, reason in text["reasons"].items()}
        more = {"estimates": None if of_estimates is None else _estimates(of_estimates, text["estimates"], arrays)}
        return {"name": text["name"], "time_unit": text["time_unit"], "reasons": reasons, **arrays, **traces, **more}
    except (ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error, EOFError) as error:
        what = (
            f"{error} is missing"
            if isinstance(error, KeyError)
            else (str(error) or type(error).__name__).splitlines()[0]
        )
        raise ControllerError(f"{file} is not a log that Log.save() wrote: {what}") from error


def _check(arrays: Mapping[str, Any], traces: Mapping[str, tuple[Trace, ...]]) -> None:
    """ValueError unless lengths and numbers of columns fit together, and every status is one."""
    steps = len(arrays["u"])
    for name in ARRAYS:
        rows = steps + (name in ("t", "x"))
        expected = (rows, len(traces[COLUMNS[name]])) if name in COLUMNS else (rows,)
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


def _trace(name: str, unit: str, bounds: list[dict[str, Any]], signal: str) -> Trace:
    return Trace(name, unit, tuple(Bound(**bound) for bound in bounds), signal)
