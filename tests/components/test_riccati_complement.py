"""Rows of the working set by the Schur complement: no correction, whatever changes between the phases."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from riccati_harness import RiccatiQP, Shape, drawn_rows

from examples import crane
from nmpc_codegen import Options, build
from nmpc_codegen.components.qp import RiccatiActiveSet
from nmpc_codegen.runtime.build import PROFILES
from verification.oracles.riccati import StageProblem, StageQP, equality_solution, random_problem, residuals

#: The last sample of a sequence comes after all for which the solver may have chosen weights.
SETTLED = 10
TERMINAL = Shape(10, 4, 1, tuple((10, i) for i in range(4)))
GENERAL = Shape(10, 4, 1, tuple((10, -1) for _ in range(4)))
SHAPES = {
    "terminal": TERMINAL,
    "general": GENERAL,
    "on the way": Shape(6, 4, 2, ((2, 1), (3, -1), (5, -1), (6, 2))),
    "free": Shape(4, 5, 2, ((0, 1), (0, -1), (4, -1)), (1, 3, 4)),
    "one stage": Shape(1, 3, 3, ((0, -1), (1, 0))),
}
LIMITS = {"double": 1e-10, "single": 2e-3}
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=10, deadline=None)


def solver(shape: Shape, precision: str = "double") -> RiccatiQP:
    return RiccatiQP(shape, RiccatiActiveSet(), precision, PROFILES["test"].flags)


def equations(
    problem: StageProblem, shape: Shape, rows: np.ndarray, values: np.ndarray, box: float = np.inf
) -> StageQP:
    """The rows are equations, the controls have bounds of the given size."""
    n = shape.ns * shape.nus
    bounds = np.full(n, box)
    lower, upper = np.append(-bounds, values), np.append(bounds, values)
    penalty, curvature = np.full(len(rows), np.inf), np.zeros(len(rows))
    return StageQP(problem, rows, tuple(k for k, _ in shape.rows), lower, upper, penalty, curvature)


def drawn(rng: np.random.Generator, shape: Shape, box: float = np.inf) -> StageQP:
    problem = random_problem(rng, shape.ns, shape.nx, shape.nus, shape.free)
    return equations(problem, shape, drawn_rows(rng, shape), 0.3 * rng.normal(size=len(shape.rows)), box)


def moved(rng: np.random.Generator, qp: StageQP, amount: float) -> StageQP:
    """Another measurement, and other values of the equations."""
    n, change = qp.lower.size - len(qp.rows), amount * rng.normal(size=len(qp.rows))
    lower, upper = qp.lower.copy(), qp.upper.copy()
    lower[n:] += change
    upper[n:] = lower[n:]
    x_0 = qp.problem.x_0 + amount * rng.normal(size=qp.problem.nx)
    return dataclasses.replace(qp, problem=dataclasses.replace(qp.problem, x_0=x_0), lower=lower, upper=upper)


def holds(s: RiccatiQP, qp: StageQP, limit: float) -> None:
    """The solution, without a correction and without another working set."""
    result = residuals(qp, s.x, s.u, s.mult)
    assert result.worst <= limit, result
    assert (s["refinements"], s["iterations"]) == (0, 0)


@pytest.mark.parametrize("precision", LIMITS)
@pytest.mark.parametrize("name", SHAPES)
@few
@given(seed=seeds)
def test_equations_need_no_correction(name: str, precision: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    s, qp = solver(SHAPES[name], precision), drawn(rng, SHAPES[name])
    assert s.run(qp) == "OK"
    if precision == "double":
        holds(s, qp, LIMITS[precision])
    assert residuals(qp, s.x, s.u, s.mult).worst <= LIMITS[precision]


@few
@given(seed=seeds, name=st.sampled_from(sorted(SHAPES)))
def test_bounds_and_measurement_may_change_between_the_phases(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    s, qp = solver(SHAPES[name]), drawn(rng, SHAPES[name])
    for amount in (1e-3, 1.0, 0.0):
        s.load(qp)
        assert s.factorize() == "OK"
        for _ in range(2):
            other = moved(rng, qp, amount)
            s.load_bounds(other)
            assert s.solve(other.problem.x_0) == "OK"
            holds(s, other, 1e-10)


@few
@given(seed=seeds)
def test_with_controls_at_their_bounds(seed: int) -> None:
    """After the working set is found, samples near this one need neither a correction nor another set."""
    rng = np.random.default_rng(seed)
    shape = SHAPES["on the way"]
    loose = drawn(rng, shape)
    s = solver(shape)
    assert s.run(loose) == "OK"
    qp = drawn(np.random.default_rng(seed), shape, box=0.8 * float(np.abs(s.u).max()))
    if s.run(qp) != "OK":  # the equations cannot be reached
        return
    for _ in range(SETTLED):
        assert s.run(qp) == "OK"
    bounds = shape.ns * shape.nus
    side = s["side"][:bounds].copy()
    assert np.any(side)
    near = moved(rng, qp, 1e-7)
    for _ in range(2):  # the second time with other bounds of the active controls, without a preparation
        s.load_bounds(near)
        assert s.solve(near.problem.x_0) == "OK"
        holds(s, near, 1e-10)
        lower, upper = near.lower.copy(), near.upper.copy()
        lower[:bounds] += 1e-7 * (side < 0) * rng.uniform(size=bounds)
        upper[:bounds] -= 1e-7 * (side > 0) * rng.uniform(size=bounds)
        near = dataclasses.replace(near, lower=lower, upper=upper)


@few
@given(seed=seeds)
def test_a_control_that_reaches_its_bound_needs_no_correction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = SHAPES["on the way"]
    s, qp = solver(shape), drawn(rng, shape)
    assert s.run(qp) == "OK"
    c = int(np.argmax(np.abs(s.u)))
    lower, upper = qp.lower.copy(), qp.upper.copy()
    lower[c], upper[c] = -0.99 * np.abs(s.u).max(), 0.99 * np.abs(s.u).max()
    near = dataclasses.replace(qp, lower=lower, upper=upper)
    s.load_bounds(near)
    assert s.solve(near.problem.x_0) == "OK"
    assert (s["iterations"], s["refinements"]) == (1, 0)
    assert residuals(near, s.x, s.u, s.mult).worst <= 1e-10


@few
@given(seed=seeds, name=st.sampled_from(["terminal", "general", "on the way", "one stage"]))
def test_what_the_preparation_knows(seed: int, name: str) -> None:
    """Values of the members as a function of dx_0, and C, are those of the dense QP without the rows."""
    rng = np.random.default_rng(seed)
    shape = SHAPES[name]
    s, qp = solver(shape), drawn(rng, shape)
    s.load(qp)
    assert s.factorize() == "OK"
    schur, n = s.memory["schur"], len(shape.rows)
    dense = np.zeros((n, qp.problem.size))
    for a, k, row in zip(qp.rows, qp.at, dense, strict=True):
        row[qp.problem.x(k)] = a[: shape.nx]
        if k < shape.ns:
            row[qp.problem.u(k)] = a[shape.nx :]

    def values(**data: np.ndarray) -> np.ndarray:
        return dense @ equality_solution(dataclasses.replace(qp.problem, **data), dense[:0], np.zeros(0))[0]

    at_zero = values(x_0=np.zeros(shape.nx))
    scale = np.abs(at_zero).max()
    np.testing.assert_allclose(schur["origin"], at_zero, rtol=0, atol=1e-10 * scale)
    predicted = schur["origin"] + schur["pull"][:, : shape.nx] @ qp.problem.x_0
    np.testing.assert_allclose(predicted, values(), rtol=0, atol=1e-10 * scale)
    L = np.tril(schur["complement"], -1) + np.eye(n)
    C = L @ np.diag(1 / np.diag(schur["complement"])) @ L.T
    mult = equality_solution(qp.problem, dense, qp.lower[-n:])[2]
    np.testing.assert_allclose(
        C @ mult, values() - qp.lower[-n:], rtol=0, atol=1e-9 * np.abs(mult).max() * np.abs(C).max()
    )


@few
@given(seed=seeds, name=st.sampled_from(["terminal", "general", "on the way"]))
def test_the_feedback_phase_has_no_backward_substitution(seed: int, name: str) -> None:
    """Not even if the values of the equations change: p is neither read nor written."""
    rng = np.random.default_rng(seed)
    s, qp = solver(SHAPES[name]), drawn(rng, SHAPES[name])
    s.load(qp)
    assert s.factorize() == "OK"
    s.memory["riccati"]["p"][...] = np.nan
    near = moved(rng, qp, 1.0)
    s.load_bounds(near)
    assert s.solve(near.problem.x_0) == "OK"
    holds(s, near, 1e-10)
    assert np.all(np.isnan(s.memory["riccati"]["p"]))


@few
@given(seed=seeds)
def test_a_row_enters_without_a_recursion(seed: int) -> None:
    """A row that becomes active between the phases does not touch the factors."""
    rng = np.random.default_rng(seed)
    shape = SHAPES["on the way"]
    s, qp = solver(shape), drawn(rng, shape)
    n = shape.ns * shape.nus
    open_rows = dataclasses.replace(qp, lower=np.full_like(qp.lower, -np.inf), upper=np.full_like(qp.upper, np.inf))
    for _ in range(2):
        assert s.run(open_rows) == "OK"
    factors = s.memory["riccati"]["P"].copy()
    upper = open_rows.upper.copy()
    upper[n + 2] = qp.values(s.x, s.u)[n + 2] - 0.1
    closed = dataclasses.replace(open_rows, upper=upper)
    s.load_bounds(closed)
    assert s.solve(closed.problem.x_0) == "OK"
    assert s["side"][n + 2] == 1
    assert s["refinements"] == 0
    np.testing.assert_array_equal(s.memory["riccati"]["P"], factors)
    assert residuals(closed, s.x, s.u, s.mult).worst <= 1e-10
    s.load_bounds(open_rows)
    assert s.solve(qp.problem.x_0) == "OK"
    assert not np.any(s["side"])
    np.testing.assert_array_equal(s.memory["riccati"]["P"], factors)
    assert residuals(open_rows, s.x, s.u, s.mult).worst <= 1e-10


@few
@given(seed=seeds, contradictory=st.booleans())
def test_equations_that_depend_on_others(seed: int, contradictory: bool) -> None:
    """Consistent ones hold without a correction; a contradiction is never OK, and is left behind."""
    rng = np.random.default_rng(seed)
    s, qp = solver(GENERAL), drawn(rng, GENERAL)
    n, mix = GENERAL.ns * GENERAL.nus, rng.normal(size=(2, 2))
    rows, values = qp.rows.copy(), qp.lower[n:].copy()
    rows[2:], values[2:] = mix @ rows[:2], mix @ values[:2]
    good = equations(qp.problem, GENERAL, rows, values)
    if contradictory:
        values = values + np.array([0, 0, 0, 1.0])
        for _ in range(2):
            assert s.run(equations(qp.problem, GENERAL, rows, values)) in ("INFEASIBLE", "ITERATION_LIMIT")
    for _ in range(SETTLED):
        assert s.run(good) == "OK"
    holds(s, good, 1e-9)


@few
@given(seed=seeds)
def test_rows_that_are_soft(seed: int) -> None:
    """An equation whose multiplier exceeds its penalty is violated; those that hold need no correction."""
    rng = np.random.default_rng(seed)
    s, hard = solver(TERMINAL), drawn(rng, TERMINAL)
    assert s.run(hard) == "OK"
    force = np.abs(s.mult[-4:])
    penalty = np.where(force >= np.sort(force)[-1], 0.5, 1e3) * force.max()
    soft = dataclasses.replace(hard, penalty=penalty)
    for _ in range(SETTLED):
        assert s.run(soft) == "OK"
    assert s["relaxed"] >= 1
    holds(s, soft, 1e-9)


@pytest.mark.parametrize("precision", LIMITS)
def test_the_crane_at_rest_at_the_end(precision: str) -> None:
    """Terminal equations in closed loop: the controls of the dense solver, without a correction."""
    dense, stages = (
        build(crane.build_ocp(), Options(qp=qp, precision=precision), profile="test")
        for qp in (None, RiccatiActiveSet())
    )
    rng = np.random.default_rng(0)
    x = np.array([1.0, 0.0, 0.0, 0.0])
    for k in range(40):
        expected = dense.step(x)
        control = stages.step(x)
        assert (dense.status.name, stages.status.name) == ("OK", "OK")
        assert np.max(np.abs(control - expected)) <= (1e-8 if precision == "double" else 2e-2)
        if k >= 20:
            assert stages.stats.qp_iterations == 0
            assert stages._s.qp.refinements == 0
        x = np.asarray(dense.x[1]) + 1e-4 * rng.standard_normal(4)
