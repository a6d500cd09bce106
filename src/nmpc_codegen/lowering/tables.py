"""The constant arrays of a package hold declared data, scales, places and look-up tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from nmpc_codegen.components.core import TABLES_OF_OTHERS
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.completion.scales import round_scales
from nmpc_codegen.frontend.problem import Array, Problem, Stage
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.kernel import called_lookups
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.stated import augmented_state, probes
from nmpc_codegen.package.lookup import Lookup


def tables(model: Model, routines: Sequence[Routine]) -> tuple[Table, ...]:
    """Return the constant arrays of the unit; ``routines`` may read look-up tables."""
    p, sizes = model.problem, model.problem.scales
    rows = p.qp_rows

    def real(name: str, values: ArrayLike, doc: str) -> Table:
        return Table(name, "real", tuple(float(v) for v in np.ravel(values)), doc)

    def integer(name: str, values: Iterable[int], doc: str) -> Table:
        return Table(name, "int", tuple(int(v) for v in values), doc)

    longest_step = model.parts.integrator.longest_step(p)
    first = np.searchsorted([r[0] for r in rows], range(p.N + 2))
    offsets = [s.offset for s in p.own_parameters] + [p.np - p.data_behind]
    found = (
        real("interval_length", p.dt, "dt_k"),
        *([] if p.discrete else [real("step_length", [longest_step], "longest integration step")]),
        real("z_scale", round_scales(sizes.z), "scales of (x, u)"),
        real("row_magnitude", round_scales(sizes.rows), "scales of the terms of the rows"),
        real("row_offset", sizes.offsets, "constant parts of the rows, which belong to their bounds"),
        real("cost_size", round_scales(sizes.cost), "scale of the cost: its most expensive part"),
        real("force_size", round_scales(sizes.forces), "scales of the gradient of the cost with respect to (x, u)"),
        real("initial_state", p.x_initial, "initial values of the states"),
        real("default_control", _default_controls(p), "0, clipped to the bounds"),
        real("default_parameter", p.p_value, "p"),
        real("default_reference", p.path.reference, "yref"),
        real("default_terminal_reference", p.terminal.reference, "yref_N"),
        real("default_start_reference", p.start.reference, "reference of the residual at the start"),
        real("default_start_weight", _weight_values(p.start), "weight of the residual at the start"),
        real("default_weight", _weight_values(p.path), "W"),
        real("default_terminal_weight", _weight_values(p.terminal), "W_N"),
        real("default_lower", [r.lower for r in p.rows], "lower bounds of the rows"),
        real("default_upper", [r.upper for r in p.rows], "upper bounds of the rows"),
        integer("control_reference", p.control_reference, "residual that holds the reference of control j, or -1"),
        integer("control_row", control_rows(p), "row that bounds control j, or -1"),
        integer("free_state", p.free_initial, "state that is free component f of x_0"),
        integer("row_first", first, "first row of node k"),
        integer("soft_place", _soft_places(p), "place of a row among the soft ones; -1: it is hard"),
        real("default_soft_l1", [r.soft[0] for r in p.rows if r.soft], "penalties l1 v of the soft rows"),
        real("default_soft_l2", [r.soft[1] for r in p.rows if r.soft], "penalties l2/2 v^2 of the soft rows"),
        integer("penalty_scaled", (r.scaled for r in p.rows if r.soft), "1: times the length of the interval"),
        *probes.tables(p.saddles),
        real("proximal", round_scales(p.proximal), "curvature of steps in samples"),
        integer("on_states", p.rows_on_states, "1: row on states alone"),
        integer("is_pulled", (i in p.pulled_rows for i in range(len(p.rows))), "1: hard row on controls alone"),
        real("parameter_lower", _limits(p, -math.inf), "lower bounds of the elements of p"),
        real("parameter_upper", _limits(p, math.inf), "upper bounds of the elements of p"),
        integer("parameter_offset", offsets, "first element of a parameter in p"),
        *augmented_state.tables(model),
        *lookup_tables(routines),
        *(table for component in model.parts.components for table in component.tables(p)),
        *TABLES_OF_OTHERS,
    )
    return tuple({table.name: table for table in reversed(found)}.values())[::-1]


def lookup_tables(routines: Iterable[Routine]) -> list[Table]:
    """Return the arrays of the look-up tables in routines.

    Raises:
        ProblemError: two tables have one name.
    """
    found: dict[str, Lookup] = {}
    for lookup in called_lookups(routines):
        other = found.setdefault(lookup.table, lookup)
        if other.values != lookup.values:
            raise ProblemError(
                f"two look-up tables have the name {lookup.name!r}; give them different names= (what "
                "a table needs for its axes has its name with _x, _y, _per_x, _x_splines)"
            )
    return [Table(name, "real", lookup.values, "look-up table") for name, lookup in found.items()]


def _limits(p: Problem, none: float) -> list[float]:
    """Return the lower or upper bounds of the user's parameters; ``none`` stands for a missing bound."""
    sides = [(s.low if none < 0 else s.high) or (none,) * s.size for s in p.own_parameters]
    return [value for side in sides for value in side]


def _soft_places(p: Problem) -> list[int]:
    """Return for every row its index among the soft ones, or -1."""
    soft = [i for i, row in enumerate(p.rows) if row.soft is not None]
    return [soft.index(i) if i in soft else -1 for i in range(len(p.rows))]


def _weight_values(stage: Stage) -> Array:
    return np.diag(stage.weight) if stage.diagonal_weight else stage.weight


def control_rows(p: Problem) -> list[int]:
    return [next((i for i, r in enumerate(p.rows) if r.variable(p.nx) == p.nx + j), -1) for j in range(p.nu)]


def _default_controls(p: Problem) -> list[float]:
    rows = [p.rows[i] if i >= 0 else None for i in control_rows(p)]
    return [float(np.clip(0.0, r.lower, r.upper)) if r else 0.0 for r in rows]
