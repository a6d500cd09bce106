"""The preamble of a package's .c: short names for what the header declares, and where run-time data stand.

Inside the one translation unit everything is static, so names need no prefix: NX is CRANE_NX, solver_t is
crane_solver_t. Only names that the unit uses are defined.
"""

from __future__ import annotations

import re

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.print_c import CStyle
from nmpc_codegen.lowering.tolerances import TOLERANCES, tolerance
from nmpc_codegen.runtime.package_description import Kind

#: Functions of math.h that the parts call in the working precision: upper case in the parts.
FUNCTIONS = ("sqrt", "fabs", "ceil")


#: A number in the working precision: R(0.5).
REAL_CONSTANT = ("R", "x", "((real_t)(x))")


def preamble(module: CModule, body: str) -> str:
    """Type definitions and macros that ``body`` uses."""
    used = set(re.findall(r"[A-Za-z_]\w*", body))
    p, P = module.name, module.macro
    types = [*(s.name for s in module.structs), "status"]
    lines = [f"typedef {p}_real real_t;"]
    lines += [f"typedef {p}_{name}_t {name}_t;" for name in types if f"{name}_t" in used]
    macros: list[tuple[str, str]] = [(m.name, f"{P}_{m.name}") for m in module.macros]
    macros += [(name, f"{P}_{name}") for name in ("ALL", *(status.name for status in module.statuses))]
    macros += arithmetic(module.precision)
    lines += [f"#define {name} {value}" for name, value in macros if name in used]
    parametric = [("API", "name", f"{p}_##name"), REAL_CONSTANT, *accessors(module)]
    lines += [f"#define {name}({arguments}) {text}" for name, arguments, text in parametric if name in used]
    return "\n".join(lines)


def conditions(module: CModule) -> str:
    """Macros that the `#if`s of unresolved parts need besides the preamble: the switches."""
    return "\n".join(f"#define {name} {value}" for name, value in module.switches.items())


def arithmetic(precision: str) -> list[tuple[str, str]]:
    """(macro, text): functions of math.h and tolerances in the working precision."""
    style = CStyle("real_t", precision == "single")
    functions = [(name.upper(), style.function(name)) for name in FUNCTIONS]
    return functions + [(f"TOL_{name.upper()}", style.literal(tolerance(name, precision))) for name in TOLERANCES]


def accessors(module: CModule) -> list[tuple[str, str, str]]:
    """(macro, arguments, text): where references, weights, parameters and bounds of a node stand.

    Data that may change are members of the solver ``s``, once, once per node, or once and for the terminal node;
    fixed data are tables.
    """
    layouts = module.layouts

    def member(option: Kind, text: str, table: str) -> str:
        return table if layouts[option] == "fixed" else f"({text})"

    def at(option: Kind, k: str, shared: str = "0") -> str:
        return k if layouts[option] == "node" else shared

    def bound(which: str, index: str) -> str:
        return f"{member('bounds', f'(s)->{which}[{index}]', f'default_{which}')}[row]"

    weight = f"(s)->W[{at('weight', 'k')}]"
    path_weight = weight if module.diagonal_weight else f"&{weight}[0][0]"
    every = at("bounds", "k", "(k) == N")
    return [
        ("YREF", "s, k", member("reference", f"(s)->yref[{at('reference', 'k')}]", "default_reference")),
        ("YREF_N", "s", member("reference", "(s)->yref_N", "default_terminal_reference")),
        ("WEIGHT", "s, k", member("weight", path_weight, "default_weight")),
        (
            "WEIGHT_N",
            "s",
            member("weight", "(s)->W_N" if module.diagonal_weight_N else "&(s)->W_N[0][0]", "default_terminal_weight"),
        ),
        ("PARAM", "s, k", member("parameter", f"(s)->p[{at('parameter', 'k')}]", "default_parameter")),
        ("PARAM_N", "s", member("parameter", f"(s)->p[{at('parameter', 'N', '1')}]", "default_parameter")),
        ("PATH_LOWER", "s, k, row", bound("lower", at("bounds", "k"))),
        ("PATH_UPPER", "s, k, row", bound("upper", at("bounds", "k"))),
        ("ROW_LOWER", "s, k, row", bound("lower", every)),
        ("ROW_UPPER", "s, k, row", bound("upper", every)),
    ]
