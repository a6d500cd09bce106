"""Which integrator a problem has where the options leave it open, and with which steps, tried at its first plan.

RK4 needs |h lambda| < 2.78 of the fastest mode. A model for which it would need many steps is stiff: an implicit scheme
takes a few, each of which solves linear systems. The one with fewer operations is chosen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators import Discrete, ExplicitRungeKutta, ImplicitRungeKutta
from nmpc_codegen.components.integrators.implicit.trial import Trial
from nmpc_codegen.components.integrators.implicit_runge_kutta import NEWTON_LIMIT, NEWTON_STEPS
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.lowering.first_plan import points
from nmpc_codegen.lowering.schemes.stability import MOST_EXPLICIT, MOST_STEPS, needed_steps
from nmpc_codegen.options import Options
from nmpc_codegen.package.signals import list_some

#: Steps per interval that are tried; error of an interval, relative to the scale of a state, that is accurate, and that
#: is warned of; steps of the comparison for every step.
STEPS, ACCURATE, ROUGH, FINER = (1, 2, 3, 4, 6, 8, 12), 2e-3, 5e-2, 4

#: If no number of steps is accurate, the fewest within this factor of the least error are taken; error of an interval
#: that cannot be integrated.
NEAR, LOST = 1.25, 1e3

#: The last correction of a stage that samples may leave, relative to the scale of a state, and that is warned of;
#: Newton steps at most.
LEFT, FAR, MOST_NEWTON = 1e-3, 1e-1, 12


def choose_integrator(problem: Problem, options: Options) -> tuple[Integrator, tuple[str, ...]]:
    """The integrator of the options or, where they leave it open, that of the problem; the reasons."""
    chosen, reasons = _choose(problem, options)
    if isinstance(chosen, ImplicitRungeKutta) and chosen.newton is None and _is_consistent(problem):
        chosen.check(problem)
        chosen, more = _with_newton(problem, chosen)
        reasons = (*reasons, *more)
    if options.goal == "speed" or chosen.small == chosen:
        return chosen, reasons
    return chosen.small, (*reasons, f"integrator: {chosen.small}; goal: size")


def _choose(problem: Problem, options: Options) -> tuple[Integrator, tuple[str, ...]]:
    if options.integrator:
        return options.integrator, ()
    if problem.discrete:
        return Discrete(), (f"integrator: {Discrete.name}; the dynamics are a discrete map",)
    if problem.solved:
        return _for_algebra(problem)
    default = ExplicitRungeKutta()
    needed, modes = needed_steps(problem, default)
    if needed == default.steps:
        return default, (f"integrator: {default.name}; default for differential equations: RK4",)
    explicit = replace(default, steps=MOST_STEPS if needed is None else needed)
    fast = f"the first plan {modes.verb} the eigenvalue {modes.fastest} 1/{problem.time_unit}, for which RK4"
    few = needed is not None and needed <= MOST_EXPLICIT
    implicit = None if few else implicit_for(problem)
    if implicit is None:
        kept = default if needed is None else explicit
        tried = "" if few else "; the stages of an implicit scheme cannot be solved there"
        reason = f"{fast} needs {'more than ' if needed is None else ''}{explicit.steps:,} steps{tried}"
        return kept, (f"integrator: {kept.name}, RK4 with steps={kept.steps}; {reason}",)
    theirs, ours = _operations(problem, replace(explicit, steps=1)) * explicit.steps, _operations(problem, implicit)
    chosen: ExplicitRungeKutta | ImplicitRungeKutta = implicit if needed is None or theirs > ours else explicit
    return chosen, (
        f"integrator: {chosen.name}, {chosen.tableau.name} with steps={chosen.steps}; {fast} needs "
        f"{'more than ' if needed is None else ''}{explicit.steps:,} steps per interval: {theirs:,} operations per "
        f"linearisation{' with so many' if needed is None else ''}, {implicit.tableau.name} with "
        f"steps={implicit.steps}: {ours:,}",
    )


def _for_algebra(problem: Problem) -> tuple[Integrator, tuple[str, ...]]:
    """The implicit scheme for equations that Newton's method solves."""
    chosen = (implicit_for(problem) if _is_consistent(problem) else None) or ImplicitRungeKutta()
    return chosen, (
        f"integrator: {chosen.name}, {chosen.tableau.name} with steps={chosen.steps}; stages solve the equations of "
        f"{list_some(problem.newton_names)}, which are not linear in them",
    )


def _is_consistent(problem: Problem) -> bool:
    """True unless Newton's method finds no algebraic variables at the first plan."""
    return problem.algebra is None or bool(np.all(np.isfinite(problem.algebra.found)))


def _operations(problem: Problem, integrator: ExplicitRungeKutta | ImplicitRungeKutta) -> int:
    """Of a linearisation of all intervals; an explicit scheme in loops."""
    looped = replace(integrator, unroll="none") if isinstance(integrator, ExplicitRungeKutta) else integrator
    return looped.interval(problem).linearize.count.total * problem.N


