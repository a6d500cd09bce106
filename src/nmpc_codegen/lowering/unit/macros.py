"""The preamble of a package's .c has short names for the header, access to run-time data, and kernel calls.

Inside the single translation unit everything is static, so names need no prefix: NX is CRANE_NX, solver_t is
crane_solver_t (unless the header declares the short name, see names.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from textwrap import wrap
from types import MappingProxyType

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.printing.c_style import CStyle, unit_style
from nmpc_codegen.ir.printing.struct_sweeps import call
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.lowering.tolerances import FACTORS, ROOT, TOLERANCES, UNIT, origin, tolerance
from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.names import rename
from nmpc_codegen.package.signals import Kind
from nmpc_codegen.package.struct_layout import Struct

#: Functions of math.h that the parts call in the working precision; the parts write them in upper case.
FUNCTIONS = ("sqrt", "fabs", "ceil", "sin", "cos", "exp", "log", "log1p")


#: Maximum length of a line without and with its continuation mark.
WIDTH, LINE = 114, 120

#: A number in the working precision: R(0.5).
REAL_CONSTANT = Item("R", "macro", "((real_t)(x))", "x", apart=False)


def print_macro(item: Item, renamed: Mapping[str, str]) -> str:
    """Return the definition of a macro, or of a short name; ``renamed`` maps inner names to new names."""
    name = renamed.get(item.name, item.name)
    if item.kind == "alias":
        text = f"typedef {item.text} {name};" if name.endswith("_t") else f"#define {name} {item.text}"
    else:
        head = name if item.arguments is None else rename(f"{item.name}({item.arguments})", renamed)
        text = f"#define {head} {rename(item.text, renamed)}"
    text = " \\\n    ".join(wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False))
    beside = f"{text} /* {item.note} */"
    if not item.note:
        return text
    # A space that does not break keeps the end of the comment with its last word.
    above = "\n * ".join(wrap(f"/* {item.note}\xa0*/", LINE - 3, break_long_words=False)).replace("\xa0", " ")
    return beside if len(beside) <= LINE else f"{above}\n{text}"


#: Macro whose value the compiler chooses -> its definition.
CHOSEN: Mapping[str, str] = {
    "BLOCK_WIDTH": """/* Columns of a block of a matrix product: its rows stay in vector registers. */
#if defined(__AVX__)
#define BLOCK_WIDTH 8
#else
#define BLOCK_WIDTH 4
#endif"""
}


def short_names(name: str, structs: Sequence[Struct]) -> tuple[Item, ...]:
    """Return typedefs of the header's types of the package ``name`` without prefix, under a comment."""
    heading = Item("", "heading", "/* Short names inside this translation unit. */")
    types = [f"{struct}_t" for struct in (*(s.name for s in structs), "status")]
    return (heading, alias("real_t", f"{name}_real"), *(alias(short, f"{name}_{short}") for short in types))


def alias(name: str, text: str, note: str = "") -> Item:
    """Return a short name of a declaration in the header."""
    return Item(name, "alias", text, apart=False, note=note)


def macro(name: str, text: str, arguments: str | None = None, note: str = "") -> Item:
    """Return a macro; ``arguments`` holds the names of its arguments, separated by commas."""
    return Item(name, "macro", text, arguments, apart=False, note=note)


def definitions(module: CModule) -> tuple[Item, ...]:
    """Return every type and macro that a unit may use."""
    p, P, features = module.name, module.macro, module.features.macros
    found = list(short_names(p, module.structs))
    for m in module.macros:
        note = m.doc if not m.public or m.shown is not None else ""
        if m.name == "NXHAT":
            found.append(alias(m.name, f"{P}_NX", note))
        elif m.public and m.shown is None:
            found.append(alias(m.name, f"{P}_{m.name}", note))
        else:
            found.append(macro(m.name, "NMPC_CODEGEN_UNIT" if m.name == "MAGIC" else str(m.value), note=note))
    found += [alias(status, f"{P}_{status}") for status in ("ALL", *(status.name for status in module.statuses))]
    spelling = features if module.whole else ("VECTOR_LANES", "PACK_WIDTH")
    found += [macro(name, str(features[name])) for name in spelling]
    found += arithmetic(module.precision, module.features.own_math)
    found += [macro("API", f"{p}_##name", "name"), REAL_CONSTANT, *accessors(module)]
    if module.whole:
        found += [macro(name.upper(), "((void)0)", "...") for name in module.absent_kernels]
    found.append(macro("HESSIAN", f"((s)->hessian.Q[{'0' if module.sizes.get('NQ') == 1 else 'k'}])", "s, k"))
    places = {**PLACES, **module.places} | (MEASURED_START if module.features.start_is_measured else {})
    found += [kernel_call(routine, places, module.places) for routine in module.routines]
    found += [product_call(routine, module.style) for routine in module.called_products]
    return (*found, *(Item(name, "directive", text, apart=False) for name, text in CHOSEN.items()))


