"""CModule -> Sources: the only importer of jinja2. Byte-deterministic: no dates, no paths, numbers by repr."""

from __future__ import annotations

import json
import math
from functools import cache
from typing import Any

import jinja2

from nmpc_codegen.ir.cmodule import CModule, Field, Table
from nmpc_codegen.ir.print_c import CStyle
from nmpc_codegen.ir.sweep import print_routine
from nmpc_codegen.lowering.parts import read_part, resolve, template_directory
from nmpc_codegen.lowering.preamble import preamble

# path -> text of one package
Sources = dict[str, str]


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
    """Names every template may use: prefixes, type of the header, and spelling of literals in the unit."""
    style = unit_style(precision)
    return {"p": prefix, "P": prefix.upper(), "real": f"{prefix}_real", "lit": style.literal}


def unit_style(precision: str) -> CStyle:
    """How numbers and functions are spelled inside the translation unit."""
    return CStyle("real_t", precision == "single")


def render(module: CModule) -> Sources:
    """All files of the package."""
    names = _names(module)
    body = render_unit(module, names)
    names |= {"body": body, "preamble": preamble(module, body)}
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


def _names(module: CModule) -> dict[str, Any]:
    style = unit_style(module.precision)
    return context(module.name, module.precision) | {
        "m": module,
        "member": lambda field: _member(field, module),
        "dim": lambda macro: _dim(macro, module),
        "values": lambda table: _values(table, style),
        "print_routine": lambda routine: print_routine(routine, style),
        "copies": lambda option: _copies(module.layouts[option], option in ("reference", "weight")),
        "initial": ", ".join(style.literal(v) for s in module.metadata["states"] for v in s["value"]),
        "dt": style.literal(module.metadata["dt"][0]),
    }


def render_unit(module: CModule, names: dict[str, Any]) -> str:
    """The translation unit after its preamble: tables, printed kernels, parts."""
    sizes = {**{m.name: m.value for m in module.macros}, **module.switches, **module.products.column_switches}

    def generated(path: str) -> str:
        return environment().get_template(_GENERATED[path].format(spelling=module.products.spelling)).render(names)

    def part(path: str) -> str:
        return resolve(read_part(path, generated), sizes).rstrip("\n")

    return environment().get_template("unit.c.jinja").render(names | {"part": part, "generated": generated})


#: What parts include as a file that is generated for the package -> its template.
_GENERATED = {
    "generated/products.c": "products/{spelling}.c.jinja",
    "generated/product_columns.c": "products/{spelling}_columns.c.jinja",
    "generated/hessian_blocks.c": "products/blocks.c.jinja",
}


def _copies(layout: str, path_only: bool) -> str:
    """Lowest and highest node that has a copy of its own, and how many copies there are."""
    if layout == "node":
        return "0, N - 1, N" if path_only else "0, N, N + 1"
    return "0, -1, 1" if path_only else "N, N, 2"


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
