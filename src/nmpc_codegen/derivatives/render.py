"""DerivativeModel -> path -> text of the folder of C that export() writes, by the printer of the compiler."""

from __future__ import annotations

from typing import Any

from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.layout import calls_parts, functions, macros, scheme_sizes, settings, structs
from nmpc_codegen.derivatives.model import DerivativeModel
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.printing.c_style import unit_style
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.lowering.data.tables import lookup_tables
from nmpc_codegen.lowering.parts import INTERVALS, print_intervals, read_part
from nmpc_codegen.lowering.preamble import REAL_CONSTANT, Definition, arithmetic, kernel_call
from nmpc_codegen.lowering.pruning.constants import Constants
from nmpc_codegen.lowering.pruning.reach import calling
from nmpc_codegen.lowering.render import (
    GCC_12,
    Unit,
    block_comment,
    context,
    environment,
    member,
    print_functions,
    prototype,
    tidy,
)
from nmpc_codegen.package.features import KERNELS
from nmpc_codegen.package.memory import Field, struct_layout
from nmpc_codegen.package.status import Status

FOLDER = "derivatives"

#: Parts of the unit in the order of its text.
PARTS = ("simulate.c", "linearize.c", "gradient.c", "alternative.c")
OF_OUTPUTS, SECOND_ORDER = "impulse_response.c", "hessians.c"

#: Values that the functions return; they have the same meaning as in controllers.
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
#: Functions whose last result is what Newton's method leaves of the stages.
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
    """All files of the package ``name``."""
    style = unit_style(model.precision)
    names = _names(model, name)
    header = tidy(environment().get_template(f"{FOLDER}/header.h.jinja").render(names))
    known = _definitions(model, name)
    unit = Unit(
        name,
        header,
        environment().get_template(f"{FOLDER}/body.c.jinja").render(names),
        tuple(known),
        print_functions(model.routines, style),
        structs(model),
        _tables(model),
        _constants(model, known),
    )
    names |= unit.texts(style)
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
        "unit": problem.N,
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
        "member": lambda field: member(field, name, macros(model)),
        "numbers": _numbers,
        "settings": settings(model),
        "functions": functions(model),
        "operations": Counts(model).all,
        "parts": [
            *([_intervals(model)] if calls_parts(model) else []),
            *(read_part(f"{FOLDER}/{part}", lambda path: "").rstrip("\n") for part in parts),
        ],
        "comment": block_comment,
        "prototype": lambda function: prototype(function, name),
        "nout": model.outputs,
    }


def _intervals(model: DerivativeModel) -> str:
    """The part of implicit schemes, and the functions of an interval that call it."""
    style = unit_style(model.precision)
    routines, sizes = model.routines, scheme_sizes(model)
    return read_part(INTERVALS, lambda path: print_intervals(routines, style), sizes).rstrip("\n")


def _constants(model: DerivativeModel, known: list[Definition]) -> Constants:
    sizes = {m.name: m.value for m in macros(model)} | {"NOUT": model.outputs} | scheme_sizes(model)
    present = {routine.name for routine in model.routines}
    absent = (name for name in KERNELS if name.startswith("stage_") and name not in present)
    ranges = {t.name: (int(min(t.values)), int(max(t.values))) for t in _tables(model) if t.ctype == "int" and t.values}
    return Constants(sizes, ranges, kernels=frozenset(name.upper() for name in absent), calling=calling(known))


def _numbers(field: Field) -> str:
    """C text of how many numbers a member has."""
    return " * ".join(f"({size.text})" if " " in size.text else size.text for size in field.shape)


def _definitions(model: DerivativeModel, name: str) -> list[Definition]:
    """Every macro that the unit may use."""
    constants = [("N", "NMPC_CODEGEN_UNIT")]
    constants += [(macro.name, f"{name.upper()}_{macro.name}") for macro in macros(model)[1:]]
    constants += [(status.name, f"{name.upper()}_{status.name}") for status in STATUSES]
    constants += arithmetic(model.precision)
    constants += [(size, str(value)) for size, value in scheme_sizes(model).items() if not size.startswith("HAS_")]
    parametric: list[Definition] = [("API", "name", f"{name}_##name"), REAL_CONSTANT]
    return [*((macro, None, text) for macro, text in constants), *parametric, *map(_kernel_call, model.routines)]


def _kernel_call(routine: Routine) -> Definition:
    """(macro, arguments, text): call of a lifted function with what it reads or writes."""
    if routine.name.startswith("stage_"):
        return kernel_call(routine)
    terminal = routine.name.startswith("terminal_")
    places = PLACES | (TERMINAL_PLACES if terminal else {})
    passed = [places.get(p.name, p.name) for p in routine.reads] + [p.name for p in routine.writes]
    outputs = [p.name for p in routine.outputs]
    outputs += ["left"] if routine.name in LEAVING and "left" not in outputs else []
    arguments = (*LEADING.get(routine.name, ("d", "k", "x", "u")), *outputs)
    return routine.name.upper(), ", ".join(arguments), f"{routine.name}({', '.join(passed)})"


def _tables(model: DerivativeModel) -> tuple[Table, ...]:
    """Interval lengths and declared values."""
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
