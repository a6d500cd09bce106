"""A recording holds the inputs of a closed loop and the controls of the host, for the same samples on a target.

    u_k, status_k = feedback(x_k) after prepare(), or step(x_k),   x_{k+1} = plant(x_k, u_k)

The host runs the package in its profile "verify", without contraction; all inputs are numbers of the package's own
precision, written to C as hexadecimal literals, which are exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.lowering.templates import environment
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.struct_layout import Precision
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.estimation.observer import Observer
from nmpc_codegen.runtime.loops.sampling import own_plant
from nmpc_codegen.runtime.loops.simulate import simulate

Array = NDArray[np.float64]
Disturbed = Callable[[int, Array], Array]

#: Tolerance of |u - u_host| relative to the range of the control.
TOLERANCE = {"double": 1e-9, "single": 1e-3}

PERIOD = 50  # number of samples after which restart_loop() restarts
SPREAD = 0.05  # relative to the declared initial state


@dataclass(frozen=True, eq=False)
class Event:
    """An event changes data before sample ``sample``: the reference of all nodes or of node N, or the plan (x, u)."""

    sample: int
    call: Literal["set_reference", "set_terminal_reference", "plan"]
    values: Array

    def apply(self, controller: Controller) -> None:
        """Apply the change on the host."""
        if self.call == "plan":
            states = controller.x.size
            controller.x[:] = self.values[:states].reshape(controller.x.shape)
            controller.u[:] = self.values[states:].reshape(controller.u.shape)
        else:
            getattr(controller, self.call)(self.values)

    def c(self, prefix: str, nodes: str) -> list[str]:
        """Return the C statements that apply the change on the target, with the numbers in ``values``."""
        if self.call == "plan":
            return [
                "memcpy(s->x, values, sizeof s->x);",
                "memcpy(s->u, values + sizeof s->x / sizeof(real_t), sizeof s->u);",
            ]
        node = f"{prefix.upper()}_ALL, " if self.call == "set_reference" else ""
        return [f"(void){prefix}_{self.call}(s, {node}values);"]


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording has the inputs and the host's outputs of a closed loop.

    ``u_range`` (nu,) is the range of every control.
    """

    description: PackageDescription
    x: Array  # (samples, nx)
    events: tuple[Event, ...]
    u: Array  # (samples, nu)
    status: NDArray[np.int64]  # (samples,), status of feedback(), or of prepare() if that failed
    u_range: Array

    @property
    def header(self) -> str:
        """Return the text of recording.h."""
        d = self.description
        events = [
            {
                "sample": event.sample,
                "size": event.values.size,
                "numbers": literals(event.values, d.precision),
                "lines": event.c(d.name, "ALL"),
            }
            for event in self.events
        ]
        return (
            environment()
            .get_template("firmware/recording.h.jinja")
            .render(
                p=d.name,
                **_call(d),
                has_solve=int(d.offers("solve")),
                has_phases=int(d.has_phases),
                samples=len(self.x),
                x=[literals(row, d.precision) for row in self.x],
                events=events,
            )
        )


def _call(d: PackageDescription) -> dict[str, object]:
    """Return the template values for the call of one sample: numbers of inputs and outputs, and the call expression."""
    P, found = d.name.upper(), d.estimation
    if found is None:
        return {"P": P, "inputs": f"{P}_NX", "outputs": f"{P}_NU", "call": "step)(s, x, u)", "has_model": 1}
    known, controls = (f"({P}_NM + {P}_NIN)", f", (x) + {P}_NM") if found.nu else (f"{P}_NM", "")
    call = f"estimate)(s, x{controls}, u)"
    return {"P": P, "inputs": known, "outputs": f"{P}_NX", "call": call, "has_model": 0}


def literals(values: ArrayLike, precision: Precision) -> str:
    """Return the numbers as exact C literals, separated by commas; NaN is written as the macro of math.h."""
    suffix = "F" if precision == "single" else ""
    numbers = np.asarray(values, dtype=np.float64).ravel()
    return ", ".join("NAN" if math.isnan(v) else f"{float(v).hex()}{suffix}" for v in numbers)


