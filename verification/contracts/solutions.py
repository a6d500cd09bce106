"""These contracts compare solve() with IPOPT, and the KKT residuals and the cost of any plan with numpy."""

from __future__ import annotations

import numpy as np
import pytest

from nmpc_codegen import Controller, Status
from nmpc_codegen.oracle.trajectory import Data, evaluate_cost, kkt_residuals
from verification.contracts.subject import MOST_ITERATIONS, TOLERANCE, Array, Subject, relative
from verification.problems import point

#: Distances from IPOPT's controls and states, and relative cost, in each precision; residuals of a solution in double.
NEAR = {"double": 1e-5, "single": 5e-3}
SAME_COST = {"double": 1e-8, "single": 5e-4}
STATIONARY = 1e-6
ROUGH = 2e-5  # tolerance of single shooting, which approaches rows by penalties and barriers
#: Relative errors of the residuals and the cost of a plan.
ROUNDING = {"double": 1e-9, "single": 2e-3}
MULTIPLIERS = ("lam", "mu_x", "mu_u", "mu", "mu_N", "eta")


def solve_equals_ipopt(subject: Subject) -> None:
    """Assert that solve() returns IPOPT's controls, states and cost, and that numpy's KKT residuals vanish."""
    controller, x0 = subject.controller(), subject.measured()
    compare_with_ipopt(subject, controller, x0, subject.data(x0))


def compare_with_ipopt(subject: Subject, controller: Controller, x0: Array, data: Data) -> None:
    """Solve for x0 and these data, and compare with IPOPT.

    Where the problem has several solutions, IPOPT starts once more at ours, and must find nothing cheaper there.
    """
    precision = subject.options.precision
    tol = max(TOLERANCE[precision], ROUGH * (subject.model.parts.algorithm.name == "adjoint_shooting"))
    solution = controller.solve(x0, tol, MOST_ITERATIONS)
    found = subject.oracle.solve(data)
    if not found.success:
        assert solution.status is not Status.OK, f"OK where IPOPT says {found.status}"
        return
    assert solution.status is Status.OK, controller.diagnose()
    own = solution.x.shape[1]
    if max(relative(solution.u, found.u), relative(solution.x, found.x[:, :own])) > NEAR[precision]:
        plan = np.array(controller.whole_x, dtype=float)
        found = subject.oracle.solve(data, x=plan, u=np.array(solution.u, dtype=float))
    same = abs(solution.cost - found.cost) <= max(SAME_COST[precision], 2 * tol) * max(abs(found.cost), 1e-2)
    if precision == "double" and has_multipliers(subject, controller):
        residuals = kkt_residuals(subject.model.problem, point(controller), data, subject.scheme)
        assert residuals.worst <= STATIONARY * max(1.0, abs(found.cost)), residuals
        same |= found.residuals.worst > residuals.worst or solution.cost > found.cost  # another local solution
    assert same, f"cost {solution.cost:.10g}, that of IPOPT {found.cost:.10g}"


def residuals_and_cost_equal_numpy(subject: Subject) -> None:
    """Compare kkt() and cost of a plan that is no solution with numpy; multipliers keep their signs and zeros."""
    controller, x0, precision = subject.controller(), subject.measured(), subject.options.precision
    controller.solve(x0, TOLERANCE[precision])
    problem, data, random = subject.model.problem, subject.data(x0), np.random.default_rng(7)
    names = ("x", "u", *(MULTIPLIERS if has_multipliers(subject, controller) else ()))
    for name in names:
        value = np.array(getattr(controller, name))
        moved = value * (1 + 0.1 * random.uniform(-1, 1, value.shape))
        if name in ("x", "u", "lam"):
            moved += 0.05 * random.uniform(-1, 1, value.shape)
        if name == "x" and problem.coupled is not None:
            moved[0] = value[0]  # AugmentedLagrangian reads the measured state in coupled rows
        setattr(controller, name, moved.astype(value.dtype))
    rel = ROUNDING[precision]
    x, u = (np.array(a, dtype=float) for a in (controller.whole_x, controller.u))
    cost = evaluate_cost(problem, x, u, data, subject.scheme)
    assert controller.cost == pytest.approx(cost, rel=rel, abs=rel)
    if not has_multipliers(subject, controller):
        return
    ours, theirs = controller.kkt(), kkt_residuals(problem, point(controller), data, subject.scheme)
    assert theirs.worst > 1e-3
    least = rel * max(1.0, theirs.stationarity)
    for part in ("stationarity", "equality", "inequality"):
        assert getattr(ours, part) == pytest.approx(getattr(theirs, part), rel=rel, abs=least), part
    if all(row.lower < row.upper for row in problem.rows):  # C has equations among the inequalities
        assert ours.complementarity == pytest.approx(theirs.complementarity, rel=rel, abs=least)


def has_multipliers(subject: Subject, controller: Controller) -> bool:
    """Return True if every multiplier of the problem can be read.

    This excludes added states, and controllers of single shooting, which keep no multipliers.
    """
    return hasattr(controller, "lam") and not controller.description.augmentation.count
