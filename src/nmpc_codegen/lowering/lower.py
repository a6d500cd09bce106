"""Model -> CModule: all sizes and all C names. It loops over the components and never tests which one it has."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from nmpc_codegen.components.algorithms.shifts import sampling_period
from nmpc_codegen.components.base import Component, Counts, Dims
from nmpc_codegen.components.core import SIZES_OF_OTHERS
from nmpc_codegen.decisions.dimensions import DOCS
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.completion.saddles import PROBE_PARTS, PROBE_SIZES, Saddles
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.ir.cmodule import CModule, Macro, Section, Setter, check_prefix
from nmpc_codegen.ir.kernel import called_functions, called_lookups
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.lowering.data.tables import control_rows, round_scales, tables
from nmpc_codegen.lowering.lanes.nodes import with_lanes
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.naming.enums import enums
from nmpc_codegen.lowering.naming.local_names import local_names
from nmpc_codegen.lowering.structs import absent_members, extras, lowered_structs, settings
from nmpc_codegen.lowering.unit.read import own_names
from nmpc_codegen.options import as_data
from nmpc_codegen.package.description import INTERFACE_SIZES, PackageDescription, Report
from nmpc_codegen.package.features import KERNELS, Features, KernelName
from nmpc_codegen.package.memory import Size, Struct, place
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.signals import Argument, EntryPoint, Kind, Layout, Residual, c_constants
from nmpc_codegen.package.status import Status

# Maximum value of counters, and maximum number of steps of integrate().
MANY = 1_000_000
# Moves of a control back onto hard rows on controls alone; each halves at least a large excess of a circle.
PULLS = 16
# Part of an integration step by which rounding errors of times may exceed a number of steps.
ROUNDING_OF_STEPS = 1e-3

# Marks a solver struct that init() has initialised.
MAGIC = 0x4E4D5043


def lower(model: Model, name: str | None = None, whole: bool = False) -> CModule:
    """Determine every size and name of the package ``name`` (default: the name of the problem).

    ``whole``: the package keeps what it does not need, members of size 0, structs of features that it lacks, all text
    of the parts (GNU C). It does the same to the bit; tests compare the two.
    """
    problem = model.problem
    name = problem.name if name is None else name
    check_prefix(name)
    dims = model.dims
    foreign = [(c.name, c.foreign_sources(name, model.options.precision, dims)) for c in model.parts.components]
    if model.options.math == "own":
        _check_math(model, [component for component, files in foreign if files])
    features = _features(model)
    structs, layout = place(lowered_structs(model, dims, features, whole), model.options.precision)
    macros = _macros(model, dims, whole)
    printed, ranges = _printed_routines(model), _ranges(model, dims)
    stored = tables(model, printed)
    routines = tuple(r for r in printed if r.name not in KERNELS or r.name in features.kernels)
    lookups = called_lookups(printed)
    unit = ["find_interval", *(name for lookup in lookups for name in (lookup.table, lookup.function))]
    unit += [*(m.name for m in macros), *(t.name for t in stored), *(r.name for r in routines), *features.macros]
    module = CModule(
        description=_description(model, name, macros, structs, _report(model, dims, features, structs, layout), ranges),
        target=model.target,
        macros=macros,
        enums=enums(problem),
        tables=stored,
        rows=problem.qp_rows,
        settings=settings(model, dims, whole),
        setters=_setters(model),
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
        extras=tuple(extra.part for extra in extras(model, features)),
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
    """What the components contribute to the unit, with the bytes of the structs that they own."""
    held = {f.ctype for s in structs if s.name != "solver" for f in s.fields} | {"solver"}

    def size(component: Component) -> int:
        owned = [s for s in component.structs(dims) if s.name in layout and s.name not in held]
        return sum(layout[s.name][0] * s.count for s in owned)

    return tuple(
        Section(f"{c.seam}: {c.name}", c.template, _section_count(c.cost(dims, model)), size(c))
        for c in model.parts.components
    )


def _ranges(model: Model, dims: Dims) -> dict[str, tuple[int, int]]:
    """Values that members may have in a sample."""
    return {name: limits for c in model.parts.components for name, limits in c.ranges(dims).items()}


def _with_members_apart(module: CModule) -> CModule:
    """The package with an underscore after every member of a struct that would have the name of a size macro."""
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
    """Raise OptionError if the package needs functions of math.h that have no text of their own."""
    default = f", the default of the target {model.target.name}," if model.target.math == "own" else ""
    clash = f'math="own"{default} (--set math=own) clashes with'
    if foreign:
        raise OptionError(
            f'{clash} {foreign[0]}, whose foreign code calls the C library; choose another one, or math="libm"'
        )
    known = {*own_names(), *CStyle.INSTRUCTIONS}
    for routine in _printed_routines(model):
        missing = sorted(called_functions([routine]) - known)
        if missing:
            raise OptionError(
                f"{clash} {routine.name}(): {', '.join(missing)} has no text of its own; there is "
                f'{", ".join(sorted(known))}; choose math="libm" or another expression'
            )


def _printed_routines(model: Model) -> tuple[Routine, ...]:
    """The routines that have results: a problem without terminal cost has no terminal_cost()."""
    return tuple(r for r in model.routines if r.writes)


def _features(model: Model) -> Features:
    """The features of the problem, the options and the target, those that the components add, and what follows."""
    p, parts = model.problem, model.parts
    found = _of_problem(model)
    for component in parts.components:
        found = component.adds(found)
    tuned = found.tuned and (found.set_parameter or found.set_weight or found.set_bounds or found.set_soft)
    exact = bool(model.exact or found.regularize_reduced)
    bends = found.has_qp and (p.nonlinear_model or p.nonlinear_rows or p.nonlinear_cost or found.tuned)
    goes_on = bends and found.judges and found.iterates
    search = found.has_qp and (found.solve or goes_on)
    curved = search and exact and not p.couples_free_start
    relaxable = found.hard_rows and (search or found.solve or found.relax)
    nonlinear = found.has_qp and p.nonlinear_rows
    eliminates = parts.condensing is not None and parts.condensing.eliminates
    checked = eliminates and not found.approximate
    condensed = parts.condensing is not None and parts.condensing.gives == "condensed"
    return replace(
        found,
        kernels=found.kernels | _gradients_of_cost(model, found, eliminates),
        tuned=tuned,
        takes_penalties=found.set_soft and found.has_qp,
        two_hessians=bool(model.exact),
        curved=curved,
        keeps_multipliers=curved or found.stage_multipliers,
        relaxation=relaxable,
        priced_rows=found.relax
        and any(k < p.N and p.rows[row].hard and p.rows_on_states[row] for k, _, _, row in p.qp_rows),
        elastic=relaxable or any(row.soft is not None for row in p.rows),
        nonlinear_rows=nonlinear,
        nonlinear_model=found.has_qp and p.nonlinear_model,
        search=search,
        judges=bends and found.judges,
        iterates=goes_on,
        exact_qp=found.has_qp and not bends,
        shifts_back=goes_on and parts.algorithm.shift == "repeat" and not found.idle_end,
        row_scales=relaxable or nonlinear or search,
        check_step=checked,
        check_gradient=checked and condensed,
    )


def _of_problem(model: Model) -> Features:
    """The features of the problem, the options and the target."""
    p, parts, target = model.problem, model.parts, model.target
    kinds, imposed = {kind for _, kind, _, _ in p.qp_rows}, {(k, row) for k, _, _, row in p.qp_rows}
    eliminates = parts.condensing is not None and parts.condensing.eliminates
    computing = {r.name for r in model.routines if r.writes}
    computing |= {"state_step", "adjoint_step"} if eliminates else set()
    core, layouts = parts.algorithm.core, model.options.online.layouts
    return Features(
        kernels=frozenset(name for name in KERNELS if name in computing),
        set_reference=_is_set(model, "reference"),
        set_weight=_is_set(model, "weight"),
        set_parameter=_is_set(model, "parameter"),
        set_bounds=_is_set(model, "bounds"),
        set_soft=_is_set(model, "soft"),
        reference_by_node=layouts["reference"] == "node",
        weight_by_node=layouts["weight"] == "node",
        parameter_by_node=layouts["parameter"] == "node",
        bounds_by_node=layouts["bounds"] == "node",
        soft_by_node=layouts["soft"] == "node",
        state_rows=0 in kinds,
        general_rows=1 in kinds,
        hard_rows=any(p.rows[row].hard for _, _, _, row in p.qp_rows),
        rows_move=any((k + 1, row) in imposed for k, row in imposed),
        proximal=bool(p.proximal),
        saddles=any(slope >= 0 for slope in model.problem.saddles.slopes),
        idle_states=any(model.problem.saddles.drivers),
        idle_end=p.idle_end and parts.algorithm.shift == "repeat",
        end_equations=any(k == p.N and p.rows[row].is_equation for k, _, _, row in p.qp_rows),
        pulled_rows=bool(p.pulled_rows),
        control_bounds=any(place >= 0 for place in control_rows(p)),
        accumulators=bool(p.accumulators),
        all_measured=not p.accumulators and not p.free_initial,
        inner=bool(p.augmentation.count),
        previous=bool(p.augmentation.previous),
        timed=p.augmentation.time,
        estimator=p.estimation is not None,
        known_controls=p.estimation is not None and p.estimation.nu > 0,
        solve=model.options.solves,
        nodes="nodes" in core,
        products="products" in core,
        kkt="kkt" in core,
        has_qp="qp" in parts.algorithm.needs,
        stage_multipliers=not eliminates,
        terminal_block=bool(model.products.Q_N),
        single=model.options.precision == "single",
        own_math=model.options.math == "own",
        small=model.options.goal == "size",
        scalar=target.sums == "variables" or model.options.goal == "size",
        avx512=target.avx512,
    )


def _is_set(model: Model, kind: Kind) -> bool:
    """True if data of this kind exist and can be changed at run time."""
    p = model.problem
    residuals = p.path.ny + p.terminal.ny
    sizes: dict[Kind, int] = {
        "reference": residuals,
        "weight": residuals,
        "parameter": len(p.own_parameters),
        "bounds": len(p.rows),
        "soft": sum(row.soft is not None for row in p.rows),
    }
    return model.options.online.layouts[kind] != "fixed" and sizes[kind] > 0


def _gradients_of_cost(model: Model, found: Features, eliminates: bool) -> set[KernelName]:
    """Whether g + Q z is a product over the nonzeros: for elimination, and on stages if the Hessian keeps them few."""
    changes = found.regularize_stages or found.regularize_reduced
    changes |= found.has("start_hessian") or found.has("initial_hessian")
    keeps = model.parts.condensing is not None and not changes
    path, terminal = model.products.sparse
    kernels: set[KernelName] = {"cost_gradient"} if keeps and not eliminates and path else set()
    return kernels | ({"terminal_adjoint"} if eliminates or (keeps and terminal) else set())


def _section_count(counts: Counts) -> OpCount | None:
    return sum(counts.values(), OpCount()) if counts else None


def _macros(model: Model, dims: Dims, whole: bool) -> tuple[Macro, ...]:
    core = [s for s in vars(dims).values() if isinstance(s, Size) and (s.text != "NQ" or model.parts.hessian)]
    of_qp: Iterable[Size] = () if dims.condensed is None else vars(dims.condensed).values()
    inner = model.problem.augmentation
    others = {*(() if inner.count else ("NXHAT",)), *(() if model.problem.estimation else ("NM", "NIN"))}
    kept = [s for s in (*core, *of_qp) if s.text not in others]
    macros = [Macro(s.text, s.value, DOCS[s.text], shown=_in_header(s, model.problem)) for s in kept]
    macros += _inner_macros(model)
    if dims.condensed:
        macros.append(Macro("PANEL", PANEL, "columns processed together"))
    macros += _data_macros(model.problem)
    macros += _probe_macros(model.problem.saddles)
    macros.append(Macro("ALGEBRAIC", len(model.problem.algebraic_names), "algebraic variables"))
    macros.append(Macro("PULLS", PULLS, "moves of a control back onto rows, at most"))
    parameters = model.problem.own_parameters
    macros.append(Macro("PARAMS", len(parameters), "parameters by name"))
    names = c_constants([s.name for s in parameters])
    macros += [Macro(f"SIZE_{c}", s.size, f"elements of {s.name}") for c, s in zip(names, parameters, strict=True)]
    for component in model.parts.components:
        macros += [Macro(*entry) for entry in component.sizes(dims)]
    parts = model.parts
    reach = parts.algorithm.reach(model.problem) / parts.integrator.longest_step(model.problem)
    if reach or whole:
        steps = math.ceil(reach + ROUNDING_OF_STEPS)
        macros.append(Macro("PLAN_STEPS", steps, "integration steps from a node of the plan to a new one, at most"))
    macros.append(Macro("MANY", MANY, "most integration steps of one call, and largest count of samples"))
    macros.append(Macro("MAGIC", MAGIC, "marks a struct that init has initialised"))
    if whole:
        absent = (entry for component in parts.components for entry in component.absent_sizes(dims))
        macros += [Macro(*entry) for entry in (*SIZES_OF_OTHERS, *absent)]
    public = {s for e in _entries(model) for a in (*e.inputs, *e.outputs) for s in a.shape}
    public.update(INTERFACE_SIZES, (f"SIZE_{name}" for name in names))
    found = {macro.name: replace(macro, public=macro.name in public) for macro in reversed(macros)}
    if clash := [macro.name for macro in macros if not whole and found[macro.name].value != macro.value]:
        raise ValueError(f"two components state the size {clash[0]}, with different values")
    return tuple(found.values())[::-1]


def _data_macros(problem: Problem) -> tuple[Macro, ...]:
    """What penalties, noise and bounds of parameters there are."""
    soft = [row for row in problem.rows if row.soft is not None]
    scaled, bounded = any(row.scaled for row in soft), any(s.low for s in problem.own_parameters)
    return (
        Macro("SOFT_ROWS", len(soft), "rows with a penalty"),
        Macro("NOISES", len(problem.noise), "controls that are noise at the end of an interval"),
        Macro("SCALED_PENALTIES", int(scaled), "1: penalties of a row are times dt_k"),
        Macro("BOUNDED_PARAMETERS", int(bounded), "1: some parameters have bounds"),
    )


def _probe_macros(saddles: Saddles) -> tuple[Macro, ...]:
    """How idle controls are probed."""
    partners = any(partner >= 0 for partner in saddles.partners)
    return (
        Macro("PROBES", len(PROBE_SIZES), "sizes of a move of an idle control that are tried"),
        Macro("PROBE_PARTS", PROBE_PARTS, "halvings of a probe, at most"),
        Macro("PARTNERS", int(partners), "1: some controls act by a product"),
    )


def _inner_macros(model: Model) -> tuple[Macro, ...]:
    """Sizes of what stands behind the states and parameters of the user."""
    inner = model.problem.augmentation
    return (
        Macro("NBAND", model.products.banded, "the last states, which act on no other one"),
        Macro("NMEM", len(inner.previous), "controls that a node knows of the node before"),
        Macro("NHELD", len(inner.held), "controls with blocks"),
        Macro("NDATA", inner.data, "parameters behind those of the user"),
    )


def _in_header(size: Size, problem: Problem) -> int | None:
    """What the header says of the number of states or parameters, if others stand behind those of the user."""
    inner = problem.augmentation
    hidden = {"NX": inner.count, "NP": problem.data_behind}.get(size.text, 0)
    return size.value - hidden if hidden else None


#: What sets the states behind the measured ones.
SET_PREVIOUS = EntryPoint(
    "set_previous",
    "The control that the actuator applied last, where it is not the one that was returned; for the next sample, or "
    "the present one between prepare and feedback.",
    (Argument("u", "real", ("NU",)),),
)
SET_TIME = EntryPoint(
    "set_time",
    "Time of the next sample; every sample moves it on by DT.",
    (Argument("time", "real"),),
)


#: What finds the algebraic variables of a state.
ALGEBRAIC = EntryPoint(
    "algebraic",
    "Algebraic variables at the state x and the controls u, with the parameters of node k; x[k] and u[k] of the plan "
    "have those of the plan, x[N] with u[N - 1].",
    (Argument("k", "int"), Argument("x", "real", ("NX",)), Argument("u", "real", ("NU",))),
    (Argument("z", "real", ("ALGEBRAIC",)),),
)


def _entries(model: Model) -> tuple[EntryPoint, ...]:
    """The functions of the algorithm, and those of the states behind the measured ones."""
    inner = model.problem.augmentation
    more = (*((SET_PREVIOUS,) if inner.previous else ()), *((SET_TIME,) if inner.time else ()))
    more += (ALGEBRAIC,) if model.problem.algebraic_names else ()
    return (*model.parts.algorithm.entries(_features(model)), *more)


#: Values of k that are allowed besides ALL, for every kind of data that can be changed at run time.
_NODES: Mapping[Kind, Mapping[Layout, str]] = {
    "reference": {"shared": "no node", "node": "0 .. N - 1"},
    "weight": {"shared": "no node", "node": "0 .. N - 1"},
    "parameter": {"shared": "N", "node": "0 .. N"},
    "bounds": {"shared": "N, if the row holds there", "node": "a node of the row"},
    "soft": {"shared": "N, if the row holds there", "node": "a node of the row"},
}


def _setters(model: Model) -> tuple[Setter, ...]:
    """The setters of all data that exist in the problem and can be changed."""
    layouts = model.options.online.layouts
    estimates = model.problem.estimation is not None
    return tuple(
        Setter(n, "no node" if estimates and n == "parameter" else nodes[layouts[n]])
        for n, nodes in _NODES.items()
        if _is_set(model, n)
    )


def _description(
    model: Model,
    name: str,
    macros: tuple[Macro, ...],
    structs: tuple[Struct, ...],
    report: Report,
    ranges: Mapping[str, tuple[int, int]],
) -> PackageDescription:
    """The data that Controller and open_package() need besides the C text."""
    p, sizes = model.problem, model.problem.scales
    return PackageDescription(
        name=name,
        precision=model.options.precision,
        target=model.target.name,
        sizes={m.name: m.value for m in macros},
        structs=structs,
        states=p.own_states,
        augmentation=p.augmentation,
        controls=() if p.augmentation.idle else p.controls,
        parameters=p.own_parameters,
        rows=p.rows,
        residuals=_residuals(p, p.path),
        residuals_N=_residuals(p, p.terminal),
        dt=p.dt,
        discrete=p.discrete,
        time_unit="samples" if p.discrete else p.time_unit,
        statuses=tuple(Status.__members__),
        shift=model.parts.algorithm.shift,
        sampling_time=sampling_period(model.parts.algorithm.shift, model.parts.algorithm.sampling_time, p),
        entry_points=_entries(model),
        online=model.options.online.layouts,
        options=as_data(model.options),
        report=report,
        ranges=ranges,
        algebraic=p.algebra.signals if p.algebra else (),
        estimation=p.estimation,
        newton=p.newton_names,
        scales=tuple(round_scales([*sizes.z[: p.measured], *sizes.z[p.nx : p.nx + p.nu - p.augmentation.idle]])),
        row_scales=tuple(round_scales(sizes.rows)),
    )


def _residuals(problem: Problem, stage: Stage) -> tuple[Residual, ...]:
    """The residuals of a stage, with the states and controls that they are."""
    names = (*problem.state_names, *problem.control_names, "")  # the last one for -1
    signals = [names[place] for place in stage.y_elements]
    values = [float(value) for value in stage.reference]
    return tuple(map(Residual, stage.y_names, values, signals))


def _report(
    model: Model,
    dims: Dims,
    features: Features,
    structs: tuple[Struct, ...],
    layout: Mapping[str, tuple[int, int]],
) -> Report:
    """Memory, exact operation counts, and the choices with their reasons."""
    counts = {r.name: r.count for r in _printed_routines(model)}
    if features.products:
        called = model.products.called_vectors(features)
        counts |= {name: routine.count for name, routine in called.items()}
    if model.parts.condensing and model.parts.condensing.columns:
        counts |= model.products.column_counts
    for component in model.parts.components:
        counts |= component.cost(dims, model)
    return Report(
        ram_bytes=layout["solver"][0],
        ram_bytes_by_struct={s.name: layout[s.name][0] * s.count for s in structs},
        operations=counts,
        linearization_operations=counts.get("linearize", OpCount()).total,
        choices=model.choices.reasons,
        looped=tuple(r.name for r in _printed_routines(model) if len(r.kernels) > 1),
    )