def arithmetic(precision: str, own: bool = False) -> list[Item]:
    """Return functions of math.h or their replacements, infinity, tolerances and factors in the working precision."""
    style = unit_style(precision, own)
    found = [macro(name.upper(), style.function(name)) for name in FUNCTIONS]
    found.append(macro("INF", "((real_t)INFINITY)"))
    for name, (_, reason) in sorted(TOLERANCES.items(), key=lambda item: item[0] not in (UNIT, ROOT)):
        text = _text_of_tolerance(name, precision, style)
        power = "" if text.startswith("(") or name == UNIT else f"; 2^{math.log2(tolerance(name, precision)):g}"
        found.append(macro(f"TOL_{name.upper()}", text, note=reason + power))
    for name, (value, reason) in FACTORS.items():
        found.append(macro(f"FACTOR_{name.upper()}", style.literal(value), note=reason))
    return found


def _text_of_tolerance(name: str, precision: str, style: CStyle) -> str:
    """Return a tolerance as a multiple of the machine epsilon or of its root: (32.0 * TOL_UNIT)."""
    unit, factor = origin(name, precision)
    return f"({style.literal(factor)} * TOL_{unit.upper()})" if unit else style.literal(factor)


def accessors(module: CModule) -> list[Item]:
    """Return macros for references, weights, parameters and bounds of a node.

    Data that can be changed are members of the solver ``s``: one copy, one per node, or one for the path and one for
    the terminal node. Fixed data are tables.
    """
    layouts = module.layouts

    def member(option: Kind, text: str, table: str) -> str:
        return table if layouts[option] == "fixed" else f"({text})"

    def at(option: Kind, k: str, shared: str = "0") -> str:
        return k if layouts[option] == "node" else shared

    soft = "penalty" if module.features.takes_penalties else "soft"
    weight = f"(s)->W[{at('weight', 'k')}]"
    path_weight = weight if module.diagonal_weight else f"&{weight}[0][0]"
    found = [
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
        ("PATH_LOWER", "s, k, row", member("bounds", f"(s)->lower[{at('bounds', 'k')}][row]", "default_lower[row]")),
        ("PATH_UPPER", "s, k, row", member("bounds", f"(s)->upper[{at('bounds', 'k')}][row]", "default_upper[row]")),
        ("SOFT_L1", "s, k", member("soft", f"(s)->{soft}_l1[{at('soft', 'k', '(k) == N')}]", "default_soft_l1")),
        ("SOFT_L2", "s, k", member("soft", f"(s)->{soft}_l2[{at('soft', 'k', '(k) == N')}]", "default_soft_l2")),
        ("END_MULTIPLIERS", "s", _last_multipliers(module, "NE", "NH_N")),
        ("COUPLED_MULTIPLIERS", "s", _last_multipliers(module, "NE")),
    ]
    return [macro(name, text, arguments) for name, arguments, text in found]


def _last_multipliers(module: CModule, *sizes: str) -> str:
    """Return the multipliers of the last rows, as many as these sizes say.

    The vector ends with those of the coupled rows, after the general ones of node N.
    """
    return f"((s)->mult + ({' - '.join(['NG', *(size for size in sizes if module.value(size))])}))"


def product_call(routine: LoopedRoutine, style: CStyle) -> Item:
    """Return the call of a product with the stage matrices, with the operands that it reads or writes."""
    names, text = call(routine, style)
    return macro(routine.name.upper(), text, ", ".join(names))


