"""Choice of the Hessian: that of the algorithm, unless the problem has what only the exact one supports."""

from __future__ import annotations

from dataclasses import replace

from nmpc_codegen.components.hessians import ExactHessian, GaussNewton
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.options import Options


def choose_hessian(problem: Problem, options: Options) -> tuple[Options, tuple[str, ...]]:
    """The options with a Hessian, and the reason if it is not the default of the algorithm.

    Gauss-Newton is that of samples of a least-squares problem, whatever its rows: one step of it is short enough
    beside an obstacle, where a step with an exact Hessian that is made convex may be far too long.
    """
    if options.hessian is not None or options.algorithm.default("hessian") != GaussNewton.name:
        return options, ()
    beyond = problem.features - GaussNewton.supports
    if not beyond or not beyond <= ExactHessian.supports:
        return options, ()
    why = f"the problem has a {sorted(beyond)[0]}"
    exact = ExactHessian() if options.algorithm.convex else ExactHessian(regularization=None)
    return replace(options, hessian=exact), (f"hessian: {ExactHessian.name}; {why}",)


def couples_free_start(problem: Problem) -> bool:
    """True if rows couple x_N with components of x_0 that the solver chooses: a recursion over the stages alone cannot
    hold such equations. solve() then leaves an indefinite Hessian to the route of the QP."""
    return bool(problem.coupled_rows and problem.free_initial)


def solves_exactly(problem: Problem, options: Options, chosen: bool) -> bool:
    """True if solve() has the exact Hessian although samples have another: nothing was ``chosen`` by the user, and the
    package is not for a microcontroller, where a second Hessian is too much code."""
    approximate = isinstance(options.hessian, GaussNewton) and "qp" in options.algorithm.needs
    roomy = options.solve and options.goal == "speed" and options.processor == "vector"
    return approximate and chosen and roomy and not couples_free_start(problem)
