"""The fields of a log, and its quantities: their names, units and bounds."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.status import Status

Array = NDArray[np.float64]

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def with_unit(name: str, unit: str) -> str:
    """Name and unit for an axis, with powers as superscripts: ``a [m/s²]``."""
    text = re.sub(r"\^(-?\d+)", lambda power: power[1].translate(SUPERSCRIPTS), unit)
    return f"{name} [{text}]" if text else name


#: Array of a log -> its field with the traces of the columns.
COLUMNS = {"x": "states", "u": "controls", "z": "algebraic", "h": "rows", "p": "parameters", "y": "references"}


@dataclass(frozen=True)
class Bound:
    """Bounds of a row at the end of the loop (+-inf: none); ``soft``: they may be violated at a cost."""

    lower: float = -math.inf
    upper: float = math.inf
    soft: bool = False


@dataclass(frozen=True)
class Trace:
    """One quantity of a log; ``signal``: the state or control that a residual is, "" for another expression."""

    name: str
    unit: str = ""
    bounds: tuple[Bound, ...] = ()
    signal: str = ""

    @property
    def lower(self) -> float:
        """The largest lower bound, -inf if there is none."""
        return max((bound.lower for bound in self.bounds), default=-math.inf)

    @property
    def upper(self) -> float:
        """The smallest upper bound, inf if there is none."""
        return min((bound.upper for bound in self.bounds), default=math.inf)

    @property
    def label(self) -> str:
        """Label of its axis."""
        return with_unit(self.name, self.unit)


@dataclass(frozen=True, eq=False)
class Estimates:
    """What an estimator has found in a loop, one entry per sample.

    ``x``, ``std``: its estimates, the unknown parameters behind the states, and their standard deviations. ``y``: the
    measurements, NaN where one was missing. ``p``: the true values of the unknown parameters.
    ``states``, ``sensors``: names and units of the columns of x and y; ``signal`` of a sensor: the state that it shows.
    """

    x: Array  # (steps, nx + unknown parameters)
    std: Array  # (steps, nx + unknown parameters)
    y: Array  # (steps, ny)
    p: Array  # (steps, unknown parameters)
    status: NDArray[np.int64]  # (steps,)
    time_ns: NDArray[np.int64]  # (steps,)
    states: tuple[Trace, ...]
    sensors: tuple[Trace, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """The record of a closed loop, one entry per sample; t and x have one more for its end.

    ``z``: algebraic variables at x[k], u[k]. ``h``: values of the general path rows there, those that hold at node 0 or
    at several nodes before the end. ``p``, ``y``: parameters and reference of the path residual at node 0. ``cost[k]``:
    of the plan of sample k.
    ``states`` ... ``references``: names, units and bounds of the columns of x, u, z, h, p, y.
    ``reasons``: what Controller.diagnose() said at the first sample with each status.
    """

    name: str
    time_unit: str  # "samples" for a discrete map
    t: Array  # (steps+1,)
    x: Array  # (steps+1, nx)
    u: Array  # (steps, nu)
    z: Array  # (steps, number of algebraic variables)
    h: Array  # (steps, number of rows)
    p: Array  # (steps, np)
    y: Array  # (steps, ny)
    status: NDArray[np.int64]  # (steps,), values of Status
    cost: Array  # (steps,)
    time_ns: NDArray[np.int64]  # (steps,), prepare and feedback together
    states: tuple[Trace, ...]
    controls: tuple[Trace, ...]
    algebraic: tuple[Trace, ...]
    rows: tuple[Trace, ...]
    parameters: tuple[Trace, ...]
    references: tuple[Trace, ...]
    reasons: Mapping[Status, str] = field(default_factory=dict)
    estimates: Estimates | None = None  # of a loop with an estimator
