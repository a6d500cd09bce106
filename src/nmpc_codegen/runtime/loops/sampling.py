"""The length of the samples of a closed loop is determined here, and the package's integrator as its plant."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.given import SAME_TIME, is_positive, is_same_time

Array = NDArray[np.float64]
Plant = Callable[[Array, Array, float], ArrayLike]

STEP_SLACK = 1e-9  # relative tolerance: dt = 3 intervals, computed as a sum of floats, is 3 steps, not 4


def interval_of(described: PackageDescription, dt: float | None) -> float:
    """Return the length of a sample: dt, else that of the controller, else its first interval.

    Raises:
        ControllerError: dt is no positive number, or the controller is made for another sampling time.
    """
    own, sampled, unit = described.dt[0], described.sampling_time, described.time_unit
    if dt is None:
        return sampled or own
    if not is_positive(dt):
        raise ControllerError(f"dt is {dt!r}; expected a positive number ({unit})")
    if described.discrete and dt != own:
        raise ControllerError(f"dt is {dt!r}, but the dynamics are a discrete map of dt = {own!r}: leave dt out")
    if sampled is not None and not is_same_time(dt, sampled):
        raise ControllerError(
            f"dt is {dt!r}, but the plan is shifted by {sampled!r} {unit} before every sample: state the "
            f"sampling time by RealTimeIteration(sampling_time={dt!r}), or shift nothing, shift=None"
        )
    return float(dt)


def samples_ahead(described: PackageDescription, interval: float) -> NDArray[np.int64]:
    """Return for every node, (N+1,), how many samples ahead the last sample at or before its time is."""
    times = np.append(0.0, np.cumsum(described.dt))
    return np.floor(times / interval + SAME_TIME).astype(np.int64)


def integrations(described: PackageDescription, dt: float) -> int:
    """Return the number of equal integrations in a sample of length dt, none longer than the first interval."""
    whole = described.augmentation.count or "integrator_jump" in described.report.operations  # jumps occur once
    return 1 if whole else max(1, math.ceil(dt / described.dt[0] * (1.0 - STEP_SLACK)))


def own_plant(ctrl: Controller) -> Plant:
    """Return the integrator of the package as a plant."""

    def integrate(x: Array, u: Array, dt: float) -> Array:
        count = integrations(ctrl.description, dt)
        for _ in range(count):
            x = ctrl.integrate(x, u, dt / count)
        return x

    return integrate
