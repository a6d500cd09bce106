"""Computing times, deadlines and periods."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.given import is_positive
from nmpc_codegen.runtime.pictures.style import (
    CONTROL_COLOR,
    FAILURE_COLOR,
    ROW_HEIGHT,
    STATE_COLOR,
    WIDTH,
    File,
    Legend,
    finish,
    new_figure,
    use_style,
)
from nmpc_codegen.runtime.records.trace import Record

Array = NDArray[Any]

BINS = 60
WIDE = 100.0  # times are drawn on a logarithmic axis if the largest is so many times the least
#: Nanoseconds of the units of time that are times.
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
#: Units in which times are shown, in nanoseconds.
SHOWN = {"h": 3600e9, "min": 60e9, "s": 1e9, "ms": 1e6, "µs": 1e3, "ns": 1.0}
LATE = 1.5  # periods after which a sample counts as one that began late
FAR = 100.0  # a deadline that is so many times the worst case is not drawn
MEDIAN: Legend = ("median", {"color": "0.2", "linewidth": 1.0})
WORST: Legend = ("worst", {"color": CONTROL_COLOR, "linewidth": 1.2})
DEADLINE: Legend = ("deadline", {"color": FAILURE_COLOR, "linewidth": 1.2, "linestyle": (0, (5, 3))})


def nanoseconds(log: Record, dt: float | None) -> float | None:
    """A deadline, by default the sampling time, in nanoseconds; None if the unit of time of the problem is no time."""
    if dt is not None and not is_positive(dt):
        raise ControllerError(f"plot_times(): dt is {dt!r}; expected a positive number ({log.time_unit})")
    unit = NANOSECONDS.get(log.time_unit)
    if unit is None and dt is not None:
        raise ControllerError(f"plot_times(): dt is {dt!r} {log.time_unit}, which is no unit of time: leave it out")
    return None if unit is None else unit * (log.dt if dt is None else dt)


def draw(log: Record, dt: float | None, file: File) -> Any:
    """Histogram of the computing times, and of the periods of a recording."""
    if not len(log.time_ns):
        raise ControllerError("plot_times(): the log has no sample")
    deadline = nanoseconds(log, dt)
    panels = [("computing time of a sample", log.time_ns)]
    if len(log.began_ns) > 1:
        panels.append(("period from sample to sample", np.diff(log.began_ns)))
    figure = new_figure((WIDTH, 1.2 + 1.6 * ROW_HEIGHT * len(panels)), file)
    shown = [MEDIAN, WORST]
    with use_style():
        axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
        for axis, (label, values) in zip(axes, panels, strict=True):
            unit = _unit(np.median(values))
            near = deadline is not None and deadline <= FAR * values.max()
            _draw_histogram(axis, values / SHOWN[unit], deadline / SHOWN[unit] if deadline and near else None)
            shown += [DEADLINE] if near else []
            axis.set_xlabel(f"{label} [{unit}]")
            axis.set_ylabel("samples")
        return finish(figure, "\n".join([log.name, *in_words(log, dt)]), shown, file)


def _draw_histogram(axis: Any, values: Array, limit: float | None) -> None:
    """Counts on a logarithmic scale, so that a single late sample is seen."""
    ends = [values.min(), values.max(), *([] if limit is None else [limit])]
    low, high = float(min(ends)), float(max(ends))
    wide = low > 0 and high > WIDE * low
    if wide:
        axis.set_xscale("log")
    margin = 0.02 * (high - low) or 0.05 * abs(high) or 1.0
    bins = np.geomspace(low, high, BINS + 1) if wide else np.linspace(low - margin, high + margin, BINS + 1)
    axis.hist(values, bins=bins, color=STATE_COLOR, log=True)
    axis.set_ylim(bottom=0.6)
    axis.axvline(float(np.median(values)), **MEDIAN[1])
    axis.axvline(float(values.max()), **WORST[1])
    if limit is not None:
        axis.axvline(limit, **DEADLINE[1])


def in_words(log: Record, dt: float | None = None) -> list[str]:
    """Median and worst time with the deadline, and the periods of a recording, each in a line."""
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


def late_starts(log: Record) -> Array:
    """Samples of a recording, by their places in the log, that began more than half of a period late."""
    period = nanoseconds(log, None)
    if period is None or len(log.began_ns) < 2:
        return np.zeros(0, np.int64)
    return np.flatnonzero(np.diff(log.began_ns) > LATE * period * np.diff(np.round(log.t[:-1] / log.dt))) + 1


def _unit(nanoseconds: Any) -> str:
    """The largest unit in which a time is at least 1."""
    return next((unit for unit in SHOWN if nanoseconds >= SHOWN[unit]), "ns")


def short_time(nanoseconds: Any) -> str:
    """A time in that unit."""
    unit = _unit(nanoseconds)
    return f"{nanoseconds / SHOWN[unit]:.4g} {unit}"
