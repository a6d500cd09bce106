"""The preamble of a package's .c: short names for declarations of the header, access to run-time data, kernel calls.

Inside the one translation unit everything is static, so names need no prefix: NX is CRANE_NX, solver_t is
crane_solver_t (parts.py: unless the header declares the short name). Only names that the unit uses are defined.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from textwrap import wrap
from types import MappingProxyType

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.printing.c_style import CStyle, unit_style
from nmpc_codegen.ir.printing.products import call
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.lowering.parts import names_in, rename
from nmpc_codegen.lowering.pruning.reach import Definition as Definition
from nmpc_codegen.lowering.tolerances import FACTORS, TOLERANCES, tolerance
from nmpc_codegen.package.signals import Kind

#: Functions of math.h that the parts call in the working precision: upper case in the parts.
FUNCTIONS = ("sqrt", "fabs", "ceil", "sin", "cos", "exp", "log", "log1p")


#: Maximum length of a line without its continuation mark, and with it.
WIDTH, LINE = 114, 120

#: A number in the working precision: R(0.5).
REAL_CONSTANT = ("R", "x", "((real_t)(x))")


def preamble(
    name: str,
    types: Sequence[str],
    known: Sequence[Definition],
    body: Collection[str],
    renamed: Mapping[str, str],
    docs: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Short names of those types of the package ``name``, and those macros of ``known``, that a text with the
    identifiers ``body`` uses; ``renamed``: inner name -> new name; ``docs``: what sizes of this unit alone are."""
    found, used = definitions(known, body)
    chosen = [text for macro, text in CHOSEN.items() if macro in used]
    inner = [rename(f"{short}_t", renamed) for short in types]
    lines = [f"typedef {name}_real {rename('real_t', renamed)};"]
    lines += [f"typedef {name}_{t}_t {short};" for t, short in zip(types, inner, strict=True) if f"{t}_t" in used]
    for macro, arguments, text in found:
        declared = arguments is None and text in (f"{name.upper()}_{macro}", _of_header(macro, name))
        head = rename(macro if arguments is None else f"{macro}({arguments})", renamed)
        define = f"#define {head} {text if declared else rename(text, renamed)}"
        lines.append(" \\\n    ".join(wrap(define, WIDTH, break_long_words=False, break_on_hyphens=False)))
        if reason := REASONS.get(macro, docs.get(macro, "")):
            lines[-1:] = _with_reason(lines[-1], reason)
    return "\n".join([*lines, *(rename(text, renamed) for text in chosen)])


def _of_header(macro: str, name: str) -> str:
    """The macro of the header with another name that this one stands for; "": none."""
    return f"{name.upper()}_NX" if macro == "NXHAT" else ""


#: Macro of which the compiler chooses the value -> its definition.
CHOSEN: Mapping[str, str] = {
    "BLOCK_WIDTH": """/* Columns of a block of a matrix product: its rows stay in vector registers. */
#if defined(__AVX__)
#define BLOCK_WIDTH 8
#else
#define BLOCK_WIDTH 4
#endif"""
}

#: Macro of a threshold -> its reason.
REASONS: Mapping[str, str] = {
    **{f"TOL_{name.upper()}": reason for name, (_, reason) in TOLERANCES.items()},
    **{f"FACTOR_{name.upper()}": reason for name, (_, reason) in FACTORS.items()},
}


def _with_reason(define: str, reason: str) -> list[str]:
    """The definition with a comment behind it, or above it if the line would be too long."""
    beside = f"{define} /* {reason} */"
    return [beside] if len(beside) <= LINE else [f"/* {reason} */", define]


def definitions(known: Sequence[Definition], body: Collection[str]) -> tuple[list[Definition], set[str]]:
    """Macros that a text with the identifiers ``body`` uses, also through other macros, and all its identifiers."""
    used = set(body)
    found: set[str] = set()
    while more := {name for name, _, _ in known if name in used} - found:
        found |= more
        used |= names_in(*(text for name, _, text in known if name in more))
    return [definition for definition in known if definition[0] in found], used


def all_definitions(module: CModule) -> list[Definition]:
    """Every macro that a unit may use."""
    p, P = module.name, module.macro
    sizes = [m for m in module.macros if m.name != "MAGIC"]
    constants = [(m.name, f"{P}_{m.name}" if m.public and m.shown is None else str(m.value)) for m in sizes]
    constants = [(n, _of_header(n, p) or text) for n, text in constants]
    constants.append(("MAGIC", "NMPC_CODEGEN_UNIT"))
    constants += [(name, f"{P}_{name}") for name in ("ALL", *(status.name for status in module.statuses))]
    features = module.features.macros
    constants += [
        *((name, str(features[name])) for name in (features if module.whole else ("VECTOR_LANES", "PACK_WIDTH"))),
        *arithmetic(module.precision, module.features.own_math),
    ]
    parametric = [("API", "name", f"{p}_##name"), REAL_CONSTANT, *accessors(module)]
    if module.whole:
        parametric += [(name.upper(), "...", "((void)0)") for name in module.absent_kernels]
    parametric.append(("HESSIAN", "s, k", f"(s)->hessian.Q[{'0' if module.sizes.get('NQ') == 1 else 'k'}]"))
    places = {**PLACES, **module.places} | (MEASURED_START if module.features.start_is_measured else {})
    parametric += [kernel_call(routine, places, module.places) for routine in module.routines]
    parametric += [product_call(routine, module.style) for routine in module.called_products]
    return [*((name, None, text) for name, text in constants), *parametric]


