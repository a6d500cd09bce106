"""Algebraic equations and implicit dynamics: what is eliminated, what is left to Newton's method, what is refused."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, ProblemError
from nmpc_codegen.frontend.classify import classify


def started(**more: Any) -> tuple[OCP, Any, Any]:
    """x' = u with a cost: (ocp, x, u)."""
    ocp = OCP("started", T=1.0, N=4)
    x, u = ocp.state("x", initial=0.5), ocp.control("u")
    ocp.least_squares(ca.vertcat(x, u), weight=1.0, reference=[0.0, 0.25])
    return ocp, x, u


def values(ocp: OCP, x: Any, u: Any, z: Any = ()) -> np.ndarray:
    """Derivatives, and algebraic variables, where Newton's method has found z."""
    problem = classify(ocp)
    algebra = problem.algebra
    assert algebra is not None
    p = problem.p_value
    data = np.concatenate([p, np.array(z, dtype=float), np.zeros(len(z) ** 2)])
    f = np.asarray(problem.dynamics(x, u, data)).ravel()
    return np.concatenate([f, np.asarray(algebra.values(x, u, p, z)).ravel()])


def test_equations_are_solved_in_the_order_in_which_they_depend_on_each_other() -> None:
    ocp, x, u = started()
    a, b, c = ocp.algebraic("a"), ocp.algebraic("b"), ocp.algebraic("c")
    ocp.algebraic_equation(c - a * b - u)  # c of a and b
    ocp.algebraic_equation(2 * b - a**2)  # b of a: linear in b
    ocp.algebraic_equation(a - 3 * x)
    ocp.dynamics({x: c})
    assert classify(ocp).newton_names == ()
    assert values(ocp, [2.0], [1.0]).tolist() == [109.0, 6.0, 18.0, 109.0]


@pytest.mark.parametrize("n", [2, 3, 5])
def test_linear_systems_are_eliminated_with_pivots_of_the_first_plan(n: int) -> None:
    """Zeros on the diagonal, coefficients that depend on the state."""
    rng = np.random.default_rng(n)
    A, b = rng.normal(size=(n, n)), rng.normal(size=n)
    A[range(n), range(n)] = 0.0
    ocp, x, u = started()
    z = ocp.algebraic("z", size=n)
    ocp.algebraic_equation((ca.DM(A) * (1 + x**2)) @ z - ca.DM(b) * u)
    ocp.dynamics({x: z[0]})
    expected = np.linalg.solve(A * 5.0, b * 3.0)
    assert classify(ocp).newton_names == ()
    assert values(ocp, [2.0], [3.0])[1:] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("n", [3, 4, 6])
def test_no_pivot_vanishes_where_a_system_is_regular(n: int) -> None:
    """A rotation, whose entries are 0 at other angles than that of the first plan, and entries that do not move."""
    rng = np.random.default_rng(n)
    A, b, angle = rng.normal(size=(n, n)), rng.normal(size=n), np.pi / 2
    A[n - 1, 0] = 0.0
    ocp, x, u = started()
    z = ocp.algebraic("z", size=n)
    M = ca.SX(ca.DM(A))
    M[0, 0], M[0, 1], M[1, 0], M[1, 1] = 4 * ca.cos(x), -4 * ca.sin(x), 4 * ca.sin(x), 4 * ca.cos(x)
    M[2:, 2:] = M[2:, 2:] * (2 + ca.cos(x))
    ocp.algebraic_equation(M @ z - ca.DM(b) * u)
    ocp.dynamics({x: z[0]})
    at = ca.Function("at", [x], [M])
    for value in (0.5, angle - 1e-12, angle, 3.0):
        expected = np.linalg.solve(np.asarray(at(value)), b)
        assert values(ocp, [value], [1.0])[1:] == pytest.approx(expected, rel=1e-9, abs=1e-11)


def test_a_system_that_is_not_finite_at_the_first_plan() -> None:
    ocp = OCP("pole", T=1.0, N=3)
    x, u = ocp.state("x", initial=0.0), ocp.control("u")
    z = ocp.algebraic("z", size=3)
    ocp.algebraic_equation(ca.vertcat(z[1] * (1 / x) + z[2] - u, z[0] + z[2] - x, z[0] + 2 * z[1] - 1))
    ocp.dynamics({x: z[0]})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    expected = np.linalg.solve([[0, 0.5, 1], [1, 0, 1], [1, 2, 0]], [3.0, 2.0, 1.0])
    assert values(ocp, [2.0], [3.0])[1:] == pytest.approx(expected, rel=1e-12)


