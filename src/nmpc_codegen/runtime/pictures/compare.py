"""Two logs on the same axes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from nmpc_codegen.runtime.pictures.loop import curves_of, draw_curve, time_label
from nmpc_codegen.runtime.pictures.style import File, Legend, finish, fit, name_times, stack_axes, use_style
from nmpc_codegen.runtime.records.trace import Record

OTHER_COLOR = "#b0307a"


def draw(log: Record, other: Record, names: tuple[str, str], file: File) -> Any:
    """The curves of one log, and over them those of the other with the same label."""
    theirs = {curve.trace.label: curve for curve in curves_of(other)}
    curves = [replace(curve, logarithmic=False) for curve in curves_of(log)]
    figure, columns = stack_axes(len(curves), file)
    second: Legend = (names[1], {"color": OTHER_COLOR, "linewidth": 1.2})
    shown: list[Legend] = [(names[0], {"color": "0.25", "linewidth": 1.6}), second]
    with use_style():
        axes = [axis for column in columns for axis in column]
        for axis, curve in zip(axes, curves, strict=True):
            shown += draw_curve(axis, curve)
            found = theirs.get(curve.trace.label)
            if found is not None and np.isfinite(found.values).any():
                style = "steps-post" if curve.held else "default"
                axis.plot(found.t, found.values, drawstyle=style, zorder=2.6, **second[1])
                (low, high), values = axis.get_ylim(), found.values[np.isfinite(found.values)]
                if not low <= values.min() <= values.max() <= high:
                    fit(axis, min(low, float(values.min())), max(high, float(values.max())))
        name_times(columns, time_label(log.time_unit))
        axes[0].set_xlim(min(log.t[0], other.t[0]), max(log.t[-1], other.t[-1]))
        return finish(figure, f"{log.name}: {names[0]} and {names[1]}", shown, file)
