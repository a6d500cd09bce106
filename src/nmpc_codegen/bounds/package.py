"""Worst case of a sample: CModule -> CModule with bounds on its operations in the report."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

from nmpc_codegen.bounds.c_source import Type, constants, functions, macros, struct_members, tables
from nmpc_codegen.bounds.names import Unit
from nmpc_codegen.bounds.worst_case import UnboundedError, WorstCase
from nmpc_codegen.errors import OptionError
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.choose import CLOSE, Choice
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.preamble import all_definitions
from nmpc_codegen.lowering.render import unit_text

#: Results of the last analyses: an export and a build of one problem, or another printed style, ask the same.
_KNOWN: dict[Hashable, dict[str, int]] = {}
MOST_KNOWN = 100

#: The operations do not depend on the name of the package.
ANY_NAME = "package"

#: The phases of a sample.
PHASES = ("prepare", "feedback")


def settled(model: Model, name: str | None = None) -> CModule:
    """The package with the QP solver whose worst case is least among those that are close; see bounded().

    Raises:
        OptionError: the one that raises it for the model itself, if no package exists.
    """
    if model.choice is None or not model.choice.rivals:
        return bounded(lower(model, name))
    packages: list[tuple[Choice, CModule]] = []
    errors: list[OptionError] = []
    for choice in (model.choice, *model.choice.rivals):
        try:
            packages.append((choice, bounded(lower(_with(model, choice), name))))
        except OptionError as error:
            errors.append(error)
    if not packages:
        raise errors[0]
    worst = {c.label: m.description.report.worst_operations.get("sample") for c, m in packages}
    known = {label: count for label, count in worst.items() if count is not None}
    if len(known) < len(packages):
        return packages[0][1]
    choice, module = min(packages, key=lambda package: known[package[0].label])
    table = "; ".join(f"{label}: {count:,}" for label, count in known.items())
    why = f"least worst case of a sample among solvers that need at most {CLOSE} times the least ({table})"
    return _because(module, f"qp: {choice.qp.name}; {why}")


def _with(model: Model, choice: Choice) -> Model:
    """The model with another QP solver and its reasons."""
    parts = replace(model.parts, condensing=choice.condensing, qp=choice.qp)
    return replace(model, parts=parts, choice=choice)


def _because(module: CModule, reason: str) -> CModule:
    """The module with one more reason."""
    report = module.description.report
    report = replace(report, choices=(*report.choices, reason))
    return replace(module, description=replace(module.description, report=report))


def bounded(module: CModule) -> CModule:
    """The module with the worst case of its phases in the report, if it is known."""
    if not {entry.name for entry in module.entry_points}.issuperset(PHASES):
        return module
    try:
        worst = _bounds(module)
    except UnboundedError:
        return module
    description = module.description
    report = replace(description.report, worst_operations=worst | {"sample": sum(worst.values())})
    return replace(module, description=replace(description, report=report))


def _bounds(module: CModule) -> dict[str, int]:
    """Operations of the phases, computed once for equal texts with equal data."""
    module = replace(module, description=replace(module.description, name=ANY_NAME))
    text = unit_text(module)
    key = (
        text,
        tuple(all_definitions(module)),
        tuple((m.name, m.value) for m in module.macros),
        tuple((t.name, *t.values) for t in module.tables if t.ctype == "int"),
        tuple((s.name, *((f.name, f.ctype, len(f.shape)) for f in s.fields)) for s in module.structs),
        tuple((r.name, r.count.total) for r in (*module.routines, *module.called_products)),
        tuple(sorted(module.ranges.items())),
    )
    if key not in _KNOWN:
        found = WorstCase(_unit(module, text))
        worst = {phase: found.operations(f"api_{phase}") for phase in PHASES}
        if len(_KNOWN) == MOST_KNOWN:
            _KNOWN.pop(next(iter(_KNOWN)))
        _KNOWN[key] = worst
    return _KNOWN[key]


def _unit(module: CModule, text: str) -> Unit:
    members: dict[str, list[Type]] = {}
    for struct in module.structs:
        for member in struct.fields:
            base = "int" if member.ctype.startswith("int") else member.ctype
            members.setdefault(member.name, []).append(Type(base, len(member.shape)))
    for name, types in struct_members(text).items():
        members.setdefault(name, []).extend(types)
    counted = (*module.routines, *module.called_products)
    return Unit(
        functions=functions(text),
        macros=macros(all_definitions(module)),
        counts={routine.name: routine.count.total for routine in counted},
        sizes={**constants(text), **{macro.name: macro.value for macro in module.macros}},
        tables={**tables(text), **{t.name: [int(v) for v in t.values] for t in module.tables if t.ctype == "int"}},
        ranges=module.ranges,
        members=members,
    )
