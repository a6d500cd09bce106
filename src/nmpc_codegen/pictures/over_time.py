"""A closed loop is drawn with one axis per quantity, with bounds, references and marks."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.status import Status
from nmpc_codegen.pictures.style import (
    ALGEBRAIC_COLOR,
    CONTROL_COLOR,
    DOUBT_COLOR,
    ESTIMATE,
    ESTIMATE_COLOR,
    FAILURE_COLOR,
    HARD,
    LATE_COLOR,
    MEASURED,
    PARAMETER_COLOR,
    REFERENCE,
    ROW_COLOR,
    SENSOR_COLOR,
    SOFT,
    STATE_COLOR,
    TIME_COLOR,
    Legend,
    finish,
    fit,
    name_axis,
    spread,
    stack_axes,
    use_style,
)
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.records.one_plan import Plan
from nmpc_codegen.runtime.records.timing import late_starts
from nmpc_codegen.runtime.records.trace import File, Record, Trace, with_unit

Array = NDArray[np.float64]

#: Statuses whose control comes from a QP although its rows or its plan are doubtful.
DOUBTFUL = (Status.RELAXED, Status.NOT_CONVERGED)

#: Times of samples with their entry in the legend.
Mark = tuple[Array, Legend]

#: Computing times are drawn on a logarithmic axis if the longest one exceeds this multiple of the median.
UNEVEN = 20


@dataclass(frozen=True, eq=False)
class CurveBounds:
    """The bounds of a curve are valid from one of the times ``t`` to the next."""

    t: Array
    lower: Array
    upper: Array
    soft: bool


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve has the values of a trace over time, and their reference, one value per sample.

    held: constant until the next sample; dots: known only at the samples; logarithmic: positive values of different
    magnitude; estimate: estimates at the samples, and two standard deviations; measured: measurements; bounds: those of
    all rows on the trace.
    """

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
    bounds: tuple[CurveBounds, ...] = ()


def draw(log: Record, file: File) -> Any:
    """Draw a log; see Log.plot()."""
    failed = bool(np.any((log.status != Status.OK) & ~np.isin(log.status, DOUBTFUL)))
    return draw_curves(curves_of(log), title_of(log), time_label(log.time_unit), marks_of(log), file, failed)


def draw_curves(
    curves: Sequence[Curve], title: str, label: str, marks: Sequence[Mark], file: File, failed: bool
) -> Any:
    """Draw a figure with one axis per curve, with marks at the times of doubtful and of failed samples."""
    figure, axes = stack_axes(len(curves), label, file)
    shown: list[Legend] = []
    with use_style():
        for axis, curve in zip(axes, curves, strict=True):
            shown += draw_curve(axis, curve)
            shown += draw_marks(axis, marks)
        t = curves[0].t
        axes[0].set_xlim(t[0], t[-1] if len(t) > 1 else t[0] + 1.0)
        return finish(figure, title, shown, file, FAILURE_COLOR if failed else "0.2")


