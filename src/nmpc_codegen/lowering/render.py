"""CModule -> Sources: the only importer of jinja2. Byte-deterministic: no dates, no paths, numbers by repr."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import jinja2

from nmpc_codegen.ir.cmodule import CModule, Field, Table
from nmpc_codegen.ir.print_c import CStyle
from nmpc_codegen.ir.sweep import print_routine
from nmpc_codegen.lowering.tolerances import tolerance

# path -> text of one package
Sources = dict[str, str]


def template_directory() -> Path:
    """Templates inside the installed package, or at the top of a source checkout."""
    here = Path(__file__).resolve()
    packaged = here.parents[1] / "templates"
    return packaged if packaged.is_dir() else here.parents[3] / "templates"


@cache
def environment() -> jinja2.Environment:
    """StrictUndefined: a name that a template misspells is an error."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(template_directory()),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )


def context(prefix: str, precision: str) -> dict[str, Any]:
    """Names every template may use: prefixes, type, and spelling of literals, functions and tolerances."""
    style = CStyle(f"{prefix}_real", precision == "single")
    return {
        "p": prefix,
        "P": prefix.upper(),
        "real": style.real,
        "lit": style.literal,
        "fn": style.function,
        "tol": lambda name: style.literal(tolerance(name, precision)),
    }


def render(module: CModule) -> Sources:
    """All files of the package."""
    names = context(module.name, module.precision)
    style = CStyle(names["real"], module.precision == "single")
    names |= {
        "m": module,
        "member": lambda field: _member(field, module),
        "dim": lambda macro: _dim(macro, module),
        "values": lambda table: _values(table, style),
        "print_routine": lambda routine: print_routine(routine, style),
        **_data(module),
        "initial": ", ".join(style.literal(v) for s in module.metadata["states"] for v in s["value"]),
        "dt": style.literal(module.metadata["dt"][0]),
    }
    files = {
        f"{module.name}.h": "solver.h.jinja",
        f"{module.name}.c": "solver.c.jinja",
        "main.c": "main.c.jinja",
        "CMakeLists.txt": "CMakeLists.txt.jinja",
        "README.md": "README.md.jinja",
    }
    sources = {path: _tidy(environment().get_template(t).render(names)) for path, t in files.items()}
    sources[f"{module.name}.json"] = json.dumps(module.metadata, indent=1, allow_nan=False) + "\n"
    return sources


def _data(module: CModule) -> dict[str, Any]:
    """Where the templates find the data that may change at run time; fixed ones in their tables.

    yref(k), weight(k), param(k) at the path node k, yref_N, weight_N, param_N at the terminal one: pointers.
    path_bound("lower", k, row) at a path node, row_bound("lower", k, row) at any: numbers. k and row are C texts.
    copies("weight"): lowest and highest node that has a copy of its own, and how many copies there are.
    """
    layouts, N = module.layouts, f"{module.macro}_N"
    matrix = "" if module.diagonal_weight else "[0]"

    def member(option: str, text: str, table: str) -> str:
        return table if layouts[option] == "fixed" else text

    def at(option: str, k: str, shared: str = "0") -> str:
        return k if layouts[option] == "node" else shared

    def weight(k: str) -> str:
        text = f"s->W[{at('weight', k)}]{matrix}"
        return member("weight", f"&{text}[0]" if matrix else text, "default_weight")

    def bound(which: str, index: str, row: str) -> str:
        return f"{member('bounds', f's->{which}[{index}]', f'default_{which}')}[{row}]"

    return {
        "yref": lambda k: member("reference", f"s->yref[{at('reference', k)}]", "default_reference"),
        "yref_N": member("reference", "s->yref_N", "default_terminal_reference"),
        "weight": weight,
        "weight_N": member(
            "weight", "s->W_N" if module.diagonal_weight_N else "&s->W_N[0][0]", "default_terminal_weight"
        ),
        "param": lambda k: member("parameter", f"s->p[{at('parameter', k)}]", "default_parameter"),
        "param_N": member("parameter", f"s->p[{at('parameter', N, '1')}]", "default_parameter"),
        "path_bound": lambda which, k, row: bound(which, at("bounds", k), row),
        "row_bound": lambda which, k, row: bound(which, at("bounds", k, f"{k} == {N}"), row),
        "copies": lambda option: _copies(layouts[option], option in ("reference", "weight"), N),
    }


def _copies(layout: str, path_only: bool, N: str) -> str:
    if layout == "node":
        return f"0, {N} - 1, {N}" if path_only else f"0, {N}, {N} + 1"
    return "0, -1, 1" if path_only else f"{N}, {N}, 2"


def _member(field: Field, module: CModule) -> str:
    """Declaration of a struct member; sizes of 0 are padded to 1."""
    ctype = {"real": f"{module.name}_real", "int32": "int32_t"}.get(field.ctype, f"{module.name}_{field.ctype}_t")
    sizes = "".join(f"[{s.c(module.macro) if s.value else 1}]" for s in field.shape)
    return f"{ctype} {field.name}{sizes};"


def _dim(macro: str, module: CModule) -> str:
    return f"{module.macro}_{macro}" if module.value(macro) else "1"


def _values(table: Table, style: CStyle) -> str:
    if not table.values:
        return "0" if table.ctype == "int" else style.literal(0.0)
    return ", ".join(_value(v, style) if table.ctype == "real" else str(v) for v in table.values)


def _value(value: float, style: CStyle) -> str:
    if math.isinf(value):
        return f"{'-' if value < 0 else ''}({style.real})INFINITY"
    return style.literal(value)


def _tidy(text: str) -> str:
    """No trailing blanks, no runs of empty lines, one newline at the end."""
    lines: list[str] = []
    for line in (raw.rstrip() for raw in text.splitlines()):
        if line or (lines and lines[-1]):
            lines.append(line)
    return "\n".join(lines).strip("\n") + "\n"
