"""Notes collects the entries of a log from a controller, sample by sample, in a simulation or from a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.signals import units
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.diagnosis.plan import PlanData, PlanReader
from nmpc_codegen.runtime.diagnosis.plan_rows import (
    imposed_nodes,
    path_reference,
    row_values,
    start_parameters,
    whole_parameters,
)
from nmpc_codegen.runtime.records.log import Log
from nmpc_codegen.runtime.records.trace import Estimates, Limit, Plans, Record, Trace, traces_of

Array = NDArray[np.float64]

LOG_COLUMNS = 5  # status, cost, time, residual and t
#: Default limits of a log: number of plans, and bytes that they may take.
MOST_PLANS, PLAN_BYTES = 1000, 2**26
REAL: int = np.dtype(np.float64).itemsize
#: Arrays of a log with integers.
INTEGERS: dict[str, Any] = dict.fromkeys(("status", "time_ns", "began_ns"), np.int64)


@dataclass(frozen=True)
class Logged:
    """The numbers of the rows that a log shows: general rows, in h, and rows in ``limits``, whose bounds are logged."""

    general: list[int]
    limits: list[int]

    @classmethod
    def of(cls, ctrl: Controller) -> Logged:
        """Select the rows that a log of this controller shows.

        They are general rows and bounds of states that hold at several nodes before the end, general rows at node 0,
        and bounds of controls.
        """
        general, limits = [], []
        for i, row in enumerate(ctrl.description.rows):
            path = [k for k in row.nodes if k < ctrl.dims.N]
            if row.is_general and row.index >= 0 and (0 in path or len(path) > 1):
                general.append(i)
                limits.append(i)
            elif row.kind == "control" or (row.kind == "state" and len(row.nodes) > 1):
                limits.append(i)
        return cls(general, limits)


def columns_of_log(ctrl: Controller) -> int:
    """Return how many numbers a log stores for every sample, besides plans."""
    logged, d = Logged.of(ctrl), ctrl.dims
    return d.nx + d.nu + d.np + d.ny + len(logged.general) + 2 * len(logged.limits) + LOG_COLUMNS


def spacing(ctrl: Controller, steps: int) -> int:
    """Return the number of samples between logged plans so that they respect PLAN_BYTES and MOST_PLANS."""
    N, d = ctrl.dims.N, ctrl.dims
    size = REAL * (N + 1) * int(ctrl.whole_x.shape[1] + d.nu + d.np + 3 * d.nr)
    return max(1, math.ceil(steps / MOST_PLANS), math.ceil(steps * size / PLAN_BYTES))


class Notes:
    """The entries of a log while the loop runs; ``every`` samples lie between two logged plans, 0: none."""

    def __init__(self, ctrl: Controller, steps: int, interval: float, every: int) -> None:
        d, described = ctrl.dims, ctrl.description
        self._ctrl, self._interval, self._every, self._logged = ctrl, interval, every, Logged.of(ctrl)
        counts = {"ends": steps + 1, "samples": steps, "states": d.nx, "controls": d.nu, "parameters": d.np}
        counts |= {"algebraic": len(ctrl.names.algebraic), "rows": 0, "references": d.ny, "recorded": 0}
        counts["limits"] = len(self._logged.limits)
        self._arrays: dict[str, Any] = {
            name: np.zeros([counts[axis] for axis in axes], INTEGERS.get(name, np.float64))
            for name, axes in Record.AXES.items()
        }
        self._arrays["residual"][:] = np.nan
        self._arrays["t"] += interval * np.arange(steps + 1)
        self.x, self.u = self._arrays["x"], self._arrays["u"]
        self._known = np.zeros((steps, ctrl.known.size))
        self._reasons: dict[Status, str] = {}
        self._plans: list[PlanData] = []
        self._planned: list[int] = []
        self._reader = PlanReader(ctrl)
        self._has_residual = "residual" in described.members("stats")
        rows = [described.rows[i] for i in self._logged.limits]
        self._first = [imposed_nodes(row)[0] for row in rows]

    def take(self, k: int, u: Array, time_ns: int, planned: bool = True, keep: bool | None = None) -> None:
        """Log sample k, whose state is in ``x``, from the controller after the sample.

        If ``planned`` is false, the controller does not hold the plan of this sample. ``keep`` says whether the plan is
        logged; None: if its turn has come.
        """
        ctrl, bounds, status = self._ctrl, self._reader.bounds(self._ctrl), self._ctrl.status
        if status not in self._reasons:
            self._reasons[status] = ctrl.diagnose() if status else ""
        lower, upper = (side[self._first, self._logged.limits] for side in bounds)
        found = {"u": u, "time_ns": time_ns, "status": status, "cost": ctrl.cost if planned else np.nan}
        found |= {"p": start_parameters(ctrl), "y": path_reference(ctrl), "z": ctrl.algebraic(self.x[k], u)}
        found |= {"residual": ctrl.view("stats.residual")} if self._has_residual else {}
        for name, value in (*found.items(), ("lower", lower), ("upper", upper)):
            self._arrays[name][k] = value
        self._known[k] = ctrl.known
        if (self._every and k % self._every == 0) if keep is None else keep:
            self._plans.append(self._reader.copy(ctrl, bounds))
            self._planned.append(k)

    def finish(
        self, estimates: Estimates | None = None, t: Array | None = None, began_ns: NDArray[np.int64] | None = None
    ) -> Log:
        """Return the log; ``t`` holds the times of the samples and of the end, by default from 0 on."""
        ctrl, arrays, described = self._ctrl, self._arrays, self._ctrl.description
        behind = np.tile(whole_parameters(ctrl)[:1, ctrl.dims.np :], (len(self.u), 1))
        x, p = np.hstack([self.x[:-1], self._known]), np.hstack([arrays["p"], behind])
        own, rows, limits = self._find_axes()
        arrays["h"] = row_values(ctrl, x, self.u, p, arrays["z"])[:, self._logged.general][:, own]
        arrays |= {name: value for name, value in (("t", t), ("began_ns", began_ns)) if value is not None}
        return Log(
            name=described.name,
            time_unit=described.time_unit,
            **arrays,
            **traces_of(described),
            rows=rows,
            reasons=self._reasons,
            limits=limits,
            program=described.program,
            dt=self._interval,
            plans=self._keep_plans(),
            estimates=estimates,
        )

    def _find_axes(self) -> tuple[list[int], tuple[Trace, ...], tuple[Limit, ...]]:
        """Return the columns of h that get an axis, their traces, and the limits of all rows.

        The other columns of h are single states or controls, on whose axes their bounds are shown.
        """
        described, names = self._ctrl.description, self._ctrl.names
        signals = {n: ("x", i) for i, n in enumerate(names.states)} | {
            n: ("u", j) for j, n in enumerate(names.controls)
        }
        steps, places = described.program.steps, described.program.rows
        own: list[int] = []
        rows: list[Trace] = []
        limits: list[Limit] = []
        for number, first in zip(self._logged.limits, self._first, strict=True):
            row = described.rows[number]
            if row.is_general:
                name, port, element, _ = steps[max(places[number])]
                place = signals.get(row.name)
                if name != "input" or place != ("xup"[port], element):
                    place = "h", len(own)
                    own.append(self._logged.general.index(number))
                    rows.append(Trace(row.name))
            else:
                place = ("u" if row.kind == "control" else "x"), row.index
            delay = float(sum(described.dt[:first]))
            limits.append(Limit(row.name, *place, number, row.soft is not None, delay))
        return own, tuple(rows), tuple(limits)

    def _keep_plans(self) -> Plans | None:
        """Return the logged plans with a summary of their rows over the nodes."""
        if not self._plans:
            return None
        ctrl, found = self._ctrl, self._reader.evaluate(self._ctrl, self._plans)
        nx, described = ctrl.dims.nx, ctrl.description
        unit = units(described.states, described.controls)
        of_rows = ((*ctrl.names.states, *ctrl.names.controls)[p] if p is not None else "" for p in self._variables())
        return Plans(
            sample=np.array(self._planned, dtype=np.int64),
            t=np.append(0.0, np.cumsum(described.dt)),
            x=np.stack([plan.x[:, :nx] for plan in self._plans]),
            u=np.stack([plan.u for plan in self._plans]),
            distance=_least(found.distance),
            multiplier=_largest(found.multiplier),
            active=found.active.sum(axis=1),
            rounding=found.rounding,
            rows=tuple(Trace(r.name, unit.get(of, "")) for r, of in zip(described.rows, of_rows, strict=True)),
        )

    def _variables(self) -> list[int | None]:
        return [row.variable(self._ctrl.dims.nx) for row in self._ctrl.description.rows]


def _least(distance: Array) -> Array:
    """Return the least distance over all nodes, NaN for a row that holds at none."""
    known = np.where(np.isnan(distance), np.inf, distance).min(axis=1)
    return np.where(np.isnan(distance).all(axis=1), np.nan, known)


def _largest(multiplier: Array) -> Array:
    """Return the multiplier with the largest absolute value over the nodes."""
    place = np.argmax(np.abs(np.nan_to_num(multiplier)), axis=1)
    return np.take_along_axis(multiplier, place[:, None, :], axis=1)[:, 0, :]
