"""Whether an explicit scheme is stable where the problem is stated: |R(h lambda)| <= 1 for the damped modes of f_x.

    R(z) = 1 + z b' (I - z A)^{-1} 1,   x+ = R(h lambda) x   for x' = lambda x

(Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.2). RK4 needs |h lambda| < 2.78 on the
negative real axis and 2.83 on the imaginary one.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.integrators import ButcherTableau, ExplicitRungeKutta
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.lowering.first_plan import points

Array = NDArray[Any]

#: More steps than this are no remedy.
MOST_STEPS = 1000

#: A mode counts as damped if its decay rate is at least this part of |lambda|; others may grow by rounding or little.
DAMPED, SLACK, UNDAMPED_SLACK = 1e-3, 1e-6, 0.5


def stability_warning(problem: Problem, integrator: Integrator) -> tuple[str, ...]:
    """A warning that names the steps that are needed, if the scheme is not stable for the longest interval."""
    if problem.discrete or not isinstance(integrator, ExplicitRungeKutta):
        return ()
    of_corners = [(where, _modes(corner)) for where, corner in problem.corners]
    modes = np.concatenate([found for _, found in of_corners])
    steps = range(integrator.steps, MOST_STEPS + 1)
    needed = next((n for n in steps if _is_stable(integrator.tableau, modes * (max(problem.dt) / n))), None)
    if needed == integrator.steps or not len(modes):
        return ()
    where, of_worst = max(of_corners, key=lambda found: np.max(np.abs(found[1]), initial=0.0))
    worst = of_worst[np.argmax(np.abs(of_worst))]
    remedy = (
        f"{needed} steps per interval are needed for stability: ExplicitRungeKutta({integrator.tableau.name}, "
        f"steps={needed}), or --set integrator.steps={needed}"
        if needed is not None
        else "no number of steps up to 1,000 is sufficient: the model may be too stiff for an explicit scheme"
    )
    return (
        f"integrator {integrator.tableau.name} with steps={integrator.steps} is unstable at the initial state "
        f"or a reference{f' with {where}' if where else ''}, where the model has the eigenvalue {worst:.3g} 1/s; "
        f"{remedy}",
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
