"""solve() where IPOPT solves: swing-ups, minimum time, linear costs, on every route; its table and its picture."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import linprog

from nmpc_codegen import (
    OCP,
    Controller,
    ControllerError,
    ExactHessian,
    GaussNewton,
    Options,
    RealTimeIteration,
    Status,
    build,
)
from verification.routes import ROUTES
from verification.strangers import linear, solves
from verification.strangers.problems import OPEN, known


@cache
def built(name: str, route: str | None = None, **changes: object) -> Controller:
    stranger = known(name)
    options = stranger.options()
    if route is not None:
        condensing, qp = ROUTES[route]
        options = replace(options, condensing=condensing, qp=qp)
    return build(stranger.ocp(), replace(options, **changes), profile="test")


@pytest.mark.few(3)
@pytest.mark.filterwarnings("ignore:.*the cost has no curvature")
@pytest.mark.parametrize("name", OPEN)
def test_what_users_found_unsolved(name: str) -> None:
    """The first three starts, each to the optimum of IPOPT or to another one; no false INFEASIBLE."""
    found = solves.solves(known(name), built(name).copy(), range(3))
    assert all(solve.solved for solve in found)


@pytest.mark.few(3)
@pytest.mark.parametrize("route", ["dense", "riccati", "interior"])
@pytest.mark.parametrize("name", ["steering", "gate", "free_time"])
def test_the_route_does_not_decide(name: str, route: str) -> None:
    assert solves.solves(known(name), built(name, route).copy(), range(1))[0].solved


@pytest.mark.parametrize("guess", [0.1, 0.5, 3.0])
def test_a_free_end_time_from_short_and_long_guesses(guess: float) -> None:
    """min int T^2 + u^2 + T^2 of a double integrator, x = 10, |u| <= 2: 43.8724 at T = 4.47926 by IPOPT."""
    c = built("free_time").copy()
    c.x[:] = [0.0, 0.0, guess]
    solution = c.solve([0.0, 0.0, guess], max_iterations=200)
    assert solution.status == Status.OK
    assert solution.cost == pytest.approx(43.872408, rel=1e-6)
    assert solution.x[0, 2] == pytest.approx(4.47926, abs=1e-4)


@pytest.mark.few(3)
@pytest.mark.parametrize("route", [None, "riccati", "interior"])
@pytest.mark.parametrize("case", linear.CASES, ids=lambda case: case.name)
def test_linear_programs_as_linprog_solves_them(case: linear.LinearCase, route: str | None) -> None:
    """Every sample and every solve() of a day is OK and has the cost of linprog."""
    condensing, qp = (None, None) if route is None else ROUTES[route]
    c = build(case.ocp(), Options(condensing=condensing, qp=qp), profile="test")
    bad, worst = replace(case, samples=24).run(c)
    assert bad == 0
    assert worst <= linear.SAME


@pytest.mark.parametrize("route", ["dense", "riccati", "interior"])
def test_no_curvature_at_all(route: str) -> None:
    """Neither state nor control in a cost that is constant but for one linear term, N = 1: the bound is the optimum."""
    ocp = OCP("slope", T=1.0, N=1)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.terminal_cost(2 * x)
    ocp.subject_to(-3, u, 4)
    condensing, qp = ROUTES[route]
    c = build(ocp, Options(condensing=condensing, qp=qp), profile="test")
    best = linprog([2.0], bounds=[(-3, 4)]).fun + 2.0
    assert c.step([1.0]) == pytest.approx(-3.0)
    assert c.status == Status.OK
    assert c.solve([1.0]).cost == pytest.approx(best)


def _fletcher() -> OCP:
    """min (1 + u)^2 + (-2 u^2 + u - 1)^2, whose minimum 0 is one from which Gauss-Newton steps lead away by -2."""
    ocp = OCP("fletcher", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: -x})
    ocp.least_squares(ca.vertcat(u + 1, -2 * u**2 + u - 1, x), weight=[1.0, 1.0, 1.0])
    ocp.subject_to(-1, u, 1)
    return ocp


def test_samples_may_leave_the_plan_of_solve() -> None:
    c = build(_fletcher(), Options(algorithm=RealTimeIteration(shift=None)), profile="test")
    c.u[:] = 0.05
    solution = c.solve([0.0])
    assert solution.status == Status.OK
    assert np.abs(solution.u).max() < 1e-6
    c.u[:] = 1e-6
    found, moved = [], 0.0
    for _ in range(40):
        c.step([0.0])
        found.append(c.diagnose())
        moved = max(moved, np.abs(c.u).max())
    assert moved > 0.1
    assert any("Options(hessian=ExactHessian())" in words for words in found[20:])
    exact = build(_fletcher(), Options(hessian=ExactHessian(), algorithm=RealTimeIteration(shift=None)), profile="test")
    exact.u[:] = 1e-6
    for _ in range(40):
        exact.step([0.0])
    assert np.abs(exact.u).max() < 1e-9
    assert exact.diagnose() == str(Status.OK)


def test_the_second_hessian_is_for_those_who_choose_none() -> None:
    """Given, for size and without solve() there is one Hessian; the report says which solve() has."""
    stranger = known("unicycle")

    def second(**changes: object) -> bool:
        c = build(stranger.ocp(), replace(stranger.options(), **changes), profile="test")
        said = any("solve(): exact Hessian" in choice for choice in c.description.report.choices)
        assert said == ("in_solve" in c.description.members("curved"))
        return said

    assert second()
    assert not second(hessian=GaussNewton())
    assert not second(goal="size")
    assert not second(solve=False)


def test_samples_are_the_same_with_and_without_solve() -> None:
    """The Hessian of solve() leaves samples alone, before and after."""
    stranger = known("unicycle")
    plain = RealTimeIteration(iterations=1)
    start = stranger.initial(0)
    with_solve, without = (
        build(stranger.ocp(), replace(stranger.options(), algorithm=plain, solve=solve), profile="test")
        for solve in (True, False)
    )
    with_solve.solve(start)
    with_solve.reset()
    for c in (with_solve, without):
        c.x[:] = start
    for _ in range(5):
        assert np.array_equal(with_solve.step(start), without.step(start))
        assert np.array_equal(with_solve.x, without.x)


def test_table_and_picture(tmp_path: Path) -> None:
    c = built("steering").copy()
    start = known("steering").initial(0)
    c.x[:] = start
    solution = c.solve(start)
    text = solution.convergence_table(tmp_path / "log.csv")
    lines = text.splitlines()
    assert len(lines) == 1 + solution.iterations
    assert lines[0].split()[:2] == ["iteration", "cost"]
    with (tmp_path / "log.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["relative"]) for row in rows] == [entry.kkt.relative for entry in solution.log]
    assert float(rows[-1]["stationarity"]) == solution.kkt.stationarity
    assert float(rows[-1]["cost"]) == solution.cost
    assert max(float(row["shift"]) for row in rows) > 0
    solution.plot_convergence(tmp_path / "log.png")
    assert (tmp_path / "log.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(ControllerError, match="no iteration"):
        replace(solution, log=()).plot_convergence()


@pytest.mark.parametrize("route", [None, "dense", "interior"])
def test_an_infeasible_linear_program_names_its_row(route: str | None) -> None:
    """Heat of at most 1 a node cannot fill a store with 9 in 8 nodes."""
    ocp = OCP("store", T=8.0, N=8)
    heat, u, price = ocp.state("heat"), ocp.control("u"), ocp.parameter("price", value=0.1)
    ocp.dynamics({heat: u})
    ocp.stage_cost(price * u)
    ocp.subject_to(0, u, 1)
    ocp.subject_to(9, heat, 10, at="end", name="full")
    condensing, qp = (None, None) if route is None else ROUTES[route]
    c = build(ocp, Options(condensing=condensing, qp=qp), profile="test")
    assert c.solve([0.0]).status == Status.INFEASIBLE
    assert "row 'full_end' at node 8 is violated by 1" in c.diagnose()
    assert c.solve([2.0]).status == Status.OK
    assert c.solve([np.nan]).iterations == 0
