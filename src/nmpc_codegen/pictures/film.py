"""A closed loop is animated with the current plan."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.pictures.over_time import draw_bounds, hold, signals_of, time_label, title_of
from nmpc_codegen.pictures.plane import PATH, draw_surroundings, places
from nmpc_codegen.pictures.plans import choose, kept_plans
from nmpc_codegen.pictures.style import (
    CONTROL_COLOR,
    PLAN,
    STATE_COLOR,
    WIDTH,
    finish,
    fit,
    is_inline,
    name_axis,
    new_figure,
    stack_axes,
    use_style,
)
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.given import is_positive
from nmpc_codegen.runtime.records.timing import nanoseconds
from nmpc_codegen.runtime.records.trace import File, Plans, Record

WRITERS = {".gif": "pillow", ".mp4": "ffmpeg"}
SLOWEST, FASTEST = 5.0, 30.0  # pictures per second
NOW = {"color": PLAN[1]["color"], "linewidth": 1.6}

#: A function that draws the sample of the n-th plan.
Frame = Callable[[int], None]


def draw(log: Record, file: File, xy: tuple[str, str] | None, every: int, fps: float | None) -> Any:
    """Draw the animation; write it if a file is given."""
    plans = kept_plans(log, "animate()")
    chosen = sorted({*choose(plans, every, "animate()"), len(plans.sample) - 1})
    if fps is not None and not is_positive(fps):
        raise ControllerError(f"animate(): fps is {fps!r}; expected a positive number")
    if xy is not None and (isinstance(xy, str) or len(xy) != 2):
        raise ControllerError(f"animate(): xy is {xy!r}; expected the names of two states")
    if fps is None:
        fps = float(np.clip(1e9 / (every * (nanoseconds(log, None) or 1e8)), SLOWEST, FASTEST))
    animation = extra("matplotlib.animation", "animate()")
    writer = "" if file is None else _writer(file, animation)
    with use_style():
        figure, show = _over_time(log, plans, file) if xy is None else _draw_plane(log, plans, xy, file)
        film = _class_of(animation)(figure, show, frames=chosen, interval=1e3 / fps, blit=False, repeat=True)
        if file is not None:
            film.save(Path(file), writer=writer, fps=fps, dpi=100)
        elif is_inline():  # the animation is the value of the cell, not its first picture
            extra("matplotlib.pyplot", "animate()").close(figure)
    return film


@cache
def _class_of(animation: Any) -> Any:
    """Return the class of an animation that a notebook plays."""

    class Film(animation.FuncAnimation):  # type: ignore[misc]
        """A film is an animation of matplotlib."""

        def _repr_html_(self) -> str:
            return str(self.to_jshtml())

    return Film


def _writer(file: Any, animation: Any) -> str:
    """Return the writer for a file with this ending, or raise ControllerError."""
    ending = Path(file).suffix.lower()
    if ending not in WRITERS:
        raise ControllerError(f"animate(): {file} ends in {ending!r}; expected {' or '.join(WRITERS)}")
    if not animation.writers.is_available(WRITERS[ending]):
        raise ControllerError(f"animate(): {file} needs {WRITERS[ending]}, which is not installed; .gif needs nothing")
    return WRITERS[ending]


def _title(log: Record, k: int) -> str:
    """Return name and time of a sample, with the same number of digits for all samples."""
    if log.time_unit == "samples":
        return f"{log.name}: sample {k}"
    digits = max(0, 1 - math.floor(math.log10(log.dt)))
    return f"{log.name}: t = {log.t[k]:.{digits}f} {log.time_unit}"


def _over_time(log: Record, plans: Plans, file: File) -> tuple[Any, Frame]:
    """Draw states and controls over time."""
    nx, curves, lines = len(log.states), signals_of(log), []
    figure, axes = stack_axes(len(curves), time_label(log.time_unit), file)
    for i, (axis, curve) in enumerate(zip(axes, curves, strict=True)):
        planned = plans.x[..., i] if i < nx else plans.u[..., i - nx]
        values = np.append(planned.ravel(), curve.values)
        values = values[np.isfinite(values)]
        low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
        _, seen = draw_bounds(axis, curve.bounds, low, high)
        fit(axis, min([low, *seen]), max([high, *seen]))
        name_axis(axis, curve.trace)
        style = {"drawstyle": "steps-post" if curve.held else "default"}
        color = CONTROL_COLOR if curve.held else STATE_COLOR
        past = axis.plot([], [], color=color, linewidth=1.6, **style)[0]
        lines.append((past, axis.plot([], [], **NOW, **style)[0]))
    axes[0].set_xlim(log.t[0], log.t[plans.sample[-1]] + plans.t[-1])
    finish(figure, title_of(log), [("plan", NOW)], None)

    def show(n: int) -> None:
        k = int(plans.sample[n])
        for i, ((past, plan), curve) in enumerate(zip(lines, curves, strict=True)):
            past.set_data(curve.t[: k + 1], curve.values[: k + 1])
            plan.set_data(log.t[k] + plans.t, plans.x[n, :, i] if i < nx else hold(plans.u[n, :, i - nx]))
        figure.suptitle(_title(log, k), fontsize=10, color="0.2")

    return figure, show


def _draw_plane(log: Record, plans: Plans, xy: tuple[str, str], file: File) -> tuple[Any, Frame]:
    """Draw one state over another; obstacles are at their current places."""
    i, j = places(log, *xy, "animate()")
    figure = new_figure((WIDTH, 0.75 * WIDTH), file)
    axis = figure.subplots()
    shown = draw_surroundings(axis, log, i, j, True, [int(plans.sample[0])])
    finish(figure, title_of(log), [PATH, ("plan", NOW), *shown], None)
    limits = axis.get_xlim(), axis.get_ylim()

    def show(n: int) -> None:
        k = int(plans.sample[n])
        with use_style():  # cleared axes are drawn again
            axis.clear()
            draw_surroundings(axis, log, i, j, True, [k])
            axis.set_xlim(*limits[0])
            axis.set_ylim(*limits[1])
            axis.plot(log.x[: k + 1, i], log.x[: k + 1, j], zorder=3, **PATH[1])
            axis.plot(plans.x[n, :, i], plans.x[n, :, j], zorder=2.5, marker=".", markersize=3, **NOW)
            figure.suptitle(_title(log, k), fontsize=10, color="0.2")

    return figure, show
