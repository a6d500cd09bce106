"""What every QP solver of a package does beside solving: failures that leave no trace, data that change between the
phases, samples that repeat. The QPs, and the judge of answers, are those of test_stage_qps.py."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import crane
from nmpc_codegen import (
    OCP,
    NoCondensing,
    Options,
    RealTimeIteration,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    Status,
    build,
)
from verification.oracles.stage_qp import Shape, StageQP, residuals
from verification.oracles.stage_qp_random import random_qp
from verification.qp.stage_solvers import StageSolver, solver_options, solvers, wrong_answer

SOLVERS = solvers()
ROWS, BOUNDS, LONG = Shape(4, 2, 6, states=2, path=2, end=2), Shape(3, 2, 8), Shape(3, 2, 60)
FAILED = (Status.NUMERICAL_FAILURE, Status.ITERATION_LIMIT, Status.INFEASIBLE)
every_solver = pytest.mark.parametrize("name", SOLVERS)
few = settings(max_examples=8, deadline=None)
seeds = st.integers(0, 2**16)


def good(shape: Shape, seed: int, kind: str = "plain") -> StageQP:
    return random_qp(shape, kind, seed)


@every_solver
@few
@given(
    seed=seeds,
    member=st.sampled_from(["S", "b", "Q", "Q_N", "g", "g_N", "C", "lower", "upper"]),
    bad=st.sampled_from([np.nan, np.inf, -np.inf]),
)
def test_data_that_are_not_finite(name: str, seed: int, member: str, bad: float) -> None:
    """Fresh and after another sample; the next one is solved."""
    rng, solver, qp = np.random.default_rng(seed), StageSolver(ROWS, SOLVERS[name]), good(ROWS, seed)
    array = getattr(qp, member).copy()
    place = [int(rng.integers(size)) for size in array.shape]
    if member in ("S", "Q", "g"):
        place[0] = 1  # x_0 is given: its terms have no effect
    if member in ("Q", "Q_N"):
        place[-2:] = sorted(place[-2:], reverse=True)
    if member == "C":
        place = [int(np.flatnonzero((qp.rows.kind == 1) & (qp.rows.node == 1))[-1]), 0]
    array[tuple(place)] = {"lower": abs(bad), "upper": -abs(bad)}.get(member, bad)
    wrong = dataclasses.replace(qp, **{member: array})
    for _ in range(2):
        assert solver.solve(wrong) in FAILED
        assert np.isfinite(solver.point.du).all()
        assert solver.solve(qp) == Status.OK
        assert wrong_answer(qp, solver.point) == ""


@every_solver
def test_crossed_bounds_are_infeasible(name: str) -> None:
    qp, solver = good(ROWS, 1), StageSolver(ROWS, SOLVERS[name])
    for row in (0, 5, len(qp.rows) - 1):
        lower, upper = qp.lower.copy(), qp.upper.copy()
        lower[row], upper[row] = 1.5, 1.0
        assert solver.solve(dataclasses.replace(qp, lower=lower, upper=upper)) == Status.INFEASIBLE
        assert solver.certificate is None
    assert solver.solve(qp) == Status.OK
    assert wrong_answer(qp, solver.point) == ""


@every_solver
def test_an_indefinite_hessian_fails_and_is_left_behind(name: str) -> None:
    qp, solver = good(BOUNDS, 2), StageSolver(BOUNDS, SOLVERS[name])
    indefinite = dataclasses.replace(qp, Q=-qp.Q, Q_N=-qp.Q_N)
    assert solver.solve(indefinite) in FAILED
    assert solver.solve(qp) == Status.OK
    assert wrong_answer(qp, solver.point) == ""


@every_solver
@few
@given(seed=seeds)
def test_bounds_and_measurement_may_change_between_the_phases(name: str, seed: int) -> None:
    """The prediction may be wrong in every bound and in dx_0."""
    rng, solver, qp = np.random.default_rng(seed), StageSolver(BOUNDS, SOLVERS[name]), good(BOUNDS, seed)
    assert solver.solve(qp) == Status.OK
    for box in (0.1, 10.0, 1.0):
        lower_u, upper_u = -box * rng.random((2, BOUNDS.N, BOUNDS.nu)) * [[[1]], [[-1]]]
        other = dataclasses.replace(qp, lower_u=lower_u, upper_u=upper_u, dx0=rng.normal(size=BOUNDS.nx))
        assert solver.feedback(other) == Status.OK
        assert residuals(other, solver.point).worst <= 1e-8


@every_solver
@few
@given(seed=seeds, shape=st.sampled_from([ROWS, BOUNDS]))
def test_the_same_problem_again(name: str, seed: int, shape: Shape) -> None:
    """An active-set method predicts its working set: no iteration."""
    solver, qp = StageSolver(shape, SOLVERS[name]), good(shape, seed)
    assert solver.solve(qp) == Status.OK
    before = solver.point
    if "exact" in solver.memory["qp"].dtype.names and not solver.memory["qp"]["exact"]:
        return  # the interior point method has solved it
    assert solver.solve(qp) == Status.OK
    assert solver.iterations == 0 or "interior" in name
    np.testing.assert_allclose(solver.point.dx, before.dx, atol=1e-8 * np.abs(before.dx).max())


@every_solver
def test_a_control_without_cost_and_effect(name: str) -> None:
    """Unbounded: no answer, and finite numbers; with bounds it is at the one that its linear cost asks for."""
    qp, solver = good(BOUNDS, 3), StageSolver(BOUNDS, SOLVERS[name])
    S, Q = qp.S.copy(), qp.Q.copy()
    S[:, :, -1] = Q[:, -1, :] = Q[:, :, -1] = 0.0
    free = np.full((BOUNDS.N, BOUNDS.nu), np.inf)
    endless = dataclasses.replace(qp, S=S, Q=Q, lower_u=-free, upper_u=free)
    assert solver.solve(endless) in FAILED
    assert np.isfinite(solver.point.du).all()
    lower = np.where(np.arange(BOUNDS.nu) == BOUNDS.nu - 1, -1.0, -np.inf) * np.ones((BOUNDS.N, 1))
    bounded = dataclasses.replace(endless, lower_u=lower, upper_u=-lower, u=0 * qp.u)
    assert solver.solve(bounded) == Status.OK
    np.testing.assert_allclose(solver.point.du[:, -1], -np.sign(qp.g[:, -1]), atol=1e-9)


@few
@given(seed=seeds)
def test_growth_over_the_horizon_costs_no_accuracy_on_stages(seed: int) -> None:
    """The recursion uses feedback: |A^60| is of the order of 1e7."""
    qp = random_qp(LONG, "none_active", seed, radius=1.3)
    name = next(name for name in SOLVERS if name.endswith("riccati_active_set"))
    solver = StageSolver(LONG, SOLVERS[name])
    assert solver.solve(qp) == Status.OK
    assert residuals(qp, solver.point).dynamics <= 1e-13


def test_a_working_set_that_is_not_found_goes_to_the_interior_point_method() -> None:
    """Two working sets are allowed; the answer is exact."""
    options = next(o for name, o in SOLVERS.items() if name.endswith("riccati_active_set"))
    few_sets = solver_options(options.condensing, RiccatiActiveSet(max_iterations=1))
    solver = StageSolver(ROWS, few_sets)
    for seed in range(5):
        qp = good(ROWS, seed, "all_active")
        solver.reset()
        assert solver.solve(qp) == Status.OK
        assert wrong_answer(qp, solver.point) == ""


@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_crane_at_rest_at_the_end(precision: str) -> None:
    """Terminal equations in closed loop: the controls of the dense solver, without a correction."""
    dense, stages = (
        build(crane.build_ocp(), Options(qp=qp, precision=precision), profile="test")
        for qp in (None, RiccatiActiveSet())
    )
    rng = np.random.default_rng(0)
    x = np.array([1.0, 0.0, 0.0, 0.0])
    for k in range(40):
        expected, control = dense.step(x), stages.step(x)
        assert (dense.status, stages.status) == (Status.OK, Status.OK)
        assert np.max(np.abs(control - expected)) <= (1e-8 if precision == "double" else 2e-2)
        if k >= 20:
            assert stages.stats.qp_iterations == 0
        x = np.asarray(dense.x[1]) + 1e-4 * rng.standard_normal(4)


def test_bounds_that_block_one_another_need_many_iterations() -> None:
    """Dynamics that grow by a third in each of 40 intervals, from a state that no admissible control brings back: the
    first 20 steps of the method are short, and yet it arrives."""
    rng = np.random.default_rng(1)
    A, B = rng.standard_normal((6, 6)), rng.standard_normal((6, 2))
    ocp = OCP("growth", N=40)
    x, u = ocp.state("x", size=6), ocp.control("u", size=2)
    ocp.dynamics({x: 1.3 / np.abs(np.linalg.eigvals(A)).max() * A @ x + B @ u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0] * 6 + [0.01] * 2)
    ocp.subject_to(-1, u, 1)
    algorithm = RealTimeIteration(iterations=1, shift=None)
    options = Options(condensing=NoCondensing(), qp=RiccatiInteriorPoint(), algorithm=algorithm)
    controller = build(ocp, options, "test")
    controller.step(10 * rng.standard_normal(6))
    assert controller.status == Status.OK
    assert 20 < controller.stats.qp_iterations <= 45
