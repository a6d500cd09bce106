"""Notebooks show a controller, a log and a solution as a title, a text and tables."""

from __future__ import annotations

from nmpc_codegen.package.signals import horizon, nodes, units
from nmpc_codegen.package.status import Kkt
from nmpc_codegen.pictures.html import ROWS, page, ranges, shorten, table
from nmpc_codegen.runtime.diagnosis.plan_rows import path_bounds, path_reference, start_parameters
from nmpc_codegen.runtime.memory import Memory
from nmpc_codegen.runtime.records.one_plan import Plan
from nmpc_codegen.runtime.records.trace import Record


def of_controller(ctrl: Memory) -> str:
    """Return signals at node 0 of the plan, rows with present bounds, references, and choices of the compiler."""
    described = ctrl.description
    values = {"state": ctrl.x[0], "control": ctrl.u[0], "parameter": start_parameters(ctrl)}
    names = {"state": ctrl.names.states, "control": ctrl.names.controls, "parameter": ctrl.names.parameters}
    unit = units(described.states, described.controls, described.parameters)
    signals: list[tuple[object, ...]] = []
    for kind, of_kind in names.items():
        signals += shorten(
            [(kind, name, unit[name], float(value)) for name, value in zip(of_kind, values[kind], strict=True)]
        )
    rows: list[tuple[object, ...]] = []
    for i, row in enumerate(described.rows):
        lower, upper = path_bounds(ctrl, i)
        place = row.variable(ctrl.dims.nx)
        of_row = "" if place is None else (*ctrl.names.states, *ctrl.names.controls)[place]
        rows.append((lower, row.name, upper, unit.get(of_row, ""), nodes(row.nodes), row.strictness))
    targets: list[tuple[object, ...]] = [
        (r.name, unit.get(r.signal, ""), float(y))
        for r, y in zip(described.residuals, path_reference(ctrl), strict=True)
    ]
    grid = horizon(described.dt, described.time_unit, described.discrete)
    code = f"{described.precision} precision, target {described.target}, profile {ctrl.profile}, {ctrl.nbytes:,} bytes"
    last = f"\nlast call: {ctrl.status}, {ctrl.time_ns / 1e3:.1f} us" if ctrl.time_ns else ""
    return page(
        f"Controller {described.name}",
        f"N={grid}; {code}{last}",
        [
            table(("", "name", "unit", "at node 0"), signals),
            table(ROWS, shorten(rows)),
            table(("residual", "unit", "reference"), shorten(targets)),
            table(("chosen by the compiler",), [(choice,) for choice in described.report.choices]),
        ],
    )


def of_log(log: Record, text: str) -> str:
    """Return the summary of a log, and the range of every quantity."""
    groups = [
        *(("state", log.states, log.x), ("control", log.controls, log.u)),
        *(("algebraic", log.algebraic, log.z), ("row", log.rows, log.h)),
        ("parameter", log.parameters, log.p),
    ]
    return page(f"Log {log.name}", text, [ranges(groups)])


def of_solution(plan: Plan | None, kkt: Kkt, text: str) -> str:
    """Return the text of a solution, the range of every quantity of its plan, and its residuals."""
    if plan is None:
        return page("Solution", text, [])
    groups = [("state", plan.states, plan.x), ("control", plan.controls, plan.u)]
    residuals = [(part, f"{value:.1e}") for part, value in kkt.parts.items()]
    tables = [ranges([*groups, ("algebraic", plan.algebraic, plan.z)]), table(("KKT residual", ""), residuals)]
    return page(f"Solution {plan.name}", text, tables)
