"""ocp.lqr_terminal_cost(): the first control of a short plan is that of the regulator, by IPOPT and by the C."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy.linalg

from examples import driving
from nmpc_codegen import OCP, ExplicitRungeKutta, Options, ProblemError, build, generate
from nmpc_codegen.economic.terminal import lqr_terminal_cost
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.complete import complete
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.reference import CLASSICAL, solve_reference


def completed_of(ocp: OCP, options: Options | None = None) -> Problem:
    """The problem with its terminal cost."""
    return complete(classify(ocp), options or Options())


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
    problem = completed_of(ocp, options)
    assert problem.terminal.y_names == ("x", "v")
    assert problem.uses == frozenset()
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
    problem = completed_of(ocp)
    assert "general cost" in problem.uses
    u0 = solve_reference(problem).u[0]
    np.testing.assert_allclose(u0, found.u_s - found.K @ (problem.x_initial - found.x_s), rtol=0, atol=1e-7)


def pushed(N: int, turn: float = 0.0, mixed: bool = False) -> OCP:
    """An indefinite quadratic cost that pushes the first of two states against its bound; rotated by a storage."""
    ocp = OCP("pushed", N=N)
    x, u = ocp.state("x", size=2, initial=[0.8, 0.3]), ocp.control("u", size=2)
    x_next = np.array([[0.9, 0.2], [-0.3, 1.1]]) @ x + np.array([[1.0, 0.3], [0.2, 1.0]]) @ u
    ocp.dynamics({x: x_next}, discrete=True)
    storage = lambda z: turn * (z[0] ** 2 - z[0] * z[1] - 2 * z[1] ** 2 + z[0])  # noqa: E731
    ocp.stage_cost(-5 * x[0] + x[1] ** 2 + 0.1 * ca.sumsqr(u) + 0.05 * u[0] * x[1] + storage(x_next) - storage(x))
    if mixed:
        ocp.subject_to(-np.inf, x[0] + 0.1 * u[0], 1, name="row")
        ocp.subject_to(-9, x, 9)
    else:
        ocp.subject_to(-9, x, [1, 9])
    ocp.lqr_terminal_cost(economic=True)
    return ocp


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("turn", [0.0, 1.5])
@pytest.mark.parametrize("N", [1, 3])
def test_active_row_at_the_steady_state(N: int, turn: float, mixed: bool) -> None:
    """A short plan is the beginning of a long one, also when it ends on a row, which keeps its multiplier there.

    IPOPT solves both. A row of states is stated at node N, too; a mixed row belongs to the cost-to-go.
    """
    found = lqr_terminal_cost(pushed(2, turn, mixed), economic=True)
    assert found.active == (("row",) if mixed else ("x[0]",))
    assert (abs(found.slope[0] - found.lam[0]) < 1e-9) == mixed
    long, short = (solve_reference(completed_of(pushed(k, turn, mixed))) for k in (40, N))
    np.testing.assert_allclose(short.u, long.u[:N], rtol=0, atol=2e-7)
    np.testing.assert_allclose(short.x, long.x[: N + 1], rtol=0, atol=2e-7)
    assert np.abs(long.x[N] - found.x_s).max() > 1e-4, "the plan must not end in the steady state already"


def test_indefinite_cost_to_go_of_the_car() -> None:
    """2 s with the cost-to-go plan like 12 s, by IPOPT; the brake is held at its bound, the position left out."""
    plans = []
    for N in (20, 120):
        ocp = driving.build_ocp(intervals=N)
        problem = completed_of(ocp, driving.options())
        x0 = np.array([0.0, 0.3, driving.SPEED + 0.05, 0.01, 0.0])
        plans.append(solve_reference(problem, replace(CLASSICAL, steps=driving.STEPS), x0=x0))
    assert np.linalg.eigvalsh(lqr_terminal_cost(ocp, driving.options(), economic=True).P)[0] < -0.1
    np.testing.assert_allclose(plans[0].u, plans[1].u[:20], rtol=0, atol=5e-6)
    np.testing.assert_allclose(plans[0].x, plans[1].x[:21], rtol=0, atol=5e-5)


def test_rows_that_bind_further_states_are_refused() -> None:
    """p <= 1 of p+ = p + v, v+ = v + u, strictly active, keeps v = 0, which no row states at node N."""
    ocp = OCP("wall", N=3)
    p, v, u = ocp.state("p"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({p: p + v, v: v + u}, discrete=True)
    ocp.stage_cost(-p + v**2 + u**2)
    ocp.subject_to(-np.inf, p, 1)
    with pytest.raises(ProblemError, match=r"strictly active rows \(p\).*ocp\.subject_to\(best\.x"):
        lqr_terminal_cost(ocp, economic=True)


def test_equations_of_a_tracking_problem_hold_behind_the_end() -> None:
    """u_0 + u_1 = 0 at every interval: the regulator has one control."""
    ocp = OCP("equation", N=1)
    x, u = ocp.state("x", size=2, initial=[1.0, 1.0]), ocp.control("u", size=2)
    A, B = np.array([[0.9, 0.2], [-0.3, 1.1]]), np.array([[1.0, 0.3], [0.2, 1.0]])
    ocp.dynamics({x: A @ x + B @ u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ocp.subject_to(0, u[0] + u[1], 0)
    found = lqr_terminal_cost(ocp)
    expected = scipy.linalg.solve_discrete_are(A, B @ [[1.0], [-1.0]], np.eye(2), [[2.0]])
    np.testing.assert_allclose(found.P, expected, rtol=1e-9)


def test_mode_that_no_control_moves_is_named() -> None:
    ocp = OCP("uncontrolled", T=1.0, N=5)
    x, y, u = ocp.state("x"), ocp.state("y"), ocp.control("u")
    ocp.dynamics({x: u - x, y: 0.5 * y})
    ocp.least_squares(ca.vertcat(x, y, u), weight=1.0)
    with pytest.raises(ProblemError, match=r"no control moves a mode of y that changes by the factor 1\.105"):
        lqr_terminal_cost(ocp)


def test_steady_state_outside_its_bounds_is_refused() -> None:
    ocp = oscillator(x=[0.5, 0.0], u=[0.5])
    ocp.subject_to(-1, ocp.x[0], 0.4, name="near")
    with pytest.raises(ProblemError, match=r"violates the row 'near': 0\.5 is not in -1 \.\. 0\.4"):
        completed_of(ocp)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"x": [1, 2, 3], "u": [0]}, "x has shape"), ({"x": "a"}, "x must be numbers"), ({"economic": "yes"}, "economic")],
)
def test_bad_arguments(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        lqr_terminal_cost(oscillator(), **arguments)  # type: ignore[arg-type]


def test_terminal_terms_add_up() -> None:
    """A terminal cost of the user stays."""
    ocp = economic(2)
    ocp.terminal_cost(5 * ocp.x**2)
    both, alone = completed_of(ocp).terminal, completed_of(economic(2)).terminal
    values = [float(ca.Function("V", [s.x, s.p], [s.cost])(0.7, ca.DM(0, 1))) for s in (both, alone)]
    assert values[0] - values[1] == pytest.approx(5 * 0.49, abs=1e-12)


def test_given_steady_state() -> None:
    """Away from the references, where the cost has a slope that a tracking terminal cost ignores."""
    found = lqr_terminal_cost(oscillator(), x=[0.5, 0.0], u=[0.5])
    np.testing.assert_allclose(found.x_s, [0.5, 0])
    np.testing.assert_allclose(found.P, lqr_terminal_cost(oscillator()).P, rtol=1e-8)
    assert not found.lam.any()
    problem = completed_of(oscillator(x=[0.5, 0.0], u=[0.5]))
    np.testing.assert_allclose(problem.terminal.reference, [0.5, 0])


def test_cyclic_state_is_left_out() -> None:
    ocp = OCP("cart", T=1.0, N=5)
    p, v, u = ocp.state("p"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({p: v + 1, v: u - v})
    ocp.least_squares(ca.vertcat(v, u), weight=1.0)
    ocp.lqr_terminal_cost()
    ocp.cyclic(p)
    assert completed_of(ocp).terminal.y_names == ("v",)
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
        generate(oscillator(**request_))


def test_references_that_are_no_steady_state() -> None:
    ocp = OCP("far", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0, reference=[1.0, 0.0])
    ocp.lqr_terminal_cost()
    with pytest.raises(ProblemError, match="the references are no steady state"):
        completed_of(ocp)


def test_general_cost_needs_economic() -> None:
    ocp = OCP("general", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(x**2 + u**2)
    ocp.lqr_terminal_cost()
    with pytest.raises(ProblemError, match="no least squares; use economic=True"):
        completed_of(ocp)
    with pytest.raises(ProblemError, match="stated twice"):
        ocp.lqr_terminal_cost(economic=True)
