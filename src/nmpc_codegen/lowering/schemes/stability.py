"""Whether an explicit scheme is stable where the problem is stated: |R(h lambda)| <= 1 for the damped modes of f_x.

    x+ = R(h lambda) x   for x' = lambda x,   R(z) = 1 + z b' (I - z A)^{-1} 1

(Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.2). RK4 needs |h lambda| < 2.78 on the
negative real axis and 2.83 on the imaginary one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators import SDIRK3, ButcherTableau, ExplicitRungeKutta, ImplicitRungeKutta
from nmpc_codegen.components.integrators.implicit.trial import Trial
from nmpc_codegen.components.integrators.implicit_runge_kutta import NEWTON_LIMIT
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.lowering.first_plan import points

Array = NDArray[Any]

#: More steps than this are no remedy.
MOST_STEPS = 1000

#: Explicit steps per interval above which a model counts as stiff.
MOST_EXPLICIT = 6

#: A mode counts as damped if its decay rate is at least this part of |lambda|; others may grow by rounding or little.
DAMPED, SLACK, UNDAMPED_SLACK = 1e-3, 1e-6, 0.5


class Modes(NamedTuple):
    """Eigenvalues of f_x that do not grow, where the problem states points, and where the fastest of them is; or, if
    the model becomes stiff from there, at the ends of intervals."""

    values: Array
    where: str
    at_ends: bool = False

    @property
    def verb(self) -> str:
        """What the first plan does to them."""
        return "leads to" if self.at_ends else "has"

    @property
    def fastest(self) -> str:
        """The fastest one, without an imaginary part that is rounding."""
        worst = complex(self.values[np.argmax(np.abs(self.values))])
        return f"{worst.real:.3g}" if abs(worst.imag) <= DAMPED * abs(worst) else f"{worst:.3g}"


def needed_steps(problem: Problem, integrator: ExplicitRungeKutta) -> tuple[int | None, Modes]:
    """The steps per interval with which an explicit scheme is stable, at least those that it has; None if MOST_STEPS
    are not sufficient. The ends of intervals count if the model is stiff there and not where they start."""
    stated = _of_corners(problem, points, at_ends=False)
    needed = _steps_for(stated, problem, integrator)
    if needed is None or needed > MOST_EXPLICIT:
        return needed, stated
    ends = _of_corners(problem, _ends, at_ends=True)
    more = _steps_for(ends, problem, integrator)
    return (needed, stated) if more is not None and more <= MOST_EXPLICIT else (more, ends)


def _steps_for(modes: Modes, problem: Problem, integrator: ExplicitRungeKutta) -> int | None:
    """The steps per interval with which an explicit scheme is stable for these modes, at least those that it has."""
    steps = range(integrator.steps, MOST_STEPS + 1)
    return next((n for n in steps if _is_stable(integrator.tableau, modes.values * (max(problem.dt) / n))), None)


def _of_corners(problem: Problem, places: Callable[[Problem], list[tuple[Array, Array]]], at_ends: bool) -> Modes:
    """The modes at these places of all corners."""
    found = [(where, _modes(corner, places(corner))) for where, corner in problem.corners]
    where, _ = max(found, key=lambda each: np.max(np.abs(each[1]), initial=0.0))
    return Modes(np.concatenate([values for _, values in found]), where, at_ends)


def _ends(problem: Problem) -> list[tuple[Array, Array]]:
    """The ends of the longest interval from the points that the problem states, by an implicit scheme."""
    trial, dt = Trial(problem, SDIRK3), max(problem.dt)
    ends = [(trial.interval(x, u, problem.p_value, dt, 1, NEWTON_LIMIT).x, u) for x, u in points(problem)]
    return [(x, u) for x, u in ends if np.all(np.isfinite(x))]


def stability_warning(
    problem: Problem, integrator: Integrator, implicit: Callable[[Problem], ImplicitRungeKutta | None]
) -> tuple[str, ...]:
    """A warning if an explicit scheme is not stable for the longest interval, with the steps that are needed;
    ``implicit``: an implicit scheme that works."""
    if problem.discrete or not isinstance(integrator, ExplicitRungeKutta):
        return ()
    needed, modes = needed_steps(problem, integrator)
    if needed == integrator.steps or not len(modes.values):
        return ()
    offers = []
    found = implicit(problem) if needed is None or needed > MOST_EXPLICIT else None
    if found is not None:
        offers.append(
            f"ImplicitRungeKutta({found.tableau.name}, steps={found.steps}) works there "
            f"(--set integrator={found.name} --set integrator.steps={found.steps})"
        )
    offers.append(
        f"{needed} steps per interval are needed for stability: ExplicitRungeKutta({integrator.tableau.name}, "
        f"steps={needed}), or --set integrator.steps={needed}"
        if needed is not None
        else f"the model is too stiff for an explicit scheme: {MOST_STEPS:,} steps per interval are not sufficient"
    )
    place = "an interval behind" if modes.at_ends else "at"
    where, remedy = f" with {modes.where}" if modes.where else "", "; ".join(offers)
    return (
        f"integrator {integrator.tableau.name} with steps={integrator.steps} is unstable {place} the initial state "
        f"or a reference{where}, where the model has the eigenvalue {modes.fastest} 1/{problem.time_unit}; {remedy}",
    )


def _modes(problem: Problem, places: list[tuple[Array, Array]]) -> Array:
    """Eigenvalues of f_x with Re <= 0 at these points (x, u); those without finite derivatives are left out."""
    x, u, p = problem.path.x, problem.path.u, problem.path.p
    jacobian = ca.Function("f_x", [x, u, p], [ca.densify(ca.jacobian(problem.dynamics(x, u, p), x))])
    found = []
    for state, control in places:
        F = np.asarray(jacobian(state, control, problem.p_value), dtype=float)
        if np.all(np.isfinite(F)):
            values = np.linalg.eigvals(F)
            found.append(values[values.real <= DAMPED * np.abs(values)])
    return np.concatenate(found) if found else np.zeros(0, complex)


def _is_stable(tableau: ButcherTableau, z: Array) -> bool:
    slack = np.where(z.real < -DAMPED * np.abs(z), SLACK, UNDAMPED_SLACK)
    found = map(tableau.stability_function, z)
    return all(math.hypot(R.real, R.imag) <= 1 + more for R, more in zip(found, slack, strict=True))
