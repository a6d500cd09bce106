"""Closed loops of a controller and a plant, and their log.

u_k = step(x_k),   x_{k+1} = plant(x_k, u_k, dt) + disturbance(k, x_k)
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.controller import Controller, Status
from nmpc_codegen.runtime.diagnosis.diagnose import WARNED
from nmpc_codegen.runtime.diagnosis.rows import parameters, path_bounds, row_values
from nmpc_codegen.runtime.given import is_positive, is_same_time
from nmpc_codegen.runtime.package_description import RowKind, Signal
from nmpc_codegen.runtime.plot import CONTROL_COLOR, ROW_COLOR, STATE_COLOR, Curve, Trace, draw

Array = NDArray[np.float64]
Plant = Callable[[Array, Array, float], ArrayLike]
Disturbance = Callable[[int, Array], ArrayLike]
Reference = Callable[[int, Controller], None]

LOG_BYTES = 2**31  # a larger log may not fit into memory, and the run would take hours
LOG_COLUMNS = 4  # status, cost, time and t
LONG_RUN = 200  # number of steps from which a progress bar is shown
SAME = 1e-6  # relative tolerance within which a row equals a signal, in single precision too
STEP_SLACK = 1e-9  # relative tolerance: dt = 3 intervals, computed as a sum of floats, is 3 steps, not 4


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """The record of a closed loop. ``cost[k]`` is the cost of the plan that the controller computed at sample k.

    ``h[k]`` contains the values at x[k], u[k] of the general path rows ``rows``: those that hold at node 0 or at
    several nodes before the end. ``reasons``: what Controller.diagnose() said at the first sample with each status.
    """

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
    h: Array  # (steps, number of rows)
    rows: tuple[Trace, ...]
    reasons: Mapping[Status, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Log {self.name}: {len(self.u)} samples, x {self.x.shape}, u {self.u.shape}, h {self.h.shape}>"

    @property
    def ok(self) -> bool:
        """True if every sample was solved."""
        return bool(np.all(self.status == Status.OK))

    @property
    def failure(self) -> str:
        """What diagnose() said at the first sample that was not OK; "" if all were."""
        bad = [Status(s) for s in self.status if s != Status.OK]
        return self.reasons[bad[0]] if bad else ""

    @property
    def failures(self) -> int:
        """Number of samples whose status is a failure: neither OK nor NOT_CONVERGED."""
        return sum(Status(s).is_failure for s in self.status)

    @property
    def first_failure(self) -> str:
        """When, where and why a sample failed first; "" if none did."""
        return next((self._first(status) for status in self._in_order() if status.is_failure), "")

    def _in_order(self) -> list[Status]:
        """The statuses that occur, in the order of their first samples."""
        return sorted(map(Status, self.reasons), key=lambda s: int(np.argmax(self.status == s)))

    def _first(self, status: Status) -> str:
        """The first sample with a status: its number, its time and what diagnose() said."""
        first = int(np.argmax(self.status == status))
        when = f"sample {first}, t = {self.t[first]:g} {self.time_unit}".rstrip()
        why = self.reasons[status].removeprefix(f"{status.name}: ")
        return f"first {status.name}: {when}: " + "\n    ".join(why.splitlines())

    def summary(self) -> str:
        """A summary in a few lines: length, statuses, when and why the first sample with each of them other than OK was
        not OK, times, last state."""
        counts = {Status(s).name: int(np.sum(self.status == s)) for s in np.unique(self.status)}
        outcome = ", ".join(f"{name} {count}" for name, count in counts.items()) or "none"
        last = ", ".join(f"{trace.name} = {value:.6g}" for trace, value in zip(self.states, self.x[-1], strict=True))
        lines = [f"{self.name}: {len(self.u)} samples over {self.t[-1]:g} {self.time_unit}".rstrip()]
        lines.append(f"status: {outcome}")
        reasons = "\n".join(self._first(status) for status in self._in_order() if status != Status.OK).splitlines()
        lines += [line for i, line in enumerate(reasons) if WARNED not in line or line not in reasons[:i]]
        if len(self.time_ns):
            median, worst = np.median(self.time_ns) / 1e3, np.max(self.time_ns) / 1e3
            lines.append(f"time per sample: median {median:.1f} us, worst {worst:.1f} us")
        lines.append(f"last state: {last}")
        return "\n".join(lines)

    def plot(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot states, controls and general path rows over time, with dashed bounds where a curve comes near. Marks at
        the lower edge: samples that failed, red, and those whose status is RELAXED or NOT_CONVERGED, orange.

        Args:
            file: file for the picture (.png, .pdf, .svg); None: only return the figure, for plt.show().

        Returns:
            The matplotlib figure.
        """
        curves = [Curve(trace, self.t, self.x[:, i], STATE_COLOR) for i, trace in enumerate(self.states)]
        held = np.append(self.u, self.u[-1:], axis=0)
        curves += [
            Curve(trace, self.t[: len(held)], held[:, j], CONTROL_COLOR, held=True)
            for j, trace in enumerate(self.controls)
        ]
        curves += [Curve(trace, self.t[:-1], self.h[:, i], ROW_COLOR, dots=True) for i, trace in enumerate(self.rows)]
        failed = int(np.sum(self.status != Status.OK))
        note = f"{len(self.u)} samples" + (f", {failed} not OK" if failed else "")
        time = "time [s]" if self.time_unit == "s" else "sample"
        doubtful = np.isin(self.status, (Status.RELAXED, Status.NOT_CONVERGED))
        marks = (self.t[:-1][doubtful], self.t[:-1][(self.status != Status.OK) & ~doubtful])
        return draw(curves, f"{self.name}  ({note})", time, marks, file)


