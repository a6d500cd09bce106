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

Array = NDArray[np.float64]

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
    panels = [("computing time of a sample [µs]", log.time_ns / 1e3, None if deadline is None else deadline / 1e3)]
    if len(log.began_ns) > 1:
        period = np.diff(log.began_ns) / 1e6
        panels.append(("period from sample to sample [ms]", period, None if deadline is None else deadline / 1e6))
    figure = new_figure((WIDTH, 0.9 + 1.6 * ROW_HEIGHT * len(panels)), file)
    with use_style():
        axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
        for axis, (label, values, limit) in zip(axes, panels, strict=True):
            _draw_histogram(axis, values, limit)
            axis.set_xlabel(label)
            axis.set_ylabel("samples")
        shown = [MEDIAN, WORST, *([DEADLINE] if deadline is not None else [])]
        return finish(figure, f"{log.name}: {in_words(log, dt)}", shown, file)


def _draw_histogram(axis: Any, values: Array, limit: float | None) -> None:
    """Counts on a logarithmic scale, so that a single late sample is seen."""
    edge = [] if limit is None else [limit]
    low, high = min(values.min(), *edge, values.max()), max(values.max(), *edge, values.min())
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


def in_words(log: Record, dt: float | None = None) -> str:
    """Median and worst time, deadlines that were missed, periods of a recording."""
    deadline = nanoseconds(log, dt)
    median, worst = np.median(log.time_ns) / 1e3, np.max(log.time_ns) / 1e3
    words = [f"median {median:.1f} µs, worst {worst:.1f} µs"]
    if deadline is not None:
        late = int(np.sum(log.time_ns > deadline))
        words.append(f"{late} of {len(log.time_ns)} samples later than {deadline / 1e6:g} ms")
    if len(log.began_ns) > 1:
        period = np.diff(log.began_ns) / 1e6
        words.append(f"period {np.mean(period):.3f} ms, jitter {np.std(period):.3f} ms, longest {period.max():.3f} ms")
    return "; ".join(words)
