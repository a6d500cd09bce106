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
from nmpc_codegen.frontend.scales import scales
from nmpc_codegen.lowering.first_plan import points
from nmpc_codegen.lowering.schemes.stability import MOST_EXPLICIT, MOST_STEPS, needed_steps
from nmpc_codegen.options import Options

#: Steps per interval that are tried; error of an interval, relative to the scale of a state, that is accurate; steps of
#: the comparison for every step.
STEPS, ACCURATE, FINER = (1, 2, 3, 4), 2e-3, 4

#: The last correction of a stage that samples may leave, relative to the scale of a state, and Newton steps at most.
LEFT, MOST_NEWTON = 1e-3, 12


def choose_integrator(problem: Problem, options: Options) -> tuple[Integrator, tuple[str, ...]]:
    """The integrator of the options or, where they leave it open, that of the problem; the reasons."""
    chosen, reasons = _choose(problem, options)
    if isinstance(chosen, ImplicitRungeKutta) and chosen.newton is None:
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
    default = ExplicitRungeKutta()
    needed, modes = needed_steps(problem, default)
    if needed == default.steps:
        return default, (f"integrator: {default.name}; default for differential equations: RK4",)
    explicit = replace(default, steps=MOST_STEPS if needed is None else needed)
    fast = f"the first plan has the eigenvalue {modes.fastest} 1/{problem.time_unit}, for which RK4"
    few = needed is not None and needed <= MOST_EXPLICIT
    implicit = None if few else implicit_for(problem)
    if implicit is None:
        kept = explicit if few else default
        return kept, (f"integrator: {kept.name}, RK4 with steps={kept.steps}; {fast} needs {explicit.steps} steps",)
    theirs, ours = _operations(problem, replace(explicit, steps=1)) * explicit.steps, _operations(problem, implicit)
    chosen: ExplicitRungeKutta | ImplicitRungeKutta = implicit if needed is None or theirs > ours else explicit
    return chosen, (
        f"integrator: {chosen.name}, {chosen.tableau.name} with steps={chosen.steps}; {fast} needs "
        f"{'more than ' if needed is None else ''}{explicit.steps:,} steps per interval: {theirs:,} operations per "
        f"linearisation, {implicit.tableau.name} with steps={implicit.steps}: {ours:,}",
    )


def _operations(problem: Problem, integrator: ExplicitRungeKutta | ImplicitRungeKutta) -> int:
    """Of a linearisation of all intervals; an explicit scheme in loops."""
    looped = replace(integrator, unroll="none") if isinstance(integrator, ExplicitRungeKutta) else integrator
    return looped.interval(problem).linearize.count.total * problem.N


def implicit_for(problem: Problem) -> ImplicitRungeKutta | None:
    """The implicit scheme with the fewest steps that are accurate from the points of the first plan; None if no stage
    of it can be solved there."""
    default = ImplicitRungeKutta()
    trial, size = Trial(problem, default.tableau), scales(problem).z[: problem.nx]
    dt, found = max(problem.dt), list(_starts(problem))

    def ends(steps: int) -> Array:
        return np.array([trial.interval(x, u, p, dt, steps, NEWTON_LIMIT).x for x, u, p in found])

    with np.errstate(all="ignore"):
        for steps in STEPS:
            coarse, fine = ends(steps), ends(FINER * steps)
            kept = np.all(np.isfinite(fine), axis=1)
            error = np.max(np.abs(coarse - fine)[kept] / size, initial=0.0)
            if np.any(kept) and (error <= ACCURATE or (steps == STEPS[-1] and np.isfinite(error))):
                return replace(default, steps=steps)
    return None


def _with_newton(problem: Problem, given: ImplicitRungeKutta) -> tuple[ImplicitRungeKutta, tuple[str, ...]]:
    """The scheme with as many Newton steps as the first plan needs in a sample."""
    trial, size = Trial(problem, given.tableau), scales(problem).z[: problem.nx]
    left = np.inf
    for newton in range(NEWTON_STEPS, MOST_NEWTON + 1):
        found = [trial.interval(*at, max(problem.dt), given.steps, newton).left / size for at in _starts(problem)]
        left = max((float(np.max(each)) for each in found if np.all(np.isfinite(each))), default=np.inf)
        if left <= LEFT:
            break
    chosen = newton if np.isfinite(left) else NEWTON_STEPS
    return replace(given, newton=chosen), (
        f"Newton steps of a stage in samples: {chosen}; the last correction at the first plan is {left:.0e} of a state",
    )


def _starts(problem: Problem) -> Iterator[tuple[Array, Array, Array]]:
    """The points of the first plan, with the controls there and at their bounds, at all corners."""
    for _, corner in problem.corners:
        sides = [np.array([row.lower, row.upper]) for row in corner.rows if row.kind == "control"]
        places = [row.index for row in corner.rows if row.kind == "control"]
        for x, u in points(corner):
            yield x, u, corner.p_value
            for side in (0, 1):
                moved = u.copy()
                for place, bounds in zip(places, sides, strict=True):
                    if np.isfinite(bounds[side]):
                        moved[place] = bounds[side]
                yield x, moved, corner.p_value
