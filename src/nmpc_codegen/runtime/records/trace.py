"""The fields of a log, and its quantities: their names, units and bounds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.program import Program
from nmpc_codegen.package.signals import units
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
class Trace:
    """One quantity of a log; ``signal``: the state or control that a residual is, "" for another expression."""

    name: str
    unit: str = ""
    signal: str = ""

    @property
    def label(self) -> str:
        """Label of its axis."""
        return with_unit(self.name, self.unit)


def traces_of(described: PackageDescription) -> dict[str, Any]:
    """Names and units of states, controls, algebraic variables, parameters and references, by these words."""
    kinds = ("states", "controls", "algebraic", "parameters")
    unit = units(*(getattr(described, kind) for kind in kinds))
    found = {kind: tuple(Trace(name, unit[name]) for name in getattr(described.names, kind)) for kind in kinds}
    return found | {"references": tuple(Trace(r.name, unit.get(r.signal, ""), r.signal) for r in described.residuals)}


@dataclass(frozen=True)
class Limit:
    """A row that bounds a column of a log.

    ``array``, ``column``: what it bounds, of "x", "u" or "h"; ``row``: its place in the program of the rows; ``soft``:
    it may be violated at a cost; ``delay``: time of the first node where it holds, at which the bound of a sample is.
    """

    name: str
    array: str
    column: int
    row: int
    soft: bool = False
    delay: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Plans:
    """Plans that a log has kept, of n samples, with the rows of the problem along each.

    ``distance``: the least of all nodes to the nearer bound, negative where a row is violated, and NaN of coupled rows;
    ``multiplier``: the one of largest size, positive at an upper bound, NaN if the algorithm has none; ``active``: at
    how many nodes the row is active. ``rows``: names of their columns; ``rounding``: violations that are none.
    """

    sample: NDArray[np.int64]  # (n,)
    t: Array  # (N+1,), time of every node after the sample
    x: Array  # (n, N+1, nx)
    u: Array  # (n, N, nu)
    distance: Array  # (n, number of rows)
    multiplier: Array  # (n, number of rows)
    active: NDArray[np.int64]  # (n, number of rows)
    rounding: Array  # (number of rows,)
    rows: tuple[Trace, ...]

    def __repr__(self) -> str:
        rows = ", ".join(trace.name for trace in self.rows)
        return f"<Plans of {len(self.sample)} samples: x {self.x.shape}, u {self.u.shape}; rows {rows}>"


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
    ``lower``, ``upper``: bounds of the rows in ``limits``, each at the first node where it holds. ``residual``: how far
    the plan was from the model and its rows, see Stats; NaN where the algorithm has none.
    ``states`` ... ``references``: names and units of the columns of x, u, z, h, p, y.
    ``reasons``: what Controller.diagnose() said at the first sample with each status. ``program``: the rows as
    functions of states, controls and parameters.
    ``began_ns``: when each sample began, of a recording, by a clock that only runs forward; else empty; ``dt``: the
    time between samples that was meant. ``remarks``: on the file of a recording.
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
    lower: Array  # (steps, number of limits)
    upper: Array  # (steps, number of limits)
    residual: Array  # (steps,)
    states: tuple[Trace, ...]
    controls: tuple[Trace, ...]
    algebraic: tuple[Trace, ...]
    rows: tuple[Trace, ...]
    parameters: tuple[Trace, ...]
    references: tuple[Trace, ...]
    reasons: Mapping[Status, str] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()
    program: Program = field(default_factory=Program)
    dt: float = 0.0
    plans: Plans | None = None
    estimates: Estimates | None = None  # of a loop with an estimator
    began_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    remarks: tuple[str, ...] = ()

    def number(self, k: int) -> int:
        """Number of the k-th sample of the log: of a recording that of the recorder, from 0 on."""
        return round(self.t[k] / self.dt) if len(self.began_ns) else k
