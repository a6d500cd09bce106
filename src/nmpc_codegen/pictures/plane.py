"""One state is drawn over another: the path, plans, and the region that rows forbid."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import list_some
from nmpc_codegen.pictures.over_time import references_of, title_of
from nmpc_codegen.pictures.plans import choose, kept_plans
from nmpc_codegen.pictures.style import (
    DOUBT_COLOR,
    FAILURE_COLOR,
    HARD,
    PLAN,
    REFERENCE_COLOR,
    SOFT,
    STATE_COLOR,
    WIDTH,
    Legend,
    finish,
    new_figure,
    spread,
    use_style,
)
from nmpc_codegen.runtime.records.trace import File, Record

Array = NDArray[np.float64]

SET_POINTS = 10  # largest number of references that are drawn as points
LONGEST = 4.0  # largest ratio of the axes for which both have one scale
POINTS = 240  # points in each direction of the grid on which rows are evaluated
FORBIDDEN: Legend = ("forbidden", {"color": FAILURE_COLOR, "alpha": 0.18, "marker": "s", "linestyle": ""})
COSTLY: Legend = ("soft row violated", {"color": DOUBT_COLOR, "alpha": 0.18, "marker": "s", "linestyle": ""})
PATH: Legend = ("path", {"color": STATE_COLOR, "linewidth": 1.8})
BEGIN: Legend = ("start", {"color": STATE_COLOR, "marker": "o", "linestyle": ""})
TARGET: Legend = ("reference", {"color": REFERENCE_COLOR, "linewidth": 0.8, "marker": "+", "markersize": 5})


def places(log: Record, x: str, y: str, user: str) -> tuple[int, int]:
    """Return the columns of two states; raise ControllerError if one does not exist."""
    names = [trace.name for trace in log.states]
    if x == y:
        raise ControllerError(f"{user}: {x!r} over itself; expected two states")
    for name in (x, y):
        if name not in names:
            raise ControllerError(f"{user}: there is no state {name!r}; expected one of {list_some(names)}")
    return names.index(x), names.index(y)


def draw(log: Record, x: str, y: str, rows: bool, every: int, file: File) -> Any:
    """Draw the path with its start, the forbidden region, the reference, and plans."""
    i, j = places(log, x, y, "plot_xy()")
    chosen = choose(kept_plans(log, "plot_xy()"), every, "plot_xy()") if every else []
    figure = new_figure((WIDTH, 0.75 * WIDTH), file)
    with use_style():
        axis = figure.subplots()
        shown = draw_surroundings(axis, log, i, j, rows, _moments(log))
        if log.plans is not None and chosen:
            for plan in log.plans.x[chosen]:
                axis.plot(plan[:, i], plan[:, j], zorder=1.8, **PLAN[1])
            shown.append(PLAN)
        axis.plot(log.x[:, i], log.x[:, j], zorder=3, **PATH[1])
        axis.plot(log.x[:1, i], log.x[:1, j], zorder=4, **BEGIN[1])
        return finish(figure, title_of(log), [PATH, BEGIN, *shown], file)


def _moments(log: Record) -> list[int]:
    """Return the samples at which obstacles are drawn: first, middle and last one."""
    return sorted({0, len(log.u) // 2, len(log.u) - 1}) if len(log.u) else []


def draw_surroundings(axis: Any, log: Record, i: int, j: int, rows: bool, samples: list[int]) -> list[Legend]:
    """Draw axes with fitting scales, bounds of both states, references, and forbidden regions at these samples."""
    ends = []
    for place in (i, j):
        values = np.concatenate([log.x[:, place], *_also_seen(log, place)])
        values = values[np.isfinite(values)]
        low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
        ends.append((low - 0.12 * spread(low, high), high + 0.12 * spread(low, high)))
    axis.set_xlim(*ends[0])
    axis.set_ylim(*ends[1])
    axis.set_xlabel(log.states[i].label)
    axis.set_ylabel(log.states[j].label)
    lengths = [high - low for low, high in ends]
    if log.states[i].unit == log.states[j].unit and max(lengths) <= LONGEST * min(lengths):
        axis.set_aspect("equal", adjustable="box")
    shown = _draw_lines(axis, log, i, j, samples)
    if rows and samples:
        for number in range(len(log.limits)):
            shown += _draw_forbidden(axis, log, number, (i, j), samples)
    return shown


def _also_seen(log: Record, place: int) -> list[Array]:
    """Return the values of a state in plans and its references."""
    planned = [] if log.plans is None else [log.plans.x[:, :, place].ravel()]
    followed = references_of(log).get(log.states[place].name)
    return planned if followed is None else [*planned, followed]


def _draw_lines(axis: Any, log: Record, i: int, j: int, samples: list[int]) -> list[Legend]:
    """Draw the visible bounds of the two states, and their references if both have one.

    All references are drawn, or that of a single sample.
    """
    shown: list[Legend] = []
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    for k, limit in enumerate(log.limits):
        if limit.array == "x" and limit.column in (i, j) and samples:
            style = SOFT if limit.soft else HARD
            low, high, line = (left, right, axis.axvline) if limit.column == i else (bottom, top, axis.axhline)
            for value in np.unique([log.lower[samples, k], log.upper[samples, k]]):
                if low <= value <= high:
                    line(float(value), zorder=1.5, **style[1])
                    shown.append(style)
    known, names = references_of(log), [log.states[column].name for column in (i, j)]
    if len(log.y) and all(name in known for name in names):
        target = np.column_stack([known[name] for name in names])
        target = target[samples] if len(samples) == 1 else target
        points = np.unique(target, axis=0)
        if len(points) <= SET_POINTS:
            axis.plot(*points.T, zorder=1.6, **{**TARGET[1], "linestyle": ""})
        else:
            axis.plot(*target.T, zorder=1.6, **{**TARGET[1], "marker": ""})
        shown.append(TARGET)
    return shown


def _draw_forbidden(axis: Any, log: Record, number: int, columns: tuple[int, int], samples: list[int]) -> list[Legend]:
    """Shade the region where a row is violated that depends only on the two states and on parameters."""
    limit = log.limits[number]
    place = max(log.program.rows[limit.row])
    needed = log.program.inputs(place) if place >= 0 else frozenset()
    of_states = {element for port, element in needed if port == 0}
    own = [element for port, element in needed if port == 2]
    foreign = any(port == 1 for port, _ in needed) or any(element >= log.p.shape[1] for element in own)
    if not of_states or not of_states <= set(columns) or foreign:
        return []
    data = np.column_stack([log.p[:, own], log.lower[:, number], log.upper[:, number]])[samples]
    different = [k for k, row in enumerate(data) if not any(np.array_equal(row, data[m]) for m in range(k))]
    across, up = (np.linspace(ends[0], ends[1], POINTS) for ends in (axis.get_xlim(), axis.get_ylim()))
    grid = np.meshgrid(across, up)
    x = np.full((grid[0].size, max(columns) + 1), math.nan)
    x[:, columns[0]], x[:, columns[1]] = grid[0].ravel(), grid[1].ravel()
    legend = COSTLY if limit.soft else FORBIDDEN
    color, shown = legend[1]["color"], []
    for k in different:
        p = np.tile(log.p[samples[k]], (len(x), 1))
        with np.errstate(all="ignore"):
            value = log.program.values(x, np.zeros((len(x), 0)), p, [place])[place]
        inside = np.minimum(value - data[k, -2], data[k, -1] - value).reshape(grid[0].shape)
        if np.nanmin(inside) < 0.0:
            axis.contourf(across, up, inside, levels=[-math.inf, 0.0], colors=[color], alpha=0.18, zorder=1.1)
            axis.contour(across, up, inside, levels=[0.0], colors=[color], linewidths=0.9, zorder=1.2)
            shown = [legend]
            if len(different) > 1:
                middle = [float(part.ravel()[np.ravel(inside) < 0.0].mean()) for part in grid]
                axis.annotate(f"t = {log.t[samples[k]]:.3g}", middle, ha="center", va="center", fontsize=7, color="0.3")
    return shown