def test_a_mass_matrix() -> None:
    ocp = OCP("mass", T=1.0, N=4)
    q, v, u = ocp.state("q", size=2, initial=[0.3, 0.1]), ocp.state("v", size=2), ocp.control("u")
    M = ca.vertcat(ca.horzcat(3 + 2 * ca.cos(q[1]), 1 + ca.cos(q[1])), ca.horzcat(1 + ca.cos(q[1]), 1))
    ocp.dynamics({q: v})
    ocp.implicit_dynamics(M @ ocp.der(v) - ca.vertcat(u, -q[1]), name="joints")
    ocp.least_squares(ca.vertcat(q, v, u), weight=1.0)
    angle = 0.7
    matrix = np.array([[3 + 2 * np.cos(angle), 1 + np.cos(angle)], [1 + np.cos(angle), 1]])
    found = values(ocp, [0.0, angle, 0.0, 0.0], [2.0])
    assert found[2:] == pytest.approx(np.linalg.solve(matrix, [2.0, -angle]), rel=1e-12)


def test_a_derivative_that_is_stated_may_stand_in_equations() -> None:
    ocp, x, u = started()
    ocp.dynamics({x: -x + u})
    z = ocp.algebraic("z")
    ocp.implicit_dynamics(z - 2 * ocp.der(x))
    assert values(ocp, [2.0], [5.0]).tolist() == [3.0, 6.0]


def test_fully_implicit_equations_are_left_to_newton() -> None:
    ocp, x, u = started()
    ocp.implicit_dynamics(ocp.der(x) + ocp.der(x) ** 3 + x - u)
    problem = classify(ocp)
    assert problem.newton_names == ("der(x)",)
    assert problem.algebra is not None
    assert problem.algebra.found == pytest.approx([np.roots([1, 0, 1, 0.25])[2].real], rel=1e-9)
    assert "nonlinear algebraic equations" in problem.uses


def test_only_blocks_that_are_not_linear_are_left_to_newton() -> None:
    ocp, x, u = started()
    a, b, c = ocp.algebraic("a"), ocp.algebraic("b", initial=1.0), ocp.algebraic("c")
    ocp.algebraic_equation(a - x - 1, name="first")
    ocp.algebraic_equation(b**2 - a, name="root")
    ocp.algebraic_equation(c - a * b, name="last")
    ocp.dynamics({x: c + u})
    assert classify(ocp).newton_names == ("b",)
    assert values(ocp, [3.0], [0.0], [2.0]).tolist() == [8.0, 4.0, 2.0, 8.0]


def test_values_and_two_derivatives_of_expressions_with_newtons_z_are_those_of_the_solution() -> None:
    """z + z^3 = x u: the expression of a node with z and W at the solution."""
    ocp, x, u = started()
    z = ocp.algebraic("z")
    ocp.algebraic_equation(z + z**3 - x * u)
    ocp.dynamics({x: z})
    ocp.stage_cost(ca.sin(z) * x)
    problem = classify(ocp)
    stage = problem.path
    v = ca.vertcat(stage.x, stage.u)
    H, g = ca.hessian(stage.cost, v)
    at = ca.Function("at", [stage.x, stage.u, stage.p, stage.dt], [stage.cost, g, H])
    x0, u0 = np.array([1.2]), np.array([0.8])

    def cost(w: np.ndarray) -> float:
        root = float(next(r.real for r in np.roots([1, 0, 1, -w[0] * w[1]]) if abs(r.imag) < 1e-12))
        return float(np.sin(root) * w[0] * 0.25)

    found = [np.asarray(part) for part in at(x0, u0, problem.node_values(x0, u0), 0.25)]
    w, h = np.array([1.2, 0.8]), 1e-4
    steps = h * np.eye(2)
    slopes = [(cost(w + d) - cost(w - d)) / (2 * h) for d in steps]
    bends = [
        [(cost(w + a + b) - cost(w + a - b) - cost(w - a + b) + cost(w - a - b)) / (4 * h**2) for b in steps]
        for a in steps
    ]
    assert float(found[0].item()) == pytest.approx(cost(w), rel=1e-13)
    assert found[1].ravel() == pytest.approx(slopes, abs=1e-7)
    assert found[2] == pytest.approx(np.array(bends), abs=1e-6)


