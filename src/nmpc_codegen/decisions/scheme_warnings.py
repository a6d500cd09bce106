"""Warnings state where a scheme is unstable or inaccurate at the stated points, and which scheme is sufficient."""

from __future__ import annotations

import numpy as np

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators import ExplicitRungeKutta, ImplicitRungeKutta
from nmpc_codegen.decisions.accuracy import LOST, Flow
from nmpc_codegen.decisions.choices import Decision
from nmpc_codegen.decisions.stability import MOST_EXPLICIT, MOST_STEPS, Modes
from nmpc_codegen.decisions.trials import Trials
from nmpc_codegen.package.signals import list_some

#: Errors above which there is a warning: of an implicit scheme, of a chosen explicit scheme, of a stated one.
ROUGH, ROUGH_EXPLICIT, ROUGH_STATED = 5e-2, 1e-2, 2e-1

#: Numbers of explicit steps among which a warning names accurate ones; number of steps of the comparison.
OFFERED, FINEST = (*range(2, 31), 40, 60, 80, 120, 160), 512

#: Last correction of a stage, relative to the scale of a state, above which there is a warning.
FAR = 1e-1


def scheme_warnings(trials: Trials, integrator: Decision[Integrator]) -> tuple[str, ...]:
    """Return warnings of a scheme at the points that its problem states.

    An explicit scheme may be unstable, or inaccurate inside the bounds; an implicit one inaccurate, or its stages
    unsolved.
    """
    scheme = integrator.value
    if isinstance(scheme, ExplicitRungeKutta):
        needed, modes = trials.needed_steps(scheme)
        if needed != scheme.steps:
            return (_warn_of_instability(trials, scheme, needed, modes),) if len(modes.values) else ()
        return _warn_of_error(trials, scheme, ROUGH_STATED if integrator.stated else ROUGH_EXPLICIT)
    return _warn_of_stages(trials, scheme) if isinstance(scheme, ImplicitRungeKutta) else ()


def _warn_of_instability(trials: Trials, scheme: ExplicitRungeKutta, needed: int | None, modes: Modes) -> str:
    """Return the warning that an explicit scheme is unstable for the longest interval, with the steps that it needs."""
    offers = []
    found = trials.nearest_implicit[0] if needed is None or needed > MOST_EXPLICIT else None
    if found is not None:
        offers.append(
            f"ImplicitRungeKutta({found.tableau.name}, steps={found.steps}) works there "
            f"(--set integrator={found.name} --set integrator.steps={found.steps})"
        )
    offers.append(
        f"{needed} steps per interval are needed for stability: ExplicitRungeKutta({scheme.tableau.name}, "
        f"steps={needed}), or --set integrator.steps={needed}"
        if needed is not None
        else f"the model is too stiff for an explicit scheme: {MOST_STEPS:,} steps per interval are not sufficient"
    )
    place = "an interval behind" if modes.at_ends else "at"
    where, remedy = f" with {modes.where}" if modes.where else "", "; ".join(offers)
    return (
        f"integrator {scheme.tableau.name} with steps={scheme.steps} is unstable {place} the initial state or a "
        f"reference{where}, where the model has the eigenvalue {modes.fastest} 1/{trials.problem.time_unit}; {remedy}"
    )


def _warn_of_error(trials: Trials, scheme: ExplicitRungeKutta, most: float) -> tuple[str, ...]:
    """Return a warning if a stable explicit scheme has a larger error than this, with an accurate alternative."""
    flow, tableau, problem = trials.flow, scheme.tableau, trials.problem
    error = flow.error(tableau, scheme.steps)
    if error <= most:
        return ()
    better = Flow(problem, trials.size, FINEST).accurate_steps(tableau, [n for n in OFFERED if n > scheme.steps])
    remedy = (
        f"steps={better} are accurate (--set integrator.steps={better})"
        if better
        else f"take shorter intervals, or a scheme for stiff models: {OFFERED[-1]} steps are not accurate either"
    )
    where = zip(problem.state_names, flow.worst(tableau, scheme.steps), strict=True)
    off = f"{error:.1g} of the largest value of a state off" if error < LOST else "lost"
    return (
        f"integrator {tableau.name} with steps={scheme.steps} is not accurate: the end of an interval from "
        f"{list_some([f'{name} = {value:.3g}' for name, value in where])} is {off}; {remedy}",
    )


def _warn_of_stages(trials: Trials, scheme: ImplicitRungeKutta) -> tuple[str, ...]:
    """Return a warning if an implicit scheme is inaccurate at the first plan, or does not solve its stages there."""
    algebra = trials.problem.algebra
    if algebra and not trials.is_consistent:
        unknown = zip(algebra.names, algebra.found, algebra.start, strict=True)
        names = list_some([f"{name} from {start:g}" for name, found, start in unknown if not np.isfinite(found)])
        return (
            f"the algebraic equations are not solved at the first plan: Newton's method does not find {names}; give "
            "another initial= of it, or of states",
        )
    tableau, steps, newton = scheme.tableau, scheme.steps, scheme.newton_steps
    said = f"integrator {tableau.name} with steps={steps}"
    where, more = "at the initial state or a reference, with controls there or at a bound", "take more steps"
    error = trials.interval_error(tableau, steps)
    if error >= LOST:
        return (f"{said}: its stages cannot be solved {where}; {more}",)
    if error > ROUGH:
        return (f"{said}: more steps end {error:.1g} of the scale of a state elsewhere {where}; {more}",)
    left = trials.newton_left(tableau, steps, newton)
    rest = f"{newton} Newton steps leave {left:.1g} of the scale of a state"
    return (f"{said}: {rest} {where}; {more}, or more Newton steps",) if left > FAR else ()
