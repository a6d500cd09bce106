"""Integration schemes are tried on one problem; the results of a trial are kept.

The choice of a scheme, warnings and linearize() share these results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, cached_property, partial

import numpy as np

from nmpc_codegen.components.base import Integrator, Transition
from nmpc_codegen.components.integrators import ButcherTableau, ExplicitRungeKutta, ImplicitRungeKutta
from nmpc_codegen.components.integrators.implicit.trial import Trial
from nmpc_codegen.components.integrators.implicit_runge_kutta import NEWTON_LIMIT
from nmpc_codegen.decisions.accuracy import ACCURATE, LOST, Flow, starts
from nmpc_codegen.decisions.stability import MOST_EXPLICIT, Modes, modes_at_ends, stated_modes, steps_for
from nmpc_codegen.frontend.completion.complete import CompleteProblem
from nmpc_codegen.frontend.completion.scales import Scales, scales
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.ir.model import Interval

#: Numbers of steps per interval that are tried for an implicit scheme; steps of the comparison for each of them.
STEPS, FINER = (1, 2, 3, 4, 6, 8, 12), 4

#: NEAR: if no number of steps is accurate, the least number with an error within this factor of the least error is
#: taken. VAIN: trials stop after this number of trials in a row that do not halve the error. MOST_STARTS: largest
#: number of points of a trial.
NEAR, VAIN, MOST_STARTS = 1.25, 3, 32


class Trials:
    """Integration schemes are tried on one problem."""

    def __init__(self, problem: Problem, sizes: Scales) -> None:
        self.problem, self.dt, self.size = problem, max(problem.dt), sizes.z[: problem.nx]
        self._scheme: Callable[[ButcherTableau], Trial] = cache(partial(Trial, problem, self.size))
        self._intervals: dict[Integrator, Interval] = {}
        self._ends_of: Callable[[ButcherTableau, int], Array] = cache(self._find_ends)

    def interval(self, integrator: Integrator) -> Interval:
        """Return the functions of an interval by this integrator."""
        if isinstance(integrator, ImplicitRungeKutta):
            integrator = replace(integrator, newton=integrator.newton_steps)
        if integrator not in self._intervals:
            self._intervals[integrator] = integrator.interval(self.problem)
        return self._intervals[integrator]

    # Explicit schemes ------------------------------------------------------------------------------------------------

    @cached_property
    def flow(self) -> Flow:
        """Return the model over the longest interval."""
        return Flow(self.problem, self.size)

    def needed_steps(self, integrator: ExplicitRungeKutta) -> tuple[int | None, Modes]:
        """Return the steps per interval with which an explicit scheme is stable, and the modes that decide.

        The steps are at least those of the scheme; None if MOST_STEPS are not sufficient. The ends of intervals count
        if the model is stiff there and not at the starts.
        """
        needed = steps_for(self._stated, integrator, self.dt)
        if needed is None or needed > MOST_EXPLICIT:
            return needed, self._stated
        more = steps_for(self._at_ends, integrator, self.dt)
        return (needed, self._stated) if more is not None and more <= MOST_EXPLICIT else (more, self._at_ends)

    @cached_property
    def _stated(self) -> Modes:
        return stated_modes(self.problem)

    @cached_property
    def _at_ends(self) -> Modes:
        one_step = ImplicitRungeKutta(steps=1)
        return modes_at_ends(self.problem, lambda x, u, p: self.end(one_step, x, u, p))

    # Implicit schemes ------------------------------------------------------------------------------------------------

    @property
    def is_consistent(self) -> bool:
        """Return False if Newton's method fails to find the algebraic variables at the first plan."""
        algebra = self.problem.algebra
        return algebra is None or bool(np.all(np.isfinite(algebra.found)))

    @cached_property
    def nearest_implicit(self) -> tuple[ImplicitRungeKutta | None, float]:
        """Return the implicit scheme with the least number of accurate steps from the first plan, and its error.

        If no number is accurate, one with nearly the least error is returned; None if no stage can be solved.
        """
        default, errors = ImplicitRungeKutta(), dict[int, float]()
        vain, best = 0, np.inf
        for steps in STEPS:
            errors[steps] = self.interval_error(default.tableau, steps)
            if errors[steps] <= ACCURATE:
                return ImplicitRungeKutta(default.tableau, steps), errors[steps]
            vain, best = (vain + 1 if errors[steps] > best / 2 else 0), min(best, errors[steps])
            if vain == VAIN:
                break
        least = min(errors.values())
        steps = next(steps for steps, error in errors.items() if error <= NEAR * least)
        return (ImplicitRungeKutta(default.tableau, steps) if np.isfinite(least) else None), errors[steps]

    def interval_error(self, tableau: ButcherTableau, steps: int) -> float:
        """Return the largest error of the longest interval from the first plan, relative to the scales.

        The comparison takes more steps. The error is LOST if only the comparison has a finite end, infinite if no
        interval has.
        """
        with np.errstate(all="ignore"):
            coarse, fine = self._ends_of(tableau, steps), self._ends_of(tableau, FINER * steps)
            kept = np.all(np.isfinite(fine), axis=1)
            errors = np.max(np.abs(coarse - fine)[kept] / self.size, axis=1, initial=0.0)
        ended = np.isfinite(errors)
        return float(np.max(np.where(ended, errors, LOST))) if np.any(ended) else np.inf

    def newton_left(self, tableau: ButcherTableau, steps: int, newton: int) -> float:
        """Return the largest last correction of a stage over the longest interval from the first plan.

        It is relative to the scales; infinite if no stage can be solved.
        """
        trial = self._scheme(tableau)
        found = [trial.interval(*at, self.dt, steps, newton).left / self.size for at in self._starts]
        return max((float(np.max(each)) for each in found if np.all(np.isfinite(each))), default=np.inf)

    def end(self, integrator: ImplicitRungeKutta, x: Array, u: Array, p: Array) -> Array:
        """Return the end of the longest interval from a point."""
        return self._scheme(integrator.tableau).interval(x, u, p, self.dt, integrator.steps, NEWTON_LIMIT).x

    def slopes(self, integrator: ImplicitRungeKutta) -> Transition:
        """Return (x, u, p, dt) -> d x_next / d(x, u) of an interval, with Newton's method to rounding errors."""
        trial = self._scheme(integrator.tableau)
        return lambda x, u, p, dt: trial.interval(x, u, p, dt, integrator.steps, NEWTON_LIMIT).S

    def _find_ends(self, tableau: ButcherTableau, steps: int) -> Array:
        """Return the ends of the longest interval from the points of the first plan."""
        trial = self._scheme(tableau)
        return np.array([trial.interval(*at, self.dt, steps, NEWTON_LIMIT).x for at in self._starts])

    @cached_property
    def _starts(self) -> list[tuple[Array, Array, Array]]:
        """Return the points of the first plan, at most MOST_STARTS of them, evenly selected."""
        found = list(starts(self.problem))
        return found[:: -(-len(found) // MOST_STARTS)]


def trials_of(problem: Problem) -> Trials:
    """Return the trials of a problem, which need not be complete."""
    return Trials(problem, problem.scales if isinstance(problem, CompleteProblem) else scales(problem))
