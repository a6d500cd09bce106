"""The Hessian of samples is chosen here, and the exact one that solve() may use in addition."""

from __future__ import annotations

from nmpc_codegen.components.base import Hessian, Integrator
from nmpc_codegen.components.hessians import ExactHessian, GaussNewton
from nmpc_codegen.components.stage_cost import StageCosts
from nmpc_codegen.decisions.choices import Decision
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.model import HessianModel
from nmpc_codegen.options import Options


def choose_hessian(problem: Problem, options: Options) -> Decision[Hessian | None]:
    """Return the Hessian of samples: the given one, or the algorithm's default unless the problem needs another.

    Samples of a least-squares problem use the Gauss-Newton Hessian, whatever the rows of the problem. An exact Hessian
    has to be made convex near a nonconvex row, and its full step may then be far too long.
    """
    beyond, default = problem.uses - GaussNewton.supports, options.with_defaults.hessian
    if options.hessian is not None:
        return Decision(options.hessian, stated=True)
    if not isinstance(default, GaussNewton) or not beyond or not beyond <= ExactHessian.supports:
        return Decision(default)
    exact = ExactHessian() if options.algorithm.convex else ExactHessian(regularization=None)
    return Decision(exact, (f"hessian: {ExactHessian.name}; the problem has a {sorted(beyond)[0]}",))


def choose_exact(
    problem: Problem, options: Options, hessian: Decision[Hessian | None], costs: StageCosts, integrator: Integrator
) -> Decision[HessianModel | None]:
    """Return the blocks of the exact Hessian that solve() uses beside the Gauss-Newton one of samples, if there is one.

    It exists if the compiler has chosen the Hessian of samples, and the package has room for a second one.
    """
    approximate = isinstance(hessian.value, GaussNewton) and "qp" in options.algorithm.needs
    roomy = options.solves and options.goal == "speed"
    if not (approximate and roomy) or hessian.stated or problem.couples_free_start:
        return Decision(None)
    try:
        blocks = ExactHessian().blocks(problem, costs, integrator)
    except OptionError as error:
        return Decision(None, (f"solve(): the Hessian of the samples; {error}",))
    return Decision(blocks, ("solve(): exact Hessian; for convergence from afar",))
