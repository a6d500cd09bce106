"""Two logs are compared on the same axes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.pictures.over_time import changed_parameters, curves_of, draw_bounds, draw_curve, time_label
from nmpc_codegen.pictures.style import Legend, finish, fit, stack_axes, use_style
from nmpc_codegen.runtime.records.trace import File, Record

OTHER_COLOR = "#b0307a"


def draw(log: Record, other: Record, names: tuple[str, str], file: File) -> Any:
    """Draw the curves of one log, and over them the curves of the other log with the same label."""
    if not isinstance(other, Record):
        raise ControllerError(f"compare(): {other!r} is no log")
    if log.time_unit != other.time_unit:
        raise ControllerError(f"compare(): one log is in {log.time_unit}, the other in {other.time_unit}")
    if isinstance(names, str) or len(names) != 2:
        raise ControllerError(f"compare(): names is {names!r}; expected two")
    changed = {*changed_parameters(log), *changed_parameters(other)}
    theirs = {(curve.color, curve.trace.label): curve for curve in curves_of(other, changed)}
    curves = [replace(curve, logarithmic=False) for curve in curves_of(log, changed)]
    figure, axes = stack_axes(len(curves), time_label(log.time_unit), file)
    second: Legend = (names[1], {"color": OTHER_COLOR, "linewidth": 1.2})
    shown: list[Legend] = [(names[0], {"color": "0.25", "linewidth": 1.6}), second]
    with use_style():
        for axis, curve in zip(axes, curves, strict=True):
            shown += draw_curve(axis, curve)
            found = theirs.get((curve.color, curve.trace.label))
            if found is not None and np.isfinite(found.values).any():
                style = "steps-post" if curve.held else "default"
                axis.plot(found.t, found.values, drawstyle=style, zorder=2.6, **second[1])
                values = found.values[np.isfinite(found.values)]
                ends = float(values.min()), float(values.max())
                seen = draw_bounds(axis, found.bounds, *ends, {"color": OTHER_COLOR, "alpha": 0.6})[1]
                low, high = axis.get_ylim()
                if not low <= min([ends[0], *seen]) <= max([ends[1], *seen]) <= high:
                    fit(axis, min([low, ends[0], *seen]), max([high, ends[1], *seen]))
        axes[0].set_xlim(min(log.t[0], other.t[0]), max(log.t[-1], other.t[-1]))
        return finish(figure, f"{log.name}: {names[0]} and {names[1]}", shown, file)
