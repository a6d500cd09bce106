"""A Record holds the arrays of a log with their axes, and its quantities with names, units and bounds."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.program import Program
from nmpc_codegen.package.signals import units
from nmpc_codegen.package.status import Status

Array = NDArray[np.float64]
#: File for a picture; None: no file.
File = str | os.PathLike[str] | None

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def with_unit(name: str, unit: str) -> str:
    """Return name and unit for an axis, with powers as superscripts: ``a [m/s²]``."""
    text = re.sub(r"\^(-?\d+)", lambda power: power[1].translate(SUPERSCRIPTS), unit)
    return f"{name} [{text}]" if text else name


@dataclass(frozen=True)
class Trace:
    """A trace is a quantity of a log.

    Attributes:
        name: name of the quantity.
        unit: unit of the quantity, "" for none.
        signal: the state or control, if a residual is a single one; else "".
    """

    name: str
    unit: str = ""
    signal: str = ""

    @property
    def label(self) -> str:
        """Return the label of its axis."""
        return with_unit(self.name, self.unit)


def traces_of(described: PackageDescription) -> dict[str, Any]:
    """Return names and units of states, controls, algebraic variables, parameters and references, by these words."""
    kinds = ("states", "controls", "algebraic", "parameters")
    unit = units(*(getattr(described, kind) for kind in kinds))
    found = {kind: tuple(Trace(name, unit[name]) for name in getattr(described.names, kind)) for kind in kinds}
    return found | {"references": tuple(Trace(r.name, unit.get(r.signal, ""), r.signal) for r in described.residuals)}


@dataclass(frozen=True)
class Limit:
    """A limit is a row that bounds a column of a log.

    Attributes:
        name: name of the row.
        array: the bounded array, "x", "u" or "h".
        column: the bounded column of this array.
        row: index of the row in the program.
        soft: True if it may be violated at a cost.
        delay: time of the first node where the row holds; bounds of a sample apply at this time after it.
    """

    name: str
    array: str
    column: int
    row: int
    soft: bool = False
    delay: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Plans:
    """A log has the plans of n samples, with the rows of the problem along each.

    Attributes:
        sample: (n,), numbers of the samples.
        t: (N+1,), time of every node after the sample.
        x: (n, N+1, nx), states.
        u: (n, N, nu), controls.
        distance: (n, rows), least distance to the nearer bound over all nodes, negative where a row is violated, NaN
            for coupled rows.
        multiplier: (n, rows), multiplier of largest absolute value over the nodes, positive at an upper bound, NaN if
            the algorithm has none.
        active: (n, rows), number of nodes at which the row is active.
        rounding: (rows,), violations up to these values are rounding.
        rows: names of the rows.
    """

    AXES: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "sample": ("plans",),
        "t": ("nodes",),
        "x": ("plans", "nodes", "states"),
        "u": ("plans", "intervals", "controls"),
        **dict.fromkeys(("distance", "multiplier", "active"), ("plans", "planned")),
        "rounding": ("planned",),
    }

    sample: NDArray[np.int64]
    t: Array
    x: Array
    u: Array
    distance: Array
    multiplier: Array
    active: NDArray[np.int64]
    rounding: Array
    rows: tuple[Trace, ...]

    def __repr__(self) -> str:
        rows = ", ".join(trace.name for trace in self.rows)
        return f"<Plans of {len(self.sample)} samples: x {self.x.shape}, u {self.u.shape}; rows {rows}>"


@dataclass(frozen=True, eq=False)
class Estimates:
    """An estimator in a loop has these results, one entry per sample.

    Attributes:
        x: (steps, nx + unknown parameters), estimates of the states, then of the parameters.
        std: standard deviations of the estimates.
        y: (steps, ny), measurements, NaN where one was missing.
        p: (steps, unknown parameters), the true values.
        status: (steps,), values of Status.
        time_ns: (steps,), computing times (ns).
        states: names and units of the columns of x.
        sensors: names and units of the columns of y; ``signal`` is the state that a sensor measures.
    """

    AXES: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **dict.fromkeys(("x", "std"), ("samples", "states")),
        "y": ("samples", "sensors"),
        "p": ("samples", "unknown"),
        **dict.fromkeys(("status", "time_ns"), ("samples",)),
    }

    x: Array
    std: Array
    y: Array
    p: Array
    status: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    states: tuple[Trace, ...]
    sensors: tuple[Trace, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """The record of a closed loop, one entry per sample; t and x have one more for its end.

    Attributes:
        name: name of the package.
        time_unit: unit of t; "samples" for a discrete map.
        t: (steps+1,), times.
        x: (steps+1, nx), states of the plant.
        u: (steps, nu), controls.
        z: (steps, number), algebraic variables at x[k], u[k].
        h: (steps, number), values at x[k], u[k] of the general rows that hold at node 0 or at several nodes before the
            end.
        p: (steps, np), parameters at node 0.
        y: (steps, ny), reference of the path residual at node 0.
        status: (steps,), values of Status.
        cost: (steps,), cost of the plan of every sample.
        time_ns: (steps,), computing time of prepare and feedback together (ns).
        lower: (steps, number of ``limits``), lower bounds of these rows, each at the first node where it holds.
        upper: (steps, number of ``limits``), upper bounds at the same nodes.
        residual: (steps,), violation of the model and the rows by the plan, see Stats; NaN if the algorithm has none.
        states: names and units of the columns of x.
        controls: names and units of the columns of u.
        algebraic: names and units of the columns of z.
        rows: names and units of the columns of h.
        parameters: names and units of the columns of p.
        references: names and units of the columns of y.
        reasons: text of Controller.diagnose() at the first sample with each status.
        limits: rows that bound columns of x, u and h.
        program: the rows as functions of states, controls and parameters.
        dt: nominal time between samples.
        plans: logged plans, or None.
        estimates: results of the estimator, or None.
        began_ns: begin of each sample of a recording on a monotonic clock (ns); else empty.
        remarks: remarks on the file of a recording.
    """

    AXES: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "t": ("ends",),
        "x": ("ends", "states"),
        **{
            name: ("samples", kind)
            for name, kind in zip("uzhpy", ("controls", "algebraic", "rows", "parameters", "references"), strict=True)
        },
        **dict.fromkeys(("status", "cost", "time_ns", "residual"), ("samples",)),
        **dict.fromkeys(("lower", "upper"), ("samples", "limits")),
        "began_ns": ("recorded",),
    }

    name: str
    time_unit: str
    t: Array
    x: Array
    u: Array
    z: Array
    h: Array
    p: Array
    y: Array
    status: NDArray[np.int64]
    cost: Array
    time_ns: NDArray[np.int64]
    lower: Array
    upper: Array
    residual: Array
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
    estimates: Estimates | None = None
    began_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    remarks: tuple[str, ...] = ()

    def number(self, k: int) -> int:
        """Return the number of the k-th sample of the log; in a recording, that of the recorder, counted from 0."""
        return round(self.t[k] / self.dt) if len(self.began_ns) else k


#: Array of a log -> field with the traces of its columns.
COLUMNS = {name: axes[1] for name, axes in Record.AXES.items() if len(axes) > 1 and axes[1] != "limits"}
