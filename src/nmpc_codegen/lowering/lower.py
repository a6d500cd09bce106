"""lower() turns a Model into a CModule: all sizes and all C names, gathered from their owners.

The owners are the components, whose classes are never tested, and the files of stated/.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from nmpc_codegen.components.base import Component, Counts, Dims
from nmpc_codegen.components.core import SIZES_OF_OTHERS
from nmpc_codegen.errors import OptionError
from nmpc_codegen.ir.cmodule import CModule, Macro, Section, check_prefix
from nmpc_codegen.ir.kernel import called_functions, called_lookups
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.lowering.describe import describe, report_of
from nmpc_codegen.lowering.find_features import features_of
from nmpc_codegen.lowering.lanes.nodes import with_lanes
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.naming.enums import enums
from nmpc_codegen.lowering.naming.local_names import local_names
from nmpc_codegen.lowering.stated import algebra, augmented_state, data, probes
from nmpc_codegen.lowering.structs import absent_members, hooked_parts, lowered_structs
from nmpc_codegen.lowering.tables import tables
from nmpc_codegen.lowering.unit.read import own_names
from nmpc_codegen.package.description import INTERFACE_SIZES
from nmpc_codegen.package.features import KERNELS
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.signals import EntryPoint
from nmpc_codegen.package.struct_layout import Size, Struct, place

# Maximum value of counters, and maximum number of steps of integrate().
MANY = 1_000_000
# Largest number of corrections of a control towards hard rows that depend only on controls; each one at least halves a
# large violation of a circle.
PULLS = 16
# Fraction of an integration step by which rounding errors of times may exceed a number of steps.
ROUNDING_OF_STEPS = 1e-3

# Marks a solver struct that init() has initialised.
MAGIC = 0x4E4D5043


def lower(model: Model, name: str | None = None, whole: bool = False) -> CModule:
    """Determine every size and name of the package ``name`` (default: the name of the problem).

    A ``whole`` package (GNU C) keeps what it does not need: members of size 0, structs of features that it lacks, all
    text of the parts. It computes the same bits; tests compare the two.
    """
    problem = model.problem
    name = problem.name if name is None else name
    check_prefix(name)
    dims, printed, algorithm = model.dims, model.printed, model.parts.algorithm
    foreign = [(c.name, c.foreign_sources(name, model.options.precision, dims)) for c in model.parts.components]
    if model.options.math == "own":
        _check_math(model, [component for component, files in foreign if files])
    features = features_of(model)
    entries = (*algorithm.entries(features), *augmented_state.entries(problem), *algebra.entries(problem))
    structs, layout = place(lowered_structs(model, dims, features, whole), model.options.precision)
    macros = _macros(model, dims, entries, whole)
    stored = tables(model, printed)
    routines = tuple(r for r in printed if r.name not in KERNELS or r.name in features.kernels)
    lookups = called_lookups(printed)
    unit = ["find_interval", *(name for lookup in lookups for name in (lookup.table, lookup.function))]
    unit += [*(m.name for m in macros), *(t.name for t in stored), *(r.name for r in routines), *features.macros]
    module = CModule(
        description=describe(model, name, macros, structs, entries, report_of(model, features, structs, layout)),
        target=model.target,
        macros=macros,
        enums=enums(problem),
        tables=stored,
        rows=problem.qp_rows,
        settings=data.settings(model, dims, whole),
        setters=data.setters(model),
        routines=routines,
        products=model.products,
        features=features,
        sections=_sections(model, dims, structs, layout),
        signals=(
            ("x", problem.state_names[: problem.measured]),
            ("u", problem.control_names),
            ("z", problem.algebraic_names),
            ("p", problem.parameter_names[: problem.np - problem.augmentation.data]),
            ("y", problem.path.y_names),
            ("y_N", problem.terminal.y_names),
            ("h", problem.path.h_names),
            ("h_N", problem.terminal.h_names),
        ),
        names=local_names(problem, [*unit, *model.products.vectors, *model.products.panels]),
        diagonal_weight=problem.path.diagonal_weight,
        scaled_weight=any(problem.path.scale_with_dt),
        diagonal_weight_N=problem.terminal.diagonal_weight,
        hooked_parts=tuple(hooked.part for hooked in hooked_parts(model, features)),
        places={name: place for c in model.parts.components for name, place in c.places.items()},
        absent_members=absent_members(model, dims, features, structs),
        absent_kernels=tuple(name for name in KERNELS if not features.has(name)),
        whole=whole,
        one_step=model.interval.one_step,
        jump_rows=model.interval.jump_rows,
        foreign={path: text for _, files in foreign for path, text in files.items()},
    )
    return _with_members_apart(with_lanes(module))


def _sections(
    model: Model, dims: Dims, structs: tuple[Struct, ...], layout: Mapping[str, tuple[int, int]]
) -> tuple[Section, ...]:
    """Return the sections of the components in the unit, with the bytes of the structs that they own."""
    held = {f.ctype for s in structs if s.name != "solver" for f in s.fields} | {"solver"}

    def size(component: Component) -> int:
        owned = [s for s in component.structs(dims) if s.name in layout and s.name not in held]
        return sum(layout[s.name][0] * s.count for s in owned)

    return tuple(
        Section(f"{c.seam}: {c.name}", c.template, _section_count(c.cost(dims, model)), size(c))
        for c in model.parts.components
    )


def _with_members_apart(module: CModule) -> CModule:
    """Return the package with an underscore after every struct member that would have the name of a size macro."""
    macros = {f"{module.macro}_{macro.name}" for macro in module.macros}
    if not any(member.name in macros for struct in module.structs for member in struct.fields):
        return module
    structs = tuple(
        replace(s, fields=tuple(replace(f, name=f"{f.name}_") if f.name in macros else f for f in s.fields))
        for s in module.structs
    )
    ranges = {f"{name}_" if name in macros else name: limits for name, limits in module.description.ranges.items()}
    return replace(module, description=replace(module.description, structs=structs, ranges=ranges))


def _check_math(model: Model, foreign: list[str]) -> None:
    """Raise OptionError if the package needs functions of math.h that the own elementary functions lack."""
    default = f", the default of the target {model.target.name}," if model.target.math == "own" else ""
    clash = f'math="own"{default} (--set math=own) clashes with'
    if foreign:
        raise OptionError(
            f'{clash} {foreign[0]}, whose foreign code calls the C library; choose another one, or math="libm"'
        )
    known = {*own_names(), *CStyle.INSTRUCTIONS}
    for routine in model.printed:
        missing = sorted(called_functions([routine]) - known)
        if missing:
            raise OptionError(
                f"{clash} {routine.name}(): {', '.join(missing)} has no text of its own; there is "
                f'{", ".join(sorted(known))}; choose math="libm" or another expression'
            )


def _section_count(counts: Counts) -> OpCount | None:
    return sum(counts.values(), OpCount()) if counts else None


def _macros(model: Model, dims: Dims, entries: Iterable[EntryPoint], whole: bool) -> tuple[Macro, ...]:
    """Return the sizes of all owners; sizes that the functions of the header name are public."""
    problem, parts = model.problem, model.parts
    number, *sizes = data.parameter_macros(problem)
    macros = [
        *_shared_sizes(model, dims),
        *augmented_state.macros(model),
        *((Macro("PANEL", PANEL, "columns processed together"),) if dims.condensed else ()),
        *data.macros(problem),
        *probes.macros(problem.saddles),
        *algebra.macros(problem),
        Macro("PULLS", PULLS, "most moves of a control back onto rows"),
        number,
        *sizes,
        *(Macro(name, int(n), doc) for part in parts.components for name, n, doc in part.sizes(dims)),
    ]
    reach = parts.algorithm.reach(problem) / parts.integrator.longest_step(problem)
    if reach or whole:
        steps = math.ceil(reach + ROUNDING_OF_STEPS)
        macros.append(Macro("PLAN_STEPS", steps, "most integration steps from a node of the plan to a new one"))
    macros.append(Macro("MANY", MANY, "most integration steps of one call, and largest count of samples"))
    macros.append(Macro("MAGIC", MAGIC, "marks a struct that init has initialised"))
    if whole:
        absent = (entry for component in parts.components for entry in component.absent_sizes(dims))
        macros += [Macro(*entry) for entry in (*SIZES_OF_OTHERS, *absent)]
    public = {s for e in entries for a in (*e.inputs, *e.outputs) for s in a.shape}
    public.update(INTERFACE_SIZES, (macro.name for macro in sizes))
    found = {macro.name: replace(macro, public=macro.name in public) for macro in reversed(macros)}
    if clash := [macro.name for macro in macros if not whole and found[macro.name].value != macro.value]:
        raise ValueError(f"two components state the size {clash[0]}, with different values")
    return tuple(found.values())[::-1]


def _shared_sizes(model: Model, dims: Dims) -> Iterator[Macro]:
    """Yield the sizes that components share, as far as the package has them."""
    problem = model.problem
    absent = {*(() if problem.augmentation.count else ("NXHAT",)), *(() if problem.estimation else ("NM", "NIN"))}
    absent |= set() if model.parts.hessian else {"NQ"}
    of_qp = {} if dims.condensed is None else vars(dims.condensed)
    for size in (*vars(dims).values(), *of_qp.values()):
        if isinstance(size, Size) and size.text not in absent:
            yield Macro(size.text, int(size), size.doc, shown=augmented_state.in_header(size, problem))
