"""render() prints a CModule and its unit as Sources; every run gives the same text, without dates or paths."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import groupby
from textwrap import wrap
from typing import Any

from nmpc_codegen.ir.cmodule import CModule, Macro
from nmpc_codegen.lowering.contents import lines_by_section, shorter
from nmpc_codegen.lowering.dialect.directives import resolve
from nmpc_codegen.lowering.templates import context, environment
from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.text import library_headers, text_of_unit
from nmpc_codegen.package.deviations import DEVIATIONS
from nmpc_codegen.package.seal import seal
from nmpc_codegen.package.signals import Argument, EntryPoint, Signal, horizon, nodes
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.package.struct_layout import PURPOSES, WORK, Field, Size, Struct
from nmpc_codegen.package.version import __version__
from nmpc_codegen.targets import PORTABLE, UNALIGNED_MOVES, Target

#: Maximum length of a comment line in the header without its margin.
WIDTH = 116

#: -f options that GCC 12 needs: otherwise it drops calls, assumes an aligned stack in leaf functions, and inlines loops
#: into functions in which it does not vectorise them.
GCC_12 = ("no-delete-null-pointer-checks", "no-tree-loop-distribute-patterns", "no-inline-functions")


def render(module: CModule, items: Sequence[Item]) -> Sources:
    """Return all files of the package, sealed; ``items`` is its translation unit."""
    names = _names(module)
    header = tidy(environment().get_template("package/solver.h.jinja").render(names))
    included = library_headers(items)
    files = {
        f"{module.name}.c": "package/solver.c.jinja",
        "main.c": module.description.kind.main,
        "CMakeLists.txt": "package/CMakeLists.txt.jinja",
        "README.md": "package/README.md.jinja",
    }
    names |= _page(module) | _target_files(module, included)
    names |= {
        "folders": module.folders,
        "libraries": module.libraries,
        "guard": _guard(module.name, module.target),
        "spelling": _spelling(module),
        "magic": module.value("MAGIC"),
        "system_headers": included,
        "unit": (unit := text_of_unit(items, header, module.name, module.structs)),
        "sections": lines_by_section(unit),
        "shorter": list(shorter(module.features)),
    }
    sources = {f"{module.name}.h": header}
    sources |= {path: tidy(environment().get_template(t).render(names)) for path, t in files.items()}
    sources[f"{module.name}.json"] = module.description.to_json()
    return Sources(seal({**sources, **module.foreign}, module.name), module.description)


def _names(module: CModule) -> dict[str, Any]:
    names: dict[str, Any] = context(module.name, module.style)
    names |= {
        "m": module,
        "gcc12": GCC_12,
        "deviations": DEVIATIONS if module.target.board else {},
        "version": __version__,
        "member": lambda field: member(field, module.name, module.public),
        "by_purpose": _group_by_purpose,
        **struct_words(module.name),
        "comment": block_comment,
        "prototype": lambda entry: prototype(entry, module.name, SOLVER),
        "statuses": {status: status.text for status in module.statuses},
        "structs": [s for s in module.structs if s.name in _public(module)],
        "inner_structs": [s for s in module.structs if s.name not in _public(module)],
        "precision": module.precision,
        "dim": lambda macro: f"{module.macro}_{macro}",
        "resolved": lambda template: _resolve(environment().get_template(template).render(names), module),
        "initial": ", ".join(names["lit"](v) for s in module.description.states for v in s.value),
        "dt": names["lit"](module.description.sampling_time or module.description.dt[0]),
        "what": module.description.kind.words,
        "usage": module.description.kind.usage,
    }
    return names | _names_of_estimator(module, names)


def _names_of_estimator(module: CModule, names: Mapping[str, Any]) -> dict[str, Any]:
    """Return names for the example and README.md of an estimator on measurements and controls."""
    found = module.description.estimation
    if found is None:
        return {}
    real, u = names["real"], f"u[{module.macro}_NIN]"
    units = [s.unit for s in found.measured for _ in s.elements]
    return {
        "inputs": found.nu,
        "arguments": f"const {real} y[{module.macro}_NM]" + (f", const {real} {u}" if found.nu else ""),
        "controls": f"    const {real} {u} = {{ 0 }};" if found.nu else "",
        "noise": ", ".join(names["lit"](v) for v in found.noise_std),
        "measurements": [
            (name, unit, f"{std:g}") for name, unit, std in zip(found.measurements, units, found.noise_std, strict=True)
        ],
    }


def _public(module: CModule) -> set[str]:
    """Return the structs that a caller reads: results of calls, and arguments."""
    (solver,) = (struct for struct in module.structs if struct.name == "solver")
    passed = {a.ctype for entry in module.entry_points for a in (*entry.inputs, *entry.outputs)}
    return {field.ctype for field in solver.fields if field.role == "result"} | passed - {"solver"} | {"kkt"}


def _resolve(text: str, module: CModule) -> str:
    """Return the text with the branches of `#if` that the package has; a whole package leaves them to the compiler."""
    return resolve(text, module.decided).rstrip()


def _guard(name: str, target: Target) -> str:
    """Return an #error for compilers of another machine than that of the package."""
    if not target.defines:
        return ""
    missing = " || ".join(f"!defined({macro})" for macro in target.defines)
    remedy = f"compile with {' '.join(target.flags)}" if target.flags else "compile there"
    text = f'#error "{name} is written for {target.name} ({target.machine}): {remedy}, or export another target"'
    return "\n".join([" \\\n    ".join(wrap(f"#if {missing}", WIDTH)), text, "#endif"])