def test_zeros_of_the_inverse_jacobian_are_left_out() -> None:
    """z[0] and z[1] are coupled, z[2] follows from them, z[3] stands alone; equations stand in another order."""
    ocp, x, u = started()
    z = ocp.algebraic("z", size=4, initial=[0.5, 0.4, 0.3, 0.2])
    rows = (z[2] ** 3 + z[2] - z[1], z[3] ** 3 + z[3] - u, z[0] + z[0] * z[1] ** 2 - x, z[1] ** 3 + z[1] - z[0])
    ocp.algebraic_equation(ca.vertcat(*rows))
    ocp.dynamics({x: -ca.sumsqr(z)})
    ocp.stage_cost(ca.sumsqr(z))
    problem = classify(ocp)
    assert problem.algebra is not None
    W = problem.node_values(np.array([0.7]), np.array([0.3]))[-16:].reshape(4, 4)
    assert np.array_equal(problem.algebra.inverse, W != 0)
    assert int(problem.algebra.inverse.sum()) == 8
    read = {str(each) for each in ca.symvar(problem.path.cost)} & {str(each) for each in ca.vertsplit(problem.path.p)}
    assert len(read) == 4 + 8


# Nodes ---------------------------------------------------------------------------------------------------------------


def test_a_row_on_a_variable_that_follows_from_a_control_holds_where_controls_are() -> None:
    ocp, x, u = started()
    z, y = ocp.algebraic("z"), ocp.algebraic("y")
    ocp.algebraic_equation(z - x * u)
    ocp.algebraic_equation(y + y**3 - x)
    ocp.dynamics({x: z})
    ocp.subject_to(-1, z, 1)
    ocp.subject_to(-2, y, 2)
    ocp.subject_to(-3, z, 3, at="end", name="last")
    rows = {row.name: row for row in classify(ocp).rows}
    assert rows["z"].nodes == (0, 1, 2, 3)
    assert rows["y"].nodes == (1, 2, 3, 4)
    assert rows["last_end"].nodes == (4,)


def test_node_n_has_the_control_of_the_node_before() -> None:
    ocp, x, u = started()
    z = ocp.algebraic("z")
    ocp.algebraic_equation(z - 3 * u - x)
    ocp.dynamics({x: z})
    ocp.terminal_least_squares(z, weight=1.0)
    problem = classify(ocp)
    assert problem.state_names == ("x", "previous(u)")
    y = ca.Function("y", [problem.terminal.x, problem.terminal.p], [problem.terminal.y])
    assert float(y([2.0, 5.0], [])) == 17.0


def test_a_variable_that_is_a_state_becomes_a_bound() -> None:
    ocp, x, u = started()
    z = ocp.algebraic("z")
    ocp.algebraic_equation(z - x)
    ocp.dynamics({x: u})
    ocp.subject_to(-1, z, 1)
    assert [(row.name, row.kind) for row in classify(ocp).rows] == [("z", "state")]


def test_the_ocp_may_be_changed_and_classified_again() -> None:
    ocp, x, u = started()
    z = ocp.algebraic("z")
    ocp.algebraic_equation(z - x)
    ocp.dynamics({x: u + z})
    ocp.terminal_least_squares(z, weight=1.0)
    first = classify(ocp)
    ocp.subject_to(-1, u, 1)
    assert len(classify(ocp).rows) == len(first.rows) + 1
    assert ocp.element(ocp.residuals[1].y).kind == "algebraic"  # type: ignore[union-attr]


# What is refused -----------------------------------------------------------------------------------------------------


def refused(ocp: OCP) -> str:
    with pytest.raises(ProblemError) as caught:
        classify(ocp)
    return str(caught.value)


