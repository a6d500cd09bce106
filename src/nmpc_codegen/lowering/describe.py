"""The description of a package holds what Controller and open_package() need besides the C text."""

from __future__ import annotations

from collections.abc import Mapping

from nmpc_codegen.components.algorithms.shifts import sampling_period
from nmpc_codegen.frontend.completion.scales import round_scales
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.ir.cmodule import Macro
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.options import as_data
from nmpc_codegen.package.description import PackageDescription, Report
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.signals import EntryPoint, Residual
from nmpc_codegen.package.status import Status
from nmpc_codegen.package.struct_layout import Struct


def describe(
    model: Model,
    name: str,
    macros: tuple[Macro, ...],
    structs: tuple[Struct, ...],
    entries: tuple[EntryPoint, ...],
    report: Report,
) -> PackageDescription:
    """Return the data that Controller and open_package() need besides the C text."""
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
        entry_points=entries,
        online=model.options.online.layouts,
        options=as_data(model.options),
        report=report,
        ranges={name: limits for c in model.parts.components for name, limits in c.ranges(model.dims).items()},
        algebraic=p.algebra.signals if p.algebra else (),
        estimation=p.estimation,
        newton=p.newton_names,
        scales=tuple(round_scales([*sizes.z[: p.measured], *sizes.z[p.nx : p.nx + p.nu - p.augmentation.idle]])),
        row_scales=tuple(round_scales(sizes.rows)),
    )


def _residuals(problem: Problem, stage: Stage) -> tuple[Residual, ...]:
    """Return the residuals of a stage, each with the state or control that it equals."""
    names = (*problem.state_names, *problem.control_names, "")  # the last one for -1
    signals = [names[place] for place in stage.y_elements]
    values = [float(value) for value in stage.reference]
    return tuple(map(Residual, stage.y_names, values, signals))


def report_of(
    model: Model, features: Features, structs: tuple[Struct, ...], layout: Mapping[str, tuple[int, int]]
) -> Report:
    """Return memory, exact operation counts, and the choices with their reasons."""
    counts = {r.name: r.count for r in model.printed}
    if features.products:
        called = model.products.called_vectors(features)
        counts |= {name: routine.count for name, routine in called.items()}
    if model.parts.condensing and model.parts.condensing.gives == "condensed":
        counts |= model.products.column_counts
    for component in model.parts.components:
        counts |= component.cost(model.dims, model)
    return Report(
        ram_bytes=layout["solver"][0],
        ram_bytes_by_struct={s.name: layout[s.name][0] * s.count for s in structs},
        operations=counts,
        linearization_operations=counts.get("linearize", OpCount()).total,
        choices=model.choices.reasons,
        looped=tuple(r.name for r in model.printed if len(r.kernels) > 1),
    )
