"""One plan is stored with everything that its picture shows: bounds, references and rows, node by node."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.runtime.diagnosis.plan import PlanReader
from nmpc_codegen.runtime.memory import Memory
from nmpc_codegen.runtime.records.trace import Limit, Trace, traces_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan is drawn or tabulated over its nodes.

    ``h`` holds general rows, NaN where one does not hold; ``y`` references of the residuals in ``references`` over the
    intervals; ``lower`` and ``upper`` bounds of the rows in ``limits``, NaN where they do not hold.
    """

    name: str
    time_unit: str
    t: Array  # (N+1,)
    x: Array  # (N+1, nx)
    u: Array  # (N, nu)
    z: Array  # (N+1, number of algebraic variables)
    h: Array  # (N+1, number of general rows)
    y: Array  # (N, ny)
    lower: Array  # (N+1, number of limits)
    upper: Array  # (N+1, number of limits)
    states: tuple[Trace, ...]
    controls: tuple[Trace, ...]
    algebraic: tuple[Trace, ...]
    rows: tuple[Trace, ...]
    references: tuple[Trace, ...]
    limits: tuple[Limit, ...]


def take_plan(ctrl: Memory) -> Plan:
    """Return the present plan of a controller."""
    described, d = ctrl.description, ctrl.dims
    reader = PlanReader(ctrl)
    data = reader.copy(ctrl, reader.bounds(ctrl))
    found = reader.evaluate(ctrl, [data])
    known = ~np.isnan(found.values[0])
    general = [i for i, row in enumerate(described.rows) if row.is_general]
    limits = [i for i, row in enumerate(described.rows) if known[:, i].any()]
    places = {i: ("h", general.index(i)) for i in general}
    places |= {i: ("x", row.index) for i, row in enumerate(described.rows) if row.kind == "state"}
    places |= {i: ("u", row.index) for i, row in enumerate(described.rows) if row.kind == "control"}
    traces = traces_of(described)
    return Plan(
        name=described.name,
        time_unit=described.time_unit,
        t=np.append(0.0, np.cumsum(described.dt)),
        x=data.x[:, : d.nx],
        u=data.u,
        z=data.z,
        h=found.values[0][:, general],
        y=_references(ctrl),
        lower=np.where(known, data.lower, np.nan)[:, limits],
        upper=np.where(known, data.upper, np.nan)[:, limits],
        **{kind: traces[kind] for kind in ("states", "controls", "algebraic", "references")},
        rows=tuple(Trace(described.rows[i].name) for i in general),
        limits=tuple(Limit(described.rows[i].name, *places[i], i, described.rows[i].soft is not None) for i in limits),
    )


def _references(ctrl: Memory) -> Array:
    """Return the references of the path residual at all nodes before the end, (N, ny)."""
    d, described = ctrl.dims, ctrl.description
    if not d.ny:
        return np.zeros((d.N, 0))
    if described.online["reference"] == "fixed":
        stored = np.array([[r.reference for r in described.residuals]])
    else:
        stored = np.asarray(ctrl.member("yref"), dtype=np.float64).reshape(-1, d.ny)
    return np.broadcast_to(stored, (d.N, d.ny)).copy() if len(stored) in (1, d.N) else np.full((d.N, d.ny), np.nan)
