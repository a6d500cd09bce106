"""Closed loops: a controller, a plant, and a log that can be looked at.

u_k = step(x_k),   x_{k+1} = plant(x_k, u_k, dt) + disturbance(k, x_k)
"""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.controller import Controller, Status, is_positive

Array = NDArray[np.float64]
Plant = Callable[[Array, Array, float], ArrayLike]
Disturbance = Callable[[int, Array], ArrayLike]
Reference = Callable[[int, Controller], None]

LONG_RUN = 200  # steps from which a progress bar is worth its lines
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
STEP_SLACK = 1e-9  # relative: dt = 3 intervals written as a sum of floats is 3 steps, not 4


@dataclass(frozen=True)
class Trace:
    """One plotted quantity: its name, unit, and declared or current bounds (+-inf: none)."""

    name: str
    unit: str
    lower: float
    upper: float

    @property
    def label(self) -> str:
        """Axis label with the powers of its unit raised: ``a [m/s²]``."""
        unit = re.sub(r"\^(-?\d+)", lambda power: power[1].translate(SUPERSCRIPTS), self.unit)
        return f"{self.name} [{unit}]" if unit else self.name


@dataclass(frozen=True, eq=False)
class Log:
    """What happened. ``cost[k]`` is the cost of the plan that the controller made at sample k."""

    name: str
    t: Array  # (steps+1,), s (or samples of a discrete map)
    x: Array  # (steps+1, nx)
    u: Array  # (steps, nu)
    status: NDArray[np.int64]  # (steps,), values of Status
    cost: Array  # (steps,)
    time_ns: NDArray[np.int64]  # (steps,), prepare and feedback together
    states: tuple[Trace, ...]
    controls: tuple[Trace, ...]
    time_unit: str

    @property
    def ok(self) -> bool:
        """True if every sample was solved."""
        return bool(np.all(self.status == Status.OK))

    def summary(self) -> str:
        """A few lines for a person: length, statuses, times, last state."""
        counts = {Status(s).name: int(np.sum(self.status == s)) for s in np.unique(self.status)}
        outcome = ", ".join(f"{name} {count}" for name, count in counts.items()) or "none"
        last = ", ".join(f"{trace.name} = {value:.6g}" for trace, value in zip(self.states, self.x[-1], strict=True))
        lines = [f"{self.name}: {len(self.u)} samples over {self.t[-1]:g} {self.time_unit}".rstrip()]
        lines.append(f"status: {outcome}")
        if len(self.time_ns):
            median, worst = np.median(self.time_ns) / 1e3, np.max(self.time_ns) / 1e3
            lines.append(f"time per sample: median {median:.1f} us, worst {worst:.1f} us")
        lines.append(f"last state: {last}")
        return "\n".join(lines)

    def plot(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Draw states and controls over time, bounds dashed.

        Args:
            file: where to write the picture (.png, .pdf, .svg); None: only return it, for plt.show().

        Returns:
            The matplotlib figure.
        """
        return _draw(self, file)


def simulate(
    ctrl: Controller,
    x0: ArrayLike,
    steps: int,
    dt: float | None = None,
    plant: Plant | None = None,
    disturbance: Disturbance | None = None,
    reference: Reference | None = None,
) -> Log:
    """Run a controller in closed loop. The controller is left in its last state; copy() it to keep the first.

    Args:
        ctrl: the controller.
        x0: initial state of the plant, shape (nx,).
        steps: number of samples, >= 0.
        dt: sampling time (s); default the first interval of the controller. A discrete map has its own.
        plant: plant(x, u, dt) -> next x; default the package's own integrator, in equal steps no longer than the
            controller's first interval.
        disturbance: disturbance(k, x) -> what is added to the state after sample k, x being the state before it.
        reference: called as reference(k, ctrl) before sample k: set references, parameters or bounds there.

    Raises:
        ControllerError: wrong shapes or numbers, or a plant that returns something else than a finite state.
    """
    if not isinstance(steps, int | np.integer) or isinstance(steps, bool) or steps < 0:
        raise ControllerError(f"steps is {steps!r}; expected an integer >= 0")
    interval = _interval(ctrl, dt)
    nx, nu = ctrl.dims.nx, ctrl.dims.nu
    move = plant or _own_plant(ctrl)
    x, u = np.zeros((steps + 1, nx)), np.zeros((steps, nu))
    status, time_ns, cost = np.zeros(steps, np.int64), np.zeros(steps, np.int64), np.zeros(steps)
    x[0] = _state(x0, nx, "x0")
    for k in _progress(range(steps), ctrl.description.name):
        if reference is not None:
            reference(k, ctrl)
        u[k] = ctrl.step(x[k])
        stats = ctrl.stats
        status[k], cost[k], time_ns[k] = ctrl.status, ctrl.cost, stats.prepare_ns + stats.feedback_ns
        x[k + 1] = _state(move(x[k].copy(), u[k].copy(), interval), nx, f"the plant's state after sample {k}")
        if disturbance is not None:
            x[k + 1] += _state(disturbance(k, x[k].copy()), nx, f"the disturbance of sample {k}")
    states, controls = _traces(ctrl)
    time_unit = "samples" if ctrl.description.discrete else "s"
    t = interval * np.arange(steps + 1, dtype=np.float64)
    return Log(ctrl.description.name, t, x, u, status, cost, time_ns, states, controls, time_unit)


def _interval(ctrl: Controller, dt: float | None) -> float:
    own = ctrl.description.dt[0]
    if dt is None:
        return own
    if not is_positive(dt):
        raise ControllerError(f"dt is {dt!r}; expected a positive number of seconds")
    if ctrl.description.discrete and dt != own:
        raise ControllerError(f"dt is {dt!r}, but the dynamics are a discrete map of dt = {own!r}: leave dt out")
    return float(dt)


def _own_plant(ctrl: Controller) -> Plant:
    """The package's integrator, in equal steps no longer than the first interval."""
    longest = ctrl.description.dt[0]

    def integrate(x: Array, u: Array, dt: float) -> Array:
        count = max(1, math.ceil(dt / longest * (1.0 - STEP_SLACK)))
        for _ in range(count):
            x = ctrl.integrate(x, u, dt / count)
        return x

    return integrate


def _state(value: ArrayLike, nx: int, what: str) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ControllerError(f"{what} is no array of numbers: {error}") from error
    if array.shape != (nx,):
        raise ControllerError(f"{what} has shape {array.shape}; expected ({nx},)")
    if not np.all(np.isfinite(array)):
        raise ControllerError(f"{what} is not finite: {array.tolist()}")
    return array


def _progress(samples: range, name: str) -> Iterable[int]:
    """The samples, with a progress bar on a terminal if there are many."""
    if len(samples) < LONG_RUN or not sys.stderr.isatty():
        return samples
    from rich.console import Console
    from rich.progress import track

    return track(samples, description=name, console=Console(stderr=True), transient=True)


def _traces(ctrl: Controller) -> tuple[tuple[Trace, ...], tuple[Trace, ...]]:
    """Names, units and the present simple bounds of states and controls."""
    bounds = {
        (row.kind, row.index): ctrl.path_bounds(i)
        for i, row in enumerate(ctrl.description.rows)
        if row.kind == "control" or (row.kind == "state" and len(row.nodes) > 1)
    }

    def traces(kind: str, signals: Iterable[Any]) -> tuple[Trace, ...]:
        named = [(element, signal.unit) for signal in signals for element in signal.elements]
        free = (-math.inf, math.inf)
        return tuple(Trace(name, unit, *bounds.get((kind, i), free)) for i, (name, unit) in enumerate(named))

    return traces("state", ctrl.description.states), traces("control", ctrl.description.controls)


# -- drawing -----------------------------------------------------------------------------------------------------------

WIDTH, ROW_HEIGHT = 7.2, 1.35  # inches
COLUMN_LIMIT = 8  # traces in one column
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
STATE_COLOR, CONTROL_COLOR, BOUND_COLOR, FAILURE_COLOR = "#1f5fa8", "#c2571a", "0.45", "#b3202c"


def _draw(log: Log, file: str | os.PathLike[str] | None) -> Any:
    """Figure with one axis per state and control. Written to a file it needs no display and no pyplot."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    count = len(log.states) + len(log.controls)
    columns = math.ceil(count / COLUMN_LIMIT)
    rows = math.ceil(count / columns)
    size = (WIDTH * (1.0 if columns == 1 else 0.62 * columns), 0.6 + ROW_HEIGHT * rows)
    with mpl.rc_context(STYLE):
        if file is None:
            from matplotlib import pyplot

            figure = pyplot.figure(figsize=size, layout="constrained")
        else:
            figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        axes = list(grid.T.flat)
        for axis, trace, values in zip(axes, log.states, log.x.T, strict=False):
            axis.plot(log.t, values, color=STATE_COLOR, linewidth=1.6)
            _decorate(axis, trace, values)
        for axis, trace, values in zip(axes[len(log.states) :], log.controls, log.u.T, strict=False):
            held = np.append(values, values[-1:])
            axis.step(log.t[: len(held)], held, where="post", color=CONTROL_COLOR, linewidth=1.6)
            _decorate(axis, trace, values)
        _finish(figure, grid, axes, count, log)
        if file is not None:
            figure.savefig(Path(file), dpi=160)
    return figure


def _finish(figure: Any, grid: Any, axes: list[Any], count: int, log: Log) -> None:
    """Time axis below the lowest axis of each column, common label positions, title."""
    for axis in axes[count:]:
        axis.set_visible(False)
    for column in grid.T:
        lowest = [axis for axis in column if axis.get_visible()][-1]
        lowest.set_xlabel("time [s]" if log.time_unit == "s" else "sample")
        lowest.tick_params(labelbottom=True)
    axes[0].set_xlim(log.t[0], log.t[-1] if len(log.t) > 1 else log.t[0] + 1.0)
    figure.align_ylabels()
    failed = int(np.sum(log.status != Status.OK))
    note = f"{len(log.u)} samples" + (f", {failed} not OK" if failed else "")
    figure.suptitle(f"{log.name}  ({note})", fontsize=10, color=FAILURE_COLOR if failed else "0.2")


def _decorate(axis: Any, trace: Trace, values: Array) -> None:
    """Label, limits with room to breathe, and those bounds that the trace comes near."""
    axis.set_ylabel(trace.label)
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    reach = max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-12)
    for bound in (trace.lower, trace.upper):
        if math.isfinite(bound) and low - reach <= bound <= high + reach:
            axis.axhline(bound, color=BOUND_COLOR, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1.5)
            low, high = min(low, bound), max(high, bound)
    margin = 0.08 * max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-12)
    axis.set_ylim(low - margin, high + margin)
    axis.locator_params(axis="y", nbins=4)
