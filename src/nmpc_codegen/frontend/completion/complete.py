"""complete() turns a Problem into a CompleteProblem: it adds everything that follows from the problem, once.

It adds, in this order: the terminal cost of lqr_terminal_cost(), sizes of all quantities, ties of controls to those of
the previous node, flags of variables at saddles, proximal terms.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pkgutil import resolve_name
from typing import Protocol

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.completion.saddles import Saddles, find_saddles
from nmpc_codegen.frontend.completion.scales import Scales, scales
from nmpc_codegen.frontend.completion.undetermined import flat_controls, proximal_terms
from nmpc_codegen.frontend.problem import Problem, Stage


class Asked(Protocol):
    """Completion depends on these options.

    They say whether declared diagonal weights are stored as matrices, and whether samples solve QPs with a chosen
    Hessian, whose steps proximal terms may limit.
    """

    @property
    def stores_matrices(self) -> bool: ...

    @property
    def limits_steps(self) -> bool: ...


@dataclass(frozen=True, eq=False, kw_only=True)
class CompleteProblem(Problem):
    """A complete problem has everything that follows from a problem.

    ``scales`` are the sizes of its quantities; ``saddles`` marks controls and states whose slope vanishes somewhere;
    ``flat`` names the controls without curvature, which get proximal terms.
    """

    scales: Scales
    saddles: Saddles
    flat: tuple[str, ...]


def complete(problem: Problem, options: Asked) -> CompleteProblem:
    """Return the problem with everything that follows from it and from the options.

    Raises:
        ProblemError: the terminal cost of lqr_terminal_cost() does not exist.
    """
    if problem.terminal_lqr is not None:
        problem = resolve_name(problem.terminal_lqr.rule)(problem, options)
    sizes = scales(problem)
    path, terminal = (replace(s, dense_weight=options.stores_matrices) for s in (problem.path, problem.terminal))
    flat = flat_controls(problem, sizes) if options.limits_steps and problem.estimation is None else ()
    stated = {field.name: getattr(problem, field.name) for field in fields(Problem)}
    stated |= {"path": _with_ties(path, problem, sizes), "terminal": terminal}
    stated |= {"proximal": proximal_terms(problem, sizes) if flat else ()}
    return CompleteProblem(
        **stated,
        scales=sizes,
        saddles=find_saddles(problem, sizes.z),
        flat=tuple(problem.control_names[j] for j in flat),
    )


def _with_ties(path: Stage, problem: Problem, sizes: Scales) -> Stage:
    """Return the path with residuals that tie controls to those of the previous node, where no block begins.

    A control without effect is tied to 0.
    """
    added = problem.augmentation
    if added.idle:
        return replace(path, ties=path.u)
    ties = []
    for i, j in enumerate(added.held):
        begins = path.p[problem.np - added.data + i]
        before = path.x[problem.measured + added.places[j]]
        weight = float(np.sqrt(sizes.cost)) / float(sizes.z[problem.nx + j])
        ties.append(weight * (1 - begins) * (path.u[j] - before))
    return replace(path, ties=ca.vertcat(*ties)) if ties else path