def test_a_variable_in_no_equation_is_named() -> None:
    ocp, x, u = started()
    pressure, flow = ocp.algebraic("pressure"), ocp.algebraic("flow")
    ocp.algebraic_equation(flow - x, name="valve")
    ocp.algebraic_equation(flow - 2 * u, name="pump")
    ocp.dynamics({x: pressure})
    message = refused(ocp)
    assert "'pressure' occurs in no equation, and 'pump' determines nothing new" in message
    assert "differentiate 'pump' with respect to time until it contains 'pressure'" in message


def test_variables_that_share_an_equation_are_named() -> None:
    ocp, x, u = started()
    a, b, c = (ocp.algebraic(name) for name in "abc")
    ocp.algebraic_equation(a + b + c - x, name="sum")
    ocp.algebraic_equation(c - u, name="one")
    ocp.algebraic_equation(c + x, name="two")
    ocp.dynamics({x: a})
    assert "occurs in sum alone, which determine others" in refused(ocp)


def test_an_equation_without_a_variable_has_index_two() -> None:
    ocp, x, _ = started()
    ocp.algebraic("tension")
    with pytest.raises(ProblemError, match=r"'length' contains no algebraic variable .* index 2 or higher; different"):
        ocp.algebraic_equation(x**2 - 1, name="length")


def test_a_singular_jacobian_at_the_first_plan_names_variable_and_equations() -> None:
    ocp, x, u = started()
    a, b = ocp.algebraic("a"), ocp.algebraic("b")
    ocp.algebraic_equation(a + b - x, name="sum")
    ocp.algebraic_equation(2 * a + 2 * b - u + (x - 0.5) * a, name="same")  # regular for x != 0.5
    ocp.dynamics({x: a})
    message = refused(ocp)
    assert "'b' is not determined at the first plan" in message
    assert "'same'" in message
    assert "initial=" in message


def test_a_double_root_where_newton_starts_is_singular() -> None:
    ocp, x, _ = started()
    z = ocp.algebraic("z")  # initial 0, where the derivative of z^2 vanishes
    ocp.algebraic_equation(z**2 - x)
    ocp.dynamics({x: z})
    assert "'z' is not determined at the first plan" in refused(ocp)


def test_numbers_of_equations_and_variables_differ() -> None:
    ocp, x, _ = started()
    a, _ = ocp.algebraic("a"), ocp.algebraic("b")
    ocp.algebraic_equation(a - x, name="only")
    ocp.dynamics({x: a})
    assert "1 algebraic equations (only) for 2 variables (a, b); expected one scalar equation per variable" in refused(
        ocp
    )


def test_what_may_not_stand_where() -> None:
    ocp, x, u = started()
    z = ocp.algebraic("z")
    with pytest.raises(ProblemError, match=r"der\(x\), which is allowed in implicit_dynamics\(\) only"):
        ocp.algebraic_equation(z - ocp.der(x))
    with pytest.raises(ProblemError, match="start_cost contains the algebraic 'z'"):
        ocp.start_cost(z)
    with pytest.raises(ProblemError, match="an equation is called 'twice' already"):
        ocp.algebraic_equation(z - x, name="twice"), ocp.algebraic_equation(z - u, name="twice")
    with pytest.raises(ProblemError, match="is a comparison; state 0 = left - right by its right side alone"):
        ocp.algebraic_equation(z == x)
    with pytest.raises(ProblemError, match="clashes with 'z'"):
        ocp.control("z")
    with pytest.raises(ProblemError, match="der: 'w' is no state"):
        ocp.der("w")
    discrete = OCP("discrete", N=3)
    y = discrete.state("y")
    with pytest.raises(ProblemError, match="'discrete' is a discrete map, whose states have no derivatives"):
        discrete.implicit_dynamics(discrete.der(y) - 1)


def test_a_derivative_is_given_once() -> None:
    ocp, x, u = started()
    ocp.dynamics({x: u})
    ocp.implicit_dynamics(ocp.der(x) - 2 * u)
    assert "1 algebraic equations (implicit_0) for 0 variables" in refused(ocp)


def test_discrete_states_do_not_depend_on_newtons_z() -> None:
    ocp, x, u = started()
    z, y = ocp.algebraic("z"), ocp.state("y")
    ocp.algebraic_equation(z + z**3 - x)
    ocp.dynamics({x: u}, discrete={y: z})
    assert "the next value of 'y' depends on z" in refused(ocp)
