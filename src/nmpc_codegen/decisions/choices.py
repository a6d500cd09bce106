"""Choices lists the components of a package, each with the reason for it."""

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
    """A decision is a chosen value with the sentences of the report that explain the choice.

    ``stated`` is True if the options gave the value of an integrator or a Hessian.
    """

    value: T_co
    reasons: tuple[str, ...] = ()
    stated: bool = False


@dataclass(frozen=True)
class QpChoice:
    """A QP choice has condensing and QP solver, the reasons, and warnings of the accuracy that they lose."""

    condensing: Condensing
    qp: QpSolver
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Choices:
    """The choices determine everything in a package.

    exact: blocks of the exact Hessian of solve(), if samples have another one; qp: condensing and QP solver, None while
    they are open and if the algorithm has no QP; online: data that can be changed at run time; options: all choices as
    options, or the user's while something is open; constant_hessian: True if the path Hessian block is the same at all
    nodes; trials: integration schemes that were tried; made: functions of the stages that were counted; grown: growth
    of the open loop.
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
        """Return the components."""
        of_qp = (None, None) if self.qp is None else (self.qp.condensing, self.qp.qp)
        return Parts(self.integrator.value, self.algorithm.value, self.hessian.value, *of_qp)

    @cached_property
    def dims(self) -> Dims:
        """Return the sizes that the components share."""
        return self.dims_with(self.parts.condensing)

    def dims_with(self, condensing: Condensing | None) -> Dims:
        """Return these sizes with another condensing."""
        banded, goal = self.made.products.banded, self.options.goal
        return dimensions(self.problem, condensing, self.constant_hessian, goal, banded)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return all choices with their reasons, for the report."""
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
    """Return the words of the report and of a warning on controls without curvature."""
    return f"the cost has no curvature in {', '.join(flat)}"
