"""DerivativeModel -> path -> text of the folder of C that export() writes."""

from __future__ import annotations

import re
from textwrap import wrap
from typing import Any

from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.layout import Function, Member, functions, macros, size_of, structs
from nmpc_codegen.derivatives.model import DerivativeModel
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.printing.c_style import unit_style
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.lowering.parts import names_in, read_part, rename, renamed_words
from nmpc_codegen.lowering.preamble import (
    REAL_CONSTANT,
    WIDTH,
    Definition,
    arithmetic,
    definitions,
    preamble,
)
from nmpc_codegen.lowering.render import GCC_12, block_comment, context, environment, table_values, tidy
from nmpc_codegen.package.status import Status

FOLDER = "derivatives"

#: Parts of the unit in the order of its text; the last one only with outputs.
PARTS = ("finite.c", "simulate.c", "linearize.c", "gradient.c", "alternative.c", "impulse_response.c")

#: Structs and enumerations with short names in the unit.
TYPES = ("data", "trajectory", "nodes", "linearization", "response", "status")

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
    "terminal_cost": ("d", "x"),
    "terminal_gradient": ("d", "x"),
}
PLACES = {"p": "(d)->p[k]", "dt": "&interval_length[k]", "yref": "(d)->yref[k]", "W": "(d)->W"}
TERMINAL_PLACES = {"p": "(d)->p[N]", "yref": "(d)->yref_N", "W": "(d)->W_N"}


def render(model: DerivativeModel, name: str) -> dict[str, str]:
    """All files of the package ``name``."""
    style = unit_style(model.precision)
    names = _names(model, name)
    header = tidy(environment().get_template(f"{FOLDER}/header.h.jinja").render(names))
    body = environment().get_template(f"{FOLDER}/body.c.jinja").render(names).strip("\n")
    known, words = _definitions(model, name), names_in(body)
    used = definitions(known, words)[1]
    printed = {"tables": [t for t in _tables(model) if t.name in used], "values": lambda t: table_values(t, style)}
    tables = environment().get_template("package/tables.c.jinja").render(names | printed).strip("\n")
    members = {member.name for struct in structs(model) for member in struct.members}
    renamed = renamed_words(used | names_in(tables), header, name, members)
    names |= {
        "body": rename(body, renamed),
        "preamble": preamble(name, TYPES, known, words, renamed),
        "tables": rename(tables, renamed),
        "system_headers": ["math.h", *(["stddef.h"] if "ptrdiff_t" in body else [])],
    }
    files = {
        f"{name}.c": f"{FOLDER}/unit.c.jinja",
        "main.c": f"{FOLDER}/main.c.jinja",
        "CMakeLists.txt": "package/CMakeLists.txt.jinja",
        "README.md": f"{FOLDER}/README.md.jinja",
    }
    sources = {f"{name}.h": header}
    return sources | {path: tidy(environment().get_template(t).render(names)) for path, t in files.items()}


def _names(model: DerivativeModel, name: str) -> dict[str, Any]:
    problem, style = model.problem, unit_style(model.precision)
    sizes = {"NOUT": model.outputs}
    every = structs(model)
    declared = [
        {
            "name": s.name,
            "doc": s.doc,
            "bytes": size_of(s, every, model.precision),
            "members": [{"declaration": _member(m, name), "doc": m.doc} for m in s.members],
        }
        for s in every
    ]
    return context(name, style) | {
        "precision": model.precision,
        "gcc12": GCC_12,
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
        "structs": declared,
        "members": every[0].members,
        "functions": functions(model),
        "operations": Counts(model).all,
        "routines": model.routines,
        "print_routine": lambda routine: print_routine(routine, style),
        "parts": [_part(part, sizes) for part in PARTS[: len(PARTS) if model.outputs else -1]],
        "comment": block_comment,
        "prototype": lambda function: _prototype(function, name),
        "nout": model.outputs,
    }


