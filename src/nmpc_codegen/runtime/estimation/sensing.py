"""In a closed loop with an estimator, the controller receives estimates that are made from measurements.

y_k = h(x_k, u_{k-1}, p) + noise,   xhat_k = step(y_k, u_{k-1});   the controller is given xhat_k and the parameters
that the estimator finds
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import Signal, members, units
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.diagnosis.plan_rows import start_parameters
from nmpc_codegen.runtime.estimation.observer import Observer
from nmpc_codegen.runtime.given import is_integer, is_same_time
from nmpc_codegen.runtime.records.trace import Estimates, Trace

Array = NDArray[np.float64]


class Sensing:
    """Sensing combines the sensors and the estimator of a closed loop, with a record of their samples.

    ``truth`` is a controller with the parameters of the plant; in ``ctrl`` the estimator overwrites those that it
    estimates.
    """

    def __init__(
        self, ctrl: Controller, observer: Observer, seed: int | None, steps: int, interval: float, truth: Controller
    ) -> None:
        if not isinstance(observer, Observer):
            raise ControllerError(f"estimator is {observer!r}; expected an Observer, build(ocp.estimator(...))")
        self._ctrl, self._observer, self._truth = ctrl, observer, truth
        self._check(interval)
        theirs = truth.names.parameters
        self._places = [theirs.index(name) if name in theirs else -1 for name in ctrl.names.parameters]
        if observer.nodes:  # it has run in another loop
            observer.reset()
        found = observer.estimation
        self._std = np.array(found.noise_std)
        if seed is not None and (not is_integer(seed) or seed < 0):
            raise ControllerError(f"seed is {seed!r}; expected an integer >= 0, or None for no noise")
        self._random = None if seed is None else np.random.default_rng(seed)
        self._unknown = [i for name in found.unknown for i in members(name, ctrl.names.parameters)]
        ends = [(low, high) for s in ctrl.description.parameters for low, high in _limits(s)]
        self._limits = np.array([ends[i] for i in self._unknown]).T if self._unknown else np.zeros((2, 0))
        if lacking := [ctrl.names.parameters[i] for i in self._unknown if self._places[i] < 0]:
            raise ControllerError(
                f"plant: {truth.description.name} lacks {', '.join(lacking)}, which the estimator finds"
            )
        self._known = [i for i in range(ctrl.dims.np) if i not in self._unknown]
        nx, ny = observer.dims.nx, found.ny
        self._x, self._std_x = np.zeros((steps, nx)), np.zeros((steps, nx))
        self._y, self._p = np.zeros((steps, ny)), np.zeros((steps, len(self._unknown)))
        self._status, self._time = np.zeros(steps, np.int64), np.zeros(steps, np.int64)

    def _check(self, interval: float) -> None:
        """Raise ControllerError unless the estimator belongs to the plant of this controller."""
        ctrl, observer, name = self._ctrl, self._observer, self._observer.description.name
        states, own = ctrl.names.states, observer.names.states[: ctrl.dims.nx]
        wanted = [i for n in observer.estimation.unknown for i in members(n, ctrl.names.parameters)]
        unknown = tuple(ctrl.names.parameters[i] for i in wanted)
        if own != states or observer.names.states[len(own) :] != unknown:
            raise ControllerError(f"{name} estimates {observer.names.states}; expected the states {states}")
        if observer.estimation.controls != ctrl.names.controls:
            raise ControllerError(f"{name} has the controls {observer.estimation.controls}, not {ctrl.names.controls}")
        if not is_same_time(observer.description.dt[0], interval):
            raise ControllerError(f"{name} has samples of {observer.description.dt[0]!r}, the loop of {interval!r}")
        if unknown and ctrl.description.online["parameter"] == "fixed":
            raise ControllerError(f"{name} finds {', '.join(unknown)}, and the parameters of the controller are fixed")

    def look(self, k: int, x: Array, before: Array) -> Array:
        """Return the estimate (nx,) of the plant's state ``x`` at sample k, while the controls ``before`` act."""
        observer, true = self._observer, start_parameters(self._truth)
        p = np.array(
            [true[i] if i >= 0 else own for i, own in zip(self._places, start_parameters(self._ctrl), strict=True)]
        )
        names = self._ctrl.names.parameters
        if self._known:
            observer.set_parameters({names[i]: p[i] for i in self._known})
        self._p[k] = p[self._unknown]
        y = np.asarray(observer.measure(np.concatenate([x, self._p[k]]), before), dtype=np.float64)
        noise = 0.0 if self._random is None else self._std * self._random.standard_normal(self._std.size)
        self._y[k] = y + noise
        self._x[k] = observer.step(self._y[k], before)
        self._std_x[k], self._status[k], self._time[k] = observer.std, observer.status, observer.time_ns
        if self._unknown:
            values = np.clip(self._x[k, x.size :], *self._limits)
            self._ctrl.set_parameters({names[i]: v for i, v in zip(self._unknown, values, strict=True)})
        return self._x[k, : x.size]

    def record(self) -> Estimates:
        """Return the record of the estimator."""
        described, found = self._observer.description, self._observer.estimation
        unit = units(described.states, described.controls, described.algebraic, found.measured)
        estimated = tuple(Trace(name, unit[name]) for name in self._observer.names.states)
        sensors = tuple(
            Trace(name, unit[name], signal=state) for name, state in zip(found.measurements, found.states, strict=True)
        )
        arrays = self._x, self._std_x, self._y, self._p, self._status, self._time
        return Estimates(*arrays, estimated, sensors)


def _limits(signal: Signal) -> list[tuple[float, float]]:
    """Return the limits between which the elements of a parameter may be set."""
    return list(zip(signal.low, signal.high, strict=True)) or [(-np.inf, np.inf)] * signal.size
