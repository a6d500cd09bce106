"""A derivative model becomes {path: text} of the C folder that export() writes, by the printer of the compiler."""

from __future__ import annotations

from typing import Any

from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.derivative_model import DerivativeModel
from nmpc_codegen.derivatives.layout import calls_parts, functions, macros, scheme_sizes, settings, structs
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.printing.c_style import unit_style
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.render import GCC_12, block_comment, member, prototype, struct_words, tidy
from nmpc_codegen.lowering.tables import lookup_tables
from nmpc_codegen.lowering.templates import context, environment
from nmpc_codegen.lowering.unit.assemble import INTERVALS, kernel_items, print_intervals, table_items, table_ranges
from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.macros import REAL_CONSTANT, alias, arithmetic, kernel_call, macro, short_names
from nmpc_codegen.lowering.unit.pipeline import run
from nmpc_codegen.lowering.unit.read import items_of, read_part
from nmpc_codegen.lowering.unit.text import library_headers, text_of_unit
from nmpc_codegen.package.features import KERNELS
from nmpc_codegen.package.status import Status
from nmpc_codegen.package.struct_layout import Field, struct_layout

FOLDER = "derivatives"

#: Parts of the unit in the order of its text.
PARTS = ("simulate.c", "linearize.c", "gradient.c", "alternative.c")
OF_OUTPUTS, SECOND_ORDER = "impulse_response.c", "hessians.c"

#: Values that the functions return, with the same meaning as in controllers.
STATUSES = {
    Status.OK: "ok",
    Status.NOT_FINITE: "the data or the results are not finite; the results are undefined",
    Status.BAD_INDEX: "no such node or row; nothing is written",
    Status.BAD_ARGUMENT: "argument out of range; nothing is written",
}

#: Leading arguments of the macro that calls a lifted function, before its outputs.
LEADING: dict[str, tuple[str, ...]] = {
    "integrator_adjoint": ("d", "k", "x", "u", "lam"),
    "integrator_free": ("d", "k", "x", "u", "S"),
    "interval_symmetric": ("d", "k", "x", "u", "lam"),
    "interval_forward_over_adjoint": ("d", "k", "x", "u", "lam"),
    "terminal_cost": ("d", "x"),
    "terminal_gradient": ("d", "x"),
}
#: Functions whose last result is the residual of the stages after Newton's method.
LEAVING = ("integrator_interval", "interval_symmetric", "interval_forward_over_adjoint")
PLACES = {
    "newton": "NEWTON_LIMIT",
    "p": "(d)->p[k]",
    "dt": "&interval_length[k]",
    "yref": "(d)->yref[k]",
    "W": "(d)->W",
}
TERMINAL_PLACES = {"p": "(d)->p[N]", "yref": "(d)->yref_N", "W": "(d)->W_N"}


def render(model: DerivativeModel, name: str) -> dict[str, str]:
    """Return all files of the package ``name``."""
    names = _names(model, name)
    header = tidy(environment().get_template(f"{FOLDER}/header.h.jinja").render(names))
    items = run(_assemble(model, name, names), _constants(model))
    names |= {"unit": text_of_unit(items, header, name, structs(model)), "system_headers": library_headers(items)}
    files = {
        f"{name}.c": f"{FOLDER}/unit.c.jinja",
        "main.c": f"{FOLDER}/main.c.jinja",
        "CMakeLists.txt": "package/CMakeLists.txt.jinja",
        "README.md": f"{FOLDER}/README.md.jinja",
    }
    sources = {f"{name}.h": header}
    return sources | {path: tidy(environment().get_template(t).render(names)) for path, t in files.items()}


def _names(model: DerivativeModel, name: str) -> dict[str, Any]:
    problem, every = model.problem, structs(model)
    parts = (*PARTS, *([OF_OUTPUTS] if model.outputs else []), *([SECOND_ORDER] if model.second_order else []))
    return context(name, unit_style(model.precision)) | {
        "precision": model.precision,
        "gcc12": GCC_12,
        "magic": problem.N,
        "folders": (),
        "libraries": ("m",),
        "contraction": "fast",
        "position_independent": "ON",
        "flags": "",
        "extensions": "OFF",
        "signals": (
            *(("x", problem.state_names), ("u", problem.control_names), ("p", problem.parameter_names)),
            ("z", model.output_names),
        ),
        "macros": macros(model),
        "statuses": STATUSES,
        "structs": every,
        "bytes": {struct: size for struct, (size, _) in struct_layout(every, model.precision).items()},
        "by_purpose": lambda struct: [("", struct.fields)],
        **struct_words(name),
        "member": lambda field: member(field, name, macros(model)),
        "numbers": _numbers,
        "settings": settings(model),
        "functions": functions(model),
        "operations": Counts(model).all,
        "parts": [
            *([_intervals(model)] if calls_parts(model) else []),
            *(read_part(f"{FOLDER}/{part}").rstrip("\n") for part in parts),
        ],
        "comment": block_comment,
        "prototype": lambda function: prototype(function, name),
        "nout": model.outputs,
    }


