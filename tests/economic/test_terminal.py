"""ocp.lqr_terminal_cost(): the first control of a short plan is that of the regulator, by IPOPT and by the C."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, ExplicitRungeKutta, Options, ProblemError, build
from nmpc_codegen.compiler import compiled, stated
from nmpc_codegen.economic.terminal import lqr_terminal_cost
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.oracle.reference import CLASSICAL, solve_reference


def oscillator(N: int = 4, **request: object) -> OCP:
    """A linear oscillator, tracking; the regulator is the solution of any horizon."""
    ocp = OCP("oscillator", T=0.3 * N, N=N)
    x, v = ocp.state("x", initial=1.0), ocp.state("v", initial=-0.5)
    u = ocp.control("u")
    ocp.dynamics({x: v, v: -x + u})
    ocp.least_squares(ca.vertcat(x, v, x + u), weight=[2.0, 1.0, 0.3], reference=[1.0, 0.0, 2.0])
    ocp.lqr_terminal_cost(**request)  # type: ignore[arg-type]
    return ocp


def test_tracking_is_the_infinite_horizon() -> None:
    """Cross terms, references, the scheme of the options; the weight is a residual whose reference can be changed."""
    options = Options(integrator=ExplicitRungeKutta(steps=3))
    ocp = oscillator()
    found = lqr_terminal_cost(ocp, options)
    np.testing.assert_allclose([*found.x_s, *found.u_s], [1, 0, 1], atol=1e-9)
    assert found.semidefinite
    problem = stated(ocp, options)
    assert problem.terminal.y_names == ("x", "v")
    assert problem.features == frozenset()
    u0 = solve_reference(problem, replace(CLASSICAL, steps=3)).u[0]
    expected = found.u_s - found.K @ (problem.x_initial - found.x_s)
    np.testing.assert_allclose(u0, expected, rtol=0, atol=1e-8)
    other = lqr_terminal_cost(ocp, Options(integrator=ExplicitRungeKutta(steps=1)))
    assert np.abs(other.P - found.P).max() > 1e-7, "the scheme makes no difference"


def test_generated_controller() -> None:
    """The C computes the feedback of the regulator, also with Gauss-Newton."""
    ocp = oscillator()
    found = lqr_terminal_cost(ocp)
    controller = build(ocp, profile="test")
    x0 = np.array([0.3, 0.2])
    np.testing.assert_allclose(controller.step(x0), found.u_s - found.K @ (x0 - found.x_s), rtol=0, atol=1e-7)


def economic(N: int, shift: float = 3.0) -> OCP:
    """A linear map with an indefinite quadratic cost and linear terms: x^2 + u^2 rotated by shift x^2 + x."""
    ocp = OCP("economic", N=N)
    x, u = ocp.state("x", initial=1.5), ocp.control("u")
    x_next = 1.2 * x + u
    ocp.dynamics({x: x_next}, discrete=True)
    ocp.stage_cost((x - 1) ** 2 + u**2 + shift * (x_next**2 - x**2) + x_next - x)
    ocp.lqr_terminal_cost(economic=True)
    return ocp


@pytest.mark.parametrize("N", [1, 2, 6])
def test_economic_is_the_infinite_horizon(N: int) -> None:
    """P is negative, and the linear term is needed: with both, every horizon gives the same control."""
    ocp = economic(N)
    found = lqr_terminal_cost(ocp, economic=True)
    assert found.P[0, 0] < 0
    assert abs(found.lam[0]) > 0.5
    problem = stated(ocp)
    assert "general cost" in problem.features
    u0 = solve_reference(problem).u[0]
    np.testing.assert_allclose(u0, found.u_s - found.K @ (problem.x_initial - found.x_s), rtol=0, atol=1e-7)


def test_terminal_terms_add_up() -> None:
    """A terminal cost of the user stays."""
    ocp = economic(2)
    ocp.terminal_cost(5 * ocp.x**2)
    both, alone = stated(ocp).terminal, stated(economic(2)).terminal
    values = [float(ca.Function("V", [s.x, s.p], [s.cost])(0.7, ca.DM(0, 1))) for s in (both, alone)]
    assert values[0] - values[1] == pytest.approx(5 * 0.49, abs=1e-12)


def test_given_steady_state() -> None:
    """Away from the references, where the cost has a slope that a tracking terminal cost ignores."""
    found = lqr_terminal_cost(oscillator(), x=[0.5, 0.0], u=[0.5])
    np.testing.assert_allclose(found.x_s, [0.5, 0])
    np.testing.assert_allclose(found.P, lqr_terminal_cost(oscillator()).P, rtol=1e-8)
    assert not found.lam.any()
    problem = stated(oscillator(x=[0.5, 0.0], u=[0.5]))
    np.testing.assert_allclose(problem.terminal.reference, [0.5, 0])


def test_cyclic_state_is_left_out() -> None:
    ocp = OCP("cart", T=1.0, N=5)
    p, v, u = ocp.state("p"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({p: v + 1, v: u - v})
    ocp.least_squares(ca.vertcat(v, u), weight=1.0)
    ocp.lqr_terminal_cost()
    ocp.cyclic(p)
    assert stated(ocp).terminal.y_names == ("v",)
    found = lqr_terminal_cost(ocp)
    assert not found.P[0].any()
    assert found.P[1, 1] > 0
    assert found.K[0, 0] == 0


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"x": [0.5, 0.0], "u": [0.0]}, "are no steady state: one interval moves a state by"),
        ({"x": [0.5, 0.0]}, "give both x and u"),
        ({"x": [0.5]}, "lqr_terminal_cost: x has shape"),
        ({"economic": 1}, "economic must be True or False"),
    ],
)
def test_refusals(request_: dict[str, object], message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        compiled(oscillator(**request_))


def test_references_that_are_no_steady_state() -> None:
    ocp = OCP("far", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0, reference=[1.0, 0.0])
    ocp.lqr_terminal_cost()
    with pytest.raises(ProblemError, match="the references are no steady state"):
        stated(ocp)


def test_general_cost_needs_economic() -> None:
    ocp = OCP("general", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(x**2 + u**2)
    ocp.lqr_terminal_cost()
    with pytest.raises(ProblemError, match="no least squares; use economic=True"):
        stated(ocp)
    with pytest.raises(ProblemError, match="stated twice"):
        ocp.lqr_terminal_cost(economic=True)


def test_open_request_is_no_model() -> None:
    """A problem whose terminal cost has not been computed never reaches the C."""
    with pytest.raises(ProblemError, match="lqr_terminal_cost"):
        linearize(classify(oscillator()), Options())
