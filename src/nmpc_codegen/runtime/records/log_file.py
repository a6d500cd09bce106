"""Logs are stored as .npz archives: arrays as arrays, everything else in one JSON text."""

from __future__ import annotations

import json
import os
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import IO, Any, get_type_hints

import msgspec
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.program import EDGES
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.records.stream import is_recording
from nmpc_codegen.runtime.records.trace import Estimates, Plans, Record

FORMAT = "nmpc_codegen log 5"

#: Parts of a log that have arrays; in the archive, the names of these arrays begin with that of the part.
PARTS: dict[str, type[Plans | Estimates]] = {"plans": Plans, "estimates": Estimates}

#: Errors of NumPy for files that are no archives.
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, msgspec.ValidationError)


def write(log: Record, file: str | os.PathLike[str] | IO[bytes]) -> None:
    """Write a log."""
    content: dict[str, NDArray[Any]] = {}
    text = {"format": FORMAT, **_split(Record, log, "", content)}
    content["description"] = np.array(json.dumps(text))
    write_arrays(file, np.savez_compressed, content)


def _split(kind: Any, record: Any, prefix: str, content: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Return the fields that are no arrays, for JSON; the arrays are added to ``content``."""
    text: dict[str, Any] = {}
    for name in (field.name for field in fields(kind)):
        value = getattr(record, name)
        if name in kind.AXES:
            content[f"{prefix}{name}"] = value
        elif name in PARTS and value is not None:
            text[name] = _split(PARTS[name], value, f"{name}_", content)
        else:
            text[name] = msgspec.to_builtins(value, str_keys=True)
    return text


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
    """Return the fields of a Record.

    Raises:
        ControllerError: the file is no log.
    """
    if isinstance(file, str | os.PathLike) and is_recording(file):
        raise ControllerError(f"{file} is a recording; open_recording() opens it")
    try:
        with np.load(file, allow_pickle=False) as found:
            text = json.loads(str(found["description"]))
            if text["format"] != FORMAT:
                raise ValueError(f"its format is {text['format']!r}, not {FORMAT!r}")
            read = _join(Record, "", found, text)
        _check(read)
        return read
    except (ValueError, KeyError, TypeError, AttributeError, *BROKEN) as error:
        said = str(error.args[0]) if isinstance(error, KeyError) else str(error) or type(error).__name__
        what = said.splitlines()[0] if " " in said or not isinstance(error, KeyError) else f"{said!r} is missing"
        raise ControllerError(f"{file} is not a log that Log.save() wrote: {what}") from error


def _join(kind: Any, prefix: str, found: Mapping[str, Any], text: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a record, or of a part of it."""
    hints, fields_of = get_type_hints(kind), {}
    for name in (field.name for field in fields(kind)):
        if name in kind.AXES:
            fields_of[name] = found[f"{prefix}{name}"]
        elif name in PARTS:
            part = text[name]
            fields_of[name] = None if part is None else PARTS[name](**_join(PARTS[name], f"{name}_", found, part))
        else:
            fields_of[name] = msgspec.convert(text[name], hints[name], strict=False)
    return fields_of


def _check(log: Mapping[str, Any]) -> None:
    """Raise ValueError unless lengths and numbers of columns are consistent.

    References from one part to another must lead to existing entries.
    """
    samples, program, limits, plans = len(log["u"]), log["program"], log["limits"], log["plans"]
    counts = {name: len(value) for name, value in log.items() if isinstance(value, tuple)}
    counts |= {"samples": samples, "ends": samples + 1, "recorded": samples if len(log["began_ns"]) else 0}
    _check_shapes(Record, log, counts)
    for name, kind in PARTS.items():
        if (part := log[name]) is not None:
            own = vars(part)
            lengths = {other: len(value) for other, value in own.items() if isinstance(value, tuple)}
            if name == "plans":
                lengths = {**counts, "planned": len(own["rows"]), "plans": len(own["sample"]), "nodes": len(own["t"])}
                lengths["intervals"] = len(own["t"]) - 1
            _check_shapes(kind, own, {"samples": samples, **lengths})
    for status in np.unique(log["status"]):
        Status(int(status))
    program.check([sys.maxsize] * 3, len(program.rows), EDGES)
    for limit in limits:
        if not (0 <= limit.column < log[limit.array].shape[1] and 0 <= limit.row < len(program.rows)):
            raise ValueError(f"{limit} limits nothing")
    if plans is not None and len(plans.sample) and not 0 <= plans.sample.min() <= plans.sample.max() < samples:
        raise ValueError("a plan belongs to no sample")


def _check_shapes(kind: Any, arrays: Mapping[str, Any], counts: Mapping[str, int]) -> None:
    """Raise ValueError unless every array has its axes; an axis without a known length may have any."""
    for name, axes in kind.AXES.items():
        shape = arrays[name].shape
        expected = tuple(counts.get(axis, n) for axis, n in zip(axes, shape, strict=False))
        if len(shape) != len(axes) or shape != expected:
            raise ValueError(f"{name} has the shape {shape}, not {expected} ({', '.join(axes)})")