def draw_curve(axis: Any, curve: Curve) -> list[Legend]:
    """Draw the curve, its reference, and bounds that it comes near or violates; set the limits of the axis.

    Return the entries for a legend.
    """
    style = "steps-post" if curve.held else "default"
    dots: dict[str, Any] = {"marker": ".", "markersize": 4.0} if curve.dots else {}
    axis.plot(curve.t, curve.values, color=curve.color, linewidth=1.6, drawstyle=style, **dots)
    _mark_single(axis, curve)
    name_axis(axis, curve.trace)
    if curve.logarithmic:
        _scale(axis)
        return []
    finite = curve.values[np.isfinite(curve.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    shown, seen = draw_bounds(axis, curve.bounds, low, high)
    if curve.measured is not None:
        axis.plot(curve.t[: len(curve.measured)], curve.measured, zorder=1.6, **MEASURED[1])
        shown.append(MEASURED)
    if curve.estimate is not None:
        found, around = curve.estimate
        t = curve.t[: len(found)]
        axis.plot(t, found, zorder=2.4, **ESTIMATE[1])
        axis.fill_between(t, found - around, found + around, color=ESTIMATE_COLOR, alpha=0.18, linewidth=0, zorder=1.4)
        shown.append(ESTIMATE)
        seen += [float(np.nanquantile(found - around, 0.1)), float(np.nanquantile(found + around, 0.9))]
        seen += [float(np.nanmin(found)), float(np.nanmax(found))]
    if curve.reference is not None and len(curve.reference):
        followed = np.append(curve.reference, curve.reference[-1])[: len(curve.t)]
        axis.plot(curve.t, followed, drawstyle="steps-post", zorder=1.8, **REFERENCE[1])
        shown.append(REFERENCE)
        seen += [float(followed.min()), float(followed.max())]
    fit(axis, min([low, *seen]), max([high, *seen]))
    return shown


def draw_marks(axis: Any, marks: Sequence[Mark]) -> list[Legend]:
    """Draw marks at the lower edge."""
    for times, (_, style) in marks:
        axis.plot(times, np.zeros(len(times)), transform=axis.get_xaxis_transform(), zorder=4, **style)
    return [legend for _, legend in marks]


def _mark_single(axis: Any, curve: Curve) -> None:
    """Draw dots at values between unknown ones, which no line connects."""
    known = np.concatenate([[False], np.isfinite(curve.values), [False]])
    single = known[1:-1] & ~known[:-2] & ~known[2:]
    if single.any():
        axis.plot(curve.t[single], curve.values[single], color=curve.color, marker=".", linestyle="")


def _scale(axis: Any) -> None:
    """Set a logarithmic axis with plain numbers."""
    ticker = extra("matplotlib.ticker", "plot()")
    axis.set_yscale("log")
    axis.yaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_minor_locator(ticker.NullLocator())
    axis.yaxis.set_major_formatter("{x:g}")


def draw_bounds(
    axis: Any, bounds: Iterable[CurveBounds], low: float, high: float, more: Mapping[str, Any] | None = None
) -> tuple[list[Legend], list[float]]:
    """Draw the parts of bounds that values between ``low`` and ``high`` come near or violate.

    Return the entries for the legend, and the values that the axis must show; ``more`` changes the line style.
    """
    reach = spread(low, high)
    shown: list[Legend] = []
    seen: list[float] = []
    for bound in bounds:
        label, look = SOFT if bound.soft else HARD
        look = {**look, **(more or {})}
        for values, near in (
            (bound.lower, bound.lower >= low - reach),
            (bound.upper, bound.upper <= high + reach),
        ):
            drawn = np.where(near & np.isfinite(values), values, math.nan)
            if np.isnan(drawn).all():
                continue
            if np.ptp(drawn) == 0.0:
                axis.axhline(float(drawn[0]), zorder=1.5, **look)
            else:
                last = bound.t[-1] + (bound.t[-1] - bound.t[-2])
                held = np.append(drawn, drawn[-1])
                axis.plot(np.append(bound.t, last), held, drawstyle="steps-post", zorder=1.5, **look)
            shown.append((label, look))
            seen += [float(np.nanmin(drawn)), float(np.nanmax(drawn))]
    return shown, seen


def curves_of(log: Record, parameters: Collection[str] = ()) -> list[Curve]:
    """Return a curve for every quantity of a log that changes, or may change.

    These are states, estimates, controls, algebraic variables, rows, parameters that have changed or are named, and
    computing times.
    """
    start, wanted, ended = log.t[:-1], {*changed_parameters(log), *parameters}, hold(log.p)
    curves = [*_state_curves(log), *_unknown_curves(log), *_control_curves(log)]
    curves += [Curve(trace, start, log.z[:, i], ALGEBRAIC_COLOR) for i, trace in enumerate(log.algebraic)]
    curves += [
        Curve(trace, start, log.h[:, i], ROW_COLOR, dots=True, bounds=bounds_of(log, start, "h", i))
        for i, trace in enumerate(log.rows)
    ]
    curves += [
        Curve(trace, log.t[: len(ended)], ended[:, i], PARAMETER_COLOR, held=True)
        for i, trace in enumerate(log.parameters)
        if trace.name in wanted
    ]
    return [*curves, _times(log)]


def signals_of(log: Record) -> list[Curve]:
    """Return curves of states and controls."""
    return [*_state_curves(log), *_control_curves(log)]


def _state_curves(log: Record) -> list[Curve]:
    """Return curves of states with their bounds, references and estimates."""
    followed, found = references_of(log), []
    for i, trace in enumerate(log.states):
        reference, bounds = followed.get(trace.name), bounds_of(log, log.t[:-1], "x", i)
        curve = Curve(trace, log.t, log.x[:, i], STATE_COLOR, reference, bounds=bounds)
        found.append(_with_estimate(log, curve, i))
    return found


def _control_curves(log: Record) -> list[Curve]:
    """Return curves of controls with their bounds and references."""
    followed, held, found = references_of(log), hold(log.u), []
    for j, trace in enumerate(log.controls):
        reference, bounds = followed.get(trace.name), bounds_of(log, log.t[:-1], "u", j)
        found.append(Curve(trace, log.t[: len(held)], held[:, j], CONTROL_COLOR, reference, held=True, bounds=bounds))
    return found


def hold(values: Array) -> Array:
    """Return values of samples, or of intervals, (n, ...), with the last one repeated for the end of its interval."""
    return np.append(values, values[-1:], axis=0)


def changed_parameters(log: Record) -> list[str]:
    """Return the names of the parameters that are not equal at all samples."""
    return [trace.name for i, trace in enumerate(log.parameters) if (log.p[:, i] != log.p[:1, i]).any()]


def _times(log: Record) -> Curve:
    """Return the curve of the computing time of every sample."""
    times = log.time_ns / 1e3
    uneven = bool(times.size and times.max() > UNEVEN * np.median(times) > 0)
    return Curve(Trace("computing time", "µs"), log.t[:-1], times, TIME_COLOR, dots=True, logarithmic=uneven)


def bounds_of(shown: Record | Plan, t: Array, array: str, column: int) -> tuple[CurveBounds, ...]:
    """Return the bounds of a column at the times ``t``; in a log, each at the first node where it holds."""
    return tuple(
        CurveBounds(t + limit.delay, shown.lower[:, i], shown.upper[:, i], limit.soft)
        for i, limit in enumerate(shown.limits)
        if len(t) and (limit.array, limit.column) == (array, column)
    )


def references_of(shown: Record | Plan) -> dict[str, Array]:
    """Return {state or control: references of the first residual that is this signal}."""
    return {trace.signal: shown.y[:, i] for i, trace in reversed([*enumerate(shown.references)])}


def _with_estimate(log: Record, curve: Curve, i: int) -> Curve:
    """Return the curve of state i with its measurements and estimates."""
    if (found := log.estimates) is None:
        return curve
    shown = [found.y[:, m] for m, sensor in enumerate(found.sensors) if sensor.signal == curve.trace.name]
    estimate = found.x[:, i], 2 * found.std[:, i]
    return replace(curve, estimate=estimate, measured=shown[0] if shown else None)


def _unknown_curves(log: Record) -> list[Curve]:
    """Return curves of unknown parameters, and of measurements that are no states."""
    if (found := log.estimates) is None:
        return []
    start, nx = log.t[:-1], len(log.states)
    unknown = [
        _with_estimate(log, Curve(trace, start, found.p[:, i], PARAMETER_COLOR), nx + i)
        for i, trace in enumerate(found.states[nx:])
    ]
    sensors = [
        Curve(trace, start, found.y[:, m], SENSOR_COLOR, dots=True)
        for m, trace in enumerate(found.sensors)
        if not trace.signal
    ]
    return [*unknown, *sensors]


def time_label(unit: str) -> str:
    """Return the label of an axis of time."""
    return "sample" if unit == "samples" else with_unit("time", unit)


def title_of(log: Record) -> str:
    """Return name, length, and number of samples that were not OK."""
    bad = int(np.sum(log.status != Status.OK))
    return f"{log.name}  ({len(log.u)} samples{f', {bad} not OK' if bad else ''})"


def marks_of(log: Record) -> list[Mark]:
    """Return times of doubtful and of failed samples, with their statuses and style."""
    doubtful, bad = np.isin(log.status, DOUBTFUL), log.status != Status.OK
    found = []
    for some, color in ((doubtful, DOUBT_COLOR), (bad & ~doubtful, FAILURE_COLOR)):
        if some.any():
            names = ", ".join(Status(status).name for status in np.unique(log.status[some]))
            found.append((log.t[:-1][some], (names, {"color": color, "marker": "|", "linestyle": ""})))
    if len(late := late_starts(log)):
        style: dict[str, Any] = {"color": LATE_COLOR, "marker": "x", "markersize": 4, "linestyle": ""}
        found.append((log.t[:-1][late], ("began late", style)))
    return found
