"""Computing times, deadlines and periods of a log are given in numbers and words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.given import is_positive
from nmpc_codegen.runtime.records.trace import Record

#: Unit of time -> nanoseconds; other units, such as "samples", are no times.
NANOSECONDS = {
    **dict.fromkeys(("s", "sec", "seconds"), 1e9),
    **dict.fromkeys(("min", "minutes"), 60e9),
    **dict.fromkeys(("h", "hours"), 3600e9),
    "ms": 1e6,
    "us": 1e3,
    "µs": 1e3,
    "d": 86400e9,
    "days": 86400e9,
}
#: Unit in which times are shown -> nanoseconds.
SHOWN = {"h": 3600e9, "min": 60e9, "s": 1e9, "ms": 1e6, "µs": 1e3, "ns": 1.0}
LATE = 1.5  # periods after the previous sample, from which a sample counts as late


def nanoseconds(log: Record, dt: float | None) -> float | None:
    """Return a deadline, by default the sampling time, in nanoseconds; None if the problem's unit is no time."""
    if dt is not None and not is_positive(dt):
        raise ControllerError(f"plot_times(): dt is {dt!r}; expected a positive number ({log.time_unit})")
    unit = NANOSECONDS.get(log.time_unit)
    if unit is None and dt is not None:
        raise ControllerError(f"plot_times(): dt is {dt!r} {log.time_unit}, which is no unit of time: leave it out")
    return None if unit is None else unit * (log.dt if dt is None else dt)


def in_words(log: Record, dt: float | None = None) -> list[str]:
    """Return lines with median and worst time, the deadline, and the periods of a recording."""
    deadline = nanoseconds(log, dt)
    slowest = log.number(int(np.argmax(log.time_ns)))
    median, worst = short_time(np.median(log.time_ns)), short_time(np.max(log.time_ns))
    words = f"median {median}, worst {worst} (sample {slowest})"
    if deadline is not None:
        late = int(np.sum(log.time_ns > deadline))
        words += f"; {late} of {len(log.time_ns)} samples took more than {short_time(deadline)}"
    if len(log.began_ns) < 2:
        return [words]
    period = np.diff(log.began_ns)
    longest = f"{short_time(period.max())} before sample {log.number(int(np.argmax(period)) + 1)}"
    began = f"; began late: {len(late_starts(log))}" if deadline is not None else ""
    return [
        words,
        f"period {short_time(np.mean(period))}, jitter {short_time(np.std(period))}, longest {longest}{began}",
    ]


def late_starts(log: Record) -> NDArray[np.int64]:
    """Return the samples of a recording, by their index in the log, that began more than half a period late."""
    period = nanoseconds(log, None)
    if period is None or len(log.began_ns) < 2:
        return np.zeros(0, np.int64)
    return np.flatnonzero(np.diff(log.began_ns) > LATE * period * np.diff(np.round(log.t[:-1] / log.dt))) + 1


def unit_of(nanoseconds: Any) -> str:
    """Return the largest unit of SHOWN in which a time is at least 1."""
    return next((unit for unit in SHOWN if nanoseconds >= SHOWN[unit]), "ns")


def short_time(nanoseconds: Any) -> str:
    """Return a time as text, in the largest unit in which it is at least 1."""
    unit = unit_of(nanoseconds)
    return f"{nanoseconds / SHOWN[unit]:.4g} {unit}"
