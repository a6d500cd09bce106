"""solve() of the generated C against IPOPT, and its KKT residuals and cost against those recomputed in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    AdjointShooting,
    AugmentedLagrangian,
    ExactHessian,
    GaussNewton,
    Online,
    Options,
    RealTimeIteration,
    build,
    simulate,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import solve_reference
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.solving import Solution
from verification import problems
from verification.contracts.subject import relative
from verification.problems import CASES

#: General rows, optimised.
FAST = ("path_rows",)


def assert_equal_to_ipopt(name: str, solution: Solution, tolerance: float = 1e-6) -> None:
    reference = problems.reference(name)
    assert reference.success
    assert solution.status == Status.OK
    assert relative(solution.u, reference.u) <= tolerance
    assert relative(solution.x, reference.x) <= tolerance
    assert abs(solution.cost - reference.cost) <= 1e-2 * tolerance * abs(reference.cost)


@pytest.mark.parametrize("part", ["x", "u", "lam", "mu_u"])
def test_residuals_of_a_plan_that_is_not_finite(part: str) -> None:
    """NaN at one node shows, whatever the residuals of the other nodes are."""
    c = problems.controller("crane").copy()
    assert c.solve((1.0, 0.0, 0.0, 0.0)).status == Status.OK
    for node in range(len(getattr(c, part))):
        broken = c.copy()
        getattr(broken, part)[node, 0] = np.nan
        residuals = broken.kkt()
        assert np.isnan(residuals.stationarity) or np.isnan(residuals.equality), node


def test_warm_start_needs_no_iteration() -> None:
    c = problems.controller("path_rows")
    first = c.solve(CASES["path_rows"].x0, tol=1e-9)
    again = c.solve(CASES["path_rows"].x0, tol=1e-9)
    assert first.iterations > 2
    assert again.iterations == 0
    np.testing.assert_array_equal(again.u, first.u)


def test_a_warm_started_loop_begins_with_the_solution() -> None:
    """The plan of solve() belongs to the first sample, so that this sample does not shift it."""
    c = build(CASES["crane"].make(), Options(algorithm=RealTimeIteration(shift="repeat")), profile="test")
    x0 = (0.8, 0.2, 0.1, 0.0)
    solution = c.copy().solve(x0, tol=1e-10)
    log = simulate(c, x0, 1, warm_start=True)
    np.testing.assert_allclose(log.u[0], solution.u[0], atol=1e-9)


ALGORITHMS = {
    "repeat": RealTimeIteration(shift="repeat"),
    "resample": RealTimeIteration(sampling_time=0.04),
    "augmented Lagrangian": AugmentedLagrangian(),
    "adjoint shooting": AdjointShooting(),
}


def pendulum() -> OCP:
    ocp = OCP("swing", T=1.0, N=20)
    q, w, u = ocp.state("q", initial=np.pi), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: 9.81 * ca.sin(q) + 4 * u})
    ocp.least_squares(ca.vertcat(q, w, u), weight=[5, 0.1, 0.05], names=["to_q", "to_w", "to_u"])
    ocp.subject_to(-40, u, 40)
    return ocp


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_any_other_call_moves_the_plan_as_ever(algorithm: str) -> None:
    """A sample elsewhere, the one after a sample at the state of solve(), and one after shift() are shifted."""
    c, x = build(pendulum(), Options(algorithm=ALGORITHMS[algorithm]), "test"), np.array([1.0, 0.0])
    c.solve(x)
    assert c.member("solved") == 1
    calls: list[Callable[[Controller], object]] = [
        lambda d: d.step([1.0, 1e-9]),
        lambda d: d.step([np.nan, 0.0]),
        lambda d: d.step(x),
        lambda d: d.shift(),
        lambda d: d.reset(),
    ]
    for call in calls:
        d = c.copy()
        call(d)
        assert d.member("solved") == 0
    if not c.description.has_phases:
        return
    again = c.copy()
    again.shift()
    again.solve(c.x[1])  # a loop that samples by solve()
    np.testing.assert_allclose(again.copy().step(c.x[1]), again.u[0], atol=1e-6)


def test_bounds_of_a_control_that_have_moved_beyond_the_plan() -> None:
    """A plan that was optimal, and whose third control lies outside of its new bounds, is no place to stall."""
    ocp = OCP("moved", T=3.0, N=10)
    p, v, F = ocp.state("p"), ocp.state("v"), ocp.control("F")
    ocp.dynamics({p: v, v: F - ca.sin(p)})
    ocp.least_squares(ca.vertcat(p, v, F), weight=[1, 1, 1], reference=[1, 0, 0])
    ocp.subject_to(-5, F, 5)
    controller = build(ocp, Options(online=Online(bounds="node")))
    assert controller.solve([0.0, 0.0]).status == Status.OK
    controller.set_bounds("F", 1.2, 1.3, node=2)
    found = controller.solve([0.0, 0.0])
    assert found.status == Status.OK
    assert found.u[2, 0] == pytest.approx(1.2)
    controller.reset()
    np.testing.assert_allclose(controller.solve([0.0, 0.0]).u, found.u, atol=1e-6)


def test_iteration_limit() -> None:
    c = problems.controller("crane")
    solution = c.solve(CASES["crane"].x0, tol=1e-10, max_iterations=1)
    assert solution.status == Status.ITERATION_LIMIT
    assert solution.iterations == 1
    assert solution.kkt.equality > 1e-10
    assert c.status == Status.ITERATION_LIMIT


def test_infeasible_and_recovered() -> None:
    """The elastic QP leads to a point of least violation, which is no solution; the next solve is independent of it."""
    c = problems.controller("crane")
    solution = c.solve((1.0, 0.0, 0.5, 0.0))
    assert solution.status == Status.INFEASIBLE
    assert np.isfinite(c.x).all()
    assert solution.kkt.inequality > 1e-3
    assert np.abs(solution.u).max() <= 1.0
    assert_equal_to_ipopt("crane", c.solve(CASES["crane"].x0, tol=1e-10))


def test_never_ok_without_being_solved() -> None:
    """At the iteration limit the status states it, and the residuals are the true ones."""
    ocp: OCP = problems.disc()
    without = Options(hessian=GaussNewton())
    solution = build(ocp, without, profile="test").solve((1.0, 0.0), tol=1e-8, max_iterations=3)
    assert solution.status == Status.ITERATION_LIMIT
    assert max(vars(solution.kkt).values()) > 1e-3
    assert np.isfinite(solution.x).all()


def test_single_interval_by_hand() -> None:
    """x' = u, one Euler-exact interval: min 1/2 (W x0^2 + R u^2 + P (x0 + T u)^2), u = -P T x0 / (R + P T^2)."""
    ocp = OCP("point", T=0.5, N=1)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(u, weight=[0.2])
    ocp.terminal_least_squares(x, weight=[3.0])
    solution = build(ocp, profile="test").solve((2.0,), tol=1e-12)
    expected = -3.0 * 0.5 * 2.0 / (0.2 + 3.0 * 0.25)
    assert solution.u[0, 0] == pytest.approx(expected, rel=1e-14)
    assert solution.lam[1, 0] == pytest.approx(3.0 * (2.0 + 0.5 * expected), rel=1e-13)
    assert solution.cost == pytest.approx(0.1 * expected**2 + 1.5 * (2.0 + 0.5 * expected) ** 2, rel=1e-14)


