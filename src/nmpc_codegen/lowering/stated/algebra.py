"""Algebraic variables have a number, and a function that computes them for a state."""

from __future__ import annotations

from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Macro
from nmpc_codegen.package.signals import Argument, EntryPoint

#: The function that computes the algebraic variables of a state.
ALGEBRAIC = EntryPoint(
    "algebraic",
    "Compute the algebraic variables at the state x and the controls u, with the parameters of node k; x[k] and u[k] "
    "of the plan give those of the plan, x[N] with u[N - 1].",
    (Argument("k", "int"), Argument("x", "real", ("NX",)), Argument("u", "real", ("NU",))),
    (Argument("z", "real", ("ALGEBRAIC",)),),
)


def entries(problem: Problem) -> tuple[EntryPoint, ...]:
    """Return the function that computes algebraic variables, if there are any."""
    return (ALGEBRAIC,) if problem.algebraic_names else ()


def macros(problem: Problem) -> tuple[Macro, ...]:
    """Return the macro ALGEBRAIC, the number of algebraic variables."""
    return (Macro("ALGEBRAIC", len(problem.algebraic_names), "algebraic variables"),)