def _part(path: str, sizes: dict[str, int]) -> str:
    def generated(inner: str) -> str:
        raise ValueError(f"{inner}: the parts of this package include no generated text")

    return read_part(f"{FOLDER}/{path}", generated, sizes).rstrip("\n")


def _member(member: Member, name: str) -> str:
    """Declaration of a struct member."""
    ctype = f"{name}_{member.struct}_t" if member.struct else f"{name}_real"
    return f"{ctype} {member.name}{''.join(f'[{_prefixed(m, name)}]' for m in member.macros)};"


def _prefixed(text: str, name: str) -> str:
    """The macros of a text with the prefix of the package."""
    return re.sub(r"\b(N\w*)", rf"{name.upper()}_\1", text)


def _prototype(function: Function, name: str) -> str:
    """Declaration of an entry point in the header."""
    public = (argument.replace("real_t", "real") for argument in function.arguments)
    typed = (re.sub(r"\b(\w+_t|real)\b", rf"{name}_\1", argument) for argument in public)
    arguments = ", ".join(_prefixed(argument, name) if "[" in argument else argument for argument in typed)
    head = f"{name}_status_t {name}_{function.name}("
    one_line = f"{head}{arguments});"
    if len(one_line) <= WIDTH:
        return one_line
    glued = re.sub(r"(?<!,) ", "\0", arguments)
    lines = wrap(f"{glued});", WIDTH, initial_indent="    ", subsequent_indent="    ", break_long_words=False)
    return "\n".join([head, *lines]).replace("\0", " ")


def _definitions(model: DerivativeModel, name: str) -> list[Definition]:
    """Every macro that the unit may use."""
    constants = [(macro, f"{name.upper()}_{macro}") for macro, _, _ in macros(model)[1:]]
    constants.insert(0, ("N", "NMPC_CODEGEN_UNIT"))
    constants += [(status.name, f"{name.upper()}_{status.name}") for status in STATUSES]
    constants += arithmetic(model.precision)
    parametric: list[Definition] = [("API", "name", f"{name}_##name"), REAL_CONSTANT]
    return [*((macro, None, text) for macro, text in constants), *parametric, *map(_kernel_call, model.routines)]


def _kernel_call(routine: Routine) -> Definition:
    """(macro, arguments, text): call of a lifted function with what it reads or writes; the rest is only evaluated."""
    terminal = routine.name.startswith("terminal_")
    leading = LEADING.get(routine.name, ("d", "k", "x", "u"))
    places = PLACES | (TERMINAL_PLACES if terminal else {})
    passed = [places.get(p.name, p.name) for p in routine.reads] + [p.name for p in routine.writes]
    call = f"{routine.name}({', '.join(passed)})"
    outputs = [p.name for p in routine.outputs]
    used = names_in(*passed)
    unread = [f"(void)({a})" for a in (*leading, *outputs) if a not in used]
    text = f"({', '.join([*unread, call])})"
    return routine.name.upper(), ", ".join([*leading, *outputs]), text


def _tables(model: DerivativeModel) -> list[Table]:
    """Interval lengths and declared values."""
    problem = model.problem
    path, terminal = problem.path, problem.terminal

    def table(name: str, values: Any, doc: str) -> Table:
        return Table(name, "real", tuple(float(v) for v in values), doc)

    def weight(stage: Any) -> Any:
        return stage.weight.diagonal() if stage.diagonal_weight else stage.weight.reshape(-1)

    found = [
        table("interval_length", problem.dt, "lengths of the intervals"),
        table("default_x0", problem.x_initial, "declared initial state"),
        table("default_p", problem.p_value, "declared parameters"),
        table("default_yref", path.reference, "declared references"),
        table("default_W", weight(path), "declared weight"),
        table("default_yref_N", terminal.reference, "declared terminal references"),
        table("default_W_N", weight(terminal), "declared terminal weight"),
    ]
    return [t for t in found if t.values]
