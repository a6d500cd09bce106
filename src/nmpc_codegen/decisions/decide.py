"""CompleteProblem, Options -> Choices: every choice that the options leave open, once, with its reason."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from nmpc_codegen.components.base import Algorithm, Component, Dims, Hessian, Integrator, Parts, refuse_unsupported
from nmpc_codegen.decisions.decision import Decision
from nmpc_codegen.decisions.dimensions import dimensions
from nmpc_codegen.decisions.growth import Growth, growth
from nmpc_codegen.decisions.integrator import choose_integrator
from nmpc_codegen.decisions.made import Made, is_constant, make
from nmpc_codegen.decisions.qp import OpenQp, QpChoice, choose_qp
from nmpc_codegen.decisions.second_order import choose_exact, choose_hessian
from nmpc_codegen.decisions.trials import Trials
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.completion.complete import CompleteProblem
from nmpc_codegen.ir.model import HessianModel
from nmpc_codegen.options import REGISTRIES, Online, Options
from nmpc_codegen.targets import NATIVE, PORTABLE, Target


@dataclass(frozen=True, eq=False, kw_only=True)
class Choices:
    """What a package consists of; nothing is open. A Decision has the reasons.

    ``exact``: the blocks of the exact Hessian of solve(), where samples have another; ``qp``: condensing and QP solver,
    if the algorithm has a QP; ``online``: what can be changed at run time; ``options``: all of it as options.
    ``constant_hessian``: the path Hessian block is the same at all nodes. ``trials``: integration schemes that were
    tried; ``made``: functions of the stages that were counted; ``grown``: growth of the open loop.
    """

    integrator: Decision[Integrator]
    hessian: Decision[Hessian | None]
    exact: Decision[HessianModel | None]
    algorithm: Decision[Algorithm]
    qp: QpChoice | None
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
        return Parts(
            self.integrator.value,
            self.algorithm.value,
            self.hessian.value,
            None if self.qp is None else self.qp.condensing,
            None if self.qp is None else self.qp.qp,
        )

    @cached_property
    def dims(self) -> Dims:
        """The sizes that the components share."""
        banded, goal = self.made.products.banded, self.options.goal
        return dimensions(self.trials.problem, self.parts.condensing, self.constant_hessian, goal, banded)

    @property
    def reasons(self) -> tuple[str, ...]:
        """All choices with their reasons, for the report."""
        problem = self.trials.problem
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


def decide(problem: CompleteProblem, options: Options) -> Choices:
    """Choose what the options leave open.

    Raises:
        OptionError: a component does not support the problem, or options clash.
    """
    trials, online = Trials(problem), _decide_online(problem, options.online)
    hessian = choose_hessian(problem, options.hessian, options.algorithm)
    target = _decide_target(options)
    small = options.goal == "size" and not options.solves  # nothing in the package iterates
    algorithm = Decision(*options.algorithm.decide(problem, small))
    integrator = choose_integrator(trials, options.integrator, options.goal)
    _check(problem, integrator.value, hessian.value)
    made = make(trials, integrator.value, hessian.value)
    exact = choose_exact(problem, options, hessian, made.costs, integrator.value)
    constant = is_constant(made, trials, online.value)
    has_qp = "qp" in options.algorithm.needs
    asked = has_qp or algorithm.value.simulates
    grown = growth(problem, integrator.value, options.precision) if asked else Growth((), options.precision)
    of = OpenQp(problem, options, algorithm.value, hessian.value, made, grown, constant)
    qp = choose_qp(of) if has_qp else None
    choices = Choices(
        integrator=integrator,
        hessian=hessian,
        exact=exact,
        algorithm=algorithm,
        qp=qp,
        online=online,
        target=target,
        options=Options(
            integrator.value,
            hessian.value,
            None if qp is None else qp.condensing,
            None if qp is None else qp.qp,
            algorithm.value,
            online.value,
            options.precision,
            options.solves,
            options.math or target.value.math,
            options.goal,
            target.value.name,
        ),
        constant_hessian=constant,
        trials=trials,
        made=made,
        grown=grown,
    )
    _check(problem, *choices.parts.components)
    choices.parts.algorithm.check_parts(choices.parts)
    return choices


def _check(problem: CompleteProblem, *components: Component | None) -> None:
    """Raise OptionError if a component does not support the problem or its options clash with it."""
    present = [component for component in components if component is not None]
    refuse_unsupported(problem, present, REGISTRIES)
    for component in present:
        component.check(problem)


def _decide_online(problem: CompleteProblem, online: Online) -> Decision[Online]:
    """Parameters by node, where blocks of controls or rates need some.

    Raises:
        OptionError: parameters of the user have another layout.
    """
    if not problem.augmentation.data or online.parameter == "node":
        return Decision(online, stated=True)
    if problem.own_parameters:
        raise OptionError(
            f'Online.parameter: "{online.parameter}" clashes with control(hold=...) and with rates on '
            'unequal intervals, which have data of nodes; expected "node" (--set online.parameter=node)'
        )
    why = "online.parameter: node; blocks of controls, or rates on unequal intervals, have data of nodes"
    return Decision(replace(online, parameter="node"), (why,))


def _decide_target(options: Options) -> Decision[Target]:
    """The target, of which the report says what its packages lack, and what "native" has become."""
    target = options.machine
    if target != PORTABLE:
        return Decision(target, (f"target: {target.name}; {target.machine}",))
    missing = ("target: portable; of this machine the compiler knows no vectors",) if options.target == NATIVE else ()
    return Decision(target, missing)