def _spelling(module: CModule) -> str:
    """Return the end of the first line of the .c: the target, unless it is portable, and nodes computed at once."""
    target, lanes = module.target, module.features.vector_lanes
    several = f", {lanes} shooting nodes at once" if lanes > 1 else ""
    return "" if target == PORTABLE else f", for {target.machine} ({target.name}){several}"


_PROCESSOR = """The code runs on any processor. If you know it, tell the compiler (`-march=...` or `-mcpu=...`; `native`
for the machine that compiles): vector registers halve the time of large problems. `build()` in Python does the same.

"""


def _target_files(module: CModule, headers: Collection[str]) -> dict[str, str]:
    """Return names for README.md and CMakeLists.txt on the target."""
    target, x86 = module.target, "-march=x86" in " ".join(module.target.flags)
    vectors = module.features.vector_lanes > 1 or module.features.tiles
    gnu = f"GNU C (gcc 12 or newer, clang) for {target.machine}"
    return {
        "contraction": "fast" if module.target.board is None else "off",  # with which a certificate is made
        "position_independent": "ON" if module.target.board is None else "OFF",
        "headers": ", ".join(f"`<{header}>`" for header in sorted({"stdint.h", *headers} - {"immintrin.h"})),
        "flags": "".join(f" {flag}" for flag in target.of_machine),
        "compiler": "gcc" if x86 else "cc",
        "processor": _PROCESSOR if target == PORTABLE else "",
        "moves": f" {UNALIGNED_MOVES}" if x86 else "",
        "extensions": "ON" if target.standard.startswith("gnu") else "OFF",
        "language": gnu if vectors else "C99",
        "vectors": ", and `<immintrin.h>` for AVX-512" if "immintrin.h" in headers else "",
    }


def _page(module: CModule) -> dict[str, Any]:
    """Return names for README.md on the problem: grid, files, signals and rows with their constants."""
    d, name, macro = module.description, module.name, module.macro
    period = "every sample" if d.discrete else f"every {d.sampling_time or d.dt[0]:g} {d.time_unit}"
    files = {
        f"{name}.h": "the interface: sizes, names, the solver struct, all functions with their arguments",
        f"{name}.c": "the solver in one translation unit",
        f"{name}.json": "sizes, names, units, options and report, for open_package() in Python and for other tools",
        "main.c": "an example that runs a loop on the computer; only this file uses stdio",
        "CMakeLists.txt": f"builds and installs the library {name}::{name}, and builds the example",
        "README.md": "this page",
        **{f"{folder}/": "code of another generator" for folder in module.folders},
    }
    places = {enum.stem: [f"{macro}_{enum.stem}_{constant}" for constant in enum.names] for enum in module.enums}
    signals = [
        *((e, s.unit, f"x[{places['X'][i]}]", f"state, initially {v:g}") for i, e, s, v in _elements(d.states)),
        *((e, s.unit, f"u[{places['U'][i]}]", "control") for i, e, s, _ in _elements(d.controls)),
    ]
    signals += [
        (e, s.unit, f"z[{places['Z'][i]}]", f"algebraic variable, initially about {v:g}")
        for i, e, s, v in _elements(d.algebraic)
    ]
    for s, constant in zip(d.parameters, d.parameter_constants, strict=True):
        declared = ", ".join(f"{value:g}" for value in s.value)
        signals.append((s.name, s.unit, f"{macro}_PARAM_{constant}", f"parameter, declared {declared}"))
    rows = [
        (
            f"{r.lower:g}",
            r.name,
            f"{r.upper:g}",
            f"{macro}_ROW_{constant}",
            nodes(r.nodes),
            r.strictness,
        )
        for r, constant in zip(d.rows, d.row_constants, strict=True)
    ]
    residuals = [
        f"Reference {vector} of the residual: {', '.join(f'{r.name} = {r.reference:g}' for r in group)}.  "
        for vector, group in (("y", d.residuals), ("y_N (terminal)", d.residuals_N))
        if group
    ]
    grid = horizon(d.dt, d.time_unit, d.discrete)
    texts = {"grid": grid, "sample": period.capitalize(), "first_control": places["U"][0]}
    return texts | {"files": files.items(), "signals": signals, "rows": rows, "residuals": residuals}