def test_convex_rows_make_the_disc_converge() -> None:
    """The curvature of an active convex row, which plain Gauss-Newton lacks: equal to IPOPT in a few iterations."""
    ocp = problems.disc()
    solution = build(ocp, Options(hessian=GaussNewton()), "test").solve((1.0, 0.0), tol=1e-8)
    reference = solve_reference(classify(ocp), x0=[1.0, 0.0])
    assert solution.status == Status.OK
    assert solution.iterations <= 15
    np.testing.assert_allclose(solution.u, reference.u, atol=1e-6)
    np.testing.assert_allclose(solution.cost, reference.cost, rtol=1e-8)


def test_concave_rows_are_left_out() -> None:
    """Outside a disc: the curvature is negative definite, and the blocks are those without the row."""
    ocp = OCP("outside", T=1.0, N=4)
    x, y = ocp.state("x", initial=1.0), ocp.state("y", initial=0.4)
    u, w = ocp.control("u"), ocp.control("w")
    ocp.dynamics({x: u, y: w})
    ocp.least_squares(ca.vertcat(x, y, u, w), weight=[1.0, 1.0, 0.1, 0.1], reference=[-1.0, 0.2, 0.0, 0.0])
    ocp.subject_to(0.25, x**2 + y**2, np.inf)
    c = build(ocp, Options(hessian=GaussNewton()), "test")
    solution = c.solve((1.0, 0.4))
    assert solution.status == Status.OK
    assert np.abs(solution.mu).max() > 1e-3
    c.prepare()
    for block in np.array(c.view("hessian.Q")):
        np.testing.assert_array_equal(np.tril(block), np.diag([1.0, 1.0, 0.1, 0.1]))


