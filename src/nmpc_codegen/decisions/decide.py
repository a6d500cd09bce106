"""decide() makes every choice that the options leave open, once, with its reason."""

from __future__ import annotations

from dataclasses import replace

from nmpc_codegen.components.base import SEAMS, Component, refuse_unsupported
from nmpc_codegen.decisions.choices import Choices, Decision
from nmpc_codegen.decisions.growth import Growth, growth
from nmpc_codegen.decisions.integrator import choose_integrator
from nmpc_codegen.decisions.made import is_constant, make
from nmpc_codegen.decisions.qp import choose_qp
from nmpc_codegen.decisions.second_order import choose_exact, choose_hessian
from nmpc_codegen.decisions.trials import Trials
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.completion.complete import CompleteProblem
from nmpc_codegen.options import REGISTRIES, Online, Options
from nmpc_codegen.targets import NATIVE, PORTABLE, Target


def decide(problem: CompleteProblem, options: Options) -> Choices:
    """Choose what the options leave open.

    Raises:
        OptionError: a component does not support the problem, or options clash.
    """
    trials, online = Trials(problem, problem.scales), _decide_online(problem, options.online)
    hessian, target = choose_hessian(problem, options), _decide_target(options)
    small = options.goal == "size" and not options.solves  # nothing in the package iterates
    algorithm = Decision(*options.algorithm.decide(problem, small))
    integrator = choose_integrator(trials, options.integrator, options.goal)
    _check(problem, options, integrator.value, hessian.value)
    made = make(trials, integrator.value, hessian.value)
    exact = choose_exact(problem, options, hessian, made.costs, integrator.value)
    has_qp = "qp" in options.algorithm.needs
    asked = has_qp or algorithm.value.simulates
    found = Choices(
        problem=problem,
        integrator=integrator,
        hessian=hessian,
        exact=exact,
        algorithm=algorithm,
        online=online,
        target=target,
        options=options,
        constant_hessian=is_constant(made, problem, online.value),
        trials=trials,
        made=made,
        grown=growth(trials, integrator.value, options.precision) if asked else Growth((), options.precision),
    )
    found = replace(found, qp=choose_qp(found) if has_qp else None)
    _check(problem, options, *found.parts.components)
    found.parts.algorithm.check_parts(found.parts)
    return replace(found, options=_close(options, found))


def _close(options: Options, found: Choices) -> Options:
    """Return the options with every choice filled in."""
    target = found.target.value
    return replace(
        options,
        **{seam: getattr(found.parts, seam) for seam in SEAMS},
        online=found.online.value,
        solve=options.solves,
        math=options.math or target.math,
        target=target.name,
    )


def _check(problem: CompleteProblem, options: Options, *components: Component | None) -> None:
    """Raise OptionError if a component does not support the problem or its options clash with it.

    If several fail, the error names one that the user has given.
    """
    present = [component for component in components if component is not None]
    present.sort(key=lambda component: getattr(options, component.seam) is None)
    refuse_unsupported(problem, present, REGISTRIES)
    for component in present:
        component.check(problem)


def _decide_online(problem: CompleteProblem, online: Online) -> Decision[Online]:
    """Store parameters by node if blocks of controls or rates need that.

    Raises:
        OptionError: the user's parameters have another layout.
    """
    if not problem.augmentation.data or online.parameter == "node":
        return Decision(online)
    if problem.own_parameters:
        raise OptionError(
            f'Online.parameter: "{online.parameter}" clashes with control(hold=...) and with rates on '
            'unequal intervals, which have data of nodes; expected "node" (--set online.parameter=node)'
        )
    why = "online.parameter: node; blocks of controls, and rates unless intervals last a sample, have data of nodes"
    return Decision(replace(online, parameter="node"), (why,))


def _decide_target(options: Options) -> Decision[Target]:
    """Return the target with the reasons: its machine, or what the compiler of this machine lacks."""
    target = options.machine
    if target != PORTABLE:
        return Decision(target, (f"target: {target.name}; {target.machine}",))
    missing = ("target: portable; of this machine the compiler knows no vectors",) if options.target == NATIVE else ()
    return Decision(target, missing)
