"""Worst case of a sample: CModule -> CModule with bounds on its operations in the report, and the budget checked.

With a budget B, a sample computes what charges for itself only as long as ALLOWANCE = B - (bound on all other
operations of prepare and feedback) lasts, so that it never takes more than B operations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from nmpc_codegen.bounds.c_source import Type, functions, macros, struct_members
from nmpc_codegen.bounds.worst_case import UnboundedError, Unit, WorstCase
from nmpc_codegen.errors import OptionError
from nmpc_codegen.ir.cmodule import CModule, Macro
from nmpc_codegen.lowering.choose import CLOSE, Choice
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.preamble import all_definitions
from nmpc_codegen.lowering.render import unit_text

#: The phases of a sample.
PHASES = ("prepare", "feedback")


def settled(model: Model, name: str | None = None) -> CModule:
    """The package with the QP solver whose worst case is smallest among those that are close; see bounded().

    Raises:
        OptionError: the one that raises it for the model itself, if no package exists.
    """
    if not model.rivals:
        return bounded(lower(model, name))
    packages: list[tuple[CModule, str]] = []
    errors: list[OptionError] = []
    for rival in (None, *model.rivals):
        try:
            packages.append(
                (bounded(lower(model if rival is None else _with(model, rival), name)), _label(model, rival))
            )
        except OptionError as error:
            errors.append(error)
    if not packages:
        raise errors[0]
    known = [module for module, _ in packages if module.description.report.worst_operations]
    if len(known) < len(packages):
        return packages[0][0]
    module, _ = min(packages, key=lambda package: package[0].description.report.worst_operations["sample"])
    table = "; ".join(f"{label}: {m.description.report.worst_operations['sample']:,}" for m, label in packages)
    return _because(module, f"of the solvers within {CLOSE} times of that the one with the least worst case ({table})")


def _label(model: Model, rival: Choice | None) -> str:
    condensing, qp = (model.parts.condensing, model.parts.qp) if rival is None else (rival.condensing, rival.qp)
    assert condensing is not None
    assert qp is not None
    return Choice(condensing, qp).label


def _with(model: Model, rival: Choice) -> Model:
    """The model with another QP solver, for the reasons of the choice that it stands for."""
    kept = model.choices[: -len(rival.reasons)]
    parts = replace(model.parts, condensing=rival.condensing, qp=rival.qp)
    return replace(model, parts=parts, choices=(*kept, *rival.reasons))


def _because(module: CModule, reason: str) -> CModule:
    """The module with one more reason for its last choice."""
    description = module.description
    *others, last = description.report.choices
    report = replace(description.report, choices=(*others, f"{last}; {reason}"))
    return replace(module, description=replace(description, report=report))


def bounded(module: CModule) -> CModule:
    """The module with the worst case of its phases in the report; with a budget, also the costs that are charged.

    Raises:
        OptionError: the budget is less than what every sample may need, or its QP solver has no budget.
    """
    if not {entry.name for entry in module.entry_points}.issuperset(PHASES):
        return module
    budget = module.sizes.get("MAX_OPERATIONS")
    if budget is not None and not module.iteration:
        raise OptionError(
            f"RealTimeIteration(budget={budget}) (--set algorithm.budget={budget}) clashes with a QP solver whose "
            f"operations are not counted: {', '.join(module.folders)}; choose another one, or no budget"
        )
    try:
        found = WorstCase(_unit(module, unit_text(module)))
        worst = {phase: found.operations(f"api_{phase}") for phase in PHASES}
    except UnboundedError:
        return module  # code of another generator: the report states no worst case
    if budget is None:
        return _stated(module, worst | {"sample": sum(worst.values())}, {})
    fixed = sum(worst.values())
    needed = fixed + sum(found.charges[name] for name in module.iteration)
    if budget < needed:
        raise OptionError(
            f"RealTimeIteration.budget: {budget} operations; a sample needs up to {needed} for linearisation, "
            "condensing, factorisation, one iteration and checks; expected at least that (--set algorithm.budget=...)"
        )
    costs = {name: (count, "operations that are charged at once") for name, count in sorted(found.charges.items())}
    costs["ALLOWANCE"] = (budget - fixed, "operations of a sample that may be charged")
    return _stated(module, {"sample": budget}, costs)


def _stated(module: CModule, worst: Mapping[str, int], more: Mapping[str, tuple[int, str]]) -> CModule:
    """The module with this worst case and further size macros."""
    description = module.description
    sizes = {**description.sizes, **{name: value for name, (value, _) in more.items()}}
    added = tuple(Macro(name, value, doc) for name, (value, doc) in more.items())
    report = replace(description.report, worst_operations=worst)
    return replace(
        module, macros=(*module.macros, *added), description=replace(description, sizes=sizes, report=report)
    )


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
        sizes={macro.name: macro.value for macro in module.macros},
        tables={t.name: [int(v) for v in t.values] for t in module.tables if t.ctype == "int"},
        ranges=module.ranges,
        members=members,
    )
