"""Choices: what a package consists of, each part with the reason for it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

from nmpc_codegen.components.base import Algorithm, Condensing, Dims, Hessian, Integrator, Parts, QpSolver
from nmpc_codegen.decisions.dimensions import dimensions
from nmpc_codegen.decisions.growth import Growth
from nmpc_codegen.decisions.made import Made
from nmpc_codegen.decisions.trials import Trials
from nmpc_codegen.frontend.completion.complete import CompleteProblem
from nmpc_codegen.ir.model import HessianModel
from nmpc_codegen.options import Online, Options
from nmpc_codegen.targets import Target

T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True)
class Decision(Generic[T_co]):
    """``value``: what has been chosen; ``reasons``: sentences of the report; ``stated``, of an integrator or a Hessian:
    the options gave the value."""

    value: T_co
    reasons: tuple[str, ...] = ()
    stated: bool = False


@dataclass(frozen=True)
class QpChoice:
    """Condensing, QP solver, the reasons for them, and warnings of the digits that they cost."""

    condensing: Condensing
    qp: QpSolver
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Choices:
    """What a package consists of.

    ``exact``: the blocks of the exact Hessian of solve(), where samples have another; ``qp``: condensing and QP solver,
    None while they are open and if the algorithm has no QP; ``online``: what can be changed at run time; ``options``:
    all of it as options, or those of the user while something is open. ``constant_hessian``: the path Hessian block is
    the same at all nodes. ``trials``: integration schemes that were tried; ``made``: functions of the stages that were
    counted; ``grown``: growth of the open loop.
    """

    problem: CompleteProblem
    integrator: Decision[Integrator]
    hessian: Decision[Hessian | None]
    exact: Decision[HessianModel | None]
    algorithm: Decision[Algorithm]
    qp: QpChoice | None = None
    online: Decision[Online]
    target: Decision[Target]
    options: Options
    constant_hessian: bool
    trials: Trials
    made: Made
    grown: Growth

    @cached_property
    def parts(self) -> Parts:
        """The components."""
        of_qp = (None, None) if self.qp is None else (self.qp.condensing, self.qp.qp)
        return Parts(self.integrator.value, self.algorithm.value, self.hessian.value, *of_qp)

    @cached_property
    def dims(self) -> Dims:
        """The sizes that the components share."""
        return self.dims_with(self.parts.condensing)

    def dims_with(self, condensing: Condensing | None) -> Dims:
        """These sizes with another condensing."""
        banded, goal = self.made.products.banded, self.options.goal
        return dimensions(self.problem, condensing, self.constant_hessian, goal, banded)

    @property
    def reasons(self) -> tuple[str, ...]:
        """All choices with their reasons, for the report."""
        problem = self.problem
        notes = (note for component in self.parts.components for note in component.notes(problem))
        idle = [problem.control_names[j] for j in problem.saddles.controls]
        idle += [problem.state_names[i] for i in problem.saddles.states]
        return (
            *self.integrator.reasons,
            *self.target.reasons,
            *((f"proximal terms in the QPs of samples: {no_curvature_in(problem.flat)}",) if problem.flat else ()),
            *self.hessian.reasons,
            *self.exact.reasons,
            *self.algorithm.reasons,
            *self.online.reasons,
            *notes,
            *((f"probes at saddles: the slope of {', '.join(idle)} vanishes somewhere",) if idle else ()),
            *(() if self.qp is None else self.qp.reasons),
        )


def no_curvature_in(flat: tuple[str, ...]) -> str:
    """What the report and a warning say of controls without curvature."""
    return f"the cost has no curvature in {', '.join(flat)}"