def simulate(
    ctrl: Controller,
    x0: ArrayLike,
    steps: int,
    dt: float | None = None,
    plant: Plant | None = None,
    disturbance: Disturbance | None = None,
    reference: Reference | None = None,
    warm_start: bool = False,
) -> Log:
    """Run a controller in closed loop. The controller is left in its last state; copy() it to keep the initial one.

    Args:
        ctrl: the controller.
        x0: initial state of the plant, shape (nx,).
        steps: number of samples, >= 0.
        dt: sampling time (s); by default that of the controller, or its first interval if any will do, as with
            shift=None. Leave it out for a discrete map.
        plant: plant(x, u, dt) -> next x; by default the integrator of the package, in equal steps no longer than the
            controller's first interval.
        disturbance: disturbance(k, x) -> value added to the state after sample k; x is the state before this sample.
        reference: called as reference(k, ctrl) before sample k, to set references, parameters or bounds.
        warm_start: call solve(x0) before the first sample, so that the loop starts from a converged plan. One iteration
            per sample may not find a plan from a cold start with hard rows.

    Raises:
        ControllerError: shapes or numbers are wrong, there are more steps than a log can hold, or the plant returns
            something other than a finite state.
    """
    numbers = _path_rows(ctrl)
    _check_steps(steps, ctrl, len(numbers))
    interval = _interval(ctrl, dt)
    name, nx, nu = ctrl.description.name, ctrl.dims.nx, ctrl.dims.nu
    move = plant or _own_plant(ctrl)
    x, u = np.zeros((steps + 1, nx)), np.zeros((steps, nu))
    status, time_ns, cost = np.zeros(steps, np.int64), np.zeros(steps, np.int64), np.zeros(steps)
    p = np.zeros((steps, ctrl.dims.np))
    x[0] = _state(x0, nx, "x0")
    reasons: dict[Status, str] = {}
    if warm_start:
        _solve_first(ctrl, x[0], reference)
    for k in _progress(range(steps), name):
        if reference is not None:
            reference(k, ctrl)
        u[k] = ctrl.step(x[k])
        status[k], cost[k], time_ns[k] = ctrl.status, ctrl.cost, ctrl.time_ns
        if status[k] not in reasons:
            reasons[Status(status[k])] = ctrl.diagnose() if status[k] else ""
        p[k] = parameters(ctrl)[0] if numbers else 0.0
        moved = move(x[k].copy(), u[k].copy(), interval)
        x[k + 1] = _state(moved, nx, f"the plant's state after sample {k}", partial(_before, ctrl, x[k], u[k]))
        if disturbance is not None:
            x[k + 1] += _state(disturbance(k, x[k].copy()), nx, f"the disturbance of sample {k}")
    h = row_values(ctrl, x[:-1], u, p)[:, numbers]
    own, bounds = _own_axes(ctrl, numbers, h, x, u)
    states, controls = _traces(ctrl, bounds)
    time_unit = "samples" if ctrl.description.discrete else "s"
    t = interval * np.arange(steps + 1, dtype=np.float64)
    general = tuple(Trace(ctrl.names.rows[numbers[i]], "", *path_bounds(ctrl, numbers[i])) for i in own)
    return Log(name, t, x, u, status, cost, time_ns, states, controls, time_unit, h[:, own], general, reasons)


def _path_rows(ctrl: Controller) -> list[int]:
    """Numbers of the general rows that apply to a sample: they hold at node 0, or at several nodes before the end."""
    found = []
    for i, row in enumerate(ctrl.description.rows):
        path = [k for k in row.nodes if k < ctrl.dims.N]
        if row.kind == "general" and row.index >= 0 and (0 in path or len(path) > 1):
            found.append(i)
    return found


def _solve_first(ctrl: Controller, x0: Array, reference: Reference | None) -> None:
    """Iterate to convergence with the data of the first sample; a plan that has not converged is a start as well.

    The plan belongs to the first sample, which therefore must not shift it.
    """
    if reference is not None:
        reference(0, ctrl)
    ctrl.solve(x0)
    if "samples" in ctrl.description.members("solver"):
        ctrl.view("samples")[...] = 0


