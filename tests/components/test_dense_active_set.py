"""The dense active-set solver against constructed KKT points, residuals recomputed in NumPy, and enumeration."""

from __future__ import annotations

import dataclasses
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmpc_codegen.components.qp import REGISTRY, DenseActiveSet
from nmpc_codegen.errors import OptionError
from nmpc_codegen.runtime.build import PROFILES
from tests.components import random_dense as qp_random
from tests.components.random_dense import wrong_answer, wrong_certificate
from verification.oracles.qp import (
    QuadraticProgram,
    by_enumeration,
    from_solution,
    hessian,
    infeasible,
    residuals,
)
from verification.qp.harness import FAST, QP, WARNINGS, qp_dims, source

SIZES = [(1, 0), (4, 2), (10, 4), (23, 9), (60, 20)]
KINDS = {
    "mixed": {},
    "condition": {"condition": 1e8},
    "degenerate": {"degenerate": 0.5},
    "no equality": {"weights": (1, 2, 1, 0)},
    "equalities": {"weights": (0, 1, 0, 2)},
    "all active": {"weights": (1, 0, 1, 0)},
    "none active": {"weights": (0, 1, 0, 0)},
    "scales": {"scale": 1e6},
    "scales and condition": {"scale": 1e3, "condition": 1e8},
}
seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=60, deadline=None)
few = settings(max_examples=25, deadline=None)


def solver_of(nv: int, ng: int, precision: str = "double", max_iterations: int | None = None) -> QP:
    """A solver of SIZES, compiled as for release, or another one, compiled without the optimiser."""
    flags = FAST if (nv, ng) in SIZES else PROFILES["test"].flags
    return QP(nv, ng, precision, max_iterations, flags)


def solved(qp: QuadraticProgram, solver: QP, limit: float = 1e-11) -> None:
    """Solve, and assert the optimality conditions."""
    assert solver.run(*qp.data) == "OK"
    result = residuals(qp, solver.z, solver.mult)
    assert result.worst <= limit, result


@pytest.mark.few(25)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("nv", "ng"), SIZES)
@few
@given(seed=seeds)
def test_constructed_kkt_points(nv: int, ng: int, kind: str, seed: int) -> None:
    qp = from_solution(np.random.default_rng(seed), nv, ng, **KINDS[kind])
    solver = solver_of(nv, ng)
    condition, scale = KINDS[kind].get("condition", 1e2), KINDS[kind].get("scale", 1.0)
    solved(qp, solver, 1e-10 if condition > 1e4 else 1e-11)
    error = np.abs(solver.z - qp.z) / (np.abs(qp.z) if scale > 1 else np.max(np.abs(qp.z)))
    assert np.max(error) <= (1e-6 if scale > 1 else 1e-12 * condition)


@many
@given(seed=seeds, condition=st.sampled_from([1.0, 1e2, 1e4]))
def test_multipliers_are_found_where_they_are_unique(seed: int, condition: float) -> None:
    qp = from_solution(np.random.default_rng(seed), 10, 4, condition=condition, weights=(1, 8, 1, 0))
    active = qp.rows[qp.state != 0]
    if len(active) and (len(active) > 10 or np.linalg.svd(active)[1].min() < 1e-2):
        return
    solver = solver_of(10, 4)
    solved(qp, solver)
    np.testing.assert_allclose(solver.mult, qp.mult, atol=1e-8 * condition)
    assert solver["dropped"] == 0