#: C text of the kernel inputs at node k of the solver s; two further tables have those that differ at the terminal node
#: and at the start.
PLACES = {
    "x": "(s)->x[k]",
    "u": "(s)->u[k]",
    "p": "PARAM(s, k)",
    "dt": "&interval_length[k]",
    "yref": "YREF(s, k)",
    "W": "WEIGHT(s, k)",
    "mu": "mu",
    "lam": "(s)->lam[(k) + 1]",
    "x_0": "(s)->x[0]",
    "x_N": "(s)->x[N]",
    "first": "(s)->x[0]",
    "last": "(s)->x[N]",
    "eta": "COUPLED_MULTIPLIERS(s)",
    "block": "&(Q)[0][0]",
    "dx": "dx",
    "du": "du",
    "adj": "adj",
    "d": "d",
    "z": "(s)->z[k]",
    "newton": "(s)->newton",
}
TERMINAL_PLACES = {
    "x": "(s)->x[N]",
    "z": "(s)->z[N]",
    "p": "PARAM_N(s)",
    "yref": "YREF_N(s)",
    "W": "WEIGHT_N(s)",
}
#: Place of x_0 for coupled rows if the algorithm stores the measured state for it.
MEASURED_START = {"x_0": "(s)->xhat", "first": "(s)->xhat"}
START_PLACES = {
    "x": "(s)->x[0]",
    "z": "(s)->z[0]",
    "p": "PARAM(s, 0)",
    "yref": "default_start_reference",
    "W": "default_start_weight",
}


#: Routines whose last result is the remaining correction of Newton's method, which explicit schemes lack.
LEAVING = ("integrator_interval", "path_exact")

#: Inputs that are macro arguments of every kernel that has them.
VECTORS = ("mu", "dx", "du", "adj", "d")


def kernel_call(
    routine: Routine, everywhere: dict[str, str] = PLACES, kept: Mapping[str, str] = MappingProxyType({})
) -> Item:
    """Return the call of a printed kernel, with exactly the operands that it reads or writes.

    ``kept`` maps outputs that a node stores to their places; they are no arguments. The arguments of the macro are
    always the same: the solver, the node of a path kernel, the vectors that it multiplies, the outputs. INTEGRATOR_STEP
    also takes the state, the control, the step length and the number of Newton steps, INTEGRATOR_JUMP the state and the
    control, MEASUREMENT the state and the parameters. Kernels of stages have arguments for all of their ports.
    """
    if routine.name.startswith("stage_"):
        names = [p.name for p in (*routine.inputs, *routine.outputs)]
        used = [p.name for p in (*routine.reads, *routine.writes)]
        return macro(routine.name.upper(), f"{routine.name}({', '.join(used)})", ", ".join(names))
    if routine.name == "integrator_step":
        places = {"x": "x", "u": "u", "p": "PARAM(s, k)", "h": "h", "z": "(s)->z[k]", "newton": "newton"}
        leading = ["s", "k", "x", "u", "h", "newton"]
    elif routine.name == "integrator_jump":
        places = {"x": "x", "u": "u", "p": "PARAM(s, k)", "dt": "&interval_length[k]"}
        leading = ["s", "k", "x", "u"]
    elif routine.name == "measurement":
        places, leading = {"x": "x", "p": "p"}, ["x", "p"]
    elif routine.name.startswith("terminal_"):
        places, leading = {**everywhere, **TERMINAL_PLACES}, ["s"]
    elif routine.name.startswith("start_"):
        own = {name.removeprefix("start_"): text for name, text in kept.items() if name.startswith("start_")}
        places, leading = {**everywhere, **START_PLACES, **own}, ["s"]
    elif routine.name.startswith(("coupled_", "initial_")):
        places, leading = everywhere, ["s"]
    else:
        places, leading = everywhere, ["s", "k"]
    leading += [p.name for p in routine.inputs if p.name in VECTORS]
    passed = [places[p.name] for p in routine.reads] + [kept.get(p.name, p.name) for p in routine.writes]
    outputs = [p.name for p in routine.outputs if p.name not in kept]
    if routine.name in LEAVING and "left" not in outputs:
        outputs.append("left")
    return macro(routine.name.upper(), f"{routine.name}({', '.join(passed)})", ", ".join([*leading, *outputs]))
