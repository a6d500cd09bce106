"""Model -> CModule: all sizes and all C names. Loops over components and never asks which one it holds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from nmpc_codegen.components.base import Counts, Dims
from nmpc_codegen.frontend.problem import Array, Problem, Row, Stage, c_identifier
from nmpc_codegen.ir.cmodule import (
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
from nmpc_codegen.ir.stage_products import PANEL
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.lowering.dimensions import dimensions
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.runtime.package_description import Kind, Layout, PackageDescription, Report
from nmpc_codegen.runtime.status import Status

# Counters stop here, and integrate() takes at most so many steps.
MANY = 1_000_000
# A solver struct that init() has seen.
MAGIC = 0x4E4D5043


def lower(model: Model, name: str | None = None) -> CModule:
    """Decide every size and name of the package ``name`` (default: the problem's)."""
    problem = model.problem
    name = problem.name if name is None else name
    check_prefix(name)
    dims = _dims(model)
    switches = _switches(model)
    structs = _structs(model, dims, switches)
    layout = struct_layout(structs, model.precision)
    held = {f.ctype for s in structs if s.name != "solver" for f in s.fields}
    sections = tuple(
        Section(
            f"{c.seam}: {c.name}",
            c.template,
            _section_count(c.cost(dims, model)),
            sum(
                layout[s.name][0] * int(np.prod(s_shape(s)))
                for s in c.structs(dims)
                if s.name in layout and s.name != "solver" and s.name not in held
            ),
        )
        for c in model.parts.components
    )
    macros = _macros(model, dims)
    return CModule(
        description=_description(model, name, macros, structs),
        macros=macros,
        enums=_enums(problem),
        tables=_tables(model),
        settings=_settings(model, dims),
        setters=_setters(model),
        routines=_printed(model),
        products=model.products,
        switches=switches,
        sections=sections,
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
        foreign={
            path: text
            for c in model.parts.components
            for path, text in c.foreign_sources(name, model.precision, dims).items()
        },
    )


#: Kernels that a package may lack; where there is none HAS_<NAME> is 0.
KERNELS = (
    *(
        f"{stage}_{part}"
        for stage in ("path", "terminal")
        for part in ("cost", "gradient", "hessian", "rows", "curvature")
    ),
    "initial_hessian",
    "coupled_rows",
)


def _printed(model: Model) -> tuple[Routine, ...]:
    """The routines that compute anything: a problem without terminal cost has no terminal_cost()."""
    return tuple(r for r in model.routines if r.writes)


def _switches(model: Model) -> dict[str, int]:
    """What `#if` in the parts may test besides the sizes: features of the problem and of the options, 1 or 0."""
    p, layouts = model.problem, model.online.layouts
    kinds = {kind for _, kind, _, _ in p.qp_rows}
    computing = {r.name for r in model.routines if r.writes}
    residuals = p.path.ny + p.terminal.ny
    data: dict[Kind, int] = {"reference": residuals, "weight": residuals, "parameter": p.np, "bounds": len(p.rows)}
    switches = {f"HAS_{name.upper()}": int(name in computing) for name in KERNELS}
    switches |= {f"SET_{kind.upper()}": int(layouts[kind] != "fixed" and size > 0) for kind, size in data.items()}
    switches |= {
        "SOLVE": int(model.solve),
        "STATE_STEP": int(model.solve or model.parts.condensing.eliminates),
        "STATE_ROWS": int(0 in kinds),
        "GENERAL_ROWS": int(1 in kinds),
        "HARD_ROWS": int(any(p.rows[row].soft is None for _, _, _, row in p.qp_rows)),
        "CONTROL_BOUNDS": int(any(row.kind == "control" for row in p.rows)),
        "ACCUMULATORS": int(bool(p.accumulators)),
        "ALL_MEASURED": int(not p.accumulators and not p.free_initial),
        "TERMINAL_CURVATURE": int(bool(model.products.Q_N)),
    }
    for component in model.parts.components:
        switches |= component.switches
    relaxable = switches["HARD_ROWS"] and (switches["SOLVE"] or switches.get("RELAX", 0))
    return {**switches, "RELAXATION": int(bool(relaxable))}


def s_shape(struct: Struct) -> tuple[int, ...]:
    """Padded shape of the member that holds a struct."""
    return tuple(max(1, s.value) for s in struct.shape)


def _section_count(counts: Counts) -> OpCount | None:
    return sum(counts.values(), OpCount()) if counts else None


def _dims(model: Model) -> Dims:
    return dimensions(model.problem, model.parts.condensing.qp_shape(model.problem), model.constant_hessian)


def _macros(model: Model, dims: Dims) -> tuple[Macro, ...]:
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
    macros.append(Macro("SOFT_ROWS", sum(r.soft is not None for r in model.problem.rows), "rows with a penalty"))
    macros.append(Macro("PARAMS", len(model.problem.parameters), "parameters by name"))
    macros += [Macro(f"SIZE_{s.name.upper()}", s.size, f"numbers of {s.name}") for s in model.problem.parameters]
    for component in model.parts.components:
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


#: Components whose parts still read members of size 0.
_PADDED = ("full", "none", "partial", "dense_active_set", "osqp")


def _existing(struct: Struct, switches: Mapping[str, int]) -> Struct:
    """The struct without members that the package lacks: those of size 0, and of features that are switched off."""
    fields = (f for f in struct.fields if all(f.values) and switches.get(f.only, 1))
    return replace(struct, fields=tuple(fields))


def _structs(model: Model, dims: Dims, switches: Mapping[str, int]) -> tuple[Struct, ...]:
    nodes = Size("N + 1", dims.N.value + 1)
    common = [
        Field("x", (nodes, dims.nx), "states of the plan", "iterate"),
        Field("u", (dims.N, dims.nu), "controls of the plan", "iterate"),
        *(setting.field for setting in _settings(model, dims)),
    ]
    results = [
        Field("stats", (), "counters", "result", "stats"),
        Field("kkt", (), "KKT residuals of the last solve", "result", "kkt", only="SOLVE"),
        Field(
            "relaxation",
            (),
            "l1 penalty of hard rows while a QP is relaxed, else infinite",
            "scratch",
            only="RELAXATION",
        ),
        Field("status", (), "status of the last prepare, feedback or solve", "result", "int32"),
        Field("magic", (), "set by init", "keep", "int32"),
    ]
    owned = [
        s if c.name in _PADDED else _existing(s, switches)
        for c in model.parts.components
        for s in c.structs(dims)
        if switches.get(s.only, 1)
    ]
    owned = [s for s in owned if s.fields]
    own_members = [f for s in owned if s.name == "solver" for f in s.fields]
    inner = _inner_structs(owned)
    held = {f.ctype for s in inner for f in s.fields}
    members = [Field(s.name, s.shape, s.doc, "data", s.name) for s in inner if s.name not in held]
    # Vectors before scalars: where their sizes allow it they keep the alignment of the whole.
    vectors = [f for f in own_members if f.shape]
    scalars = [f for f in own_members if not f.shape]
    fields = (*common, *vectors, *members, *scalars, *results)
    solver = Struct("solver", "the whole controller: no pointers, copy it with '='", fields)
    return (*_result_structs(), *inner, _existing(solver, switches))


def _inner_structs(owned: list[Struct]) -> list[Struct]:
    """The structs that the solver holds, every one after those that are its members; unions of one name are one."""
    stated = {s.name: s for s in owned if s.name != "solver"}
    for name in (s.name for s in owned if s.union):
        alternatives = [f for s in owned if s.name == name for f in s.fields]
        stated[name] = replace(stated[name], fields=tuple(alternatives))
    order: dict[str, Struct] = {}

    def place(struct: Struct) -> None:
        for member in struct.fields:
            if member.ctype in stated:
                place(stated[member.ctype])
        order.setdefault(struct.name, struct)

    for struct in stated.values():
        place(struct)
    return list(order.values())


def _settings(model: Model, dims: Dims) -> tuple[Setting, ...]:
    """Members that hold what can be changed at run time; fixed data have none."""
    p, layouts = model.problem, model.online.layouts
    weight = (dims.ny,) if p.path.diagonal_weight else (dims.ny, dims.ny)
    weight_N = (dims.ny_N,) if p.terminal.diagonal_weight else (dims.ny_N, dims.ny_N)
    one = Size("1", 1)
    path: Mapping[Layout, Size] = {"shared": one, "node": dims.N}
    every: Mapping[Layout, Size] = {"shared": Size("2", 2), "node": Size("N + 1", dims.N.value + 1)}
    which = {"shared": "path, terminal", "node": "every node"}

    def setting(
        option: Kind, name: str, table: str, shape: tuple[Size, ...], copies: Mapping[Layout, Size] | None, doc: str
    ) -> list[Setting]:
        entries = {"W": dims.nw, "W_N": dims.nw_N}.get(name, shape[0])
        layout = layouts[option]
        if layout == "fixed" or not entries.value:
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
_NODES: Mapping[Kind, Mapping[Layout, str]] = {
    "reference": {"shared": "no node", "node": "0 .. N - 1"},
    "weight": {"shared": "no node", "node": "0 .. N - 1"},
    "parameter": {"shared": "N", "node": "0 .. N"},
    "bounds": {"shared": "N, if the row holds there", "node": "a node of the row"},
}


def _setters(model: Model) -> tuple[Setter, ...]:
    """The setters of data that there are and that may change."""
    layouts, switches = model.online.layouts, _switches(model)
    return tuple(Setter(n, nodes[layouts[n]]) for n, nodes in _NODES.items() if switches[f"SET_{n.upper()}"])


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


def _tables(model: Model) -> tuple[Table, ...]:
    p = model.problem
    rows = p.qp_rows

    def real(name: str, values: ArrayLike, doc: str) -> Table:
        return Table(name, "real", tuple(float(v) for v in np.ravel(values)), doc)

    def integer(name: str, values: Iterable[int], doc: str) -> Table:
        return Table(name, "int", tuple(int(v) for v in values), doc)

    longest_step = model.parts.integrator.longest_step(p)
    first = np.searchsorted([r[0] for r in rows], range(p.N + 2))
    offsets = [s.offset for s in p.parameters] + [p.np]
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
        integer("parameter_offset", offsets, "first element of a parameter in p"),
        *(table for component in model.parts.components for table in component.tables(p)),
    )


