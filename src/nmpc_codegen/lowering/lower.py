"""Linearization -> CModule: all sizes and all C names. Loops over components and never asks which one it holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from nmpc_codegen.components.base import Counts, Dims
from nmpc_codegen.frontend.problem import Problem, Row, Signal, Stage, c_identifier
from nmpc_codegen.ir.cmodule import (
    STATUSES,
    CModule,
    Enum,
    Field,
    Macro,
    Section,
    Setter,
    Setting,
    Size,
    Struct,
    Table,
    check_prefix,
    struct_layout,
)
from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.stage_products import PANEL, Products
from nmpc_codegen.lowering.dimensions import dimensions
from nmpc_codegen.lowering.linearize import Linearization

# Counters stop here, and integrate() takes at most so many steps.
MANY = 1_000_000
# A solver struct that init() has seen.
MAGIC = 0x4E4D5043


def lower(lin: Linearization, name: str | None = None) -> CModule:
    """Decide every size and name of the package ``name`` (default: the problem's)."""
    problem = lin.problem
    name = problem.name if name is None else name
    check_prefix(name)
    dims = _dims(lin)
    structs = _structs(lin, dims)
    layout = struct_layout(structs, lin.options.precision)
    products = lin.products
    known = _known(lin, products)
    sections = tuple(
        Section(
            f"{c.seam}: {c.name}",
            c.template,
            _section_count(c.cost(dims, known)),
            sum(layout[s.name][0] * int(np.prod(s_shape(s))) for s in c.structs(dims) if s.name != "solver"),
        )
        for c in lin.options.components
    )
    macros = _macros(lin, dims)
    return CModule(
        name=name,
        precision=lin.options.precision,
        macros=macros,
        enums=_enums(problem),
        structs=structs,
        tables=_tables(lin),
        settings=_settings(lin, dims),
        setters=_setters(lin),
        layouts=lin.options.online.layouts,
        routines=lin.routines,
        products=products,
        switches=_switches(lin),
        sections=sections,
        statuses=STATUSES,
        signals=(
            ("x", problem.state_names),
            ("u", problem.control_names),
            ("p", problem.parameter_names),
            ("y", problem.path.y_names),
            ("y_N", problem.terminal.y_names),
            ("h", problem.path.h_names),
            ("h_N", problem.terminal.h_names),
        ),
        diagonal_weight=problem.path.diagonal_weight,
        diagonal_weight_N=problem.terminal.diagonal_weight,
        metadata=_metadata(lin, name, macros, structs, products),
        foreign=tuple(c.name for c in lin.options.components if hasattr(c, "foreign_sources")),
    )


def _known(lin: Linearization, products: Products) -> Counts:
    """Operations of the functions that components call: printed routines and stage products."""
    return {r.name: r.count for r in lin.routines} | products.counts | products.column_counts


def _switches(lin: Linearization) -> dict[str, int]:
    """What `#if` in the parts may test besides the sizes: features of the problem and of the options, 1 or 0."""
    kinds = {kind for _, kind, _, _ in lin.problem.qp_rows}
    switches = {"STATE_ROWS": int(0 in kinds), "GENERAL_ROWS": int(1 in kinds)}
    for component in lin.options.components:
        switches |= component.switches
    return switches


def s_shape(struct: Struct) -> tuple[int, ...]:
    """Padded shape of the member that holds a struct."""
    return tuple(max(1, s.value) for s in struct.shape)


def _section_count(counts: dict[str, OpCount]) -> OpCount | None:
    return sum(counts.values(), OpCount()) if counts else None


def _dims(lin: Linearization) -> Dims:
    return dimensions(lin.problem, lin.options.condensing.qp_shape(lin.problem), lin.constant_hessian)


def _macros(lin: Linearization, dims: Dims) -> tuple[Macro, ...]:
    docs = {
        "N": "intervals",
        "NX": "states",
        "NU": "controls",
        "NZ": "NX + NU",
        "NP": "parameters",
        "NY": "path residuals",
        "NY_N": "terminal residuals",
        "NW": "entries of the path weight",
        "NW_N": "entries of the terminal weight",
        "NH": "general path rows",
        "NH_N": "general terminal rows",
        "NR": "scalar rows with bounds",
        "NQ": "path Hessian blocks",
        "NF": "free components of x_0",
        "NE": "coupled rows",
        "NS": "stages of the QP",
        "NUS": "controls of a stage of the QP",
        "NXS": "states of a stage: NX and copies of components of x_0",
        "NZS": "NXS + NUS",
        "NV": "variables of the QP",
        "NSL": "slacks among them",
        "NG": "rows of the QP besides control bounds",
        "LDV": "NV rounded up to PANEL",
    }
    macros = [Macro(s.text, s.value, docs[s.text]) for s in vars(dims).values()]
    macros.append(Macro("PANEL", PANEL, "columns processed together"))
    macros.append(Macro("SOFT_ROWS", sum(r.soft is not None for r in lin.problem.rows), "rows with a penalty"))
    macros.append(Macro("PARAMS", len(lin.problem.parameters), "parameters by name"))
    macros += [Macro(f"SIZE_{s.name.upper()}", s.size, f"numbers of {s.name}") for s in lin.problem.parameters]
    for component in lin.options.components:
        macros += [Macro(*entry) for entry in component.sizes(dims)]
    macros.append(Macro("MANY", MANY, "counters stop here"))
    macros.append(Macro("MAGIC", MAGIC, "a struct that init has seen"))
    return tuple(macros)


def _enums(problem: Problem) -> tuple[Enum, ...]:
    rows = tuple(c_identifier(r.name) for r in problem.rows)
    parameters = tuple(s.name for s in problem.parameters)
    enums = []
    if rows:
        enums.append(Enum("ROW", rows, "scalar rows, for set_bounds"))
    if parameters:
        enums.append(Enum("PARAM", parameters, "parameters, for set_parameter"))
    return tuple(enums)


def _structs(lin: Linearization, dims: Dims) -> tuple[Struct, ...]:
    nodes = Size("N + 1", dims.N.value + 1)
    common = [
        Field("x", (nodes, dims.nx), "states of the plan", "iterate"),
        Field("u", (dims.N, dims.nu), "controls of the plan", "iterate"),
        *(setting.field for setting in _settings(lin, dims)),
    ]
    results = [
        Field("stats", (), "counters", "result", "stats"),
        Field("kkt", (), "KKT residuals of the last solve", "result", "kkt"),
        Field("relaxation", (), "l1 penalty of hard rows while a QP is relaxed, else infinite", "scratch"),
        Field("status", (), "status of the last prepare, feedback or solve", "result", "int32"),
        Field("magic", (), "set by init", "keep", "int32"),
    ]
    owned = [s for c in lin.options.components for s in c.structs(dims)]
    own_members = [f for s in owned if s.name == "solver" for f in s.fields]
    inner = _inner_structs(owned)
    held = {f.ctype for s in inner for f in s.fields}
    members = [Field(s.name, s.shape, s.doc, "data", s.name) for s in inner if s.name not in held]
    solver = Struct(
        "solver", "the whole controller: no pointers, copy it with '='", (*common, *own_members, *members, *results)
    )
    return (*_result_structs(), *inner, solver)


def _inner_structs(owned: list[Struct]) -> list[Struct]:
    """The structs that the solver holds, every one after those that are its members; unions of one name are one."""
    stated = {s.name: s for s in owned if s.name != "solver"}
    for name in (s.name for s in owned if s.union):
        alternatives = [f for s in owned if s.name == name for f in s.fields]
        stated[name] = replace(stated[name], fields=tuple(alternatives))
    order: dict[str, Struct] = {}

    def place(struct: Struct) -> None:
        for field in struct.fields:
            if field.ctype in stated:
                place(stated[field.ctype])
        order.setdefault(struct.name, struct)

    for struct in stated.values():
        place(struct)
    return list(order.values())


def _settings(lin: Linearization, dims: Dims) -> tuple[Setting, ...]:
    """Members that hold what can be changed at run time; fixed data have none."""
    p, layouts = lin.problem, lin.options.online.layouts
    weight = (dims.ny,) if p.path.diagonal_weight else (dims.ny, dims.ny)
    weight_N = (dims.ny_N,) if p.terminal.diagonal_weight else (dims.ny_N, dims.ny_N)
    one = Size("1", 1)
    path = {"shared": one, "node": dims.N}
    every = {"shared": Size("2", 2), "node": Size("N + 1", dims.N.value + 1)}
    which = {"shared": "path, terminal", "node": "every node"}

    def setting(
        option: str, name: str, table: str, shape: tuple[Size, ...], copies: Mapping[str, Size] | None, doc: str
    ) -> list[Setting]:
        entries = {"W": dims.nw, "W_N": dims.nw_N}.get(name, shape[0])
        layout = layouts[option]
        if layout == "fixed":
            return []
        count = copies[layout] if copies else one
        leading = (count,) if copies else ()
        suffix = f": {which[layout]}" if option == "bounds" else ""
        return [Setting(Field(name, (*leading, *shape), doc + suffix, "setting"), table, count, entries)]

    return (
        *setting("parameter", "p", "default_parameter", (dims.np,), every, "parameters"),
        *setting("reference", "yref", "default_reference", (dims.ny,), path, "references of the path residual"),
        *setting(
            "reference",
            "yref_N",
            "default_terminal_reference",
            (dims.ny_N,),
            None,
            "reference of the terminal residual",
        ),
        *setting("weight", "W", "default_weight", weight, path, "weight of the path residual"),
        *setting("weight", "W_N", "default_terminal_weight", weight_N, None, "weight of the terminal residual"),
        *setting("bounds", "lower", "default_lower", (dims.nr,), every, "lower bounds of the rows"),
        *setting("bounds", "upper", "default_upper", (dims.nr,), every, "upper bounds of the rows"),
    )


#: What k may be besides ALL, for every kind of data that a package lets change.
_NODES = {
    "reference": {"shared": "no node", "node": "0 .. N - 1"},
    "weight": {"shared": "no node", "node": "0 .. N - 1"},
    "parameter": {"shared": "N", "node": "0 .. N"},
    "bounds": {"shared": "N, if the row holds there", "node": "a node of the row"},
}


def _setters(lin: Linearization) -> tuple[Setter, ...]:
    layouts = lin.options.online.layouts
    return tuple(Setter(name, nodes[layouts[name]]) for name, nodes in _NODES.items() if layouts[name] != "fixed")


def _result_structs() -> tuple[Struct, ...]:
    def real(name: str, doc: str) -> Field:
        return Field(name, (), doc, "result")

    def count(name: str, doc: str) -> Field:
        return Field(name, (), doc, "result", "int32")

    kkt = Struct(
        "kkt",
        "KKT residuals, largest absolute values",
        (
            real("stationarity", "gradient of the Lagrangian"),
            real("equality", "gaps of the dynamics and x_0 - xhat"),
            real("inequality", "violation of bounds and rows"),
            real("complementarity", "multiplier times distance to its bound"),
        ),
    )
    stats = Struct(
        "stats",
        "counters of the last feedback or solve",
        (
            count("qp_iterations", "iterations of the last QP"),
            count("active_set_changes", "changes of the working set in the last QP"),
            count("dropped_rows", "redundant rows left out of the working set"),
            count("relaxed_rows", "soft or relaxed rows that are violated"),
            count("sqp_iterations", "iterations of the last solve"),
            count("violated_row", "hard row that cannot be met (INFEASIBLE) or is relaxed (RELAXED), or -1"),
            count("violated_node", "its node, or -1"),
            real("violation", "by how much the last step of the QP violates it"),
        ),
    )
    return kkt, stats


def _tables(lin: Linearization) -> tuple[Table, ...]:
    p = lin.problem
    rows = p.qp_rows

    def real(name: str, values: Any, doc: str) -> Table:
        return Table(name, "real", tuple(float(v) for v in np.ravel(values)), doc)

    def integer(name: str, values: Any, doc: str) -> Table:
        return Table(name, "int", tuple(int(v) for v in values), doc)

    longest_step = max(p.dt) / _steps(lin)
    first = np.searchsorted([r[0] for r in rows], range(p.N + 2))
    offsets = [s.offset for s in p.parameters] + [p.np]
    fixed = lin.options.online.parameter == "fixed"
    return (
        real("interval_length", p.dt, "dt_k"),
        *([] if p.discrete else [real("step_length", [longest_step], "longest integration step")]),
        real("initial_state", p.x_initial, "initial values of the states"),
        real("default_control", _default_controls(p), "0 inside the bounds"),
        real("default_parameter", p.p_value, "p"),
        real("default_reference", p.path.reference, "yref"),
        real("default_terminal_reference", p.terminal.reference, "yref_N"),
        real("default_weight", _weight_values(p.path), "W"),
        real("default_terminal_weight", _weight_values(p.terminal), "W_N"),
        real("default_lower", [r.lower for r in p.rows], "lower bounds of the rows"),
        real("default_upper", [r.upper for r in p.rows], "upper bounds of the rows"),
        integer("control_reference", p.control_reference, "residual that holds the reference of control j, or -1"),
        integer("control_row", _control_rows(p), "row that bounds control j, or -1"),
        integer("free_state", p.free_initial, "state that is free component f of x_0"),
        integer("row_node", [r[0] for r in rows], "node of QP row m"),
        integer("row_kind", [r[1] for r in rows], "0: state bound, 1: general row, 2: coupled row"),
        integer("row_index", [r[2] for r in rows], "component of x, h or r"),
        integer("row_id", [r[3] for r in rows], "scalar row of the user"),
        integer("row_first", first, "first QP row of node k"),
        real("row_l1", [_penalty(r)[0] for r in p.rows], "l1 penalty of a row of the user; infinite: hard"),
        real("row_l2", [_penalty(r)[1] for r in p.rows], "quadratic penalty of its violation"),
        *([] if fixed else [integer("parameter_offset", offsets, "first element of a parameter in p")]),
        *(table for component in lin.options.components for table in component.tables(p)),
    )


def _penalty(row: Row) -> tuple[float, float]:
    """(l1, l2) of a row; a hard one has an infinite l1."""
    return (math.inf, 0.0) if row.soft is None else row.soft


def _steps(lin: Linearization) -> int:
    return int(getattr(lin.options.integrator, "steps", 1))


def _weight_values(stage: Stage) -> Any:
    return np.diag(stage.weight) if stage.diagonal_weight else stage.weight


def _control_rows(p: Problem) -> list[int]:
    return [next((i for i, r in enumerate(p.rows) if r.kind == "control" and r.index == j), -1) for j in range(p.nu)]


def _default_controls(p: Problem) -> list[float]:
    rows = [p.rows[i] if i >= 0 else None for i in _control_rows(p)]
    return [float(np.clip(0.0, r.lower, r.upper)) if r else 0.0 for r in rows]


def _number(value: float) -> float | str:
    return float(value) if np.isfinite(value) else str(float(value))


def _signal(s: Signal) -> dict[str, Any]:
    return {
        "name": s.name,
        "size": s.size,
        "unit": s.unit,
        "value": list(s.value),
        "offset": s.offset,
        "scalar": s.scalar,
    }


def _row(r: Row) -> dict[str, Any]:
    return {
        "name": r.name,
        "kind": r.kind,
        "index": r.index,
        "index_terminal": r.index_terminal,
        "nodes": list(r.nodes),
        "lower": _number(r.lower),
        "upper": _number(r.upper),
        "soft": r.soft,
    }


def _metadata(
    lin: Linearization, name: str, macros: tuple[Macro, ...], structs: tuple[Struct, ...], products: Products
) -> dict[str, Any]:
    """What Controller and open_package() need besides the C text."""
    p = lin.problem
    return {
        "format": 1,
        "name": name,
        "precision": lin.options.precision,
        "sizes": {m.name: m.value for m in macros},
        "structs": [
            {
                "name": s.name,
                "doc": s.doc,
                "fields": [
                    {
                        "name": f.name,
                        "type": f.ctype,
                        "shape": list(f.values),
                        "padded": list(f.padded),
                        "role": f.role,
                        "doc": f.doc,
                    }
                    for f in s.fields
                ],
                **({"union": True} if s.union else {}),
            }
            for s in structs
        ],
        "states": [_signal(s) for s in p.states],
        "controls": [_signal(s) for s in p.controls],
        "parameters": [_signal(s) for s in p.parameters],
        "rows": [_row(r) for r in p.rows],
        "y_names": list(p.path.y_names),
        "y_names_N": list(p.terminal.y_names),
        "dt": list(p.dt),
        "discrete": p.discrete,
        "statuses": [s.name for s in STATUSES],
        "shift": getattr(lin.options.algorithm, "shift", None),
        "online": lin.options.online.layouts,
        "options": repr(lin.options),
        "report": _report(lin, structs, products),
    }


def _report(lin: Linearization, structs: tuple[Struct, ...], products: Products) -> dict[str, Any]:
    """Memory, exact operation counts, and what was chosen and why."""
    layout = struct_layout(structs, lin.options.precision)
    known = _known(lin, products)
    counts = {r.name: r.count for r in lin.routines} | products.counts
    if lin.options.condensing.columns:
        counts |= products.column_counts
    dims = _dims(lin)
    for component in lin.options.components:
        counts |= component.cost(dims, known)
    return {
        "ram_bytes": layout["solver"][0],
        "ram_bytes_by_struct": {s.name: layout[s.name][0] * int(np.prod(s_shape(s))) for s in structs},
        "operations": {name: count.as_dict() for name, count in counts.items()},
        "linearization_operations": counts["linearize"].total,
        "choices": list(lin.choices),
        "looped": [r.name for r in lin.routines if len(r.kernels) > 1],
    }