def _elements(signals: Sequence[Signal]) -> list[tuple[int, str, Signal, float]]:
    """Return (position in the vector, name, signal, value) of every element."""
    return [
        (s.offset + i, element, s, value)
        for s in signals
        for i, (element, value) in enumerate(zip(s.elements, s.value, strict=True))
    ]


def member(field: Field, name: str, public: Iterable[Macro]) -> str:
    """Return the declaration of a struct member; sizes that are not ``public`` are numbers."""
    ctype = {"real": f"{name}_real", "int32": "int32_t"}.get(field.ctype, f"{name}_{field.ctype}_t")
    known = {macro.name for macro in public if macro.shown is None}
    texts = (s.c(name.upper()) if known.issuperset(re.findall(r"[A-Z]\w*", s.text)) else int(s) for s in field.shape)
    return f"{ctype} {field.name}{''.join(f'[{text}]' for text in texts)};"


def struct_words(name: str) -> dict[str, Callable[[Struct], str]]:
    """Return functions for the beginning and end of a struct's definition; the solver's type is declared before."""

    def opening(struct: Struct) -> str:
        if struct.name == "solver":
            return f"struct {name}_solver"
        return f"typedef {'union' if struct.union else 'struct'}"

    return {
        "opening": opening,
        "closing": lambda struct: "" if struct.name == "solver" else f" {name}_{struct.name}_t",
    }


def _group_by_purpose(struct: Struct) -> list[tuple[str, tuple[Field, ...]]]:
    """Return (heading, members) of a struct; those of the solver are grouped by purpose."""
    if struct.name != "solver":
        return [("", struct.fields)]
    groups = groupby(struct.fields, key=lambda member: PURPOSES.get(member.role, WORK))
    return [(f"    /* {heading} */\n", tuple(fields)) for heading, fields in groups]


def block_comment(text: str) -> str:
    """Return the text as a block comment in filled lines."""
    lines = wrap(text, WIDTH, break_long_words=False)
    return "/* " + "\n * ".join(lines) + " */"


#: The first argument of the entry points of a controller.
SOLVER = (Argument("s", "solver"),)


def prototype(entry: EntryPoint, name: str, owner: tuple[Argument, ...] = ()) -> str:
    """Return the declaration of an entry point, whose first arguments ``owner`` may be changed."""

    def declare(argument: Argument, constant: bool) -> str:
        sizes = "".join(f"[{Size(text, 0).c(name.upper()) if text else ''}]" for text in argument.shape)
        number = {"real": f"{name}_real ", "int": "int "}.get(argument.ctype)
        const = "const " if constant and (sizes or number is None) else ""
        return f"{const}{number or f'{name}_{argument.ctype}_t *'}{argument.name}{sizes}"

    inputs, outputs = ([declare(a, True) for a in entry.inputs], [declare(a, False) for a in entry.outputs])
    arguments = ", ".join([*(declare(a, False) for a in owner), *inputs, *outputs])
    head = f"{name}_status_t {name}_{entry.name}("
    if len(head) + len(arguments) <= WIDTH:
        return f"{head}{arguments});"
    glued = re.sub(r"(?<!,) ", "\0", arguments)
    lines = wrap(f"{glued});", WIDTH, initial_indent="    ", subsequent_indent="    ", break_long_words=False)
    return "\n".join([head, *lines]).replace("\0", " ")


def tidy(text: str) -> str:
    """Return the text without trailing blanks and runs of empty lines, with one newline at the end."""
    lines: list[str] = []
    for line in (raw.rstrip() for raw in text.splitlines()):
        if line or (lines and lines[-1]):
            lines.append(line)
    return "\n".join(lines).strip("\n") + "\n"
