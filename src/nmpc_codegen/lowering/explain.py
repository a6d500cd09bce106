"""Users get explanations of a package besides its files: the program of its expressions, and warnings."""

from __future__ import annotations

from dataclasses import replace

from nmpc_codegen.components.hessians import ExactHessian
from nmpc_codegen.decisions.choices import no_curvature_in
from nmpc_codegen.decisions.scheme_warnings import scheme_warnings
from nmpc_codegen.frontend.row_program import program
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.warnings import first_plan_warnings
from nmpc_codegen.package.program import Program

#: Words on the consequence of controls without curvature.
JUMPS = "so that plans may jump between bounds; a small weight makes the plan unique"


def explain(module: CModule, model: Model) -> CModule:
    """Return the package with warnings, and with the program in which diagnose() finds numbers that are not finite."""
    found, description = program(model.problem), module.description
    report = replace(description.report, warnings=warnings(model, found))
    return replace(module, description=replace(description, program=found, report=report))


def warnings(model: Model, found: Program) -> tuple[str, ...]:
    """Return warnings of likely poor results, with remedies; ``found`` is the program of the problem."""
    problem, choices, algorithm = model.problem, model.choices, model.parts.algorithm
    second = bool(model.exact) or isinstance(model.parts.hessian, ExactHessian)
    return (
        *((f"{no_curvature_in(problem.flat)}, {JUMPS}",) if problem.flat else ()),
        *scheme_warnings(choices.trials, choices.integrator),
        *(choices.grown.of_simulation(type(algorithm).__name__, problem.N) if algorithm.simulates else ()),
        *(() if problem.estimation else first_plan_warnings(problem, found, second)),
        *(() if choices.qp is None else choices.qp.warnings),
    )
