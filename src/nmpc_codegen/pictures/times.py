"""Computing times with deadlines, and periods, are drawn as histograms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.pictures.style import (
    CONTROL_COLOR,
    FAILURE_COLOR,
    ROW_HEIGHT,
    STATE_COLOR,
    WIDTH,
    Legend,
    finish,
    new_figure,
    use_style,
)
from nmpc_codegen.runtime.records.timing import SHOWN, in_words, nanoseconds, unit_of
from nmpc_codegen.runtime.records.trace import File, Record

Array = NDArray[Any]

BINS = 60
WIDE = 100.0  # times are drawn on a logarithmic axis if the largest exceeds this multiple of the least
FAR = 100.0  # a deadline beyond this multiple of the worst case is not drawn
MEDIAN: Legend = ("median", {"color": "0.2", "linewidth": 1.0})
WORST: Legend = ("worst", {"color": CONTROL_COLOR, "linewidth": 1.2})
DEADLINE: Legend = ("deadline", {"color": FAILURE_COLOR, "linewidth": 1.2, "linestyle": (0, (5, 3))})


def draw(log: Record, dt: float | None, file: File) -> Any:
    """Draw a histogram of the computing times, and of the periods of a recording."""
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
            unit = unit_of(np.median(values))
            near = deadline is not None and deadline <= FAR * values.max()
            _draw_histogram(axis, values / SHOWN[unit], deadline / SHOWN[unit] if deadline and near else None)
            shown += [DEADLINE] if near else []
            axis.set_xlabel(f"{label} [{unit}]")
            axis.set_ylabel("samples")
        return finish(figure, "\n".join([log.name, *in_words(log, dt)]), shown, file)


def _draw_histogram(axis: Any, values: Array, limit: float | None) -> None:
    """Draw counts on a logarithmic scale, so that a single late sample is visible."""
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