def _intervals(model: DerivativeModel) -> str:
    """Return the part of implicit schemes, and the functions of an interval that call it."""
    style = unit_style(model.precision)
    routines, sizes = model.routines, scheme_sizes(model)
    return read_part(INTERVALS, lambda path: print_intervals(routines, style), sizes).rstrip("\n")


def _assemble(model: DerivativeModel, name: str, names: dict[str, Any]) -> tuple[Item, ...]:
    """Return the items of the translation unit."""
    style = unit_style(model.precision)
    body = environment().get_template(f"{FOLDER}/body.c.jinja").render(names)
    found = [*_definitions(model, name), *table_items(_tables(model), style), *kernel_items(model.routines, style)]
    return (*found, *items_of(body))


def _constants(model: DerivativeModel) -> Constants:
    sizes = {m.name: m.value for m in macros(model)} | {"NOUT": model.outputs} | scheme_sizes(model)
    present = {routine.name for routine in model.routines}
    absent = (name for name in KERNELS if name.startswith("stage_") and name not in present)
    return Constants(sizes, table_ranges(_tables(model)), kernels=frozenset(name.upper() for name in absent))


def _numbers(field: Field) -> str:
    """Return the C text of the number of entries of a member."""
    return " * ".join(f"({size.text})" if " " in size.text else size.text for size in field.shape)


def _definitions(model: DerivativeModel, name: str) -> list[Item]:
    """Return every type and macro that the unit may use."""
    found = [*short_names(name, structs(model)), macro("N", "NMPC_CODEGEN_UNIT")]
    found += [alias(size.name, f"{name.upper()}_{size.name}") for size in macros(model)[1:]]
    found += [alias(status.name, f"{name.upper()}_{status.name}") for status in STATUSES]
    found += arithmetic(model.precision)
    found += [macro(size, str(value)) for size, value in scheme_sizes(model).items() if not size.startswith("HAS_")]
    return [*found, macro("API", f"{name}_##name", "name"), REAL_CONSTANT, *map(_kernel_call, model.routines)]


def _kernel_call(routine: Routine) -> Item:
    """Return the call of a lifted function with its inputs and outputs."""
    if routine.name.startswith("stage_"):
        return kernel_call(routine)
    terminal = routine.name.startswith("terminal_")
    places = PLACES | (TERMINAL_PLACES if terminal else {})
    passed = [places.get(p.name, p.name) for p in routine.reads] + [p.name for p in routine.writes]
    outputs = [p.name for p in routine.outputs]
    outputs += ["left"] if routine.name in LEAVING and "left" not in outputs else []
    arguments = (*LEADING.get(routine.name, ("d", "k", "x", "u")), *outputs)
    return macro(routine.name.upper(), f"{routine.name}({', '.join(passed)})", ", ".join(arguments))


def _tables(model: DerivativeModel) -> tuple[Table, ...]:
    """Return the tables of interval lengths and declared values."""
    problem = model.problem
    path, terminal = problem.path, problem.terminal

    def table(name: str, values: Any, doc: str) -> Table:
        return Table(name, "real", tuple(float(v) for v in values), doc)

    def weight(stage: Any) -> Any:
        return stage.weight.diagonal() if stage.diagonal_weight else stage.weight.reshape(-1)

    found = (
        table("interval_length", problem.dt, "lengths of the intervals"),
        table("default_x0", problem.x_initial, "declared initial state"),
        table("default_p", problem.p_value, "declared parameters"),
        table("default_yref", path.reference, "declared references"),
        table("default_W", weight(path), "declared weight"),
        table("default_yref_N", terminal.reference, "declared terminal references"),
        table("default_W_N", weight(terminal), "declared terminal weight"),
        *lookup_tables(model.routines),
        *(model.integrator.tables(problem) if calls_parts(model) else ()),
    )
    return tuple(t for t in found if t.values)
