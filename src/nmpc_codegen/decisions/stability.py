"""An explicit scheme is stable at the stated points if |R(h lambda)| <= 1 for the damped modes of f_x.

    x+ = R(h lambda) x   for x' = lambda x,   R(z) = 1 + z b' (I - z A)^{-1} 1

(Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.2). RK4 needs |h lambda| < 2.78 on the
negative real axis and 2.83 on the imaginary one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from nmpc_codegen.components.integrators import ButcherTableau, ExplicitRungeKutta
from nmpc_codegen.frontend.completion.first_plan import points
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.ir.casadi_types import Function

Point = tuple[Array, Array]

#: Largest number of steps that a warning proposes.
MOST_STEPS = 1000

#: Number of explicit steps per interval above which a model counts as stiff.
MOST_EXPLICIT = 6

#: A mode counts as damped if its decay rate is at least DAMPED |lambda|; others may grow slightly.
DAMPED, SLACK, UNDAMPED_SLACK = 1e-3, 1e-6, 0.5


class Modes(NamedTuple):
    """The modes are eigenvalues of f_x that do not grow, at stated points, with the location of the fastest one.

    They are taken at the ends of intervals if the model is stiff there and not at the stated points.
    """

    values: Array
    where: str
    at_ends: bool = False

    @property
    def verb(self) -> str:
        """Return the verb for a message: the first plan has, or leads to, these modes."""
        return "leads to" if self.at_ends else "has"

    @property
    def fastest(self) -> str:
        """Return the fastest mode as text; an imaginary part that is rounding is left out."""
        worst = complex(self.values[np.argmax(np.abs(self.values))])
        return f"{worst.real:.3g}" if abs(worst.imag) <= DAMPED * abs(worst) else f"{worst:.3g}"


def stated_modes(problem: Problem) -> Modes:
    """Return the modes at the first plan and at the references of the cost, at all corners of the ranges."""
    return _modes_of_corners(problem, points, at_ends=False)


def modes_at_ends(problem: Problem, end: Callable[[Array, Array, Array], Array]) -> Modes:
    """Return the modes at the ends of the longest interval from these points; ``end`` maps (x, u, p) to that end."""

    def places(corner: Problem) -> list[Point]:
        ends = [(end(x, u, corner.p_value), u) for x, u in points(corner)]
        return [(x, u) for x, u in ends if np.all(np.isfinite(x))]

    return _modes_of_corners(problem, places, at_ends=True)


def steps_for(modes: Modes, integrator: ExplicitRungeKutta, dt: float) -> int | None:
    """Return the steps per interval of length dt with which an explicit scheme is stable for these modes.

    They are at least those of the scheme; None if MOST_STEPS are not sufficient.
    """
    steps = range(integrator.steps, MOST_STEPS + 1)
    return next((n for n in steps if _is_stable(integrator.tableau, modes.values * (dt / n))), None)


def _modes_of_corners(problem: Problem, places: Callable[[Problem], list[Point]], at_ends: bool) -> Modes:
    """Return the modes at these places of all corners."""
    x, u, p = problem.path.x, problem.path.u, problem.path.p
    f_x = ca.Function("f_x", [x, u, p], [ca.densify(ca.jacobian(problem.dynamics(x, u, p), x))])
    found = [(where, _modes(f_x, places(corner), corner.p_value)) for where, corner in problem.corners]
    where, _ = max(found, key=lambda each: np.max(np.abs(each[1]), initial=0.0))
    return Modes(np.concatenate([values for _, values in found]), where, at_ends)


def _modes(f_x: Function, places: list[Point], p: Array) -> Array:
    """Return the eigenvalues of f_x with Re <= 0 at points (x, u) with finite derivatives."""
    found = []
    for x, u in places:
        F = np.asarray(f_x(x, u, p), dtype=float)
        if np.all(np.isfinite(F)):
            values = np.linalg.eigvals(F)
            found.append(values[values.real <= DAMPED * np.abs(values)])
    return np.concatenate(found) if found else np.zeros(0, complex)


def _is_stable(tableau: ButcherTableau, z: Array) -> bool:
    slack = np.where(z.real < -DAMPED * np.abs(z), SLACK, UNDAMPED_SLACK)
    found = map(tableau.stability_function, z)
    return all(math.hypot(R.real, R.imag) <= 1 + more for R, more in zip(found, slack, strict=True))