@pytest.mark.parametrize("repeated", ["rows", "combinations", "bounds"])
@pytest.mark.parametrize(("nv", "ng"), [(4, 3), (10, 6), (30, 12)])
@few
@given(seed=seeds, condition=st.sampled_from([1e2, 1e8]), degenerate=st.sampled_from([0.0, 0.5]))
def test_redundant_rows(nv: int, ng: int, repeated: str, seed: int, condition: float, degenerate: float) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(ng, nv))
    rest = ng - ng // 2
    if repeated == "rows":
        A[ng // 2 :] = A[:rest][: ng - ng // 2] * rng.choice([1, -1, 2, 0.3], size=(rest, 1))
    elif repeated == "combinations":
        A[ng // 2 :] = rng.normal(size=(rest, ng // 2)) @ A[: ng // 2]
    else:
        A[ng // 2 :] = np.eye(nv)[rng.integers(nv, size=rest)]
    qp = from_solution(rng, nv, ng, condition=condition, degenerate=degenerate, A=A)
    solver = solver_of(nv, ng)
    other = dataclasses.replace(qp, g=10 * rng.normal(size=nv))
    for problem in (qp, other, qp):
        solved(problem, solver, 1e-10)


def test_redundant_equalities_get_no_multiplier_and_are_counted() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(2, 6))
    A = np.vstack([A, 2 * A[0] - A[1], A[1]])
    qp = from_solution(rng, 6, 4, weights=(0, 1, 0, 0), A=A)
    value = A @ qp.z
    bounds = [np.concatenate([b[:6], value]) for b in (qp.lower, qp.upper)]
    solver = solver_of(6, 4)
    solved(dataclasses.replace(qp, g=qp.g + A[0] + A[1], lower=bounds[0], upper=bounds[1]), solver)
    assert solver["dropped"] == 2
    assert np.count_nonzero(solver.mult[6:]) == 2


@pytest.mark.parametrize(("nv", "ng"), [(1, 1), (10, 4), (24, 9)])
@many
@given(seed=seeds)
def test_warm_started_sequences(nv: int, ng: int, seed: int) -> None:
    """One struct solves problems whose active sets, bounds, equalities and Hessians change strongly."""
    rng = np.random.default_rng(seed)
    solver = solver_of(nv, ng)
    for _ in range(6):
        qp = from_solution(rng, nv, ng, weights=tuple(rng.dirichlet(np.ones(4))), degenerate=0.3)
        solved(qp, solver)


@many
@given(seed=seeds)
def test_bounds_may_change_between_the_phases(seed: int) -> None:
    """The prediction passed to qp_factorize may be arbitrarily wrong: bounds turn infinite, equalities change."""
    rng = np.random.default_rng(seed)
    H, A = hessian(rng, 10, 1e3), rng.normal(size=(4, 10))
    solver = solver_of(10, 4)
    for _ in range(6):
        predicted = from_solution(rng, 10, 4, A=A, H=H, weights=(1, 1, 1, 1))
        qp = from_solution(rng, 10, 4, A=A, H=H, weights=tuple(rng.dirichlet(np.ones(4))))
        solver.load(H, A, predicted.lower, predicted.upper)
        assert solver.factorize() == "OK"
        for problem in (predicted, qp, predicted):
            solver.load_bounds(problem.lower, problem.upper)
            assert solver.solve(problem.g) == "OK"
            assert residuals(problem, solver.z, solver.mult).worst <= 1e-11


@few
@given(seed=seeds)
def test_the_same_problem_again_needs_no_iteration(seed: int) -> None:
    qp = from_solution(np.random.default_rng(seed), 10, 4)
    solver = solver_of(10, 4)
    solved(qp, solver)
    z, mult = solver.z, solver.mult
    solved(qp, solver)
    assert solver["iterations"] == 0
    np.testing.assert_allclose(solver.z, z, atol=1e-10)
    np.testing.assert_allclose(solver.mult, mult, atol=1e-9 * (1 + np.abs(mult).max()))


def test_a_shifted_working_set_is_the_prediction() -> None:
    solver = solver_of(8, 0)
    H, g = np.eye(8), -np.array([5.0, 0, 0, 5, 0, -5, 0, 5])
    assert solver.run(H, g, np.zeros((0, 8)), -np.ones(8), np.ones(8)) == "OK"
    solver.shift(2)
    assert list(solver["side"]) == [0, 1, 0, -1, 0, 1, 0, 1]
    shifted = np.append(g[2:], [0.0, -5.0])
    assert solver.run(H, shifted, np.zeros((0, 8)), -np.ones(8), np.ones(8)) == "OK"
    assert solver["iterations"] == 0
    np.testing.assert_array_equal(solver.z, np.clip(-shifted, -1, 1))


integers = st.integers(-3, 3)


@settings(max_examples=120, deadline=None)
@given(data=st.data())
def test_enumeration_agrees_on_tiny_integer_problems(data: st.DataObject) -> None:
    """Small integers make ties, repeated rows, zero rows and empty feasible sets common."""
    n, m = data.draw(st.sampled_from([(1, 1), (2, 0), (2, 1), (2, 2), (3, 1), (3, 2)]))
    draw = lambda *shape: np.array(  # noqa: E731
        data.draw(st.lists(integers, min_size=int(np.prod(shape)), max_size=int(np.prod(shape)))), float
    ).reshape(shape)
    B = draw(n, n)
    H, g, A, centre = B @ B.T + np.eye(n), draw(n), draw(m, n), draw(n + m)
    width = np.array([data.draw(st.sampled_from([0.0, 1.0, 2.0, np.inf])) for _ in range(n + m)])
    upper = np.array([data.draw(st.sampled_from([0.0, 1.0, np.inf])) for _ in range(n + m)])
    qp = QuadraticProgram(H, g, A, centre - width, np.where(width == 0, centre, centre + upper))
    best = by_enumeration(qp)
    solver = solver_of(n, m)
    if best is None:
        assert solver.run(*qp.data) == "INFEASIBLE"
    else:
        solved(qp, solver)
        np.testing.assert_allclose(solver.z, best, atol=1e-8)


@pytest.mark.parametrize(("nv", "ng"), [(1, 1), (3, 2), (10, 4), (30, 10)])
@many
@given(seed=seeds)
def test_infeasible_problems_are_recognised_and_left_behind(nv: int, ng: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    bad, good = infeasible(rng, nv, ng), from_solution(rng, nv, ng)
    w, C = bad.mult, bad.rows  # the certificate: w'C = 0 and w'value < every value the bounds allow, by construction
    np.testing.assert_allclose(w @ C, 0, atol=1e-12 * (1 + np.abs(w).max() * np.abs(C).max()))
    with np.errstate(invalid="ignore"):
        reach = np.sum(np.where(w == 0, 0.0, w * np.where(w > 0, bad.upper, bad.lower)))
    assert reach < 0
    solver = solver_of(nv, ng)
    for _ in range(2):
        assert solver.run(*bad.data) == "INFEASIBLE"
        assert not wrong_certificate(bad, solver["certificate"][: nv + ng])
        assert np.all(np.isfinite(solver.z))
        assert np.all(np.isfinite(solver.mult))
        solved(good, solver)


def test_crossed_bounds_are_infeasible() -> None:
    solver = solver_of(2, 1)
    for row in range(3):
        lower, upper = -np.ones(3), np.ones(3)
        lower[row] = 1.5
        assert solver.run(np.eye(2), np.zeros(2), np.ones((1, 2)), lower, upper) == "INFEASIBLE"
        assert not np.any(solver["certificate"])
        assert solver.run(np.eye(2), np.zeros(2), np.ones((1, 2)), lower, upper, 1.0) == "INFEASIBLE"


@many
@given(
    seed=seeds,
    name=st.sampled_from(["H", "g", "A", "lower", "upper"]),
    bad=st.sampled_from([np.nan, np.inf, -np.inf]),
)
def test_data_that_is_not_finite(seed: int, name: str, bad: float) -> None:
    rng = np.random.default_rng(seed)
    good = from_solution(rng, 10, 4)
    array = np.array(getattr(good, name))
    if name == "H":
        i, j = np.sort(rng.integers(10, size=2))
        array[j, i] = array[i, j] = bad
    else:
        array[tuple(rng.integers(array.shape))] = {"lower": abs(bad), "upper": -abs(bad)}.get(name, bad)
    solver = solver_of(10, 4)
    for warm in (False, True):
        if warm:
            solved(good, solver)
        assert solver.run(*dataclasses.replace(good, **{name: array}).data) == "NUMERICAL_FAILURE"
        assert not np.any(solver.z)
        assert not np.any(solver.mult)
    solved(good, solver)


def test_a_failed_factorisation_is_not_solved_with() -> None:
    qp = from_solution(np.random.default_rng(2), 10, 4)
    solver = solver_of(10, 4)
    assert solver.solve(qp.g) == "NUMERICAL_FAILURE"
    solved(qp, solver)
    assert solver.run(-qp.H, *qp.data[1:]) == "NUMERICAL_FAILURE"
    assert solver.solve(qp.g) == "NUMERICAL_FAILURE"
    assert not np.any(solver.z)


@many
@given(seed=seeds, lowest=st.sampled_from([-1.0, -1e-5]), n=st.sampled_from([1, 4, 10]))
def test_an_indefinite_hessian(seed: int, lowest: float, n: int) -> None:
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    H = (Q * np.append(np.linspace(1, 2, n - 1), lowest)) @ Q.T
    qp = dataclasses.replace(from_solution(rng, n, 0), H=H)
    assert solver_of(n, 0).run(*qp.data) == "NUMERICAL_FAILURE"


def test_a_zero_diagonal_entry_with_a_coupling_is_indefinite() -> None:
    H = np.array([[0.0, 1e-3], [1e-3, 1.0]])
    assert solver_of(2, 0).run(H, np.ones(2), np.zeros((0, 2)), -np.ones(2), np.ones(2)) == "NUMERICAL_FAILURE"


@pytest.mark.parametrize(("nv", "ng"), SIZES)
@few
@given(seed=seeds, share=st.sampled_from([0.0, 0.3, 0.9]), spread=st.sampled_from([1.0, 1e2]))
def test_semidefinite_hessians(nv: int, ng: int, seed: int, share: float, spread: float) -> None:
    """Any rank, 0 (a linear program) included: KKT conditions and the objective of the constructed solution.

    The proximal term amplifies rounding errors: a row outside the working set may remain violated by about 1e-8,
    relative, compared with 1e-10 for a definite Hessian.
    """
    rng = np.random.default_rng(seed)
    rank = int(share * nv)
    factor = rng.normal(size=(rank, nv)) * np.geomspace(1, spread, rank)[:, None]
    qp = from_solution(rng, nv, ng, H=factor.T @ factor, weights=(2, 2, 2, 1))
    solver = solver_of(nv, ng)
    for _ in range(2):
        assert solver.run(*qp.data) == "OK"
        assert residuals(qp, solver.z, solver.mult).worst < 1e-7
        assert qp.z is not None
        size = np.abs(qp.g) @ np.abs(qp.z) + np.abs(qp.z) @ np.abs(qp.H) @ np.abs(qp.z)
        d = solver.z - qp.z  # the difference of the objectives, without cancellation
        assert abs(d @ (qp.H @ (solver.z + qp.z) / 2 + qp.g)) <= 1e-7 * size + 1e-14


def test_semidefinite_hessian_with_degenerate_rows() -> None:
    """A feasible QP of rank below nv whose proximal weights decide whether a row looks like a contradiction."""
    qp = qp_random.semidefinite(np.random.default_rng([0, 2753]), 16, 40)
    solver = QP(16, 40)
    assert solver.run(*qp.data) == "OK"
    assert wrong_answer(qp, solver.z, solver.mult, unique=False) == ""


@few
@given(seed=seeds, n=st.sampled_from([1, 4, 10]))
def test_an_unbounded_problem(seed: int, n: int) -> None:
    """Weighted differences of neighbours have no cost along (1, ..., 1), and no bound limits g'z in that direction."""
    rng = np.random.default_rng(seed)
    difference = np.diff(np.eye(n), axis=0)
    H = difference.T @ np.diag(rng.integers(1, 9, size=n - 1)) @ difference
    g, infinite = rng.integers(-3, 1, size=n) - 1.0, np.full(n, np.inf)
    solver = solver_of(n, 0)
    assert solver.run(H, g, np.zeros((0, n)), -infinite, infinite) == "NUMERICAL_FAILURE"
    assert not np.any(solver.z)
    upper = np.append(infinite[1:], 1.0)
    assert solver.run(H, g, np.zeros((0, n)), -infinite, upper) == "OK"
    assert residuals(QuadraticProgram(H, g, np.zeros((0, n)), -infinite, upper), solver.z, solver.mult).worst < 1e-10


PENALTIES = {"mixed": (1e-2, 1.0, 1e2), "small": (1e-6, 1e-3), "large": (1e6, 1e8), "zero": (0.0,)}


def unrelated_bounds(rng: np.random.Generator, nv: int, ng: int) -> QuadraticProgram:
    """General rows whose bounds usually contradict one another and the bounds of the variables."""
    qp = from_solution(rng, nv, ng, weights=(1, 2, 1, 1))
    shift = np.append(np.zeros(nv), 3 * rng.normal(size=ng))
    return dataclasses.replace(qp, lower=qp.lower + shift, upper=qp.upper + shift, z=None, mult=None)


@pytest.mark.parametrize("penalties", PENALTIES)
@pytest.mark.parametrize(("nv", "ng"), [(1, 1), (4, 2), (10, 4), (16, 20)])
@few
@given(seed=seeds)
def test_elastic_rows(nv: int, ng: int, penalties: str, seed: int) -> None:
    """Optimality conditions of the relaxed problem, recomputed; the number of violated rows; then a warm start.

    One in a hundred of these takes more iterations from nothing than the default cap, 6.8 per variable and row.
    """
    rng = np.random.default_rng(seed)
    solver = solver_of(nv, ng, max_iterations=20 * (nv + ng))
    for build in (unrelated_bounds, infeasible):
        qp = build(rng, nv, ng)
        penalty = rng.choice(PENALTIES[penalties], size=ng) * rng.exponential(size=ng)
        for _ in range(2):
            assert solver.run(*qp.data, penalty) == "OK"
            assert residuals(qp, solver.z, solver.mult, penalty).worst <= 1e-11
        value = qp.A @ solver.z
        violation = np.maximum(value - qp.upper[nv:], qp.lower[nv:] - value)
        assert np.sum(violation > 1e-7) <= solver["relaxed"] <= np.sum(violation > 0)


@pytest.mark.parametrize(("nv", "ng"), [(4, 2), (10, 4)])
@few
@given(seed=seeds)
def test_elastic_rows_are_slack_variables(nv: int, ng: int, seed: int) -> None:
    """The cost equals that of the problem with explicit slacks, A z - over + under inside, solved by qpOASES."""
    rng = np.random.default_rng(seed)
    qp, penalty = unrelated_bounds(rng, nv, ng), rng.exponential(size=ng)
    solver = solver_of(nv, ng)
    assert solver.run(*qp.data, penalty) == "OK"
    slack = np.concatenate([penalty, penalty])
    H = np.block([[qp.H, np.zeros((nv, 2 * ng))], [np.zeros((2 * ng, nv)), np.zeros((2 * ng, 2 * ng))]])
    A = np.hstack([qp.A, -np.eye(ng), np.eye(ng)])
    other = ca.conic("other", "qpoases", {"h": ca.DM(H).sparsity(), "a": ca.DM(A).sparsity()}, {"printLevel": "none"})
    found = other(
        h=ca.sparsify(ca.DM(H)), a=ca.DM(A), g=np.concatenate([qp.g, slack]),
        lbx=np.append(qp.lower[:nv], np.zeros(2 * ng)), ubx=np.append(qp.upper[:nv], np.full(2 * ng, np.inf)),
        lba=qp.lower[nv:], uba=qp.upper[nv:],
    )  # fmt: skip
    value = qp.A @ solver.z
    violation = np.maximum(0.0, np.maximum(value - qp.upper[nv:], qp.lower[nv:] - value))
    cost = 0.5 * solver.z @ qp.H @ solver.z + qp.g @ solver.z + penalty @ violation
    assert cost == pytest.approx(float(found["cost"]), rel=1e-7, abs=1e-7)


@many
@given(seed=seeds)
def test_the_penalty_is_exact(seed: int) -> None:
    """Penalties above the multipliers change nothing; a row with a multiplier above its penalty is violated."""
    rng = np.random.default_rng(seed)
    qp = from_solution(rng, 10, 4, weights=(1, 4, 1, 0))
    solver = solver_of(10, 4)
    solved(qp, solver)
    z, mult = solver.z, solver.mult[10:]
    largest = np.max(np.abs(mult))
    assert solver.run(*qp.data, 1.01 * largest + 0.1) == "OK"
    np.testing.assert_allclose(solver.z, z, atol=1e-10)
    assert solver["relaxed"] == 0
    if largest > 1e-3:
        assert solver.run(*qp.data, 0.9 * largest) == "OK"
        assert solver["relaxed"] > 0
        assert solver.run(*qp.data) == "OK"
        np.testing.assert_allclose(solver.z, z, atol=1e-10)


def test_a_negative_penalty_is_refused() -> None:
    qp = from_solution(np.random.default_rng(5), 4, 2)
    for bad in (-1.0, np.nan):
        assert solver_of(4, 2).run(*qp.data, bad) == "NUMERICAL_FAILURE"


def test_rows_take_the_prediction_they_are_told() -> None:
    solver = solver_of(4, 3)
    solver["side"][:7] = [0, 1, -1, 1, -1, 2, 1]
    solver.shift(1, [1, 2, 2])
    assert list(solver["side"][:7]) == [1, -1, 1, 1, 2, 1, 1]


def test_the_judge_of_random_problems_sees_wrong_answers() -> None:
    rng = np.random.default_rng(4)
    qp, bad = from_solution(rng, 10, 4), infeasible(rng, 10, 4)
    assert not wrong_answer(qp, qp.z, qp.mult, unique=True)
    assert wrong_answer(qp, qp.z * (1 + 1e-6), qp.mult, unique=True)
    assert wrong_answer(qp, qp.z, qp.mult + 1e-6, unique=True)
    assert not wrong_certificate(bad, bad.mult / np.max(np.abs(bad.mult)))
    assert wrong_certificate(bad, -bad.mult / np.max(np.abs(bad.mult)))
    assert wrong_certificate(bad, 0 * bad.mult)


def test_the_iteration_cap() -> None:
    qp = from_solution(np.random.default_rng(3), 10, 0, weights=(1, 0, 1, 0))
    solver = solver_of(10, 0, max_iterations=3)
    assert solver.run(*qp.data) == "ITERATION_LIMIT"
    assert solver["iterations"] == 3
    assert np.all(np.isfinite(solver.z))
    for _ in range(5):  # the working set is kept, so that capped calls make progress
        status = solver.run(*qp.data)
    assert status == "OK"
    np.testing.assert_allclose(solver.z, qp.z, atol=1e-10)


def test_default_cap_is_enough() -> None:
    most = 0.0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        qp = from_solution(rng, 20, 10, condition=1e6, weights=(2, 1, 2, 0))
        solver = solver_of(20, 10)
        solved(qp, solver)
        most = max(most, solver["iterations"] / (10 * 30 + 50))
    assert most < 0.7


@pytest.mark.parametrize(("nv", "ng"), [(1, 0), (10, 4), (23, 9)])
@few
@given(seed=seeds)
def test_single_precision(nv: int, ng: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    qp = from_solution(rng, nv, ng, condition=1e2, degenerate=0.2, weights=(1, 6, 1, 1))
    rounded = [np.float32(a).astype(float) for a in qp.data]
    qp = QuadraticProgram(*rounded)
    solver = solver_of(nv, ng, "single")
    status = solver.run(*qp.data)
    if status == "INFEASIBLE":  # rounding of the data may have made dependent equalities inconsistent
        assert np.count_nonzero(qp.lower == qp.upper) + np.count_nonzero(solver["side"]) >= nv
        return
    assert status == "OK"
    assert residuals(qp, solver.z, solver.mult).worst <= 1e-4


def compile_source(text: str, path: Path, *command: str) -> None:
    path.write_text(text)
    subprocess.run([*command, str(path), "-o", str(path.with_suffix(".out")), "-lm"], check=True)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize(("nv", "ng"), [(1, 0), (10, 4), (12, 0)])
@pytest.mark.parametrize("compiler", [("gcc", "-std=c99", "-O2"), ("g++", "-std=c++17", "-xc++", "-fsyntax-only")])
def test_no_warnings_in_c_and_cpp(tmp_path: Path, need, precision: str, nv: int, ng: int, compiler) -> None:
    need(compiler[0])
    text = source(nv, ng, precision)
    if "-O2" in compiler and precision == "single":
        compiler = (*compiler, "-O0")  # the data flow, which the optimiser analyses, is that of double precision
    compile_source(text, tmp_path / "qp.c", *compiler, *WARNINGS, "-c")


SANITIZED = r"""
static unsigned long state = 1;
static real_t draw(void)
{
    state = state * 6364136223846793005UL + 1442695040888963407UL;
    return (real_t)((double)(state >> 11) / 9007199254740992.0 * 2 - 1);
}
int main(void)
{
    static qp_t q;
    int ok = 0;
    qp_init(&q);
    for (int trial = 0; trial < 1000; ++trial) {
        for (int i = 0; i < NV; ++i) {
            for (int j = 0; j <= i; ++j) { q.H[i][j] = i == j ? NV + 1 : draw(); }
            q.g[i] = 10 * draw();
        }
        for (int j = 0; j < NG; ++j) {
            for (int i = 0; i < NV; ++i) { q.A[j][i] = draw(); }
        }
        for (int c = 0; c < NV + NG; ++c) {
            q.lower[c] = -(draw() + 1);
            q.upper[c] = q.lower[c] + (trial % 3 == c % 3 ? 0 : 2);
        }
        if (trial % 7 == 3) { q.g[0] = (real_t)NAN; }
        if (trial % 7 == 4) { q.H[NV - 1][0] = (real_t)INFINITY; }
        if (trial % 7 == 5) { q.lower[0] = (real_t)NAN; }
        if (trial % 7 == 6) { q.H[0][0] = -1; }
        qp_factorize(&q);
        for (int c = 0; c < NV; ++c) { q.upper[c] += trial % 5 == 0; }
        ok += qp_solve(&q) == OK;
        {
            int source[NG + 1];
            for (int j = 0; j < NG; ++j) { source[j] = j + 1 < NG ? j + 1 : j; }
            qp_shift_controls(&q, 1);
#if NG
            qp_shift_rows(&q, source);
#endif
        }
    }
    return ok == 0;
}
"""


@pytest.mark.parametrize(("nv", "ng"), [(1, 0), (10, 4), (16, 20)])
def test_sanitizers_are_silent(tmp_path: Path, nv: int, ng: int) -> None:
    flags = ("-std=c99", "-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    compile_source(source(nv, ng) + SANITIZED, tmp_path / "qp.c", "gcc", *flags)
    subprocess.run([str(tmp_path / "qp.out")], check=True, timeout=60)


COUNTING = r"""
#include <cmath>
#include <cstdint>
#include <cstdio>
struct counting {
    double v;
    static long add, mul, other;
    counting() = default;
    counting(double x) : v(x) {}
};
long counting::add = 0, counting::mul = 0, counting::other = 0;
static counting operator+(counting a, counting b) { ++counting::add; return a.v + b.v; }
static counting operator-(counting a, counting b) { ++counting::add; return a.v - b.v; }
static counting operator*(counting a, counting b) { ++counting::mul; return a.v * b.v; }
static counting operator/(counting a, counting b) { return a.v / b.v; }
static counting operator-(counting a) { ++counting::other; return -a.v; }
static counting &operator+=(counting &a, counting b) { return a = a + b; }
static counting &operator-=(counting &a, counting b) { return a = a - b; }
static counting &operator*=(counting &a, counting b) { return a = a * b; }
static bool operator<(counting a, counting b) { return a.v < b.v; }
static bool operator>(counting a, counting b) { return a.v > b.v; }
static bool operator<=(counting a, counting b) { return a.v <= b.v; }
static bool operator>=(counting a, counting b) { return a.v >= b.v; }
static counting sqrt(counting a) { return std::sqrt(a.v); }
static counting fabs(counting a) { ++counting::other; return std::fabs(a.v); }
static bool isfinite(counting a) { return std::isfinite(a.v); }
"""


@pytest.mark.parametrize("nv", [1, 10, 24])
def test_operation_counts(tmp_path: Path, need, nv: int) -> None:
    need("g++")
    text = source(nv, 1).replace("#include <math.h>\n#include <stdint.h>\n", COUNTING)
    text = text.replace("typedef double real_t;", "typedef counting real_t;")
    report = 'std::printf("%ld %ld %ld\\n", counting::add, counting::mul, counting::other); '
    clear = "counting::add = counting::mul = counting::other = 0; "
    text += "int main() { static qp_t q; static counting y[LDV], z[LDV]; (void)qp_solve;"
    text += "(void)qp_factorize; (void)qp_shift_controls; (void)qp_shift_rows; qp_init(&q);"
    text += f"{clear} qp_forward(&q, y, 0); {report} {clear} qp_backward(&q, y, z); {report} }}\n"
    compile_source(text, tmp_path / "qp.cpp", "g++", "-std=c++17")
    lines = subprocess.run([str(tmp_path / "qp.out")], check=True, capture_output=True, text=True).stdout.split("\n")
    cost = DenseActiveSet().cost(qp_dims(nv, 1), {})
    for line, name in zip(lines, ("qp_forward", "qp_backward"), strict=False):
        assert [int(w) for w in line.split()] == [cost[name].add, cost[name].mul, cost[name].other], name


@pytest.mark.parametrize("bad", [0, -1, 2.5, "many", True])
def test_bad_options(bad: object) -> None:
    with pytest.raises(OptionError, match="max_iterations"):
        DenseActiveSet(max_iterations=bad)  # type: ignore[arg-type]


def test_registered_under_its_name() -> None:
    assert REGISTRY["dense_active_set"] is DenseActiveSet
    assert {n: v for n, v, _ in DenseActiveSet().sizes(qp_dims(10, 4))} == {
        "QP_MAX_ITERATIONS": 96,  # 2 x 3.4 per variable and row
        "QP_MAX_PROXIMAL_STEPS": 34,
        "QP_MAX_SEARCHES": 164,
    }
