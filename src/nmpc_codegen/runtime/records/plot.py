"""The picture of a closed loop: one axis per quantity, with bounds, references and marks."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.records.trace import Bound, Trace

Array = NDArray[np.float64]

WIDTH, ROW_HEIGHT = 7.2, 1.35  # inches
LEAST_SPREAD = 0.1  # of an axis, relative to its values
COLUMN_LIMIT = 9  # traces in one column
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
STATE_COLOR, CONTROL_COLOR, ALGEBRAIC_COLOR = "#1f5fa8", "#c2571a", "#7b4a91"
PARAMETER_COLOR, SENSOR_COLOR = "#5b6b7a", "0.55"
ROW_COLOR, TIME_COLOR = "#3f7d4e", "0.5"
BOUND_COLOR, REFERENCE_COLOR, DOUBT_COLOR, FAILURE_COLOR = "0.45", "0.15", "#d98c00", "#b3202c"
#: What the legend says, and the style of the line or mark.
HARD = ("hard bound", {"color": BOUND_COLOR, "linewidth": 1.0, "linestyle": (0, (5, 3))})
SOFT = ("soft bound", {"color": BOUND_COLOR, "linewidth": 1.2, "linestyle": (0, (1, 2))})
REFERENCE = ("reference", {"color": REFERENCE_COLOR, "linewidth": 0.8})
MEASURED = ("measured", {"color": "0.6", "marker": ".", "markersize": 2.5, "linestyle": ""})
ESTIMATE_COLOR = "#d1495b"
ESTIMATE = ("estimate ± 2 standard deviations", {"color": ESTIMATE_COLOR, "linewidth": 1.0})
MARKS = (
    ("RELAXED, NOT_CONVERGED", {"color": DOUBT_COLOR, "marker": "|", "linestyle": ""}),
    ("failed", {"color": FAILURE_COLOR, "marker": "|", "linestyle": ""}),
)
Legend = tuple[str, dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Curve:
    """Values of a trace over time, and their reference, one value per sample; ``held``: constant until the next sample;
    ``dots``: known at the samples only; ``logarithmic``: positive values of different magnitude. ``estimate``: what an
    estimator makes of them at the samples, and two standard deviations; ``measured``: what is measured of them."""

    trace: Trace
    t: Array
    values: Array
    color: str
    reference: Array | None = None
    held: bool = False
    dots: bool = False
    logarithmic: bool = False
    estimate: tuple[Array, Array] | None = None
    measured: Array | None = None


def draw(
    curves: Sequence[Curve],
    title: str,
    time_label: str,
    marks: tuple[Array, Array],
    file: str | os.PathLike[str] | None,
) -> Any:
    """Figure with one axis per curve, with marks at the times of doubtful and of failed samples."""
    mpl = extra("matplotlib", "plot()")
    columns = math.ceil(len(curves) / COLUMN_LIMIT)
    rows = math.ceil(len(curves) / columns)
    size = (WIDTH * (1.0 if columns == 1 else 0.62 * columns), 0.8 + ROW_HEIGHT * rows)
    figure = new_figure(size, file)
    with mpl.rc_context(STYLE):
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        axes = list(grid.T.flat)
        shown: list[Legend] = []
        for axis, curve in zip(axes, curves, strict=False):
            shown += _draw_curve(axis, curve)
            for times, (label, style) in zip(marks, MARKS, strict=True):
                if len(times):
                    axis.plot(times, np.zeros(len(times)), transform=axis.get_xaxis_transform(), zorder=4, **style)
                    shown.append((label, style))
        for axis in axes[len(curves) :]:
            axis.set_visible(False)
        _finish(figure, grid, time_label, curves[0].t)
        explain(figure, shown)
        figure.suptitle(title, fontsize=10, color=FAILURE_COLOR if len(marks[1]) else "0.2")
        if file is not None:
            figure.savefig(Path(file), dpi=160)
    return figure


def new_figure(size: tuple[float, float], file: object) -> Any:
    """A figure; if it is for a file, neither a display nor pyplot is needed. Not inside rc_context(): the first figure
    chooses the display and whether it is interactive, and the end of the context would take that back."""
    if file is None:
        return extra("matplotlib.pyplot", "plot()").figure(figsize=size, layout="constrained")
    return extra("matplotlib.figure", "plot()").Figure(figsize=size, layout="constrained")


def _finish(figure: Any, grid: Any, time_label: str, t: Array) -> None:
    """Add the time axis below the lowest axis of each column, and align the labels."""
    for column in grid.T:
        lowest = [axis for axis in column if axis.get_visible()][-1]
        lowest.set_xlabel(time_label)
        lowest.tick_params(labelbottom=True)
    grid[0, 0].set_xlim(t[0], t[-1] if len(t) > 1 else t[0] + 1.0)
    figure.align_ylabels()


def explain(figure: Any, shown: Iterable[Legend]) -> None:
    """A legend of the lines and marks that occur."""
    styles = dict(shown)
    if styles:
        lines = extra("matplotlib.lines", "plot()")
        handles = [lines.Line2D([], [], label=label, **style) for label, style in styles.items()]
        figure.legend(handles=handles, fontsize=8, ncols=len(handles), frameon=False, loc="outside lower center")


def _draw_curve(axis: Any, curve: Curve) -> list[Legend]:
    """The curve, its reference, bounds that it comes near or violates, the limits of the axis; what a legend has to
    explain."""
    style = "steps-post" if curve.held else "default"
    dots: dict[str, Any] = {"marker": ".", "markersize": 4.0} if curve.dots else {}
    axis.plot(curve.t, curve.values, color=curve.color, linewidth=1.6, drawstyle=style, **dots)
    axis.set_ylabel(curve.trace.label)
    if curve.logarithmic:
        ticker = extra("matplotlib.ticker", "plot()")
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_minor_locator(ticker.NullLocator())
        axis.yaxis.set_major_formatter("{x:g}")
        return []
    finite = curve.values[np.isfinite(curve.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    reach = _spread(low, high)
    shown: list[Legend] = []
    for value, (label, look) in _levels(curve.trace.bounds, low - reach, high + reach):
        axis.axhline(value, zorder=1.5, **look)
        shown.append((label, look))
        low, high = min(low, value), max(high, value)
    if curve.measured is not None:
        axis.plot(curve.t[: len(curve.measured)], curve.measured, zorder=1.6, **MEASURED[1])
        shown.append(MEASURED)
    if curve.estimate is not None:
        found, around = curve.estimate
        t = curve.t[: len(found)]
        axis.plot(t, found, zorder=2.4, **ESTIMATE[1])
        axis.fill_between(t, found - around, found + around, color=ESTIMATE_COLOR, alpha=0.18, linewidth=0, zorder=1.4)
        shown.append(ESTIMATE)
        low, high = min(low, float(found.min())), max(high, float(found.max()))
    if curve.reference is not None and len(curve.reference):
        followed = np.append(curve.reference, curve.reference[-1])[: len(curve.t)]
        axis.plot(curve.t, followed, drawstyle="steps-post", zorder=1.8, **REFERENCE[1])
        shown.append(REFERENCE)
        low, high = min(low, float(followed.min())), max(high, float(followed.max()))
    margin = 0.08 * _spread(low, high)
    axis.set_ylim(low - margin, high + margin)
    axis.locator_params(axis="y", nbins=4)
    axis.ticklabel_format(axis="y", useOffset=False)
    return shown


def _spread(low: float, high: float) -> float:
    """Distance of two values, at least a part of their size, and of 1 if both are 0."""
    return max(high - low, LEAST_SPREAD * max(abs(low), abs(high))) or LEAST_SPREAD


def _levels(bounds: Iterable[Bound], low: float, high: float) -> list[tuple[float, Legend]]:
    """The finite bounds that a curve between these values comes near or violates, each with its style."""
    found = []
    for bound in bounds:
        style = SOFT if bound.soft else HARD
        found += [(bound.lower, style)] if math.isfinite(bound.lower) and bound.lower >= low else []
        found += [(bound.upper, style)] if math.isfinite(bound.upper) and bound.upper <= high else []
    return found
