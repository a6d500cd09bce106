"""Sensors fail for some samples, and estimators must cope with it.

An estimate is finite and unknown parameters are inside their range, whatever is measured; where the status is OK, the
error is within 5 standard deviations as the covariance states them; two windows after the fault it is OK, and right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen import OCP, Status
from nmpc_codegen.runtime.estimation.observer import Observer
from verification.estimation import PLANTS, Model, Plant, battery, reactor, vehicle

Array = NDArray[np.float64]

#: Samples before the fault, during a lasting fault, and in a window after it; largest error where the status is OK.
BEFORE, LASTS, WINDOW, WITHIN = 40, 10, 10, 5.0
#: Samples with an error beyond WITHIN deviations of the noise that noise and model together may explain.
UNSEEN = 4


def cart() -> tuple[OCP, Mapping[str, Any]]:
    """Return the OCP of a cart with unknown mass."""
    ocp = OCP("cart", T=1.0, N=10)
    p, v, a = ocp.state("p", initial=1.0), ocp.state("v"), ocp.control("a")
    m = ocp.parameter("m", value=1.0, bounds=(0.2, 5))
    ocp.dynamics({p: v, v: a / m - 0.2 * v})
    noise = {"measure": {"p": p}, "noise_std": {"p": 0.02}}
    return ocp, {**noise, "process_std": {"v": 0.05, "m": 0.01}, "initial_std": {"p": 0.5, "v": 1, "m": 0.2}}


def pendulum() -> tuple[OCP, Mapping[str, Any]]:
    """Return the OCP of a pendulum whose sine and cosine of the angle are measured."""
    ocp = OCP("pendulum", T=1.0, N=20)
    angle, rate, u = ocp.state("angle", unit="rad"), ocp.state("rate", unit="rad/s"), ocp.control("u")
    ocp.dynamics({angle: rate, rate: -9.81 * ca.sin(angle) - 0.1 * rate + u})
    noise = {"measure": {"s": ca.sin(angle), "c": ca.cos(angle)}, "noise_std": {"s": 0.01, "c": 0.01}}
    return ocp, {**noise, "process_std": {"rate": 0.05}, "initial_std": {"angle": 0.5, "rate": 1}}


def _as_declared(
    make: Callable[[], tuple[OCP, Mapping[str, Any]]], guess: Any, doubt: Any, of: Plant | None, **given: Any
) -> Plant:
    """Return a plant whose initial state is the guess plus noise with the declared standard deviations."""
    n = len(guess)
    more = {} if of is None else {"low": of.low, "high": of.high, "controls": of.controls, "silent": of.silent}
    return Plant(make, guess, doubt, guess, doubt, (1.0,) * n, BEFORE, WINDOW, **{**more, **given})


def _pushes(k: int) -> tuple[float, ...]:
    return (float(np.sin(0.2 * k)),)


FAULTY: dict[str, Plant] = {
    "cart": _as_declared(
        cart, (1.0, 0.0, 1.0), (0.5, 1.0, 0.2), None, controls=_pushes, low=(-99, -99, 0.2), high=(99, 99, 5)
    ),
    "pendulum": _as_declared(pendulum, (0.3, 0.0), (0.3, 0.5), None, controls=_pushes),
    "vehicle": _as_declared(
        vehicle, (0.0, 0.0, 0.7, 0.0, 0.0), (1.0, 1.0, 0.2, 0.05, 0.05), PLANTS["vehicle"], silent=lambda k: False
    ),
    "reactor": _as_declared(reactor, (0.5, 0.05, 0.0), (0.02, 0.02, 0.02), PLANTS["reactor"]),
    "battery": _as_declared(battery, (0.3, 0.0, 0.1), (0.02, 0.002, 0.03), PLANTS["battery"]),
}


@dataclass(frozen=True)
class Fault:
    """A fault lasts some samples and computes readings from the true one, the last one before it, and the noise."""

    samples: int
    tells: Callable[[np.random.Generator, Array, Array, Array], Array]
    repeats: bool = False  # the previous sample is repeated: the plant does not move
    shows: bool = True  # noise does not explain it for long


def _drawn(rng: np.random.Generator, y: Array, low: float, high: float, std: Array) -> Array:
    size = 10 ** rng.uniform(low, high, y.size)
    return np.asarray(y + rng.choice([-1, 1], y.size) * size * std)


FAULTS: dict[str, Fault] = {
    "missing": Fault(LASTS, lambda rng, y, last, std: np.full(y.size, np.nan)),
    "infinite": Fault(LASTS, lambda rng, y, last, std: rng.choice([-np.inf, np.inf], y.size)),
    "outlier": Fault(1, lambda rng, y, last, std: _drawn(rng, y, 1, 3, std)),
    "huge": Fault(1, lambda rng, y, last, std: _drawn(rng, y, 3, 30, std)),
    "burst": Fault(LASTS, lambda rng, y, last, std: _drawn(rng, y, 1, 30, std)),
    "frozen": Fault(LASTS, lambda rng, y, last, std: last, shows=False),  # like a plant that has stopped
    "biased": Fault(LASTS, lambda rng, y, last, std: y + std * 30),
    "repeated": Fault(1, lambda rng, y, last, std: last, repeats=True),
}


@dataclass(frozen=True)
class Verdict:
    """A verdict has the fault of a run, or "", and the number of samples that were right and not OK.

    Samples in the first window and from the fault on do not count.
    """

    wrong: str
    alarms: int


def fly(plant: Plant, observer: Observer, fault: Fault, seed: int, before: int = BEFORE) -> Verdict:
    """Run samples of the plant with a fault after ``before`` good ones."""
    rng, model = np.random.default_rng([11, seed]), Model(plant)
    low, high = plant.low or (-np.inf,) * len(plant.guess), plant.high or (np.inf,) * len(plant.guess)
    x = np.clip(np.array(plant.guess) + plant.doubt * rng.standard_normal(len(plant.guess)), low, high)
    plant.begin(observer)
    ocp = plant.make()[0]
    angles = [i for i, d in enumerate(ocp.states) if d.signal.unit == "rad"]
    ranges = [p for p in ocp.parameters if p.signal.name in observer.estimation.unknown]
    wrong, alarms, seen, last, u, slack = [], 0, 0, np.zeros(0), np.array(plant.controls(0)), np.zeros(x.size)
    for k in range(before + fault.samples + 2 * WINDOW + 5):
        faulty = before <= k < before + fault.samples
        y = model.measure(x, u) + model.noise * rng.standard_normal(model.noise.size)
        y = fault.tells(rng, y, last, model.noise) if faulty else y
        last = y if not faulty else last
        found = observer.step(y, u)
        ok = observer.status is Status.OK
        error = _error(angles, np.maximum(np.abs(found - x) - slack, 0.0), observer.std)
        alarms += not ok and WINDOW <= k < before and error <= WITHIN
        seen += faulty and bool(np.any(~(np.abs(y - model.measure(x, u)) <= WITHIN * model.noise)))
        if not np.all(np.isfinite(found)):
            wrong.append(f"sample {k}: not finite")
        for i, p in enumerate(ranges, len(found) - len(ranges)):
            if p.signal.low and not p.signal.low[0] <= found[i] <= p.signal.high[0]:
                wrong.append(f"sample {k}: {p.signal.name} is {found[i]:.3g}")
        if ok and error > WITHIN and not (faulty and (seen <= UNSEEN or not fault.shows)):
            wrong.append(f"sample {k}: OK with an error of {error:.1f}")
        if k >= before + fault.samples + 2 * WINDOW and not ok:
            wrong.append(f"sample {k}: {observer.diagnose()}")
        u, before_move = np.array(plant.controls(k)), x
        x = np.clip(model.move(x, u, rng), low, high)
        if faulty and fault.repeats:
            slack, x = slack + 2 * np.abs(x - before_move), before_move
    return Verdict("; ".join(wrong[:3]), alarms)


def _error(angles: list[int], difference: Array, std: Array) -> float:
    """Return the largest error in standard deviations, up to full turns of angles."""
    rest = difference.copy()
    rest[angles] -= 2 * np.pi * np.round(rest[angles] / (2 * np.pi))
    return float(np.max(np.abs(rest) / np.maximum(std, 1e-12)))
