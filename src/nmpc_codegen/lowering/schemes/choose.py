"""Which integrator a problem has where the options leave it open, and with which steps, tried at its first plan.

RK4 needs |h lambda| < 2.78 of the fastest mode. A model for which it would need many steps is stiff: an implicit scheme
takes a few, each of which solves linear systems.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators import Discrete, ExplicitRungeKutta, ImplicitRungeKutta
from nmpc_codegen.components.integrators.implicit.implicit_runge_kutta import NEWTON_LIMIT, NEWTON_STEPS
from nmpc_codegen.components.integrators.implicit.trial import Trial
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.frontend.scales import scales
from nmpc_codegen.lowering.first_plan import points
from nmpc_codegen.lowering.schemes.stability import MOST_EXPLICIT, MOST_STEPS, Modes, needed_steps
from nmpc_codegen.options import Options

#: Steps per interval that are tried; error of an interval, relative to the scale of a state, that is accurate; steps of
#: the comparison for every step.
STEPS, ACCURATE, FINER = (1, 2, 3, 4), 1e-3, 4

#: What two Newton steps may leave, relative to the scale of a state, before a third one pays.
LEFT = 1e-5


def choose_integrator(problem: Problem, options: Options) -> tuple[Integrator, tuple[str, ...]]:
    """The integrator of the options or, where they leave it open, that of the problem; the reasons."""
    chosen, reasons = _given(problem, options)
    if isinstance(chosen, ImplicitRungeKutta) and chosen.newton is None:
        chosen, more = _with_newton(problem, chosen)
        reasons = (*reasons, *more)
    if options.goal == "speed" or chosen.small == chosen:
        return chosen, reasons
    return chosen.small, (*reasons, f"integrator: {chosen.small}; goal: size")


def _given(problem: Problem, options: Options) -> tuple[Integrator, tuple[str, ...]]:
    if options.integrator:
        return options.integrator, ()
    if problem.discrete:
        return Discrete(), (f"integrator: {Discrete.name}; the dynamics are a discrete map",)
    explicit = ExplicitRungeKutta()
    needed, modes = needed_steps(problem, explicit)
    if needed is not None and needed <= MOST_EXPLICIT:
        return explicit, (f"integrator: {explicit.name}; default for differential equations: RK4",)
    implicit = implicit_for(problem)
    if implicit is None:
        return explicit, (f"integrator: {explicit.name}; the model is stiff, but no implicit scheme was found",)
    return implicit, (_reason(problem, implicit, needed, modes),)


def _reason(problem: Problem, implicit: ImplicitRungeKutta, needed: int | None, modes: Modes) -> str:
    """Why the scheme is implicit, and what either would cost per sample."""
    steps = MOST_STEPS if needed is None else needed
    one = ExplicitRungeKutta(steps=1, unroll="none").interval(problem).linearize.count.total
    ours = implicit.interval(problem).linearize.count.total
    return (
        f"integrator: {implicit.name}, {implicit.tableau.name} with steps={implicit.steps}; the first plan is stiff, "
        f"eigenvalue {modes.fastest} 1/{problem.time_unit}: RK4 needs {'more than ' if needed is None else ''}"
        f"{steps:,} steps per interval, {one * steps * problem.N:,} operations per linearisation in place of "
        f"{ours * problem.N:,}"
    )


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
    most = 0.0
    for x, u, p in _starts(problem):
        left = trial.interval(x, u, p, max(problem.dt), given.steps, NEWTON_STEPS).left
        most = max(most, float(np.max(left / size))) if np.all(np.isfinite(left)) else most
    newton = NEWTON_STEPS if most <= LEFT else NEWTON_STEPS + 1
    return replace(given, newton=newton), (
        f"Newton steps of a stage in samples: {newton}; from the first plan two leave {most:.0e} of the states",
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