def implicit_for(problem: Problem) -> ImplicitRungeKutta | None:
    """The implicit scheme with the fewest steps that are accurate from the points of the first plan, or with those that
    are nearly as accurate as any; None if no stage of it can be solved there."""
    default = ImplicitRungeKutta()
    trial = Trial(problem, default.tableau)
    errors: dict[int, float] = {}
    for steps in STEPS:
        errors[steps] = interval_error(trial, steps)
        if errors[steps] <= ACCURATE:
            return replace(default, steps=steps)
    least = min(errors.values())
    steps = next(steps for steps, error in errors.items() if error <= NEAR * least)
    return replace(default, steps=steps) if np.isfinite(least) else None


def interval_error(trial: Trial, steps: int) -> float:
    """Largest distance of the end of the longest interval from that with more steps, relative to the scales, from the
    points of the first plan; LOST where only more steps have an end, infinite if no interval has one."""
    dt, found = max(trial.problem.dt), list(_starts(trial.problem))

    def ends(steps: int) -> Array:
        return np.array([trial.interval(x, u, p, dt, steps, NEWTON_LIMIT).x for x, u, p in found])

    with np.errstate(all="ignore"):
        coarse, fine = ends(steps), ends(FINER * steps)
        kept = np.all(np.isfinite(fine), axis=1)
        errors = np.max(np.abs(coarse - fine)[kept] / trial.size, axis=1, initial=0.0)
    ended = np.isfinite(errors)
    return float(np.max(np.where(ended, errors, LOST))) if np.any(ended) else np.inf


def accuracy_warning(problem: Problem, integrator: Integrator) -> tuple[str, ...]:
    """A warning if an implicit scheme is far from the model at the first plan, or does not solve its stages there."""
    if not isinstance(integrator, ImplicitRungeKutta):
        return ()
    if problem.algebra and not _is_consistent(problem):
        unknown = zip(problem.algebra.names, problem.algebra.found, problem.algebra.start, strict=True)
        names = list_some([f"{name} from {start:g}" for name, found, start in unknown if not np.isfinite(found)])
        return (
            f"the algebraic equations are not solved at the first plan: Newton's method does not find {names}; give "
            "another initial= of it, or of states",
        )
    scheme = f"integrator {integrator.tableau.name} with steps={integrator.steps}"
    where, more = "at the initial state or a reference, with controls there or at a bound", "take more steps"
    trial, steps, newton = Trial(problem, integrator.tableau), integrator.steps, integrator.newton_steps
    error, left = interval_error(trial, steps), newton_left(trial, steps, newton)
    if error >= LOST:
        return (f"{scheme}: its stages cannot be solved {where}; {more}",)
    if error > ROUGH:
        return (f"{scheme}: more steps end {error:.1g} of the scale of a state elsewhere {where}; {more}",)
    rest = f"{newton} Newton steps leave {left:.1g} of the scale of a state"
    return (f"{scheme}: {rest} {where}; {more}, or more Newton steps",) if left > FAR else ()


def _with_newton(problem: Problem, given: ImplicitRungeKutta) -> tuple[ImplicitRungeKutta, tuple[str, ...]]:
    """The scheme with as many Newton steps as the first plan needs in a sample."""
    trial, left = Trial(problem, given.tableau), np.inf
    for newton in range(NEWTON_STEPS, MOST_NEWTON + 1):
        left = newton_left(trial, given.steps, newton)
        if left <= LEFT:
            break
    chosen = newton if np.isfinite(left) else NEWTON_STEPS
    return replace(given, newton=chosen), (
        f"Newton steps of a stage in samples: {chosen}; the last correction at the first plan is {left:.0e} of a state",
    )


def newton_left(trial: Trial, steps: int, newton: int) -> float:
    """The largest last correction of a stage over the longest interval from the points of the first plan, relative to
    the scales; infinite if no stage can be solved."""
    dt, starts = max(trial.problem.dt), _starts(trial.problem)
    found = [trial.interval(*at, dt, steps, newton).left / trial.size for at in starts]
    return max((float(np.max(each)) for each in found if np.all(np.isfinite(each))), default=np.inf)


def _starts(problem: Problem) -> Iterator[tuple[Array, Array, Array]]:
    """The points of the first plan, with the controls there and at their bounds, at all corners."""
    for _, corner in problem.corners:
        rows = [row for row in corner.rows if row.kind == "control"]
        for x, u in points(corner):
            yield x, u, corner.p_value
            for bounds in ([row.lower for row in rows], [row.upper for row in rows]):
                moved, at = u.copy(), [row.index for row in rows]
                moved[at] = np.where(np.isfinite(bounds), bounds, moved[at])
                yield x, moved, corner.p_value
