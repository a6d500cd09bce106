"""Closed loops of a controller and a plant, and their log.

u_k = step(x_k),   x_{k+1} = plant(x_k, u_k, dt) + disturbance(k, x_k)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.estimation.observer import Observer
from nmpc_codegen.runtime.estimation.sensing import Sensing, see
from nmpc_codegen.runtime.given import fill_by_name, is_integer
from nmpc_codegen.runtime.loops.forecast import Before, Bounds, OverSamples, References, forecast
from nmpc_codegen.runtime.loops.progress import Progress
from nmpc_codegen.runtime.loops.sampling import Plant, interval_of, own_plant
from nmpc_codegen.runtime.records.log import Log
from nmpc_codegen.runtime.records.notes import REAL, Notes, columns_of_log, spacing

Array = NDArray[np.float64]
Disturbance = Callable[[int, Array], ArrayLike]
Law = Literal["step", "solve"]
Sample = Callable[[Array, int], tuple[Array, int]]

LOG_BYTES = 2**31  # a larger log may not fit into memory, and the run would take hours


def simulate(
    ctrl: Controller,
    x0: ArrayLike | Mapping[str, ArrayLike],
    steps: int,
    dt: float | None = None,
    plant: Plant | None = None,
    disturbance: Disturbance | None = None,
    before: Before | None = None,
    warm_start: bool = False,
    law: Law = "step",
    *,
    noise: Disturbance | None = None,
    parameters: OverSamples | None = None,
    bounds: Bounds | None = None,
    references: References | None = None,
    reference: References | None = None,
    estimator: Observer | None = None,
    seed: int | None = 0,
    plans: int | None = None,
) -> Log:
    """Run a controller in closed loop. The controller is left in its last state; copy() it to keep the initial one.

    Args:
        ctrl: the controller.
        x0: initial state of the plant, (nx,), or {name of a state or vector: value}; others as declared.
        steps: number of samples, >= 0.
        dt: sampling time (s, or the OCP's unit); by default that of the controller, or its first interval if any will
            do, as with shift=None. Leave it out for a discrete map.
        plant: plant(x, u, dt) -> next x; by default the integrator of the package, in steps of at most one interval.
        disturbance: disturbance(k, x) -> value added to the state after sample k; x is the state before this sample.
        before: before(k, ctrl), called before sample k, and before solve() of ``warm_start``, to set further data.
        warm_start: call solve(x0) before the first sample: a cold start with hard rows may need more iterations.
        law: "step": step(x) at every sample; "solve": solve(x), from the plan of the sample before, moved as in step().
        noise: noise(k, x) -> value added to the state x of sample k that the controller is told.
        parameters: {name: array over the samples}, (n,), or (n, size) for a vector. A node of sample k has the row of
            the sample at its time, k + j if intervals are as long as samples, so that a forecast moves along; the last
            row holds from there on. Where all nodes share one value, it is that of sample k.
        bounds: {name of a row: (lower, upper)}, each a number or an array over the samples, (n,), or (n, rows) for the
            name of a vector of rows; nodes as for parameters.
        references: {name of a residual: array over the samples}, or (n, ny) for the path residual.
        reference: the same; a function that is given here belongs to ``before``.
        estimator: build(ocp.estimator(...)), which tells the controller the state. Parameters it finds are the plant's.
        seed: of the noise of its measurements; None: no noise.
        plans: the plan of every so many samples is logged; 0: none; None: all plans, but at most 1000 and 64 MiB.

    Raises:
        ControllerError: shapes or numbers are wrong, there are more steps than a log can hold, or the plant returns
            something other than a finite state.
    """
    _check_steps(steps, _controller(ctrl))
    interval = interval_of(ctrl.description, dt)
    start = _state(_stack(x0, ctrl) if isinstance(x0, Mapping) else x0, ctrl.dims.nx, "x0")
    tell = forecast(ctrl, interval, parameters, bounds, _references(references, reference), before)
    of_plant = forecast(ctrl, interval, parameters, None, None, None)
    sensing = None if estimator is None else Sensing(ctrl, estimator, seed, steps, interval, of_plant)
    move = plant or own_plant(ctrl if sensing is None else sensing.truth)
    if warm_start:
        _solve_first(ctrl, start, tell)
    how = tell, _sample_by(law, ctrl, interval), move, disturbance, sensing, _measure_by(noise, sensing)
    return _run(ctrl, start, steps, interval, _every(plans, ctrl, steps), *how)


def _measure_by(noise: Disturbance | None, sensing: Sensing | None) -> Callable[[int, Array, Array], Array]:
    """What a controller without an estimator is told; ControllerError for noise beside one."""
    if sensing is not None and noise is not None:
        raise ControllerError("noise is given beside an estimator, whose measurements have their own")
    return see if noise is None else partial(_add_noise, noise)


def _add_noise(noise: Disturbance, k: int, x: Array, u: Array) -> Array:
    """The measured state of sample k."""
    return x + _state(noise(k, x.copy()), len(x), f"the noise of sample {k}")


def _controller(ctrl: Controller) -> Controller:
    """ControllerError unless it is one."""
    if isinstance(ctrl, Observer):
        raise ControllerError(f"{ctrl.description.name} is an estimator; expected a controller, and estimator=")
    return ctrl


def _run(
    ctrl: Controller,
    start: Array,
    steps: int,
    interval: float,
    every: int,
    tell: Before,
    sample: Sample,
    move: Plant,
    disturbance: Disturbance | None,
    sensing: Sensing | None,
    told: Callable[[int, Array, Array], Array],
) -> Log:
    """The loop and its log; ``every``: samples from plan to plan that is kept; ``told``: what a controller without an
    estimator is told of the state."""
    look = told if sensing is None else sensing.look
    name, nx, nu = ctrl.description.name, ctrl.dims.nx, ctrl.dims.nu
    notes = Notes(ctrl, steps, interval, every)
    x, u = notes.x, notes.u
    x[0] = start
    with Progress(name, steps, "samples") as progress:
        for k in range(steps):
            tell(k, ctrl)
            notes.take(k, *sample(look(k, x[k], u[k - 1] if k else np.zeros(nu)), k))
            moved = move(x[k].copy(), u[k].copy(), interval)
            x[k + 1] = _state(moved, nx, f"the plant's state after sample {k}", partial(_before, ctrl, x[k], u[k]))
            if disturbance is not None:
                x[k + 1] += _state(disturbance(k, x[k].copy()), nx, f"the disturbance of sample {k}")
            progress.add()
    return notes.finish(None if sensing is None else sensing.record())


def _sample_by(law: Law, ctrl: Controller, interval: float) -> Sample:
    """(x, k) -> the control of sample k and its time. solve() leaves nothing to the next sample, so it is said here."""

    def step(x: Array, k: int) -> tuple[Array, int]:
        return ctrl.step(x), ctrl.time_ns

    def solve(x: Array, k: int) -> tuple[Array, int]:
        if k > 0 and ctrl.description.shift is not None:
            ctrl.shift()
        found = ctrl.solve(x)
        if ctrl.description.augmentation.previous:
            ctrl.set_previous(found.u[0])
        if ctrl.description.augmentation.time:
            ctrl.set_time(ctrl.time + interval)
        return found.u[0], found.time_ns

    laws = {"step": step, "solve": solve}
    if law not in laws:
        raise ControllerError(f"law is {law!r}; allowed: 'step', 'solve'")
    return laws[law]


def _references(references: References | None, reference: References | None) -> References | None:
    """Which of both is given."""
    if callable(reference):
        raise ControllerError("reference is a function; expected before=f, and arrays over the samples in references=")
    if references is not None and reference is not None:
        raise ControllerError("references and reference are both given; expected one of them")
    return reference if references is None else references


def _stack(x0: Mapping[str, ArrayLike], ctrl: Controller) -> Array:
    """The declared initial state with the values that are given by name."""
    states = ctrl.description.states
    x = np.array([v for s in states for v in s.value], dtype=np.float64)
    fill_by_name(x, x0, ctrl.names.states, "x0", finite=False)
    return x


def _solve_first(ctrl: Controller, x0: Array, tell: Before) -> None:
    """Iterate to convergence with the data of the first sample; a plan that has not converged is a start as well. Once
    it is prepared, the first sample takes it as it is, whatever it measures."""
    tell(0, ctrl)
    ctrl.solve(x0)
    if ctrl.description.has_phases:
        ctrl.prepare()


def _check_steps(steps: object, ctrl: Controller) -> None:
    if not isinstance(steps, int | np.integer) or isinstance(steps, bool) or steps < 0:
        raise ControllerError(f"steps is {steps!r}; expected an integer >= 0")
    columns = columns_of_log(ctrl)
    most = LOG_BYTES // (columns * REAL)
    if steps > most:
        raise ControllerError(f"steps is {steps}; expected at most {most}, whose log takes {LOG_BYTES >> 30} GiB")


def _every(plans: object, ctrl: Controller, steps: int) -> int:
    """Samples from one plan that the log keeps to the next; 0: none."""
    if plans is None:
        return spacing(ctrl, steps)
    if not is_integer(plans) or int(plans) < 0:  # type: ignore[call-overload]
        raise ControllerError(f"plans is {plans!r}; expected an integer >= 0: every how many samples a plan is kept")
    return int(plans)  # type: ignore[call-overload, no-any-return]


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
