"""All plots use this style and these legends, and figures that are created here for a file or for a display."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.records.trace import File, Trace

WIDTH, ROW_HEIGHT = 7.2, 1.35  # inches
LEAST_SPREAD = 0.1  # least range of an axis, relative to its values
COLUMN_LIMIT = 9  # largest number of traces in one column
DPI = 130  # resolution of files
LABEL = 15  # characters of a line beside an axis
CHARACTER = 0.062  # width of a character in a legend, inches
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
#: Text of the legend, and style of the line or mark.
HARD = ("hard bound", {"color": BOUND_COLOR, "linewidth": 1.0, "linestyle": (0, (5, 3))})
SOFT = ("soft bound", {"color": BOUND_COLOR, "linewidth": 1.2, "linestyle": (0, (1, 2))})
REFERENCE = ("reference", {"color": REFERENCE_COLOR, "linewidth": 0.8})
MEASURED = ("measured", {"color": "0.6", "marker": ".", "markersize": 2.5, "linestyle": ""})
LATE_COLOR = "#7a4fa3"
ESTIMATE_COLOR = "#d1495b"
ESTIMATE = ("estimate ± 2 standard deviations", {"color": ESTIMATE_COLOR, "linewidth": 1.0})
PLAN = ("plans", {"color": "#6fa3c9", "linewidth": 0.8, "alpha": 0.75})
Legend = tuple[str, dict[str, Any]]


def new_figure(size: tuple[float, float], file: object) -> Any:
    """Return a figure; if it is for a file, neither a display nor pyplot is needed.

    Do not call it inside rc_context(): the first figure chooses the display and whether it is interactive, and the end
    of the context would revert that.
    """
    if file is None:
        pyplot = extra("matplotlib.pyplot", "plot()")
        return pyplot.figure(figsize=size, layout="constrained", FigureClass=_figure_class())
    return extra("matplotlib.figure", "plot()").Figure(figsize=size, layout="constrained")


@cache
def _figure_class() -> Any:
    """Return a figure that a notebook shows once in a cell: as its value or, as pyplot does, at its end."""

    class Figure(extra("matplotlib.figure", "plot()").Figure):  # type: ignore[misc]
        """A figure belongs to pyplot."""

        _shown = False

        def _ipython_display_(self) -> None:
            display = extra("IPython.display", "plot()")
            if not is_inline():
                display.display({"text/plain": repr(self)}, raw=True)
            elif not (self._shown and extra("matplotlib.pyplot", "plot()").fignum_exists(self.number)):
                self._shown = True
                display.display(display.Image(_png(self)))

    return Figure


def is_inline() -> bool:
    """Return True if a notebook shows figures as pictures at the end of their cell."""
    return "inline" in extra("matplotlib.pyplot", "plot()").get_backend()


def _png(figure: Any) -> bytes:
    """Return the figure as the bytes of a file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    return stream.getvalue()


@contextmanager
def use_style() -> Iterator[None]:
    """Apply the style of the project to everything that is drawn inside."""
    with extra("matplotlib", "plot()").rc_context(STYLE):
        yield


def finish(figure: Any, title: str, shown: Iterable[Legend], file: File, color: str = "0.2") -> Any:
    """Add legend and title, write the file if one is given, and return the figure."""
    explain(figure, shown)
    figure.suptitle(title, fontsize=10, color=color)
    if file is not None:
        figure.savefig(Path(file), dpi=DPI)
    return figure


def explain(figure: Any, shown: Iterable[Legend]) -> None:
    """Add a legend of the lines and marks that occur, in as many columns as fit into the figure."""
    styles = dict(shown)
    if styles:
        lines = extra("matplotlib.lines", "plot()")
        handles = [lines.Line2D([], [], label=label, **style) for label, style in styles.items()]
        width = CHARACTER * (max(map(len, styles)) + 8)
        count = max(1, min(len(handles), int(figure.get_figwidth() / width)))
        figure.legend(handles=handles, fontsize=8, ncols=count, frameon=False, loc="outside lower center")


def columns_of(count: int) -> list[int]:
    """Return numbers of axes in columns of at most COLUMN_LIMIT, as equal as possible: 11 become 6 and 5."""
    columns = math.ceil(count / COLUMN_LIMIT)
    return [count // columns + (i < count % columns) for i in range(columns)]


def stack_axes(count: int, time: str, file: File) -> tuple[Any, list[Any]]:
    """Return a figure with ``count`` axes over one time, in columns that are filled to the bottom, and the axes.

    The lowest axis of each column names the time; names of the others are aligned.
    """
    columns = columns_of(count)
    width = WIDTH * (1.0 if len(columns) == 1 else 0.62 * len(columns))
    figure = new_figure((width, 0.8 + ROW_HEIGHT * columns[0]), file)
    axes: list[Any] = []
    with use_style():
        outer = figure.add_gridspec(1, len(columns))
        for j, rows in enumerate(columns):
            inner = outer[j].subgridspec(rows, 1)
            for i in range(rows):
                axes.append(figure.add_subplot(inner[i], sharex=axes[0] if axes else None))
                axes[-1].tick_params(labelbottom=i == rows - 1)
            axes[-1].set_xlabel(time)
            figure.align_ylabels(axes[-rows:])
    return figure, axes


def name_axis(axis: Any, trace: Trace) -> None:
    """Set the label of a quantity, in lines that fit beside the axis."""
    axis.set_ylabel("\n".join(break_label(trace.label)), fontsize=9 if len(trace.label) <= LABEL else 8)


def break_label(label: str) -> list[str]:
    """Return lines of about LABEL characters, which end at a blank or an underscore if possible."""
    lines = []
    while len(label) > LABEL:
        cut = max((label.rfind(mark, 0, LABEL) for mark in " _["), default=-1)
        end = cut + (label[cut] != "[") if cut > 0 else LABEL
        lines.append(label[:end].rstrip())
        label = label[end:]
    return [*lines, label]


def fit(axis: Any, low: float, high: float) -> None:
    """Set limits and few plain ticks for values between these."""
    margin = 0.08 * spread(low, high)
    axis.set_ylim(low - margin, high + margin)
    axis.locator_params(axis="y", nbins=4)
    axis.ticklabel_format(axis="y", useOffset=False)


def spread(low: float, high: float) -> float:
    """Return the distance of two values, at least a fraction of their size, and of 1 if both are 0."""
    return max(high - low, LEAST_SPREAD * max(abs(low), abs(high))) or LEAST_SPREAD
