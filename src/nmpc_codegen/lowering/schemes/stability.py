"""Whether an explicit scheme is stable where the problem is stated: |R(h lambda)| <= 1 for the damped modes of f_x.

    R(z) = 1 + z b' (I - z A)^{-1} 1,   x+ = R(h lambda) x   for x' = lambda x

(Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.2). RK4 needs |h lambda| < 2.78 on the
negative real axis and 2.83 on the imaginary one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators import ButcherTableau, ExplicitRungeKutta, ImplicitRungeKutta
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
    """Eigenvalues of f_x that do not grow, where the problem states points, and where the fastest of them is."""

    values: Array
    where: str

    @property
    def fastest(self) -> str:
        """The fastest one, without an imaginary part that is rounding."""
        worst = complex(self.values[np.argmax(np.abs(self.values))])
        return f"{worst.real:.3g}" if abs(worst.imag) <= DAMPED * abs(worst) else f"{worst:.3g}"


def needed_steps(problem: Problem, integrator: ExplicitRungeKutta) -> tuple[int | None, Modes]:
    """The steps per interval with which an explicit scheme is stable, at least those that it has; None if MOST_STEPS
    are not sufficient."""
    of_corners = [(where, _modes(corner)) for where, corner in problem.corners]
    values = np.concatenate([found for _, found in of_corners])
    where, _ = max(of_corners, key=lambda found: np.max(np.abs(found[1]), initial=0.0))
    steps = range(integrator.steps, MOST_STEPS + 1)
    needed = next((n for n in steps if _is_stable(integrator.tableau, values * (max(problem.dt) / n))), None)
    return needed, Modes(values, where)


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
    where, remedy = f" with {modes.where}" if modes.where else "", "; ".join(offers)
    return (
        f"integrator {integrator.tableau.name} with steps={integrator.steps} is unstable at the initial state "
        f"or a reference{where}, where the model has the eigenvalue {modes.fastest} 1/{problem.time_unit}; {remedy}",
    )


def _modes(problem: Problem) -> Array:
    """Eigenvalues of f_x with Re <= 0 at the points that the problem states; those without finite derivatives are left
    out."""
    x, u, p = problem.path.x, problem.path.u, problem.path.p
    jacobian = ca.Function("f_x", [x, u, p], [ca.densify(ca.jacobian(problem.dynamics(x, u, p), x))])
    found = []
    for state, control in points(problem):
        F = np.asarray(jacobian(state, control, problem.p_value), dtype=float)
        if np.all(np.isfinite(F)):
            values = np.linalg.eigvals(F)
            found.append(values[values.real <= DAMPED * np.abs(values)])
    return np.concatenate(found) if found else np.zeros(0, complex)


def _is_stable(tableau: ButcherTableau, z: Array) -> bool:
    a, b = (np.array(part, dtype=float) for part in (tableau.a, tableau.b))
    one = np.ones(len(b))
    for value in z:
        amplification = abs(1 + value * b @ np.linalg.solve(np.eye(len(b)) - value * a, one))
        damped = value.real < -DAMPED * abs(value)
        if amplification > 1 + (SLACK if damped else UNDAMPED_SLACK):
            return False
    return True