def _penalty(row: Row) -> tuple[float, float]:
    """(l1, l2) of a row; a hard one has an infinite l1."""
    return (math.inf, 0.0) if row.soft is None else row.soft


def _weight_values(stage: Stage) -> Array:
    return np.diag(stage.weight) if stage.diagonal_weight else stage.weight


def _control_rows(p: Problem) -> list[int]:
    return [next((i for i, r in enumerate(p.rows) if r.kind == "control" and r.index == j), -1) for j in range(p.nu)]


def _default_controls(p: Problem) -> list[float]:
    rows = [p.rows[i] if i >= 0 else None for i in _control_rows(p)]
    return [float(np.clip(0.0, r.lower, r.upper)) if r else 0.0 for r in rows]


def _description(model: Model, name: str, macros: tuple[Macro, ...], structs: tuple[Struct, ...]) -> PackageDescription:
    """What Controller and open_package() need besides the C text."""
    p = model.problem
    return PackageDescription(
        name=name,
        precision=model.precision,
        sizes={m.name: m.value for m in macros},
        structs=structs,
        states=p.states,
        controls=p.controls,
        parameters=p.parameters,
        rows=p.rows,
        y_names=p.path.y_names,
        y_names_N=p.terminal.y_names,
        dt=p.dt,
        discrete=p.discrete,
        statuses=tuple(Status.__members__),
        shift=model.parts.algorithm.shift,
        online=model.online.layouts,
        options=repr(model.options),
        report=_report(model, structs),
    )


def _report(model: Model, structs: tuple[Struct, ...]) -> Report:
    """Memory, exact operation counts, and what was chosen and why."""
    layout = struct_layout(structs, model.precision)
    counts = {r.name: r.count for r in _printed(model)} | dict(model.products.counts)
    if model.parts.condensing.columns:
        counts |= model.products.column_counts
    if not _switches(model)["STATE_STEP"]:
        del counts["state_step"]
    dims = _dims(model)
    for component in model.parts.components:
        counts |= component.cost(dims, model)
    return Report(
        ram_bytes=layout["solver"][0],
        ram_bytes_by_struct={s.name: layout[s.name][0] * int(np.prod(s_shape(s))) for s in structs},
        operations=counts,
        linearization_operations=counts["linearize"].total,
        choices=model.choices,
        looped=tuple(r.name for r in _printed(model) if len(r.kernels) > 1),
    )
