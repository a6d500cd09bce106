"""Which integrator a problem has where the options leave it open, and with which steps, tried at its first plan.

RK4 needs |h lambda| < 2.78 of the fastest mode, and as many steps as are accurate. A model for which it would need many
is stiff: an implicit scheme takes a few, each of which solves linear systems. The one with fewer operations is chosen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators import Discrete, ExplicitRungeKutta, ImplicitRungeKutta
from nmpc_codegen.components.integrators.implicit.trial import Trial
from nmpc_codegen.components.integrators.implicit_runge_kutta import NEWTON_LIMIT, NEWTON_STEPS
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.lowering.schemes.accuracy import ACCURATE, LOST, MOST_ACCURATE, Flow, starts
from nmpc_codegen.lowering.schemes.stability import MOST_EXPLICIT, MOST_STEPS, Modes, needed_steps
from nmpc_codegen.options import Options
from nmpc_codegen.package.signals import list_some

#: Steps per interval of an implicit scheme that are tried; error that is warned of; steps of the comparison for every
#: step.
STEPS, ROUGH, FINER = (1, 2, 3, 4, 6, 8, 12), 5e-2, 4

#: Error of an explicit scheme that is warned of, chosen by default and stated.
ROUGH_EXPLICIT, ROUGH_STATED = 1e-2, 2e-1

#: Explicit steps among which a warning names some that are accurate, and those of its comparison.
OFFERED, FINEST = (*range(2, 31), 40, 60, 80, 120, 160), 512

#: If no number of steps is accurate, the fewest within this factor of the least error are taken; numbers of steps in a
#: row that do not halve the error after which no more are tried, and points at which they are.
NEAR, VAIN, MOST_STARTS = 1.25, 3, 32

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
    stable, modes = needed_steps(problem, default)
    if stable is None or stable > MOST_ACCURATE:
        return _cheapest(problem, stable, _of_modes(problem, modes))
    flow = Flow(problem)
    accurate = flow.accurate_steps(default.tableau, range(stable, MOST_ACCURATE + 1))
    if accurate == default.steps:
        return default, (f"integrator: {default.name}; default for differential equations: RK4",)
    if accurate is None:
        return _nearest(problem, flow, stable)
    off = flow.error(default.tableau, stable)
    why = (
        _of_modes(problem, modes)
        if accurate == stable
        else f"{stable} steps end {off:.1g} of a state off inside of its bounds, RK4 needs"
    )
    return _cheapest(problem, accurate, why)


def _of_modes(problem: Problem, modes: Modes) -> str:
    return f"the first plan {modes.verb} the eigenvalue {modes.fastest} 1/{problem.time_unit}, for which RK4 needs"


def _cheapest(problem: Problem, needed: int | None, why: str) -> tuple[Integrator, tuple[str, ...]]:
    """RK4 with the steps that it needs, None: more than MOST_STEPS, or an implicit scheme with fewer operations."""
    default = ExplicitRungeKutta()
    explicit = replace(default, steps=MOST_STEPS if needed is None else needed)
    few = needed is not None and needed <= MOST_EXPLICIT
    implicit, error = (None, np.inf) if few else _nearest_implicit(problem)
    if needed is not None and needed <= MOST_ACCURATE and error > ACCURATE:
        implicit, few = None, True
    if implicit is None:
        kept = default if needed is None else explicit
        tried = "" if few else "; the stages of an implicit scheme cannot be solved there"
        reason = f"{why} {'more than ' if needed is None else ''}{explicit.steps:,} steps{tried}"
        return kept, (f"integrator: {kept.name}, RK4 with steps={kept.steps}; {reason}",)
    theirs, ours = _operations(problem, replace(explicit, steps=1)) * explicit.steps, _operations(problem, implicit)
    chosen: ExplicitRungeKutta | ImplicitRungeKutta = implicit if needed is None or theirs > ours else explicit
    return chosen, (
        f"integrator: {chosen.name}, {chosen.tableau.name} with steps={chosen.steps}; {why} "
        f"{'more than ' if needed is None else ''}{explicit.steps:,} steps per interval: {theirs:,} operations per "
        f"linearisation{' with so many' if needed is None else ''}, {implicit.tableau.name} with "
        f"steps={implicit.steps}: {ours:,}",
    )


def _nearest(problem: Problem, flow: Flow, stable: int) -> tuple[Integrator, tuple[str, ...]]:
    """An implicit scheme if it is accurate where RK4 is not, else the fewest steps nearly as accurate as any."""
    default = ExplicitRungeKutta()
    errors = {n: flow.error(default.tableau, n) for n in range(stable, MOST_ACCURATE + 1)}
    steps = next(n for n, error in errors.items() if error <= NEAR * min(errors.values()))
    reason = f"RK4 with {MOST_ACCURATE} steps ends {errors[MOST_ACCURATE]:.1g} of a state off inside of its bounds"
    implicit = implicit_for(problem)
    if implicit is not None:
        trial, dt = Trial(problem, implicit.tableau), max(problem.dt)
        off = flow.error_where_worst(
            default.tableau, MOST_ACCURATE, lambda x, u, p: trial.interval(x, u, p, dt, implicit.steps, NEWTON_LIMIT).x
        )
        if off <= ACCURATE:
            scheme = f"integrator: {implicit.name}, {implicit.tableau.name} with steps={implicit.steps}"
            return implicit, (f"{scheme}; {reason}, this {off:.1g}",)
    chosen = replace(default, steps=steps)
    return chosen, (f"integrator: {chosen.name}, RK4 with steps={steps}; {reason}, and so do other schemes",)


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
    return _nearest_implicit(problem)[0]


def _nearest_implicit(problem: Problem) -> tuple[ImplicitRungeKutta | None, float]:
    """That of implicit_for(), and its error."""
    default = ImplicitRungeKutta()
    trial = Trial(problem, default.tableau)
    errors: dict[int, float] = {}
    vain, best = 0, np.inf
    for steps in STEPS:
        errors[steps] = interval_error(trial, steps)
        if errors[steps] <= ACCURATE:
            return replace(default, steps=steps), errors[steps]
        vain, best = (vain + 1 if errors[steps] > best / 2 else 0), min(best, errors[steps])
        if vain == VAIN:
            break
    least = min(errors.values())
    steps = next(steps for steps, error in errors.items() if error <= NEAR * least)
    return (replace(default, steps=steps) if np.isfinite(least) else None), errors[steps]


def interval_error(trial: Trial, steps: int) -> float:
    """Largest distance of the end of the longest interval from that with more steps, relative to the scales, from the
    points of the first plan; LOST where only more steps have an end, infinite if no interval has one."""
    dt, found = max(trial.problem.dt), _some_starts(trial.problem)

    def ends(steps: int) -> Array:
        return np.array([trial.interval(x, u, p, dt, steps, NEWTON_LIMIT).x for x, u, p in found])

    with np.errstate(all="ignore"):
        coarse, fine = ends(steps), ends(FINER * steps)
        kept = np.all(np.isfinite(fine), axis=1)
        errors = np.max(np.abs(coarse - fine)[kept] / trial.size, axis=1, initial=0.0)
    ended = np.isfinite(errors)
    return float(np.max(np.where(ended, errors, LOST))) if np.any(ended) else np.inf


def accuracy_warning(problem: Problem, integrator: Integrator, stated: bool) -> tuple[str, ...]:
    """A warning if a scheme is far from the model at the first plan, an explicit one inside of the bounds, too, or does
    not solve its stages there."""
    if isinstance(integrator, ExplicitRungeKutta):
        return _explicit_warning(problem, integrator, ROUGH_STATED if stated else ROUGH_EXPLICIT)
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


def _explicit_warning(problem: Problem, integrator: ExplicitRungeKutta, most: float) -> tuple[str, ...]:
    """A warning if an explicit scheme that is stable has a larger error than this, with what would be accurate."""
    if problem.solved or needed_steps(problem, integrator)[0] != integrator.steps:
        return ()
    flow, tableau = Flow(problem), integrator.tableau
    error = flow.error(tableau, integrator.steps)
    if error <= most:
        return ()
    better = Flow(problem, FINEST).accurate_steps(tableau, [n for n in OFFERED if n > integrator.steps])
    remedy = (
        f"steps={better} are accurate (--set integrator.steps={better})"
        if better
        else f"take shorter intervals, or a scheme for stiff models: {OFFERED[-1]} steps are not accurate either"
    )
    where = zip(problem.state_names, flow.worst(tableau, integrator.steps), strict=True)
    off = f"{error:.1g} of the largest value of a state off" if error < LOST else "lost"
    return (
        f"integrator {tableau.name} with steps={integrator.steps} is not accurate: the end of an interval from "
        f"{list_some([f'{name} = {value:.3g}' for name, value in where])} is {off}; {remedy}",
    )


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
    dt = max(trial.problem.dt)
    found = [trial.interval(*at, dt, steps, newton).left / trial.size for at in _some_starts(trial.problem)]
    return max((float(np.max(each)) for each in found if np.all(np.isfinite(each))), default=np.inf)


def _some_starts(problem: Problem) -> list[tuple[Array, Array, Array]]:
    """The points of the first plan, at most MOST_STARTS of them, evenly."""
    found = list(starts(problem))
    return found[:: -(-len(found) // MOST_STARTS)]
