"""Plans are drawn over a closed loop as a fan of predictions, and one plan by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.pictures.over_time import (
    Curve,
    bounds_of,
    draw_curve,
    draw_curves,
    draw_marks,
    hold,
    marks_of,
    references_of,
    signals_of,
    time_label,
    title_of,
)
from nmpc_codegen.pictures.style import (
    ALGEBRAIC_COLOR,
    CONTROL_COLOR,
    PLAN,
    ROW_COLOR,
    STATE_COLOR,
    Legend,
    finish,
    fit,
    stack_axes,
    use_style,
)
from nmpc_codegen.runtime.given import is_integer
from nmpc_codegen.runtime.records.one_plan import Plan
from nmpc_codegen.runtime.records.trace import File, Plans, Record

Array = NDArray[np.float64]


def kept_plans(log: Record, user: str) -> Plans:
    """Return the plans of a log; raise ControllerError if there are none."""
    if log.plans is None:
        raise ControllerError(f"{user}: the log has no plans; expected one of simulate(..., plans=1) or of a recording")
    return log.plans


def choose(plans: Plans, every: int, user: str) -> list[int]:
    """Return the indices of the plans of every ``every``-th sample, or of the next sample with a plan."""
    if not is_integer(every) or every < 1:
        raise ControllerError(f"{user}: every is {every!r}; expected an integer >= 1")
    wanted = np.arange(0, plans.sample[-1] + 1, every)
    return sorted({int(place) for place in np.searchsorted(plans.sample, wanted)})


def draw(log: Record, every: int, file: File) -> Any:
    """Draw states and controls of the loop, and plans from their beginnings on."""
    plans = kept_plans(log, "plot_plans()")
    chosen, nx, curves = choose(plans, every, "plot_plans()"), len(log.states), signals_of(log)
    figure, axes = stack_axes(len(curves), time_label(log.time_unit), file)
    shown: list[Legend] = []
    with use_style():
        for i, (axis, curve) in enumerate(zip(axes, curves, strict=True)):
            shown += [*draw_curve(axis, curve), *draw_marks(axis, marks_of(log))]
            values = plans.x[chosen, :, i] if i < nx else hold(plans.u[chosen, :, i - nx].T).T
            lines = draw_fan(axis, log.t[plans.sample[chosen]], plans.t, values, held=i >= nx)
            low, high = axis.get_ylim()
            fit(axis, min(low, lines[0]), max(high, lines[1]))
        axes[0].set_xlim(log.t[0], max(log.t[-1], log.t[plans.sample[chosen[-1]]] + plans.t[-1]))
        return finish(figure, title_of(log), [*shown, PLAN], file)


def draw_fan(axis: Any, begin: Array, t: Array, values: Array, held: bool) -> tuple[float, float]:
    """Draw thin lines of plans (n, N+1), each with a dot at its beginning; return the range of their values."""
    style = {**PLAN[1], "drawstyle": "steps-post" if held else "default"}
    for start, line in zip(begin, values, strict=True):
        axis.plot(start + t, line, zorder=1.2, **style)
    axis.plot(begin, values[:, 0], linestyle="", marker=".", markersize=3, color=PLAN[1]["color"], zorder=3)
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (np.inf, -np.inf)


def draw_plan(plan: Plan, title: str, failed: bool, file: File) -> Any:
    """Draw states, controls, algebraic variables and rows of one plan over its nodes, with bounds and references."""
    followed = references_of(plan)
    colors = {"states": STATE_COLOR, "controls": CONTROL_COLOR, "algebraic": ALGEBRAIC_COLOR, "rows": ROW_COLOR}
    curves = []
    for kind, array in (("states", "x"), ("controls", "u"), ("algebraic", "z"), ("rows", "h")):
        held = array == "u"
        for i, trace in enumerate(getattr(plan, kind)):
            values = hold(plan.u[:, i]) if held else getattr(plan, array)[:, i]
            reference = followed.get(trace.name) if array in ("x", "u") else None
            bounds = bounds_of(plan, plan.t, array, i)
            curves.append(Curve(trace, plan.t, values, colors[kind], reference, held, not held, bounds=bounds))
    return draw_curves(curves, title, time_label(plan.time_unit), (), file, failed)
