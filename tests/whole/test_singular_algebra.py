"""Algebraic equations that lose their solution: build, samples and loop end, and say what they have met."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, ControllerError, Status, build, generate, simulate
from nmpc_codegen.components.integrators.implicit.trial import Trial


def case(equation: Callable[[Any, Any], Any], x0: float, z0: float, fall: float, N: int = 20) -> OCP:
    """A state that falls towards where the equation in z has no solution."""
    ocp = OCP("case", T=2.0, N=N)
    x, u, z = ocp.state("x", initial=x0), ocp.control("u"), ocp.algebraic("z", initial=z0)
    ocp.algebraic_equation(equation(z, x))
    ocp.dynamics({x: u - fall})
    ocp.least_squares(ca.vertcat(x - 1, z - 1, u), weight=[1, 1, 0.1])
    ocp.subject_to(-1, u, 0.2)
    return ocp


LOST = {
    "root": (lambda z, x: z**2 - x, 1.0, 1.0, 0.5),
    "product": (lambda z, x: z * ca.exp(z) - x, 0.5, 0.5, 1.0),
    "sine": (lambda z, x: ca.sin(z) + x, 0.5, -0.5, 1.0),
    "fold": (lambda z, x: z**3 - 3 * z - x, 3.0, 2.1, 2.0),
}


@pytest.mark.parametrize("name", LOST)
def test_a_loop_that_loses_the_solution_ends(name: str) -> None:
    """Every control is finite and inside its bounds, no plan without z is OK, and a plant that is no more is named."""
    ctrl = build(case(*LOST[name]), profile="test")
    x, statuses = np.array([LOST[name][1]]), set()
    for _ in range(60):
        u = ctrl.step(x)
        statuses.add(ctrl.status)
        assert -1 <= u[0] <= 0.2
        assert ctrl.status is not Status.OK or np.isfinite(ctrl.cost)
        x = x + 0.1 * (u - LOST[name][3])
    assert statuses & {Status.NUMERICAL_FAILURE, Status.NOT_CONVERGED}
    with pytest.raises(ControllerError, match="not finite"):
        simulate(ctrl, [LOST[name][1]], 60)


def test_a_first_plan_of_constants_that_fall_is_not_ok_without_the_equation() -> None:
    """The first step has no length, for the controls are at their bounds; it closes gaps all the same."""
    ocp = OCP("case", T=2.0, N=40)
    x, u, z = ocp.state("x", initial=1.0), ocp.control("u"), ocp.algebraic("z", initial=1.0)
    ocp.algebraic_equation(z**2 - x)
    ocp.dynamics({x: -z + u})
    ocp.least_squares(ca.vertcat(x - 1, z - 1, u), weight=[1, 1, 0.1])
    ocp.subject_to(-1, u, -0.2)
    ctrl = build(ocp, profile="test")
    ctrl.step([1.0])
    assert ctrl.status is not Status.OK or np.isfinite(ctrl.cost)


@pytest.mark.filterwarnings("ignore::nmpc_codegen.ProblemWarning")
def test_a_build_at_singular_points_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four parameters with ranges have seventeen corners, at each of which z^2 = x is singular at the reference."""
    count, solve = [0], Trial._solve

    def counted(*given: Any) -> Any:
        count[0] += 1
        return solve(*given)

    monkeypatch.setattr(Trial, "_solve", counted)
    ocp = OCP("case", T=2.0, N=20)
    x, u, z = ocp.state("x", initial=1.0), ocp.control("u"), ocp.algebraic("z", initial=1.0)
    p = [ocp.parameter(f"p{i}", value=1.0, bounds=(0.5, 2)) for i in range(4)]
    ocp.algebraic_equation(z**2 - x * p[0])
    ocp.dynamics({x: -z * p[1] + u * p[2] - 0.1 * p[3]})
    ocp.least_squares(ca.vertcat(x, z, u), weight=[1, 1, 0.1])
    ocp.subject_to(-1, u, 0.2)
    generate(ocp)
    assert count[0] < 20_000


@pytest.mark.parametrize("start", [1.0, 0.01])
def test_unknowns_that_are_zero_at_the_first_plan_have_a_size(start: float) -> None:
    """z + exp(z) = x has z = 0 at x = 1, where Newton's method ends at rounding errors."""
    ctrl = build(case(lambda z, x: z + ca.exp(z) - x, 1.0, start, 0.0), profile="test")
    ctrl.step([1.0])
    assert ctrl.status is Status.OK
    assert ctrl.integrate([1.0], [0.2], 0.1)[0] == pytest.approx(1.02, abs=1e-9)
