"""If the options leave the integrator open, it is chosen by trials at the first plan, with its number of steps.

RK4 needs |h lambda| < 2.78 of the fastest mode, and enough steps to be accurate. A model for which it would need many
steps is stiff: an implicit scheme takes a few steps, each of which solves linear systems. The scheme with fewer
operations is chosen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators import Discrete, ExplicitRungeKutta, ImplicitRungeKutta
from nmpc_codegen.components.integrators.implicit_runge_kutta import NEWTON_STEPS
from nmpc_codegen.decisions.accuracy import ACCURATE, MOST_ACCURATE
from nmpc_codegen.decisions.choices import Decision
from nmpc_codegen.decisions.stability import MOST_EXPLICIT, MOST_STEPS, Modes
from nmpc_codegen.decisions.trials import NEAR, Trials, trials_of
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.options import Goal, Options
from nmpc_codegen.package.signals import list_some

#: Largest last correction of a stage in a sample, relative to the scale of a state; largest number of Newton steps.
LEFT, MOST_NEWTON = 1e-3, 12

#: An integrator and the reasons for it.
Chosen = tuple[Integrator, tuple[str, ...]]


def integrator_of(problem: Problem, options: Options) -> Integrator:
    """Return the integrator of a package of this problem, for callers that integrate without a package.

    A terminal cost that is still to be computed does not count.
    """
    return choose_integrator(trials_of(problem), options.integrator, options.goal).value


def choose_integrator(trials: Trials, given: Integrator | None, goal: Goal) -> Decision[Integrator]:
    """Return the given integrator, or else the chosen one, with enough Newton steps."""
    chosen, reasons = _choose(trials) if given is None else (given, ())
    if isinstance(chosen, ImplicitRungeKutta) and chosen.newton is None and trials.is_consistent:
        chosen.check(trials.problem)
        chosen, more = _with_newton(trials, chosen)
        reasons = (*reasons, *more)
    if goal == "size" and chosen.small != chosen:
        chosen, reasons = chosen.small, (*reasons, f"integrator: {chosen.small}; goal: size")
    return Decision(chosen, reasons, given is not None)


def _choose(trials: Trials) -> Chosen:
    problem = trials.problem
    if problem.discrete:
        return Discrete(), (f"integrator: {Discrete.name}; the dynamics are a discrete map",)
    if problem.solved:
        return _scheme_for_algebra(trials)
    default = ExplicitRungeKutta()
    stable, modes = trials.needed_steps(default)
    if stable is None or stable > MOST_ACCURATE:
        return _cheapest(trials, stable, _of_modes(trials, modes))
    accurate = trials.flow.accurate_steps(default.tableau, range(stable, MOST_ACCURATE + 1))
    if accurate == default.steps:
        return default, (f"integrator: {default.name}; default for differential equations: RK4",)
    if accurate is None:
        return _nearest(trials, stable)
    off = trials.flow.error(default.tableau, stable)
    why = (
        _of_modes(trials, modes)
        if accurate == stable
        else f"{stable} steps end {off:.1g} of a state off inside of its bounds, RK4 needs"
    )
    return _cheapest(trials, accurate, why)


def _of_modes(trials: Trials, modes: Modes) -> str:
    unit = trials.problem.time_unit
    return f"the first plan {modes.verb} the eigenvalue {modes.fastest} 1/{unit}, for which RK4 needs"


def _cheapest(trials: Trials, needed: int | None, why: str) -> Chosen:
    """Return RK4 with ``needed`` steps, or an implicit scheme if that takes fewer operations.

    ``needed`` is None for more than MOST_STEPS.
    """
    default = ExplicitRungeKutta()
    explicit = replace(default, steps=MOST_STEPS if needed is None else needed)
    few = needed is not None and needed <= MOST_EXPLICIT
    implicit, error = (None, np.inf) if few else trials.nearest_implicit
    if needed is not None and needed <= MOST_ACCURATE and error > ACCURATE:
        implicit, few = None, True
    many = "more than " if needed is None else ""
    if implicit is None:
        kept = default if needed is None else explicit
        tried = "" if few else "; the stages of an implicit scheme cannot be solved there"
        reason = f"{why} {many}{explicit.steps:,} steps{tried}"
        return kept, (f"integrator: {kept.name}, RK4 with steps={kept.steps}; {reason}",)
    problem = trials.problem
    theirs = explicit.operations(problem) * problem.N
    ours = trials.interval(implicit).linearize.count.total * problem.N
    chosen: ExplicitRungeKutta | ImplicitRungeKutta = implicit if needed is None or theirs > ours else explicit
    return chosen, (
        f"integrator: {chosen.name}, {chosen.tableau.name} with steps={chosen.steps}; {why} "
        f"{many}{explicit.steps:,} steps per interval: {theirs:,} operations per "
        f"linearisation{' with so many' if needed is None else ''}, {implicit.tableau.name} with "
        f"steps={implicit.steps}: {ours:,}",
    )


def _nearest(trials: Trials, stable: int) -> Chosen:
    """Return an accurate implicit scheme if RK4 is not accurate, else RK4 with the fewest good steps.

    Steps are good if their error is within a factor NEAR of the least one.
    """
    default, flow = ExplicitRungeKutta(), trials.flow
    errors = {n: flow.error(default.tableau, n) for n in range(stable, MOST_ACCURATE + 1)}
    steps = next(n for n, error in errors.items() if error <= NEAR * min(errors.values()))
    reason = f"RK4 with {MOST_ACCURATE} steps ends {errors[MOST_ACCURATE]:.1g} of a state off inside of its bounds"
    implicit, _ = trials.nearest_implicit
    if implicit is not None:
        off = flow.error_where_worst(default.tableau, MOST_ACCURATE, lambda *at: trials.end(implicit, *at))
        if off <= ACCURATE:
            scheme = f"integrator: {implicit.name}, {implicit.tableau.name} with steps={implicit.steps}"
            return implicit, (f"{scheme}; {reason}, this {off:.1g}",)
    chosen = replace(default, steps=steps)
    return chosen, (f"integrator: {chosen.name}, RK4 with steps={steps}; {reason}, and so do other schemes",)


def _scheme_for_algebra(trials: Trials) -> Chosen:
    """Return the implicit scheme for equations that Newton's method solves."""
    found = trials.nearest_implicit[0] if trials.is_consistent else None
    chosen = found or ImplicitRungeKutta()
    return chosen, (
        f"integrator: {chosen.name}, {chosen.tableau.name} with steps={chosen.steps}; stages solve the equations of "
        f"{list_some(trials.problem.newton_names)}, which are not linear in them",
    )


def _with_newton(trials: Trials, given: ImplicitRungeKutta) -> Chosen:
    """Return the scheme with the number of Newton steps that the first plan needs in a sample."""
    left = np.inf
    for newton in range(NEWTON_STEPS, MOST_NEWTON + 1):
        left = trials.newton_left(given.tableau, given.steps, newton)
        if left <= LEFT:
            break
    chosen = newton if np.isfinite(left) else NEWTON_STEPS
    return replace(given, newton=chosen), (
        f"Newton steps of a stage in samples: {chosen}; the last correction at the first plan is {left:.0e} of a state",
    )