def free_start(rows: bool, N: int = 6) -> OCP:
    """A pendulum whose angle is measured and whose initial speed is chosen by the solver."""
    ocp = OCP("free_start", T=1.2, N=N)
    phi, omega = ocp.state("phi", initial=0.8), ocp.state("omega", initial=0.1)
    torque = ocp.control("torque")
    ocp.dynamics({phi: omega, omega: -9.81 * ca.sin(phi) + torque})
    ocp.least_squares(ca.vertcat(phi, omega, torque), weight=[3.0, 0.2, 0.1], reference=[0.5, 0.0, 0.0])
    ocp.terminal_least_squares(phi, weight=[10.0])
    ocp.free_initial(omega)
    ocp.subject_to(-8, torque, 8)
    if rows:
        ocp.subject_to(-0.6, omega, 0.6)
        ocp.subject_to(-np.inf, phi**2 + 0.1 * omega**2, 0.7, at="end")
    return ocp


def test_a_free_component_need_not_be_measured() -> None:
    """In solve() it is the initial guess, NaN keeps that of the plan; step() ignores it."""
    c = build(free_start(True), profile="test")
    solution = c.solve((0.8, np.nan), tol=1e-9)
    assert solution.status == Status.OK
    for noise in (0.0, np.nan, 100.0):
        d = c.copy()
        np.testing.assert_allclose(d.step((0.8, noise), on_failure="raise"), solution.u[0], atol=1e-7)
        np.testing.assert_allclose(d.x, solution.x, atol=1e-7)
    assert c.solve((np.nan, 0.0)).status == Status.NOT_FINITE


def test_all_of_the_initial_state_free() -> None:
    """Nothing is measured: the optimum does not depend on xhat."""
    ocp = free_start(False)
    ocp.free_initial("phi")
    c = build(ocp, profile="test")
    first = c.solve((0.8, 0.1), tol=1e-9)
    reference = solve_reference(classify(ocp), x0=[0.8, 0.1])
    assert first.status == Status.OK
    assert relative(first.x, reference.x) <= 1e-6
    np.testing.assert_allclose(c.solve((-0.3, 1.0), tol=1e-9).x, first.x, atol=1e-6)


@pytest.mark.parametrize("hessian", [GaussNewton(), ExactHessian()])
def test_solve_after_shift_of_a_row_that_begins_at_node_1(hessian: Any) -> None:
    """Where x_0 is given, the bound of v and the row of v^2 hold from node 1 on.

    At node 0 their multipliers would be forces of no row, which no QP replaces.
    """
    ocp = OCP("held", T=2.0, N=8)
    p, v, u = ocp.state("p"), ocp.state("v", initial=1.0), ocp.control("u")
    ocp.dynamics({p: v, v: u})
    ocp.least_squares(ca.vertcat(p, v, u), weight=[1.0, 0.1, 0.1], reference=[9.0, 0.0, 0.0])
    ocp.terminal_least_squares(ca.vertcat(p, v), weight=[1.0, 0.1], reference=[9.0, 0.0])
    ocp.subject_to(-1, v, 1)
    ocp.subject_to(-np.inf, v**2 + 0.1 * p, 1.05)
    c = build(ocp, Options(hessian=hessian), "test")
    x = np.array([0.0, 1.0])
    assert c.solve(x, tol=1e-10).status == Status.OK
    assert c.mu_x[1, 1] > 1e-3
    assert c.mu[4:].max() > 1e-3
    for _ in range(8):
        x = np.array(c.integrate(x, c.u[0], 0.25))
        c.shift()
        assert not c.mu_x[0].any()
        solution = c.solve(x, tol=1e-10, max_iterations=20)
        assert solution.status == Status.OK, c.diagnose()
        np.testing.assert_allclose(solution.u, c.copy().solve(x, tol=1e-10, globalization="full_step").u, atol=1e-7)
    assert c.mu[1, 0] > 1e-3
