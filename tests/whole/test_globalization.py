"""solve() from cold starts: new starts, its log, full steps, multipliers of shortened steps, units."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from examples import crane
from nmpc_codegen import (
    OCP,
    ControllerError,
    DenseActiveSet,
    FullCondensing,
    GaussNewton,
    Options,
    Status,
    build,
    simulate,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference
from nmpc_codegen.oracle.trajectory import CLASSICAL, Point, kkt_residuals, node_data
from nmpc_codegen.runtime.controller import Controller
from verification import problems as cases
from verification.convergence.problems import problems
from verification.convergence.units import Units, in_units
from verification.routes import PURE, ROUTES

KNOWN = {p.name: p for p in problems()}


@cache
def built(name: str, route: str, **changes: object) -> Controller:
    condensing, qp = ROUTES[route]
    options = replace(KNOWN[name].options(), condensing=condensing, qp=qp, **changes)
    return build(KNOWN[name].make(), options, profile="test")


@pytest.mark.few(3)
@pytest.mark.parametrize("route", ["dense", "riccati"])
@pytest.mark.parametrize(("name", "number"), [("swing_up", 2), ("swing_up", 4), ("quadrotor", 5)])
def test_solve_finds_the_solution_of_ipopt(name: str, number: int, route: str) -> None:
    """Gauss-Newton steps, which the samples take, contract by 0.8 per iteration, or not at all."""
    problem, c = KNOWN[name], built(name, route).copy()
    x0 = problem.start(number)
    ocp, tableau = classify(problem.make()), replace(CLASSICAL, steps=problem.steps)
    data = node_data(ocp, x0=x0)
    reference = Reference(ocp, tableau, tol=1e-10).solve(data, x=c.x.copy(), u=c.u.copy())
    solution = c.solve(x0)
    assert solution.status == Status.OK
    assert solution.iterations <= 80
    assert solution.cost == pytest.approx(reference.cost, rel=1e-6)
    point = Point(**{n: getattr(solution, n) for n in Point.__dataclass_fields__})
    assert kkt_residuals(ocp, point, data, tableau).worst <= 1e-5 * max(1.0, np.abs(solution.lam).max())


def test_multipliers_on_stages_move_as_far_as_the_step() -> None:
    """The first step from this start is shortened, and so are the multipliers, which were 0."""
    x0 = KNOWN["swing_up"].start(0)
    c = built("swing_up", "riccati", algorithm=PURE, hessian=GaussNewton()).copy()
    searched, full = c.copy(), c.copy()
    entry = searched.solve(x0, max_iterations=1).log[0]
    full.prepare()
    full.feedback(x0, on_failure="raise")
    assert 0 < entry.length < 1
    for name in ("lam", "mu_u", "mu_x"):
        np.testing.assert_allclose(getattr(searched, name), entry.length * getattr(full, name), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "number", "route"), [("fastest_swing_up", 16, "riccati"), ("fastest_swing_up", 11, "dense")]
)
def test_a_search_that_ends_at_an_infeasible_point_starts_anew(name: str, number: int, route: str) -> None:
    c = built(name, route).copy()
    assert c.solve(KNOWN[name].start(number)).status == Status.OK
    assert int(c.view("sqp.attempts")) > 0


def test_an_infeasible_problem_stays_infeasible() -> None:
    c = cases.controller("crane").copy()
    c.set_bounds("a", 0.0, 0.0)
    solution = c.solve([1.0, 0.0, 0.0, 0.0])
    assert solution.status == Status.INFEASIBLE
    assert "row '" in c.diagnose()


def test_a_qp_that_is_given_up_has_its_own_status() -> None:
    ocp = KNOWN["swing_up"].make()
    c = build(ocp, Options(condensing=FullCondensing(), qp=DenseActiveSet(max_iterations=1)), profile="test")
    assert c.solve(KNOWN["swing_up"].start(1)).status == Status.SUBPROBLEM_FAILED
    assert "Options(qp=DenseActiveSet(max_iterations=10))" in c.diagnose()


@pytest.mark.parametrize("name", ["crane", "path_rows", "references"])
def test_the_log_does_not_change_the_iterations(name: str) -> None:
    """One call of the C code for all iterations and one call per iteration yield the same numbers."""
    x0 = cases.CASES[name].x0
    c = cases.controller(name).copy()
    logged, plain = c.copy(), c.copy()
    solution = logged.solve(x0)
    plain._measure(x0)
    assert plain.call_solve(1e-8, 100) == solution.status == Status.OK
    for part in ("x", "u", "lam"):
        np.testing.assert_array_equal(getattr(plain, part), getattr(logged, part))
    assert len(solution.log) == solution.iterations == plain.stats.sqp_iterations
    assert solution.log[-1].kkt.relative <= 1e-8
    assert int(logged.view("sqp.resumes")) == 0


def test_full_steps_are_real_time_iterations() -> None:
    c = build(crane.build_ocp(), Options(algorithm=replace(PURE, shift="repeat")), profile="test").copy()
    repeated, x0 = c.copy(), [1.0, 0.0, 0.0, 0.0]
    solution = c.solve(x0, tol=1e-10, globalization="full_step")
    assert solution.status == Status.OK
    assert solution.iterations == len(solution.log) <= 6
    for _ in range(solution.iterations):
        repeated.view("samples")[...] = 0
        repeated.step(x0, on_failure="raise")
    np.testing.assert_array_equal(repeated.u, c.u)
    assert c.solve([0.9, 0.0, 0.0, 0.0], max_iterations=1, globalization="full_step").status == Status.ITERATION_LIMIT


def test_an_unknown_globalization_is_an_error() -> None:
    with pytest.raises(ControllerError, match="globalization is 'merit'; expected 'filter' or 'full_step'"):
        cases.controller("crane").solve([1.0, 0.0, 0.0, 0.0], globalization="merit")  # type: ignore[arg-type]


def test_relative_residual_of_a_gap() -> None:
    """x_1 = 3 where the model yields 2: the gap 1 is divided by the scale of x + |x_1|."""
    ocp = OCP("point", T=0.5, N=1)
    x, u = ocp.state("x", scale=1.0), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(u, weight=[1e-3])
    c = build(ocp, profile="test")
    c.view("xhat")[:] = 2.0
    c.x[:, 0] = 2.0, 3.0
    assert c.kkt().equality == pytest.approx(1.0)
    assert c.kkt().relative == pytest.approx(0.25)


@pytest.mark.parametrize("name", ["crane", "bicycle", "battery"])
def test_samples_of_least_squares_take_gauss_newton(name: str) -> None:
    """Whatever their rows: a row that excludes a convex set and a steep soft row among them."""
    assert build(KNOWN[name].make(), profile="test").description.options["hessian"] == "GaussNewton"


@pytest.mark.few(1)
@pytest.mark.filterwarnings("ignore:.*the cost has no curvature")
@pytest.mark.parametrize(("route", "seed"), [("dense", 2), ("dense", 3), ("riccati", 3)])
def test_units_do_not_matter_to_the_exact_hessian(route: str, seed: int) -> None:
    problem = KNOWN["fermenter"]
    units = Units.of(problem.make(), seed)
    condensing, qp = ROUTES[route]
    options = replace(problem.options(), condensing=condensing, qp=qp)
    x0 = problem.start(0)
    plain = built("fermenter", route).copy().solve(x0)
    other = build(in_units(problem.make(), units), options, profile="test").solve(x0 / units.x)
    assert plain.status == other.status == Status.OK
    assert other.iterations <= 2 * plain.iterations
    assert other.cost == pytest.approx(units.cost * plain.cost, rel=1e-6)


def test_the_summary_names_the_first_failure() -> None:
    c = cases.controller("crane").copy()
    text = simulate(c, [5.0, 0.0, 3.0, 0.0], steps=3).summary()
    assert "first INFEASIBLE: sample 0, t = 0 s: no plan was found" in text
    assert "row '" in text


def test_gauss_newton_without_curvature_still_ends() -> None:
    """The plan is finite and the status true."""
    c = build(cases.disc(), Options(hessian=GaussNewton()), profile="test")
    solution = c.solve((1.0, 0.0))
    assert np.isfinite(solution.x).all()
    assert (solution.status == Status.OK) == (solution.kkt.relative <= 1e-8)