def record(
    controller: Controller,
    x0: ArrayLike,
    samples: int,
    dt: float | None = None,
    events: Sequence[Event] = (),
    disturbed: Disturbed | None = None,
) -> Recording:
    """Run the controller, in its initial state, with its own model as plant, and record the loop.

    Args:
        controller: a controller that was just built, in the profile "verify".
        x0: initial state of the plant, shape (nx,).
        samples: number of samples.
        dt: sampling time, as in simulate().
        events: changes of data.
        disturbed: disturbed(k, x) -> state that is measured at sample k and from which the plant continues.

    Raises:
        ControllerError: the state of the plant is not finite.
    """
    description, real, numbers = controller.description, controller.description.real, count(1)
    move = own_plant(controller)
    restart: Disturbed = (lambda k, x: x) if disturbed is None else disturbed

    def plant(x: Array, u: Array, interval: float) -> Array:
        return np.asarray(restart(next(numbers), np.asarray(move(x, u, interval), dtype=np.float64)))

    def apply(k: int, ctrl: Controller) -> None:
        for event in (e for e in events if e.sample == k):
            event.apply(ctrl)

    def sample(x: Array, k: int) -> tuple[Array, int]:
        if not description.has_phases:
            return controller.step(x), controller.time_ns
        prepared = controller.prepare()
        u = controller.feedback(x)
        if prepared:  # the target also reports this status
            controller._struct["status"] = prepared
        return u, controller.time_ns

    start = restart(0, np.array(x0, dtype=np.float64))
    log = simulate(controller, start, samples, dt, plant=plant, before=apply, law=sample, plans=0)
    x, u = log.x.astype(real).astype(np.float64), log.u
    exact = tuple(Event(e.sample, e.call, np.asarray(e.values).astype(real).astype(np.float64)) for e in events)
    size = float(max(np.abs(u).max(initial=0.0), np.abs(x[:-1]).max(initial=0.0)))
    return Recording(description, x[:-1], exact, u, log.status, ranges(description, u, size))


def record_estimates(observer: Observer, samples: int, seed: int = 1) -> Recording:
    """Run a new estimator on measurements of the declared initial state with noise, and record the samples.

    The profile is "verify". A fifth of the measurements is missing on average; the controls are noise of the size 0.1.
    """
    description, found = observer.description, observer.estimation
    rng, real = np.random.default_rng(seed), description.real
    inputs, estimates, statuses = [], [], []
    for _ in range(samples):
        u = (0.1 * rng.standard_normal(found.nu)).astype(real)
        y = observer.measure(description.x_initial, u) + np.array(found.noise_std) * rng.standard_normal(found.ny)
        y = np.where(rng.uniform(size=found.ny) < 0.2, np.nan, y).astype(real)
        estimates.append(observer.step(y, u if found.nu else None).astype(np.float64))
        inputs.append(np.concatenate([y, u]).astype(np.float64))
        statuses.append(int(observer.status))
    x = np.array(estimates)
    spread = np.maximum(np.ptp(x, axis=0), np.abs(np.array(description.scales[: x.shape[1]])))
    return Recording(description, np.array(inputs), (), x, np.array(statuses), spread)


def ranges(description: PackageDescription, u: Array, size: float = 0.0) -> Array:
    """Return the range of every control: between its declared bounds, else between the extremes of the recorded values.

    ``size`` is the magnitude of the results. An unbounded control that changes by at most eps size / TOLERANCE has this
    number as its range, or 1 if it is 0.
    """
    spread = np.ptp(u, axis=0) if len(u) else np.zeros(description.dims.nu)
    least = float(np.finfo(description.real).eps) / TOLERANCE[description.precision] * size
    found = np.where(spread > least, spread, least or 1.0)
    for row in description.rows:
        if row.kind == "control" and math.isfinite(row.upper - row.lower) and row.upper > row.lower:
            found[row.index] = row.upper - row.lower
    return np.asarray(found)


def restart_loop(x0: Array, seed: int = 1) -> Disturbed:
    """Return a disturbance that restarts the loop near the declared initial state every PERIOD samples."""
    random: Any = np.random.default_rng(seed)

    def disturb(k: int, x: Array) -> Array:
        if k % PERIOD != 0 or k == 0:
            return x
        return np.asarray(x0 * (1.0 + SPREAD * random.uniform(-1.0, 1.0, x0.size)))

    return disturb