def arithmetic(precision: str, own: bool = False) -> list[tuple[str, str]]:
    """(macro, text): functions of math.h or their own text, infinity, tolerances, factors in the working precision."""
    style = unit_style(precision, own)
    functions = [(name.upper(), style.function(name)) for name in FUNCTIONS]
    tolerances = [(f"TOL_{name.upper()}", style.literal(tolerance(name, precision))) for name in TOLERANCES]
    factors = [(f"FACTOR_{name.upper()}", style.literal(value)) for name, (value, _) in FACTORS.items()]
    return [*functions, ("INF", "((real_t)INFINITY)"), *tolerances, *factors]


def accessors(module: CModule) -> list[Definition]:
    """(macro, arguments, text): access to references, weights, parameters and bounds of a node.

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
        ("PATH_LOWER", "s, k, row", member("bounds", f"(s)->lower[{at('bounds', 'k')}]", "default_lower") + "[row]"),
        ("PATH_UPPER", "s, k, row", member("bounds", f"(s)->upper[{at('bounds', 'k')}]", "default_upper") + "[row]"),
        ("SOFT_L1", "s, k", member("soft", f"(s)->{soft}_l1[{at('soft', 'k', '(k) == N')}]", "default_soft_l1")),
        ("SOFT_L2", "s, k", member("soft", f"(s)->{soft}_l2[{at('soft', 'k', '(k) == N')}]", "default_soft_l2")),
        ("END_MULTIPLIERS", "s", _last_multipliers(module, "NE", "NH_N")),
        ("COUPLED_MULTIPLIERS", "s", _last_multipliers(module, "NE")),
    ]


def _last_multipliers(module: CModule, *sizes: str) -> str:
    """The multipliers of the last rows, as many as these sizes say: the vector ends with those of the coupled rows,
    after the general ones of node N."""
    return f"((s)->mult + ({' - '.join(['NG', *(size for size in sizes if module.value(size))])}))"


def product_call(routine: LoopedRoutine, style: CStyle) -> Definition:
    """(macro, arguments, text): call of a product with the stage matrices; it passes what is read or written."""
    names, text = call(routine, style)
    return routine.name.upper(), ", ".join(names), text


#: C text of the kernel inputs at node k of the solver s; two tables with those that differ at the terminal node and at
#: the start.
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
#: Where coupled rows read x_0 if the algorithm writes the measured state for it.
MEASURED_START = {"x_0": "(s)->xhat", "first": "(s)->xhat"}
START_PLACES = {
    "x": "(s)->x[0]",
    "z": "(s)->z[0]",
    "p": "PARAM(s, 0)",
    "yref": "default_start_reference",
    "W": "default_start_weight",
}


#: Routines whose last result is what Newton's method leaves of the stages, which explicit schemes have not.
LEAVING = ("integrator_interval", "path_exact")

#: Inputs that are arguments of the macro of every kernel that has them.
VECTORS = ("mu", "dx", "du", "adj", "d")


def kernel_call(
    routine: Routine, everywhere: dict[str, str] = PLACES, kept: Mapping[str, str] = MappingProxyType({})
) -> Definition:
    """(macro, arguments, text): call of a printed kernel; it passes what is read or written, nothing else.

    ``kept``: places of outputs that a node keeps, which are no arguments.

    The arguments of the macro are always the same: the solver, the node of a path kernel, the vectors that it
    multiplies, the outputs; INTEGRATOR_STEP also takes the state, the control, the step length and the steps of
    Newton's method, INTEGRATOR_JUMP the state and the control, MEASUREMENT the state and the parameters. Kernels of
    stages have arguments for all of their ports.
    """
    if routine.name.startswith("stage_"):
        names = [p.name for p in (*routine.inputs, *routine.outputs)]
        used = [p.name for p in (*routine.reads, *routine.writes)]
        return routine.name.upper(), ", ".join(names), f"{routine.name}({', '.join(used)})"
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
    arguments = ", ".join([*leading, *outputs])
    return routine.name.upper(), arguments, f"{routine.name}({', '.join(passed)})"
