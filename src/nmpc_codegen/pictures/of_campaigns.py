"""Campaigns are drawn as distributions, and as lost flights over random variables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.pictures.style import (
    FAILURE_COLOR,
    ROW_HEIGHT,
    STATE_COLOR,
    WIDTH,
    finish,
    new_figure,
    use_style,
)
from nmpc_codegen.runtime.loops.flown import Flown
from nmpc_codegen.runtime.records.trace import File, with_unit

Array = NDArray[Any]

BINS = 60
#: Number of variables in plot_lost(); largest number of points of each kind in a panel.
VARIABLES, POINTS = 3, 600
LOST = ("lost", {"color": FAILURE_COLOR, "marker": "o", "markersize": 3, "linestyle": ""})
KEPT = ("not lost", {"color": STATE_COLOR, "marker": "o", "markersize": 3, "linestyle": ""})
LIMIT = ("allowed", {"color": "0.2", "linewidth": 1.0, "linestyle": (0, (5, 3))})


def label(name: str, unit: Mapping[str, str]) -> str:
    """Return a name with its unit."""
    return with_unit(name, unit.get(name, ""))


def draw_distributions(
    flown: Flown, allowed: Array, lost: NDArray[np.bool_], title: str, unit: Mapping[str, str], file: File
) -> Any:
    """Draw histograms of costs, of violations of rows that were violated, and of times."""
    panels: list[tuple[str, Array, float]] = [("cost", flown.cost, np.inf)]
    for name, limit, amounts in zip(flown.labels.rows, allowed, flown.violation.T, strict=True):
        if np.nanmax(amounts, initial=0.0) > 0:
            panels.append((f"largest violation of {label(name, unit)}", amounts, limit))
    if np.isfinite(flown.seconds).all():
        panels.append(("mean time of a sample [µs]", 1e6 * flown.seconds[:, 0], np.inf))
    figure = new_figure((WIDTH, 0.9 + 1.25 * ROW_HEIGHT * len(panels)), file)
    with use_style():
        axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
        for axis, (text, values, limit) in zip(axes, panels, strict=True):
            _draw_histogram(axis, values, lost, flown.broken < 0)
            axis.set_xlabel(text)
            axis.set_ylabel("flights")
            if np.isfinite(limit):
                axis.axvline(limit, **LIMIT[1])
        shown = [KEPT] * bool((~lost).any()) + [LOST] * bool(lost.any())
        shown += [LIMIT] * any(np.isfinite(limit) for _, _, limit in panels)
        return finish(figure, title, shown, file)


def _draw_histogram(axis: Any, values: Array, lost: NDArray[np.bool_], whole: NDArray[np.bool_]) -> None:
    """Draw counts on a logarithmic scale, with those of lost flights on top.

    The last bin holds values that are far out or not finite; flights that are not ``whole`` do not widen the axis.
    """
    finite = values[np.isfinite(values) & (whole if whole.any() else True)]
    if not finite.size:
        return
    low, high = float(finite.min()), float(np.quantile(finite, 0.995))
    top = float(finite.max())
    high = top if top - low < 2 * (high - low) else high + 0.1 * (high - low)
    edges = np.linspace(low, high if high > low else low + max(1e-12, 1e-3 * abs(low)), BINS + 1)
    inside = np.clip(np.nan_to_num(values, nan=np.inf), edges[0], edges[-1])
    kinds = [inside[~lost], inside[lost]]
    axis.hist(kinds, edges, stacked=True, color=[STATE_COLOR, FAILURE_COLOR])
    axis.set_yscale("symlog", linthresh=10)
    axis.set_ylim(bottom=0)


def draw_pairs(flown: Flown, lost: NDArray[np.bool_], title: str, unit: Mapping[str, str], file: File) -> Any:
    """Draw lost and other flights over pairs of the variables in which they differ most."""
    heads = [*(f"start.{name}" for name in flown.labels.states), *flown.labels.drawn]
    every = np.hstack([flown.start, flown.drawn])
    spread = [i for i in range(len(heads)) if np.ptp(every[:, i]) > 0] or [0]
    chosen = sorted(spread, key=lambda i: -_difference(every[:, i], lost))[:VARIABLES]
    n = max(1, len(chosen) - 1)
    figure = new_figure((WIDTH, 0.9 + WIDTH * n / (n + 0.4) * 0.8 if n > 1 else 4.2), file)
    with use_style():
        axes = figure.subplots(n, n, squeeze=False)
        for i in range(n):
            for j in range(n):
                axis = axes[i, j]
                if j > i:
                    axis.set_visible(False)
                    continue
                column, row = chosen[j], chosen[min(i + 1, len(chosen) - 1)]
                _draw_points(axis, every[:, column], every[:, row] if len(chosen) > 1 else flown.cost, lost)
                axis.set_xlabel(label(heads[column], unit) if i == n - 1 else "")
                axis.set_ylabel((label(heads[row], unit) if len(chosen) > 1 else "cost") if j == 0 else "")
                axis.locator_params(nbins=5)
        return finish(figure, title, [KEPT, LOST] if lost.any() else [KEPT], file)


def _difference(values: Array, lost: NDArray[np.bool_]) -> float:
    """Return the largest distance between the distributions of lost and other flights (Kolmogorov and Smirnov)."""
    if not lost.any() or lost.all():
        return 0.0
    order = np.argsort(values)
    own, other = np.cumsum(lost[order]) / lost.sum(), np.cumsum(~lost[order]) / (~lost).sum()
    return float(np.max(np.abs(own - other)))


def _draw_points(axis: Any, x: Array, y: Array, lost: NDArray[np.bool_]) -> None:
    """Draw points of both kinds, the rarer kind on top."""
    kinds = [(~lost, KEPT), (lost, LOST)]
    for (some, (_, style)), alpha in zip(sorted(kinds, key=lambda k: -int(k[0].sum())), (0.4, 0.8), strict=True):
        places = np.flatnonzero(some)[:POINTS]
        axis.plot(x[places], y[places], **{**style, "markersize": 2.5, "alpha": alpha, "markeredgewidth": 0})
