"""What a campaign flies without a word: starts, parameters, the number of samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nmpc_codegen.campaigns.stated.distributions import Box
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.package.description import PackageDescription

#: Width of the box of starts, relative to that of the bounds of a state; half of it relative to its size, without.
PART = 0.1
#: Samples: so many horizons, within these limits.
HORIZONS, FEWEST, LARGEST = 3, 50, 1000


@dataclass(frozen=True)
class Facts:
    """What a description does not say: elements of parameters that the model depends on, and places in x of states that
    no measurement sets, free components of x_0 and accumulators."""

    of_model: frozenset[str]
    unmeasured: frozenset[int]


def facts_of(ocp: OCP) -> Facts:
    """The facts of a problem."""
    problem = classify(ocp)
    return Facts(problem.model_parameters, frozenset((*problem.free_initial, *problem.accumulators)))


def default_steps(described: PackageDescription, dt: float) -> int:
    """Samples of a flight: three horizons, at least 50 and at most 1000."""
    return int(min(LARGEST, max(FEWEST, math.ceil(HORIZONS * sum(described.dt) / dt - 1e-9))))


def default_starts(described: PackageDescription, facts: Facts) -> Mapping[str, Box]:
    """Boxes of the states: ``initial_range``, else around the initial value, within the bounds, with a tenth of the
    width of the bounds, or of twice the size of the state."""
    bounds = _bounds(described)
    found = {}
    for signal in described.states:
        for j, name in enumerate(signal.elements):
            place = signal.offset + j
            low, high = bounds.get(place, (-math.inf, math.inf))
            if place in facts.unmeasured:
                continue
            if signal.low and signal.low[j] < signal.high[j] and math.isfinite(signal.high[j] - signal.low[j]):
                found[name] = Box(signal.low[j], signal.high[j])
                continue
            width = high - low if math.isfinite(high - low) else 2 * described.scales[place]
            middle, half = signal.value[j], 0.5 * PART * width
            found[name] = Box(min(max(middle - half, low), middle), max(min(middle + half, high), middle))
    return found


def _bounds(described: PackageDescription) -> dict[int, tuple[float, float]]:
    """Place of a state -> its bounds along the path."""
    found: dict[int, tuple[float, float]] = {}
    for row in described.rows:
        place = row.variable(described.dims.nx)
        if place is not None and place < described.dims.nx and any(0 < k < described.dims.N for k in row.nodes):
            low, high = found.get(place, (-math.inf, math.inf))
            found[place] = max(low, row.lower), min(high, row.upper)
    return found


def default_unknown(described: PackageDescription, facts: Facts) -> Mapping[str, Box]:
    """Parameters of the model with a range: those of the plant differ from those that the controller knows."""
    return {name: box for name, box in _ranges(described).items() if name in facts.of_model}


def default_known(described: PackageDescription, facts: Facts) -> Mapping[str, Box]:
    """Parameters with a range of which costs and rows alone depend, which the controller has to know."""
    return {name: box for name, box in _ranges(described).items() if name not in facts.of_model}


def _ranges(described: PackageDescription) -> dict[str, Box]:
    if described.online["parameter"] == "fixed":
        return {}
    return {
        name: Box(low, high)
        for signal in described.parameters
        for name, low, high in zip(signal.elements, signal.low, signal.high, strict=False)
        if low < high and np.isfinite(high - low)
    }
