"""Rows are drawn over time: how near plans come to their bounds, where they are active, and their multipliers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import list_some
from nmpc_codegen.pictures.over_time import draw_marks, marks_of, time_label, title_of
from nmpc_codegen.pictures.plans import kept_plans
from nmpc_codegen.pictures.style import (
    CONTROL_COLOR,
    FAILURE_COLOR,
    HARD,
    ROW_COLOR,
    ROW_HEIGHT,
    WIDTH,
    Legend,
    finish,
    fit,
    name_axis,
    new_figure,
    use_style,
)
from nmpc_codegen.runtime.records.trace import File, Plans, Record

MOST = 12  # largest number of rows that are drawn if none are named
BOUND: Legend = ("bound", HARD[1])
ACTIVE: Legend = ("active", {"color": ROW_COLOR, "marker": "o", "markersize": 3.5, "linestyle": ""})
VIOLATED: Legend = ("violated", {"color": FAILURE_COLOR, "marker": "o", "markersize": 3.5, "linestyle": ""})


def draw(log: Record, rows: Sequence[str] | str | None, file: File) -> Any:
    """Draw two axes for every row: its distance from the bound on the left, its multiplier on the right."""
    plans = kept_plans(log, "plot_rows()")
    chosen = _choose(plans, rows)
    t = log.t[plans.sample]
    figure = new_figure((1.25 * WIDTH, 0.9 + ROW_HEIGHT * len(chosen)), file)
    shown: list[Legend] = [BOUND]
    with use_style():
        axes = figure.subplots(len(chosen), 2, sharex=True, squeeze=False)
        for (left, right), i in zip(axes, chosen, strict=True):
            distance, on = plans.distance[:, i], plans.active[:, i] > 0
            left.plot(t, distance, color=ROW_COLOR, linewidth=1.4)
            left.axhline(0.0, zorder=1.5, **HARD[1])
            for marked, legend in ((on, ACTIVE), (distance < -plans.rounding[i], VIOLATED)):
                if marked.any():
                    left.plot(t[marked], distance[marked], **legend[1])
                    shown.append(legend)
            shown += draw_marks(left, marks_of(log))
            name_axis(left, plans.rows[i])
            fit(left, *_range(distance, plans.rounding[i]))
            right.plot(t, plans.multiplier[:, i], color=CONTROL_COLOR, linewidth=1.4, marker=".", markersize=3)
            fit(right, *_range(plans.multiplier[:, i]))
            if np.isnan(plans.multiplier[:, i]).all():
                place: Any = {"xycoords": "axes fraction", "ha": "center", "fontsize": 8}
                right.annotate("the algorithm keeps none", (0.5, 0.6), **place)
        axes[0, 0].set_title("least distance of the plan from the bound", fontsize=9)
        axes[0, 1].set_title("largest multiplier (> 0: upper bound)", fontsize=9)
        for axis in axes[-1]:
            axis.set_xlabel(time_label(log.time_unit))
        figure.align_ylabels()
        some = "" if len(chosen) == len(plans.rows) else f"; {len(chosen)} of {len(plans.rows)} rows"
        return finish(figure, title_of(log) + some, shown, file)


def _range(values: Any, least: float = 0.0) -> tuple[float, float]:
    """Return least and largest finite value and 0; ``least`` is the least half distance of the ends."""
    finite = values[np.isfinite(values)]
    return min(-least, float(finite.min(initial=0.0))), max(least, float(finite.max(initial=0.0)))


def _choose(plans: Plans, rows: Sequence[str] | str | None) -> list[int]:
    """Return the numbers of named rows, also of whole vectors, or of those active or nearest to their bounds."""
    names, rows = [trace.name for trace in plans.rows], (rows,) if isinstance(rows, str) else rows
    bounded = np.array(np.isfinite(plans.distance).any(axis=0))
    if rows is None:
        size = np.nanmax(np.abs(np.where(np.isfinite(plans.distance), plans.distance, 0.0)), axis=0, initial=1e-300)
        least = np.min(np.where(np.isnan(plans.distance), np.inf, plans.distance), axis=0) / size
        order = sorted(np.flatnonzero(bounded), key=lambda i: (not plans.active[:, i].any(), least[i]))
        chosen = sorted(int(i) for i in order[:MOST])
        wanted = "the problem has no row with a finite bound at a single node"
    else:
        chosen = [i for row in rows for i, n in enumerate(names) if row in (n, n.partition("[")[0])]
        unknown = [row for row in rows if not any(row in (n, n.partition("[")[0]) for n in names)]
        wanted = f"there is no row {list_some(unknown)}; expected some of {list_some(names)}" if unknown else ""
        chosen = [] if unknown else [i for i in chosen if bounded[i]]
        wanted = wanted or (f"{list_some(list(rows))} has no finite bound" if rows else "rows is empty")
    if not chosen:
        raise ControllerError(f"plot_rows(): {wanted}")
    return chosen