def _check_steps(steps: object, ctrl: Controller, rows: int) -> None:
    if not isinstance(steps, int | np.integer) or isinstance(steps, bool) or steps < 0:
        raise ControllerError(f"steps is {steps!r}; expected an integer >= 0")
    columns = ctrl.dims.nx + ctrl.dims.nu + rows + LOG_COLUMNS
    most = LOG_BYTES // (columns * np.dtype(np.float64).itemsize)
    if steps > most:
        raise ControllerError(f"steps is {steps}; expected at most {most}, whose log takes {LOG_BYTES >> 30} GiB")


def _interval(ctrl: Controller, dt: float | None) -> float:
    own, sampled = ctrl.description.dt[0], ctrl.description.sampling_time
    if dt is None:
        return sampled or own
    if not is_positive(dt):
        raise ControllerError(f"dt is {dt!r}; expected a positive number of seconds")
    if ctrl.description.discrete and dt != own:
        raise ControllerError(f"dt is {dt!r}, but the dynamics are a discrete map of dt = {own!r}: leave dt out")
    if sampled is not None and not is_same_time(dt, sampled):
        raise ControllerError(
            f"dt is {dt!r}, but the plan is shifted by {sampled!r} s before every sample: state the sampling time by "
            f"RealTimeIteration(sampling_time={dt!r}), or shift nothing, shift=None"
        )
    return float(dt)


def _own_plant(ctrl: Controller) -> Plant:
    """The integrator of the package, in equal steps no longer than the first interval."""
    longest = ctrl.description.dt[0]

    def integrate(x: Array, u: Array, dt: float) -> Array:
        count = max(1, math.ceil(dt / longest * (1.0 - STEP_SLACK)))
        for _ in range(count):
            x = ctrl.integrate(x, u, dt / count)
        return x

    return integrate


def _before(ctrl: Controller, x: Array, u: Array) -> str:
    """From where the plant has moved, and what was said of the sample."""
    signals = zip((*ctrl.names.states, *ctrl.names.controls), (*x, *u), strict=True)
    start = ", ".join(f"{name} = {value:.4g}" for name, value in signals)
    return (
        f"; it moved from {start}. The integrator of the package needs more steps there, or plant= another one; "
        f"the sample: {ctrl.diagnose()}"
    )


def _state(value: ArrayLike, nx: int, what: str, before: Callable[[], str] = str) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ControllerError(f"{what} is no array of numbers: {error}") from error
    if array.shape != (nx,):
        raise ControllerError(f"{what} has shape {array.shape}; expected ({nx},)")
    if not np.all(np.isfinite(array)):
        raise ControllerError(f"{what} is not finite: {array.tolist()}{before()}")
    return array


def _progress(samples: range, name: str) -> Iterable[int]:
    """The samples, with a progress bar on a terminal if there are many."""
    if len(samples) < LONG_RUN or not sys.stderr.isatty():
        return samples
    from rich.console import Console
    from rich.progress import track

    return track(samples, description=name, console=Console(stderr=True), transient=True)


def _own_axes(
    ctrl: Controller, numbers: list[int], h: Array, x: Array, u: Array
) -> tuple[list[int], dict[str, tuple[float, float]]]:
    """Columns of h with an axis of their own, and bounds of the others: soft rows on a bare state or control."""
    signals = dict(zip((*ctrl.names.states, *ctrl.names.controls), (*x[:-1].T, *u.T), strict=True))
    own, bounds = [], {}
    for i, number in enumerate(numbers):
        name = ctrl.names.rows[number]
        if name in signals and np.allclose(h[:, i], signals[name], rtol=SAME, atol=0.0):
            bounds[name] = path_bounds(ctrl, number)
        else:
            own.append(i)
    return own, bounds


def _traces(ctrl: Controller, soft: dict[str, tuple[float, float]]) -> tuple[tuple[Trace, ...], tuple[Trace, ...]]:
    """Names, units and present simple bounds of states and controls, or the bounds of the soft row of that name."""
    bounds: dict[tuple[RowKind, int], tuple[float, float]] = {
        (row.kind, row.index): path_bounds(ctrl, i)
        for i, row in enumerate(ctrl.description.rows)
        if row.kind == "control" or (row.kind == "state" and len(row.nodes) > 1)
    }

    def traces(kind: RowKind, signals: Iterable[Signal]) -> tuple[Trace, ...]:
        named = [(element, signal.unit) for signal in signals for element in signal.elements]
        free = (-math.inf, math.inf)
        return tuple(
            Trace(name, unit, *bounds.get((kind, i), soft.get(name, free))) for i, (name, unit) in enumerate(named)
        )

    return traces("state", ctrl.description.states), traces("control", ctrl.description.controls)
