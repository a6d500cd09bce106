"""--check compares the generated code with IPOPT, from the declared initial state."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmpc_codegen.cli.printing import Printer
from nmpc_codegen.compiler import generate
from nmpc_codegen.economic.stage import tableau
from nmpc_codegen.errors import OptionError, ProblemWarning
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.complete import complete
from nmpc_codegen.oracle.reference import Reference, node_data
from nmpc_codegen.runtime.build import load

if TYPE_CHECKING:
    from nmpc_codegen.frontend.ocp import OCP
    from nmpc_codegen.options import Options
    from nmpc_codegen.runtime.controller import Solution

#: Limits on |a - b| / max(1, max|b|) of controls and states, and on the relative error of the cost.
LIMITS = {"double": {"u": 1e-6, "x": 1e-6, "cost": 1e-8}, "single": {"u": 1e-3, "x": 1e-3, "cost": 1e-4}}
CHECK_TOLERANCE = {"double": 1e-9, "single": 1e-3}
CHECK_ITERATIONS = 1000
CHECK_STEPS = 5000  # largest number of integrator steps over the horizon
COST_FLOOR = 1e-6  # least cost to which a relative error refers, so that a problem that starts at its goal can pass
#: Largest amount that IPOPT's barrier adds to the cost for a row at a node: for both sides, and for both slacks of a
#: soft row.
BARRIER = 4e-12


def check(ocp: OCP, options: Options, folder: Path, name: str, printer: Printer) -> bool:
    """Compile with warnings as errors, solve from the declared initial state, and compare with IPOPT.

    IPOPT starts from the same point as the generated code. If it ends at another local optimum, it is restarted at the
    solution of the generated code, which it must then return.
    """
    problem = complete(classify(ocp, options.algorithm.sampling_time), options)
    scheme = tableau(problem, options)
    refuse_long(scheme.steps * len(problem.dt))
    files: Mapping[str, str] = {
        f"{name}.{ext}": (folder / f"{name}.{ext}").read_text(encoding="utf-8") for ext in ("h", "c", "json")
    }
    controller = load(files, name, "verify", warnings_as_errors=True)
    if not options.solves:
        printer.line("--check: the package has no solve(); the same package with solve() is checked instead")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ProblemWarning)  # export() has issued them
            files = generate(ocp, replace(options, solve=True), name)
        controller = load(files, name, "verify", warnings_as_errors=True)
    solution = controller.solve(
        problem.x_initial[: problem.measured], CHECK_TOLERANCE[options.precision], CHECK_ITERATIONS
    )
    nlp = Reference(problem, scheme)
    data = node_data(problem)
    reference = nlp.solve(data)
    gap = BARRIER * sum(len(row.nodes) for row in controller.description.rows)
    errors = compare(solution, reference, gap)
    limits = LIMITS[options.precision]
    if any(not errors[key] <= limits[key] for key in limits):
        nearby = nlp.solve(data, x=np.asarray(controller.whole_x, dtype=float), u=solution.u)
        if nearby.success:
            reference, errors = nearby, compare(solution, nearby, gap)
    solved = solution.status.name in ("OK", "STALLED")
    passed = solved and reference.success and all(errors[key] <= limits[key] for key in limits)
    facts = {"errors": errors, "limits": limits, "status": solution.status.name, "iterations": solution.iterations}
    facts |= {"cost": solution.cost, "ipopt": {"status": reference.status, "cost": reference.cost}, "passed": passed}
    printer.note("check", facts)
    _print_check(printer, solution, reference, errors, limits, passed)
    if not passed:
        printer.line(controller.diagnose(), style="yellow")
    return passed


def refuse_long(steps: int) -> None:
    """Raise OptionError if IPOPT would take more than about a minute."""
    if steps > CHECK_STEPS:
        raise OptionError(
            f"--check: IPOPT would take {steps:,} steps of the integrator per evaluation; expected at most "
            f"{CHECK_STEPS:,}: check with fewer steps, or with an implicit scheme, "
            "--set integrator=implicit_runge_kutta"
        )


def compare(solution: Solution, reference: Any, gap: float = 0.0) -> dict[str, float]:
    """Return the largest |a - b| / max(1, max|b|) of all components of u and of x, and the relative error of the cost.

    b is the reference; the cost may differ by the ``gap`` that a barrier causes.
    """
    difference = max(abs(solution.cost - reference.cost) - gap, 0.0)
    errors = {"cost": difference / max(abs(reference.cost), COST_FLOOR)}
    own = reference.x[:, : solution.x.shape[1]]  # without added states
    for key, ours, theirs in (("u", solution.u, reference.u), ("x", solution.x, own)):
        size = np.maximum(1.0, np.abs(theirs).max(axis=0, initial=0.0))
        errors[key] = float((np.abs(ours - theirs) / size).max(initial=0.0))
    return errors


def _print_check(
    printer: Printer,
    solution: Solution,
    reference: Any,
    errors: Mapping[str, float],
    limits: Mapping[str, float],
    passed: bool,
) -> None:
    for key, limit in limits.items():
        fits = errors[key] <= limit
        words = (
            f"differs from IPOPT's by {errors[key]:.1e} of its size, allowed {limit:.0e}{'' if fits else ': FAILED'}"
        )
        printer.line(f"{key:<7} {words}", style="" if fits else "red")
    ours = f"{solution.status.name} ({solution.status.meaning}), {solution.iterations} iterations"
    printer.line(f"generated code: {ours}, cost {solution.cost:.10g}")
    theirs = f"{reference.status}, {reference.iterations} iterations"
    printer.line(f"IPOPT: {theirs}, cost {reference.cost:.10g}")
    printer.line("check passed" if passed else "check FAILED", style="green" if passed else "red")
