"""LETEMPC, tracking and rotation, against IPOPT on the problems that they state."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import evaporation
from nmpc_codegen import OCP, OptionError, Options, ProblemError
from nmpc_codegen.economic import Tuning, letempc_cost, letempc_terminal_cost, rotate, tracking_cost, tune
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.complete import complete
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, ReferenceSolution, node_data, solve_reference
from nmpc_codegen.oracle.trajectory import Tableau

N = 30
ONE_STEP = Tableau(CLASSICAL.A, CLASSICAL.b, 1)


@cache
def tuning() -> Tuning:
    return evaporation.tuned(N)


def solved(ocp: OCP, dP: float) -> ReferenceSolution:
    problem = classify(ocp)
    t = tuning()
    data = node_data(problem, x0=t.x_s + np.array([0.0, dP]))
    found = Reference(problem, ONE_STEP).solve(data, x=t.x_s, u=t.u_s)
    assert found.success
    return found


def with_cost(N: int = N, linear: bool = True, tracking: bool = False) -> OCP:
    """The evaporation process with the cost of a companion instead of its own."""
    ocp, t = evaporation.build_ocp(N), tuning()
    ocp.costs.clear()
    cost = tracking_cost(t, ocp.x, ocp.u, [20, 20, 0.2, 0.2]) if tracking else letempc_cost(t, ocp.x, ocp.u)
    if not linear:
        cost = cost + ca.dot(t.C.T @ t.mu_s, ca.vertcat(ocp.x, ocp.u))
    ocp.stage_cost(cost, scale_with_dt=False)
    return ocp


@pytest.mark.slow
def test_letempc_is_locally_equivalent() -> None:
    """The first control differs by O(dP^2); without the linear term, or with plain tracking, by O(dP).

    The horizon is that of the example: on a short one the fixed end hides what the linear term does.
    """
    long, t, jumps = 200, tuning(), (2.0, 0.5)
    variants = {
        "economic": evaporation.build_ocp(long),
        "letempc": with_cost(N=long),
        "no linear term": with_cost(N=long, linear=False),
        "tracking": with_cost(N=long, tracking=True),
    }
    u0: dict[str, np.ndarray] = {}
    for name, ocp in variants.items():
        problem = classify(ocp)
        nlp = Reference(problem, ONE_STEP)
        starts = [node_data(problem, x0=t.x_s + np.array([0.0, dP])) for dP in jumps]
        u0[name] = np.array([nlp.solve(start, x=t.x_s, u=t.u_s).u[0] for start in starts])
    gap = {name: np.abs(u0[name] - u0["economic"]).max(axis=1) for name in variants}
    ratio = {name: gap[name][0] / gap[name][1] for name in ("letempc", "no linear term", "tracking")}
    assert ratio["letempc"] == pytest.approx(16, abs=2)
    assert ratio["no linear term"] == pytest.approx(4, abs=0.5)
    assert ratio["tracking"] == pytest.approx(4, abs=0.5)
    assert gap["letempc"][1] < 0.01 * min(gap["no linear term"][1], gap["tracking"][1])


def test_letempc_at_the_steady_state() -> None:
    """It is zero there, its Hessian M, its slope -mu_s'C."""
    t = tuning()
    w = ca.SX.sym("w", 4)
    H, g = ca.hessian(letempc_cost(t, w[:2], w[2:]), w)
    value = ca.Function("f", [w], [H, g, letempc_cost(t, w[:2], w[2:])])(np.concatenate([t.x_s, t.u_s]))
    np.testing.assert_allclose(value[0].full(), t.M, atol=1e-12)
    np.testing.assert_allclose(value[1].full().ravel(), -t.C.T @ t.mu_s, atol=1e-12)
    assert float(value[2]) == pytest.approx(0, abs=1e-10)


@pytest.mark.parametrize("N", [1, 4])
def test_letempc_that_ends_on_an_active_row(N: int) -> None:
    """Of a linear-quadratic problem it is the problem itself, as long as the row is active: x_0 <= 1 at every node."""

    def stated(cost: str) -> OCP:
        ocp = OCP("pushed", N=N)
        x, u = ocp.state("x", size=2, initial=[0.9, 0.02]), ocp.control("u", size=2)
        ocp.dynamics({x: np.array([[0.9, 0.2], [-0.3, 1.1]]) @ x + np.array([[1, 0.3], [0.2, 1]]) @ u}, discrete=True)
        ocp.subject_to(-9, x, [1, 9])
        if cost == "letempc":
            t = tune(stated("economic"))
            ocp.stage_cost(letempc_cost(t, x, u), scale_with_dt=False)
            ocp.terminal_cost(letempc_terminal_cost(t, x))
        else:
            ocp.stage_cost(-5 * x[0] + x[1] ** 2 + 0.1 * ca.sumsqr(u))
            ocp.lqr_terminal_cost(economic=True)
        return ocp

    t = tune(stated("economic"))
    assert t.active_terminal == ("x[0]",)
    assert t.nu_s == pytest.approx(t.mu_s, rel=1e-9)
    u = [solve_reference(complete(classify(stated(cost)), Options())).u for cost in ("economic", "letempc")]
    np.testing.assert_allclose(u[1], u[0], rtol=0, atol=1e-6)


def test_refusals() -> None:
    t = tuning()
    with pytest.raises(ProblemError, match="x_N is fixed"):
        letempc_terminal_cost(t, ca.SX.sym("x", 2))
    with pytest.raises(ProblemError, match="weight has shape"):
        tracking_cost(t, ca.SX.sym("x", 2), ca.SX.sym("u", 2), np.eye(3))
    with pytest.raises(OptionError, match="expected 'map' or 'nodes'"):
        rotate(evaporation.build_ocp(3), lambda x: ca.sumsqr(x), on="elsewhere")


# Rotation -------------------------------------------------------------------------------------------------------------


def storage(x: Any) -> Any:
    return 100 * ca.sumsqr(x - tuning().x_s) + 3 * x[0]


@pytest.mark.parametrize("on", ["map", "nodes"])
def test_rotation_keeps_the_solution(on: str) -> None:
    """Lemma 4: J_rot = J + Lambda(x_0); on the map lam_rot = lam + grad Lambda(x), on the nodes only lam_0 changes."""
    rotated = evaporation.build_ocp(N)
    rotate(rotated, storage, evaporation.options(), on=on)
    plain, other = solved(evaporation.build_ocp(N), 2.0), solved(rotated, 2.0)
    np.testing.assert_allclose(other.u, plain.u, rtol=0, atol=1e-5)
    slope = 200 * (plain.x - tuning().x_s) + np.array([3.0, 0.0])
    if on == "nodes":
        slope[1:] = 0
    np.testing.assert_allclose(other.lam[:-1], (plain.lam + slope)[:-1], rtol=0, atol=1e-4)
    offset = float(ca.evalf(ca.SX(storage(ca.DM(plain.x[0])))))
    assert other.cost == pytest.approx(plain.cost + offset, rel=1e-9)


def test_rotation_and_back() -> None:
    """sign=-1 undoes it."""
    ocp = evaporation.build_ocp(N)
    for sign in (1.0, -1.0):
        rotate(ocp, storage, evaporation.options(), sign=sign)
    assert solved(ocp, 2.0).cost == pytest.approx(solved(evaporation.build_ocp(N), 2.0).cost, rel=1e-10)


def test_rotation_on_the_map_needs_a_uniform_grid() -> None:
    ocp = OCP("grid", intervals=[0.1, 0.2])
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(x**2 + u**2)
    with pytest.raises(ProblemError, match="use on='nodes'"):
        rotate(ocp, lambda x: x**2)
