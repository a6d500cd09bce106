"""The plot of a closed loop: one axis per state, control and general path row, with dashed bounds."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
WIDTH, ROW_HEIGHT = 7.2, 1.35  # inches
COLUMN_LIMIT = 8  # traces in one column
STYLE = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "0.35",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.labelsize": 9,
    "grid.color": "0.9",
    "grid.linewidth": 0.7,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.color": "0.35",
    "ytick.color": "0.35",
    "font.size": 9,
}
STATE_COLOR, CONTROL_COLOR, ROW_COLOR = "#1f5fa8", "#c2571a", "#3f7d4e"
BOUND_COLOR, DOUBT_COLOR, FAILURE_COLOR = "0.45", "#d98c00", "#b3202c"


@dataclass(frozen=True)
class Trace:
    """One plotted quantity: its name, unit, and declared or current bounds (+-inf: no bound)."""

    name: str
    unit: str
    lower: float
    upper: float

    @property
    def label(self) -> str:
        """Axis label, with powers in the unit as superscripts: ``a [m/s²]``."""
        unit = re.sub(r"\^(-?\d+)", lambda power: power[1].translate(SUPERSCRIPTS), self.unit)
        return f"{self.name} [{unit}]" if unit else self.name


@dataclass(frozen=True, eq=False)
class Curve:
    """Values of a trace over time; ``held``: constant until the next sample; ``dots``: known at the samples only."""

    trace: Trace
    t: Array
    values: Array
    color: str
    held: bool = False
    dots: bool = False


def draw(
    curves: Sequence[Curve],
    title: str,
    time_label: str,
    marks: tuple[Array, Array],
    file: str | os.PathLike[str] | None,
) -> Any:
    """Figure with one axis per curve, with marks at the times of doubtful and of failed samples. If it is written to a
    file, neither a display nor pyplot is needed."""
    import matplotlib as mpl  # imported here, so that it is loaded only for a plot
    from matplotlib.figure import Figure

    columns = math.ceil(len(curves) / COLUMN_LIMIT)
    rows = math.ceil(len(curves) / columns)
    size = (WIDTH * (1.0 if columns == 1 else 0.62 * columns), 0.6 + ROW_HEIGHT * rows)
    with mpl.rc_context(STYLE):
        if file is None:
            from matplotlib import pyplot

            figure = pyplot.figure(figsize=size, layout="constrained")
        else:
            figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        axes = list(grid.T.flat)
        for axis, curve in zip(axes, curves, strict=False):
            style = "steps-post" if curve.held else "default"
            dots: dict[str, Any] = {"marker": ".", "markersize": 4.0} if curve.dots else {}
            axis.plot(curve.t, curve.values, color=curve.color, linewidth=1.6, drawstyle=style, **dots)
            _decorate(axis, curve.trace, curve.values)
            for times, color in zip(marks, (DOUBT_COLOR, FAILURE_COLOR), strict=True):
                if not len(times):
                    continue
                axis.plot(times, np.zeros(len(times)), "|", color=color, transform=axis.get_xaxis_transform(), zorder=4)
        for axis in axes[len(curves) :]:
            axis.set_visible(False)
        _finish(figure, grid, time_label, curves[0].t)
        figure.suptitle(title, fontsize=10, color=FAILURE_COLOR if len(marks[1]) else "0.2")
        if file is not None:
            figure.savefig(Path(file), dpi=160)
    return figure


def _finish(figure: Any, grid: Any, time_label: str, t: Array) -> None:
    """Add the time axis below the lowest axis of each column, and align the labels."""
    for column in grid.T:
        lowest = [axis for axis in column if axis.get_visible()][-1]
        lowest.set_xlabel(time_label)
        lowest.tick_params(labelbottom=True)
    grid[0, 0].set_xlim(t[0], t[-1] if len(t) > 1 else t[0] + 1.0)
    figure.align_ylabels()


def _decorate(axis: Any, trace: Trace, values: Array) -> None:
    """Add the label, limits with a margin, and those bounds that the trace comes near."""
    axis.set_ylabel(trace.label)
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    reach = max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-12)
    for bound in (trace.lower, trace.upper):
        if math.isfinite(bound) and low - reach <= bound <= high + reach:
            axis.axhline(bound, color=BOUND_COLOR, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1.5)
            low, high = min(low, bound), max(high, bound)
    margin = 0.08 * max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-12)
    axis.set_ylim(low - margin, high + margin)
    axis.locator_params(axis="y", nbins=4)
