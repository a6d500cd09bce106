"""What users are told of a package beside its files: the program of its expressions, and what gives poor results."""

from __future__ import annotations

from dataclasses import replace

from nmpc_codegen.components.hessians import ExactHessian
from nmpc_codegen.frontend.flat import flat_controls
from nmpc_codegen.frontend.program import program
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.first_plan import first_plan_warnings
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.stability import stability_warning
from nmpc_codegen.package.program import Program


def explained(module: CModule, model: Model) -> CModule:
    """The package with the program, by which diagnose() finds a number that is not finite, and with warnings."""
    found, description = program(model.problem), module.description
    report = replace(description.report, warnings=warnings(model, found))
    return replace(module, description=replace(description, program=found, report=report))


def warnings(model: Model, found: Program) -> tuple[str, ...]:
    """What is likely to give poor results, with the remedies; ``found``: the program of the problem."""
    problem, algorithm = model.problem, model.parts.algorithm
    second = bool(model.exact) or isinstance(model.parts.hessian, ExactHessian)
    return (
        *_flat(model),
        *stability_warning(problem, model.parts.integrator),
        *(model.grown.of_simulation(type(algorithm).__name__, problem.N) if algorithm.simulates else ()),
        *first_plan_warnings(problem, found, second),
        *(() if model.choice is None else model.choice.warnings),
    )


def _flat(model: Model) -> tuple[str, ...]:
    """Controls without curvature, if proximal terms make up for it."""
    if not model.problem.proximal:
        return ()
    names = (model.problem.control_names[j] for j in flat_controls(model.problem, model.scales))
    where = f"the cost has no curvature in {', '.join(names)}"
    return (f"{where}, so that plans may jump between bounds; a small weight makes the plan unique",)
