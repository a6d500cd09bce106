"""Defaults of a campaign follow from the problem: starts, parameters, the number of samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nmpc_codegen.campaigns.stated.distributions import Box
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.package.description import PackageDescription

#: Width of the box of starts relative to the distance of a state's bounds; without bounds, half the width relative to
# its scale.
PART = 0.1
#: Number of horizons in a flight; limits of its number of samples.
HORIZONS, FEWEST, LARGEST = 3, 50, 1000


@dataclass(frozen=True)
class Facts:
    """Facts of the problem that a description does not contain.

    of_model: elements of parameters on which the model depends; unmeasured: indices of states that no measurement sets,
    which are free components of x_0 and accumulators.
    """

    of_model: frozenset[str]
    unmeasured: frozenset[int]


def facts_of(ocp: OCP) -> Facts:
    """Return the facts of a problem."""
    problem = classify(ocp)
    return Facts(problem.model_parameters, frozenset((*problem.free_initial, *problem.accumulators)))


def default_steps(described: PackageDescription, dt: float) -> int:
    """Return the number of samples of a flight: three horizons, at least 50 and at most 1000."""
    return int(min(LARGEST, max(FEWEST, math.ceil(HORIZONS * sum(described.dt) / dt - 1e-9))))


def default_starts(described: PackageDescription, facts: Facts) -> Mapping[str, Box]:
    """Return the boxes from which states start: ``initial_range``, else a box around the initial value.

    The box is a tenth as wide as the distance of the bounds, or as twice the scale of the state, and lies within the
    bounds.
    """
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
    """Return {index of a state: its bounds along the path}."""
    found: dict[int, tuple[float, float]] = {}
    for row in described.rows:
        place = row.variable(described.dims.nx)
        if place is not None and place < described.dims.nx and any(0 < k < described.dims.N for k in row.nodes):
            low, high = found.get(place, (-math.inf, math.inf))
            found[place] = max(low, row.lower), min(high, row.upper)
    return found


def default_unknown(described: PackageDescription, facts: Facts) -> Mapping[str, Box]:
    """Return the parameters of the model with a range: the plant's values differ from those of the controller."""
    return {name: box for name, box in _ranges(described).items() if name in facts.of_model}


def default_known(described: PackageDescription, facts: Facts) -> Mapping[str, Box]:
    """Return the parameters with a range on which only costs and rows depend; the controller must know them."""
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
