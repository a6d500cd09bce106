"""Many flights are drawn as paths of every state and control, with wrong flights on top."""

from __future__ import annotations

from collections.abc import Sequence
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
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.loops.flights import Flights
from nmpc_codegen.runtime.records.trace import File, with_unit

Array = NDArray[np.float64]

#: Text of the legend, and style of the line.
MEDIAN: Legend = ("median", {"color": "0.1", "linewidth": 1.0})
WRONG = "failed, lost or a hard row violated"
MOST = 1000  # largest number of wrong paths that are drawn
FEW = 200  # largest number of paths that are drawn as lines; of more, the density is drawn
COLUMNS, ROWS = 240, 90  # pixels of the picture of a density


def draw(flights: Sequence[Flights], wrong: NDArray[np.bool_], title: str, file: File, words: str = WRONG) -> Any:
    """Draw an axis for each state and control, which is held until the next sample.

    Flights marked by ``wrong`` are drawn last, in red, with ``words`` in the legend. The limits of an axis are those of
    flights whose state was finite, if there is one.

    Raises:
        ControllerError: the samples were not recorded, or there is no flight.
    """
    first, recorded = flights[0], [(f.x, f.u) for f in flights if f.x is not None and f.u is not None and f.u.size]
    if len(recorded) < len(flights):
        raise ControllerError("plot() needs the samples of at least one flight: simulate(..., record=True)")
    x, u = (np.concatenate(of_all) for of_all in zip(*recorded, strict=True))
    lost = np.concatenate([f.lost for f in flights]) >= 0
    panels = [(STATE_COLOR, paths) for paths in np.moveaxis(x, 2, 0)]
    panels += [(CONTROL_COLOR, paths) for paths in np.moveaxis(u, 2, 0)]
    figure = new_figure((WIDTH, 0.8 + ROW_HEIGHT * len(panels)), file)
    with use_style():
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axis, name, (color, paths) in zip(axes, (*first.states, *first.controls), panels, strict=True):
            t = np.asarray(first.dt * np.arange(first.steps + 1), dtype=np.float64)
            if color is CONTROL_COLOR:
                t, paths = np.repeat(t, 2)[1:], np.repeat(np.append(paths, paths[:, -1:], axis=1), 2, axis=1)[:, :-1]
            _draw_panel(axis, t, paths, wrong, color)
            _set_limits(axis, paths[~lost] if (~lost).any() else paths)
            axis.set_ylabel(with_unit(name, first.units.get(name, "")))
            axis.locator_params(axis="y", nbins=4)
        axes[-1].set_xlabel(with_unit("time", first.time_unit))
        axes[0].set_xlim(0.0, t[-1])
        figure.align_ylabels(axes)
        red: Legend = (words, {"color": FAILURE_COLOR})
        return finish(figure, f"{first.name}: {title}", (MEDIAN, red) if wrong.any() else (MEDIAN,), file)


def _draw_panel(axis: Any, t: Array, paths: Array, wrong: NDArray[np.bool_], color: str) -> None:
    """Draw good paths as a density, or as lines if they are few; wrong ones on top; the median of all."""
    collections = extra("matplotlib.collections", "plot()")
    few = np.sum(~wrong) <= FEW
    if not few:
        _draw_density(axis, t, paths[~wrong], color)
    for some, ink in ((~wrong & few, color), (wrong, FAILURE_COLOR)):
        lines = [np.column_stack([t, path]) for path in paths[some][:MOST]]
        style = {"linewidths": 0.6, "alpha": 0.5, "rasterized": True}
        axis.add_collection(collections.LineCollection(lines, colors=ink, **style))
    axis.plot(t, np.nanmedian(paths, axis=0), **MEDIAN[1])


def _set_limits(axis: Any, paths: Array) -> None:
    """Set the limits to the range of the finite values, with a margin."""
    finite = paths[np.isfinite(paths)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    margin = 0.05 * (high - low or abs(high) or 1.0)
    axis.set_ylim(low - margin, high + margin)


def _draw_density(axis: Any, t: Array, paths: Array, color: str) -> None:
    """Draw how many paths pass a place, on a logarithmic scale, from white to the color."""
    low, high = float(np.nanmin(paths)), float(np.nanmax(paths))
    edges = np.linspace(low, high if high > low else low + 1.0, ROWS + 1)
    counts = np.zeros((ROWS, COLUMNS))
    for j, time in enumerate(np.linspace(t[0], t[-1], COLUMNS)):
        k = min(max(int(np.searchsorted(t, time, side="right")) - 1, 0), len(t) - 2)
        share = (time - t[k]) / (t[k + 1] - t[k]) if t[k + 1] > t[k] else 1.0
        values = paths[:, k] + share * (paths[:, k + 1] - paths[:, k])
        counts[:, j] = np.histogram(values[np.isfinite(values)], edges)[0]
    maps = extra("matplotlib.colors", "plot()").LinearSegmentedColormap.from_list("paths", ["white", color, "0.1"])
    extent = (t[0], t[-1], edges[0], edges[-1])
    axis.imshow(np.log1p(counts), cmap=maps, extent=extent, origin="lower", aspect="auto", interpolation="nearest")
    axis.grid(visible=False)
