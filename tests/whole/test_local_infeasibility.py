"""solve() at a local minimum of the violation: it begins again on the line to where the plan ends."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, Status, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference, node_data


def road(amplitude: float, width: float, drag: float, end: float) -> OCP:
    """Minimum time along a road that bends, between two stops."""
    ocp = OCP("road", T=1.0, N=40)
    x, y, vx, vy = (ocp.state(name) for name in ("x", "y", "vx", "vy"))
    T, a = ocp.state("T", initial=12.0), ocp.control("a", size=2)
    ocp.dynamics({x: T * vx, y: T * vy, vx: T * (a[0] - drag * vx), vy: T * (a[1] - drag * vy), T: 0})
    ocp.free_initial(T)
    ocp.terminal_cost(T)
    ocp.subject_to(1, T, 30)
    ocp.subject_to(-np.inf, ca.sumsqr(a), 1, name="grip")
    ocp.subject_to(-np.inf, vx**2 + vy**2, 1.5, name="speed")
    ocp.subject_to(-width, y - amplitude * ca.sin(x), width, name="road")
    goal = [end, amplitude * np.sin(end), 0, 0]
    ocp.subject_to(goal, ca.vertcat(x, y, vx, vy), goal, at="end", name="goal")
    return ocp


@pytest.mark.parametrize("drawn", [(1.0, 0.3, 0.1, 6.28), (0.97, 0.21, 0.06, 6.8), (1.24, 0.2, 0.18, 5.91)])
def test_a_road_is_followed_from_a_guess_of_zeros(drawn: Any) -> None:
    ocp = road(*drawn)
    ctrl = build(ocp, profile="test")
    found = ctrl.solve([0, 0, 0, 0, 12.0], max_iterations=150)
    assert found.status is Status.OK, ctrl.diagnose()
    problem = classify(ocp)
    data = node_data(problem, x0=[0, 0, 0, 0, found.x[0, 4]])
    assert found.cost <= Reference(problem, tol=1e-9).solve(data, x=found.x, u=found.u).cost * (1 + 1e-6)


def test_what_is_infeasible_is_said_to_be_so_near_the_plans_that_were_tried() -> None:
    """A wall across the road; no guess leads on. Restarts are part of the iterations that are allowed."""
    ocp = OCP("wall", T=2.0, N=10)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(u, weight=1.0)
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(5, x**2 + x, 5, at="end", name="goal")
    ctrl = build(ocp, profile="test")
    found = ctrl.solve([0.0], max_iterations=60)
    assert found.status is Status.OK
    ocp.subject_to(-1, x, 1, name="wall")
    ctrl = build(ocp, profile="test")
    found = ctrl.solve([0.0], max_iterations=60)
    assert found.status is Status.INFEASIBLE
    assert found.iterations <= 60
    assert "near the plans that were tried: another guess, written to ctrl.x and ctrl.u, may lead on" in ctrl.diagnose()


def test_another_guess_may_lead_on() -> None:
    """The advice has been tried: from the plan of a road with a lower bend, without restarts, this one is found."""
    gentle, ocp = build(road(0.5, 0.3, 0.1, 6.28), profile="test"), road(1.0, 0.3, 0.1, 6.28)
    plan = gentle.solve([0, 0, 0, 0, 12.0], max_iterations=150)
    ctrl = build(ocp, profile="test")
    ctrl.x[:], ctrl.u[:] = plan.x, plan.u
    found = ctrl.solve([0, 0, 0, 0, plan.x[0, 4]], max_iterations=60)
    assert found.status is Status.OK
    assert found.x[-1, 4] == pytest.approx(6.936, abs=0.01)
