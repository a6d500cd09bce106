"""Operations are counted at run time: the generated .c is compiled as C++ with a counting scalar type (counting.hpp).

Every count that the compiler states (printed routines, stage products, functions of the components) is compared with
one run of that function: additions, multiplications, divisions, square roots and calls of math.h.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from nmpc_codegen import OCP, Options
from nmpc_codegen.compiler import model_of, read, text_of
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.sources import Sources
from verification.quality import parameters_of

HEADER = Path(__file__).with_name("counting.hpp")

#: Classes that are compared. The class "other" counts operations spelled in C, including comparisons in loops.
CLASSES = ("add", "mul", "div", "sqrt", "call")

#: Parameter -> argument; w has space for any vector. A package leaves out parameters that it does not read.
ARGUMENTS = {
    "s": "&s",
    "node": "&s.node[0]",
    "terminal": "&s.terminal",
    "p": "&s.qp.work.columns",
    "q": "&s.qp",
    "Q": "s.hessian.Q[0]",
    "k": "0",
    "first": "0",
    "last": "N",
    **dict.fromkeys(("dx", "du", "y", "w", "z"), "w"),
}
#: Arguments of functions in which a parameter has another meaning.
ARGUMENTS_OF = {
    "terminal_adjoint": {"Q": "s.hessian.Q_N"},
    "condense_terminal_panel": {"Q": "s.hessian.Q_N"},
    "riccati_forward": {"x": "s.qp.x", "u": "s.qp.z"},
}

#: Functions that are called more than once for their count: the statement that calls them.
STATEMENTS = {
    "condense_hessian": "for (int c = 0; c < LDG; c += COLUMNS) "
    "{ condense_propagate(&s, c); condense_hessian(&s, c); }",
}

#: Calls that must precede functions that overwrite their input; the count of a factorisation is that for a positive
#: definite matrix.
BEFORE = {
    "qp_factorize_hessian": "condense_matrices(&s); for (int i = 0; i < LDV; i++) { s.qp.H[i][i] += 1.0; }",
    "riccati_factorize": "riccati_init(&s); for (int k = 0; k < N; k++) for (int j = 0; j < NU; j++) "
    "{ s.riccati.diagonal[k][j] = 1.0; }",
    "riccati_backward": "for (int k = 0; k < N; k++) { s.riccati.b[k][0] = 1.0; }",
}

#: Largest number of ports of a routine.
MOST_PORTS = 16

#: (function, stated, counted)
Mismatch = tuple[str, dict[str, int], dict[str, int]]


def count_mismatches(ocp: OCP, options: Options | None = None) -> list[Mismatch]:
    """Return the functions of the package of ``ocp`` whose stated count differs from the measured one."""
    module = lower(model_of(*read(ocp, options)))
    return mismatches(module, text_of(module))


def mismatches(module: CModule, sources: Sources, names: Collection[str] | None = None) -> list[Mismatch]:
    """Return the mismatches of a lowered package and its text; ``names`` limits the functions."""
    stated = {
        name: _compared(count)
        for name, count in module.description.report.operations.items()
        if names is None or name in names
    }
    unit = sources[f"{module.name}.c"]
    stated = {name: count for name, count in stated.items() if re.search(rf"\b{name}\(", unit)}
    calls = {name: _call(module, name, unit) for name in stated}
    counted = run_counting(sources, module.name, calls, _room(module) * MOST_PORTS)
    return [(name, stated[name], counted[name]) for name in stated if stated[name] != counted[name]]


def _compared(count: OpCount) -> dict[str, int]:
    return {name: getattr(count, name) for name in CLASSES}


def _call(module: CModule, name: str, unit: str) -> str:
    """Return a call of one C function of a unit with valid data."""
    for routine in module.routines:
        if routine.name == name:
            ports = (*routine.reads, *routine.writes)
            return f"{name}({', '.join(_argument(port, i * _room(module)) for i, port in enumerate(ports))})"
    if name in STATEMENTS:
        return STATEMENTS[name]
    named = ARGUMENTS | ARGUMENTS_OF.get(name, {})
    return f"{name}({', '.join(named[parameter] for parameter in parameters_of(unit, name))})"


def _argument(port: Port, first: int) -> str:
    """Return the argument for a port: its own part of w."""
    if port.whole:
        return "NEWTON"
    return f"(real_t(*)[{port.cols}])(w + {first})" if port.cols else f"w + {first}"


def _room(module: CModule) -> int:
    """Return the length of the longest vector that a call reads or writes."""
    ports = [port.size for r in module.routines for port in (*r.inputs, *r.outputs)]
    return max(*ports, module.sizes["NZ"], module.sizes.get("LDV", 1))


def counting_header(header: str, name: str) -> str:
    """Return the header with the counting scalar instead of its real type."""
    for ctype in ("double", "float"):
        line = f"typedef {ctype} {name}_real;"
        if header.count(line) == 1:
            return header.replace(line, f"typedef counted {name}_real;")
    raise ValueError(f"{name}.h does not define {name}_real in one line")


def run_counting(sources: Sources, name: str, calls: Mapping[str, str], size: int) -> dict[str, dict[str, int]]:
    """Compile the package as C++ with the counting scalar, run every call once, and return the counts.

    A call may use the prepared solver struct s and a vector w of the given size.
    """
    before = [
        f"static {name}_solver_t s;",
        f"static {name}_real w[{size}];",
    ]
    start = [f"    {name}_init(&s);", f"    {name}_prepare(&s);"]
    if "newton" in sources.description.members("solver"):
        start.append("    s.newton = NEWTON;")  # as in a sample
    each = {
        function: [
            *([f"    {BEFORE[function]}"] if function in BEFORE else []),
            f"    for (int i = 0; i < {size}; i++) {{ w[i] = 0.5; }}",
        ]
        for function in calls
    }
    return run_program(sources, name, before, start, each, calls)


def run_program(
    sources: Sources,
    name: str,
    declarations: Sequence[str],
    start: Sequence[str],
    each: Mapping[str, Sequence[str]],
    calls: Mapping[str, str],
) -> dict[str, dict[str, int]]:
    """Count the calls in a program with these declarations, which runs ``start`` once and ``each`` before a call.

    PREFIX_ in a statement stands for the upper-case prefix of the package ``name``.
    """
    lines = [
        f'#include "{HEADER.name}"',
        f'#include "{name}.c"',
        "#include <stdio.h>",
        *declarations,
        "static void report(const char *function)",
        "{",
        '    printf("%s %ld %ld %ld %ld %ld\\n", function, counted::add, counted::mul, counted::div, counted::sqrt,',
        "        counted::call);",
        "}",
        "int main()",
        "{",
        *start,
    ]
    for function, call in calls.items():
        lines += [*each.get(function, ()), "    counted::reset();"]
        lines += [f"    {call};", f'    report("{function}");']
    lines += ["    return 0;", "}"]
    lines = [line.replace("PREFIX_", f"{name.upper()}_") for line in lines]
    with tempfile.TemporaryDirectory(prefix="counting-") as temporary:
        folder = Path(temporary)
        (folder / HEADER.name).write_text(HEADER.read_text(encoding="utf-8"), encoding="utf-8")
        (folder / f"{name}.h").write_text(counting_header(sources[f"{name}.h"], name), encoding="utf-8")
        (folder / f"{name}.c").write_text(sources[f"{name}.c"], encoding="utf-8")
        (folder / "main.cpp").write_text("\n".join(lines) + "\n", encoding="utf-8")
        compiler = shutil.which("clang++") or "g++"  # clang++ is the faster one without optimiser
        subprocess.run([compiler, "-std=c++17", "-O0", "-w", "main.cpp", "-o", "main", "-lm"], cwd=folder, check=True)
        out = subprocess.run([folder / "main"], capture_output=True, text=True, check=True).stdout
    found = {}
    for line in out.splitlines():
        function, *numbers = line.split()
        found[function] = dict(zip(CLASSES, map(int, numbers), strict=True))
    return found
