"""simulate() reads the arguments of a single closed loop and runs it with one_loop.py."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.batch.struct_block import Structs, single
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.estimation.observer import Observer
from nmpc_codegen.runtime.given import fill_by_name, is_integer
from nmpc_codegen.runtime.loops.forecasts import Bounds, Tables
from nmpc_codegen.runtime.loops.loop_data import Drawn, state_loop
from nmpc_codegen.runtime.loops.one_loop import Before, Conduct, Disturbance, Law, checked_state, run
from nmpc_codegen.runtime.loops.sampling import Plant
from nmpc_codegen.runtime.records.log import Log
from nmpc_codegen.runtime.records.notes import REAL, columns_of_log, spacing

Array = NDArray[np.float64]
References = ArrayLike | Tables

LOG_BYTES = 2**31  # a larger log may not fit into memory, and the run would take hours


def simulate(
    ctrl: Controller,
    x0: ArrayLike | Mapping[str, ArrayLike],
    steps: int,
    dt: float | None = None,
    plant: Plant | Controller | None = None,
    disturbance: Disturbance | Drawn | None = None,
    before: Before | None = None,
    warm_start: bool = False,
    law: Law = "step",
    *,
    noise: Disturbance | Drawn | None = None,
    parameters: Tables | None = None,
    bounds: Bounds | None = None,
    references: References | None = None,
    added: ArrayLike | None = None,
    plant_parameters: Tables | None = None,
    estimator: Observer | None = None,
    seed: int | None = 0,
    plans: int | None = None,
) -> Log:
    """Run a controller in closed loop and return the log.

    The controller is left in its last state; copy() it to keep the initial one. The loop runs in compiled code, as that
    of Batch.simulate(). With ``before``, law="solve", an estimator, or a function as plant, disturbance or noise, its
    samples are taken in Python, with the same bits.

    Args:
        ctrl: the controller.
        x0: initial state of the plant, (nx,), or {name of a state or vector: value}; others begin as declared.
        steps: number of samples, >= 0.
        dt: sampling time (s, or the OCP's unit); None: that of the controller or, with shift=None, its first interval.
        plant: plant(x, u, dt) -> next x, or a controller whose integrator advances the state; None: ``ctrl``'s own.
        disturbance: disturbance(k, x) -> value added to the state after sample k, which began at x; or random numbers:
            Normal(std), Uniform(half_width), or standard deviations, for all states or by name.
        before: before(k, ctrl), called before sample k, and before the solve() of ``warm_start``, to set further data.
        warm_start: call solve(x0) before the first sample: a cold start with hard rows may need more iterations.
        law: "step": step(x) at every sample; "solve": solve(x) from the shifted plan of the previous sample.
        noise: noise(k, x) -> value added to the state that the controller receives; or random numbers.
        parameters: {name: table over the samples}: a number, (n,), or (n, size) for a vector. A node reads the row of
            the sample at its time, or of the present sample if all nodes share it; the last row holds on.
        bounds: {name of a row: (lower, upper)}, each a table; (n, rows) for a vector of rows.
        references: {name of a residual: table}, or (n, ny) for the path residual.
        added: (steps, nx), added to the state after every sample, besides ``disturbance``.
        plant_parameters: tables for the plant only, which is then a controller: ``plant``, or a copy of ``ctrl``.
        estimator: build(ocp.estimator(...)); the controller receives its estimate of the state. Parameters that it
            estimates have their true values in the plant.
        seed: seed of the random numbers and of the measurement noise; None: measurements have no noise.
        plans: number of samples from one logged plan to the next; 0: none; None: all, but at most 1000 and 64 MiB.

    Raises:
        ControllerError: shapes or numbers are wrong, a log cannot hold the steps, or the plant's state is not finite.
    """
    conduct = Conduct(_function(plant), _function(disturbance), _function(noise), before, law, estimator, seed)
    own, drawn = _check(conduct, plant, disturbance, noise, plant_parameters)
    start, data = _start(x0, steps, _controller(ctrl)), (parameters, bounds, references)
    of_plant = plant_parameters  # with an estimator, the plant is a copy of the controller
    of_plant = {} if estimator is not None and own is None and of_plant is None else of_plant
    loop = state_loop(single(ctrl), start, own, steps, dt, *data, drawn, added, of_plant, seed)
    return run(loop, ctrl, conduct, _every(plans, ctrl, steps), warm_start)


def _function(value: Any) -> Any:
    """Return ``value`` if it is a function, else None."""
    return value if callable(value) else None


def _check(
    conduct: Conduct, plant: Any, disturbance: Any, noise: Any, plant_parameters: Tables | None
) -> tuple[Structs | None, tuple[Drawn | None, Drawn | None]]:
    """Return the plant, if it is a controller, as a copy, and random numbers.

    Raise ControllerError if arguments conflict.
    """
    if conduct.before is not None and not callable(conduct.before):
        raise ControllerError(f"before is {conduct.before!r}; expected a function (k, ctrl)")
    if plant is not None and conduct.plant is None and not isinstance(plant, Controller):
        raise ControllerError(f"plant is {plant!r:.60}; expected a function (x, u, dt), or a Controller")
    if conduct.estimator is not None and noise is not None:
        raise ControllerError("noise is given beside an estimator, whose measurements have their own")
    if conduct.plant is not None and plant_parameters is not None:
        raise ControllerError("plant_parameters belong to a plant that is a controller, and plant is a function")
    own = single(plant.copy()) if isinstance(plant, Controller) else None
    return own, (None if conduct.disturbance else disturbance, None if conduct.noise else noise)


def _start(x0: ArrayLike | Mapping[str, ArrayLike], steps: object, ctrl: Controller) -> Array:
    """Return the initial state (1, nx), which may be given by name.

    Raise ControllerError for a wrong number of steps, too.
    """
    _check_steps(steps, ctrl)
    given = x0
    if isinstance(x0, Mapping):
        given = np.array(ctrl.description.x_initial, dtype=np.float64)
        fill_by_name(given, x0, ctrl.names.states, "x0", finite=False)
    return checked_state(cast("ArrayLike", given), ctrl.dims.nx, "x0")[None]


def _controller(ctrl: Controller) -> Controller:
    """Return ``ctrl``; raise ControllerError if it is an estimator."""
    if isinstance(ctrl, Observer):
        raise ControllerError(f"{ctrl.description.name} is an estimator; expected a controller, and estimator=")
    return ctrl


def _check_steps(steps: object, ctrl: Controller) -> None:
    if not is_integer(steps) or cast("int", steps) < 0:
        raise ControllerError(f"steps is {steps!r}; expected an integer >= 0")
    most = LOG_BYTES // (columns_of_log(ctrl) * REAL)
    if cast("int", steps) > most:
        raise ControllerError(f"steps is {steps}; expected at most {most}, whose log takes {LOG_BYTES >> 30} GiB")


def _every(plans: object, ctrl: Controller, steps: int) -> int:
    """Return the number of samples from one logged plan to the next; 0: no plan is logged."""
    if plans is None:
        return spacing(ctrl, steps)
    if not is_integer(plans) or int(plans) < 0:  # type: ignore[call-overload]
        raise ControllerError(f"plans is {plans!r}; expected an integer >= 0: every how many samples a plan is kept")
    return int(plans)  # type: ignore[call-overload, no-any-return]
