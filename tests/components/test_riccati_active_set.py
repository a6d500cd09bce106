"""The Riccati active-set solver against constructed KKT points and residuals recomputed in NumPy."""

from __future__ import annotations

import dataclasses
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from riccati_harness import RiccatiQP, Shape, drawn_rows, solver_source

from nmpc_codegen.components.qp import REGISTRY, RiccatiActiveSet
from nmpc_codegen.errors import OptionError
from nmpc_codegen.runtime.build import PROFILES
from verification.oracles.riccati import StageProblem, StageQP, constructed, random_problem, residuals
from verification.qp.harness import FAST

SHAPES = {
    "smallest": Shape(1, 1, 1),
    "one stage": Shape(1, 3, 2, ((0, -1), (1, 0), (1, -1))),
    "bounds": Shape(10, 4, 2),
    "state bounds": Shape(8, 3, 2, tuple((k, i) for k in range(1, 9) for i in range(2))),
    "general": Shape(6, 4, 2, (*((k, -1) for k in range(6) for _ in range(2)), (6, -1))),
    "terminal": Shape(10, 4, 1, tuple((10, i) for i in range(4))),
    "free": Shape(4, 5, 2, ((0, 1), (0, -1), (4, -1)), (1, 3, 4)),
    "more rows": Shape(2, 3, 2, tuple((k, -1) for k in range(3) for _ in range(5))),
    "wide": Shape(3, 6, 9, ((1, -1), (3, 2), (3, 4))),
}
SHAPES |= {f"{name}, small": dataclasses.replace(SHAPES[name], form="small") for name in ("general", "free", "wide")}
#: Weights of the states lower, free, upper, equal, violated.
KINDS = {
    "mixed": (1, 3, 1, 0, 0),
    "equations": (1, 2, 1, 1, 0),
    "soft": (1, 2, 1, 0, 2),
    "all active": (1, 0, 1, 0, 0),
    "none active": (0, 1, 0, 0, 0),
    "given": (0, 1, 0, 2, 0),
}
seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=25, deadline=None)
few = settings(max_examples=8, deadline=None)


def drawn(
    rng: np.random.Generator,
    shape: Shape,
    kind: str = "mixed",
    problem: StageProblem | None = None,
    rows: np.ndarray | None = None,
    degenerate: float = 0.0,
) -> StageQP:
    problem = problem or random_problem(rng, shape.ns, shape.nx, shape.nus, shape.free)
    rows = drawn_rows(rng, shape) if rows is None else rows
    return constructed(rng, problem, rows, tuple(k for k, _ in shape.rows), KINDS[kind], degenerate)


#: Shapes with no row, control bounds, general rows, free components, compiled as for release; others without optimiser.
OPTIMISED = tuple(SHAPES[name] for name in ("smallest", "bounds", "general", "free"))


def solver(shape: Shape, precision: str = "double", **options: int) -> RiccatiQP:
    flags = FAST if shape in OPTIMISED and not options else PROFILES["test"].flags
    return RiccatiQP(shape, RiccatiActiveSet(**options), precision, flags)


def optimal(qp: StageQP, s: RiccatiQP, limit: float = 1e-10) -> None:
    """The optimality conditions hold."""
    result = residuals(qp, s.x, s.u, s.mult)
    assert result.worst <= limit, result


def near(qp: StageQP, s: RiccatiQP, limit: float) -> None:
    """The solution is the constructed one."""
    for found, true in ((s.x, qp.x), (s.u, qp.u)):
        assert np.max(np.abs(found - true)) <= limit * np.max(np.abs(true))


@pytest.mark.few(36)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SHAPES)
@few
@given(seed=seeds)
def test_constructed_kkt_points(name: str, kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    s, qp = solver(SHAPES[name]), drawn(rng, SHAPES[name], kind)
    assert s.run(qp) == "OK"
    optimal(qp, s)
    near(qp, s, 1e-5)
    if not SHAPES[name].rows:
        near(qp, s, 1e-10)


@pytest.mark.parametrize("name", ["state bounds", "general", "terminal", "free"])
@many
@given(seed=seeds, degenerate=st.sampled_from([0.0, 0.3, 1.0]))
def test_warm_started_sequences(name: str, seed: int, degenerate: float) -> None:
    """One struct solves problems whose active sets, bounds, equations and matrices change strongly."""
    rng = np.random.default_rng(seed)
    s = solver(SHAPES[name])
    for _ in range(5):
        qp = drawn(rng, SHAPES[name], str(rng.choice(list(KINDS))), degenerate=degenerate)
        assert s.run(qp) == "OK"
        optimal(qp, s, 1e-8 if degenerate else 1e-10)
        near(qp, s, 1e-5)


@many
@given(seed=seeds, name=st.sampled_from(["bounds", "state bounds", "general", "free"]))
def test_everything_but_the_matrices_may_change_between_the_phases(seed: int, name: str) -> None:
    """The prediction passed to qp_factorize may be wrong in every bound, gradient and in x_0."""
    rng = np.random.default_rng(seed)
    shape = SHAPES[name]
    s = solver(shape)
    first = drawn(rng, shape)
    s.load(first)
    assert s.factorize() == "OK"
    for kind in ("mixed", "equations", "none active", "all active"):
        problem = dataclasses.replace(first.problem, x_0=rng.normal(size=shape.nx))
        qp = drawn(rng, shape, kind, problem, first.rows)
        s.load_gradient(qp)
        s.load_bounds(qp)
        s["penalty"][...], s["curvature"][...] = qp.penalty if len(qp.rows) else np.inf, 0.0
        s.library.test_qp_gradient(s.pointer)
        assert s.solve(problem.x_0) == "OK"
        optimal(qp, s)
        near(qp, s, 1e-5)


@many
@given(seed=seeds, name=st.sampled_from(sorted(SHAPES)), kind=st.sampled_from(["mixed", "soft", "equations"]))
def test_the_same_problem_again_needs_no_iteration(seed: int, name: str, kind: str) -> None:
    s, qp = solver(SHAPES[name]), drawn(np.random.default_rng(seed), SHAPES[name], kind)
    assert s.run(qp) == "OK"
    x, _mult = s.x, s.mult
    if not s["exact"]:
        return
    assert s.run(qp) == "OK"
    assert s["iterations"] == s["changes"] == 0
    np.testing.assert_allclose(s.x, x, atol=1e-9 * np.abs(x).max())
    optimal(qp, s)


def test_a_holding_set_of_control_bounds_needs_no_correction() -> None:
    s, qp = solver(SHAPES["bounds"]), drawn(np.random.default_rng(1), SHAPES["bounds"])
    for _ in range(2):
        assert s.run(qp) == "OK"
        assert s["refinements"] == 0
    assert s["iterations"] == 0
    assert np.count_nonzero(s["side"]) > 4


def test_a_shifted_working_set_is_the_prediction() -> None:
    """Shifting a time-invariant problem by a stage shifts sides and multipliers, and rows according to their source."""
    shape = Shape(4, 1, 2, ((1, 0), (2, 0), (3, 0), (4, 0)))
    s = solver(shape)
    s["side"][...] = [1, 0, -1, 0, 0, 1, 0, -1, 1, 0, -1, 0]
    s["mult"][...] = s["side"] * np.arange(1, 13)
    s.shift(2, [1, 2, 3, 3])
    np.testing.assert_array_equal(s["side"], [-1, 0, 0, 1, 0, -1, 0, -1, 0, -1, 0, 0])
    np.testing.assert_array_equal(s["mult"], [-3, 0, 0, 6, 0, -8, 0, -8, 0, -11, 0, 0])


@few
@given(seed=seeds, radius=st.sampled_from([1.05, 1.3]))
def test_unstable_dynamics(seed: int, radius: float) -> None:
    """The recursion uses feedback: growth over the horizon does not impair its accuracy."""
    rng = np.random.default_rng(seed)
    shape = Shape(60, 3, 2)
    problem = random_problem(rng, 60, 3, 2, radius=radius)
    w = solver(shape)
    qp = StageQP(problem, np.zeros((0, 5)), (), np.full(120, -30.0), np.full(120, 30.0), np.zeros(0), np.zeros(0))
    status = w.run(qp)
    if status == "OK" and np.abs(w.u).max() < 30.0:
        gaps = [w.x[k + 1] - problem.S[k] @ np.append(w.x[k], w.u[k]) - problem.b[k] for k in range(60)]
        assert np.max(np.abs(gaps)) <= 1e-13 * np.abs(w.x).max()
        assert np.abs(w.x).max() < 1e3


def contradiction(rng: np.random.Generator, shape: Shape) -> StageQP:
    """A row at the end that cannot reach its bound if all the others hold."""
    qp = drawn(rng, shape, "none active")
    assert qp.u is not None
    assert qp.x is not None
    n = qp.u.size
    lower, upper = qp.lower.copy(), qp.upper.copy()
    lower[:n], upper[:n] = qp.u.ravel() - 0.1, qp.u.ravel() + 0.1
    reach = np.zeros(shape.nx)
    for S in qp.problem.S:
        reach = np.abs(S[:, : shape.nx]) @ reach + np.abs(S[:, shape.nx :]) @ np.full(shape.nus, 0.1)
    m = len(qp.at) - 1
    lower[n + m] = qp.values(qp.x, qp.u)[n + m] + 2 * np.abs(qp.rows[m][: shape.nx]) @ reach + 0.1
    upper[n + m] = np.inf
    return dataclasses.replace(qp, lower=lower, upper=upper)


def proves(qp: StageQP, weights: np.ndarray) -> bool:
    """sum_c f_c (value of row c) does not depend on the controls, and exceeds the value that the bounds allow."""
    p, n = qp.problem, p_controls(qp)
    grad = np.zeros((p.ns + 1, p.nx + p.nu))
    for a, k, f in zip(qp.rows, qp.at, weights[n:], strict=True):
        grad[k] += f * a
    grad[:-1, p.nx :] += weights[:n].reshape(p.ns, p.nu)
    lam, constant, largest = grad[-1, : p.nx], 0.0, 0.0
    for k in range(p.ns - 1, -1, -1):
        constant += lam @ p.b[k]
        w = grad[k] + p.S[k].T @ lam
        largest = max(largest, np.abs(w[p.nx :]).max())
        lam = w[: p.nx]
    constant += lam @ p.x_0
    with np.errstate(invalid="ignore"):
        allowed = np.sum(np.where(weights == 0, 0.0, weights * np.where(weights > 0, qp.upper, qp.lower)))
    return bool(np.abs(weights).max() > 0 and largest <= 1e-9 and constant > allowed)


def p_controls(qp: StageQP) -> int:
    return qp.problem.ns * qp.problem.nu


@pytest.mark.parametrize("name", ["state bounds", "general", "terminal"])
@few
@given(seed=seeds)
def test_infeasible_problems_are_recognised_and_left_behind(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = solver(SHAPES[name])
    bad, good = contradiction(rng, SHAPES[name]), drawn(rng, SHAPES[name])
    for _ in range(2):
        assert s.run(bad) == "INFEASIBLE"
        assert proves(bad, s["certificate"].astype(float))
        assert np.all(np.isfinite(s.x))
        assert np.all(np.isfinite(s.u))
        assert s.run(good) == "OK"
        optimal(good, s)


def test_crossed_bounds_are_infeasible() -> None:
    qp = drawn(np.random.default_rng(1), SHAPES["state bounds"])
    s = solver(SHAPES["state bounds"])
    for row in (0, 5, 20):
        lower, upper = qp.lower.copy(), qp.upper.copy()
        lower[row], upper[row] = 1.5, 1.0
        assert s.run(dataclasses.replace(qp, lower=lower, upper=upper)) == "INFEASIBLE"
        assert not np.any(s["certificate"])
        assert not np.any(s.u)
    assert s.run(qp) == "OK"
    optimal(qp, s)


@many
@given(
    seed=seeds,
    name=st.sampled_from(["S", "b", "Q", "Q_N", "g", "g_N", "rows", "lower", "upper"]),
    bad=st.sampled_from([np.nan, np.inf, -np.inf]),
)
def test_data_that_are_not_finite(seed: int, name: str, bad: float) -> None:
    rng = np.random.default_rng(seed)
    good = drawn(rng, SHAPES["general"])
    owner = good if name in ("rows", "lower", "upper") else good.problem
    array = np.array(getattr(owner, name))
    index = tuple(rng.integers(array.shape))
    if name in ("Q", "Q_N"):
        i, j = np.sort(index[-2:])
        index = (*index[:-2], j, i)
    if name in ("Q", "g") and index[0] == 0:  # x_0 is given: its block has no effect
        index = (1, *index[1:])
    if name == "rows" and good.at[index[0]] == SHAPES["general"].ns:
        index = (0, index[1])
    array[index] = {"lower": abs(bad), "upper": -abs(bad)}.get(name, bad)
    if owner is good:
        wrong = dataclasses.replace(good, **{name: array})
    else:
        wrong = dataclasses.replace(good, problem=dataclasses.replace(good.problem, **{name: array}))
    s = solver(SHAPES["general"])
    for warm in (False, True):
        if warm:
            assert s.run(good) == "OK"
        assert s.run(wrong) == "NUMERICAL_FAILURE"
        assert not np.any(s.u)
        assert not np.any(s.x)
        assert not np.any(s.mult)
    assert s.run(good) == "OK"
    optimal(good, s)


def test_a_failed_factorisation_is_not_solved_with() -> None:
    qp = drawn(np.random.default_rng(2), SHAPES["bounds"])
    s = solver(SHAPES["bounds"])
    s.load(qp)
    assert s.solve(qp.problem.x_0) == "NUMERICAL_FAILURE"
    assert s.run(qp) == "OK"
    indefinite = dataclasses.replace(qp, problem=dataclasses.replace(qp.problem, Q=-qp.problem.Q))
    assert s.run(indefinite) == "NUMERICAL_FAILURE"
    assert s.solve(qp.problem.x_0) == "NUMERICAL_FAILURE"
    assert not np.any(s.u)
    assert s.run(qp) == "OK"
    optimal(qp, s)


def test_an_unbounded_problem() -> None:
    """A control without quadratic cost, bound or effect, but with a linear cost."""
    rng = np.random.default_rng(3)
    shape = SHAPES["bounds"]
    problem = random_problem(rng, shape.ns, shape.nx, shape.nus)
    problem.Q[:, -1, :] = problem.Q[:, :, -1] = 0
    problem.S[:, :, -1] = 0
    infinite = np.full(20, np.inf)
    qp = StageQP(problem, np.zeros((0, 6)), (), -infinite, infinite, np.zeros(0), np.zeros(0))
    s = solver(shape)
    assert s.run(qp) in ("NUMERICAL_FAILURE", "ITERATION_LIMIT")
    assert np.all(np.isfinite(s.u))
    lower = np.where(np.arange(20) % 2 == 1, -1.0, -np.inf)
    bounded = dataclasses.replace(qp, lower=lower, upper=-lower)
    assert s.run(bounded) == "OK"
    optimal(bounded, s)
    np.testing.assert_array_equal(s.u[:, 1], -np.sign(problem.g[:, -1]))


@few
@given(seed=seeds)
def test_a_working_set_that_is_not_found_goes_to_the_interior_point(seed: int) -> None:
    """Two working sets are allowed; the subsequent solve is exact again."""
    rng = np.random.default_rng(seed)
    s, qp = solver(SHAPES["general"], max_iterations=1), drawn(rng, SHAPES["general"], "all active")
    assert s.run(qp) == "OK"
    optimal(qp, s, 1e-8)
    near(qp, s, 1e-5)


@few
@given(seed=seeds)
def test_soft_rows_give_way(seed: int) -> None:
    """Violations are counted, and the objective cannot be improved along any direction of the controls."""
    rng = np.random.default_rng(seed)
    shape = SHAPES["general"]
    s, qp = solver(shape), drawn(rng, shape, "soft")
    assert s.run(qp) == "OK"
    assert qp.state is not None
    value = qp.values(s.x, s.u)[p_controls(qp) :]
    violation = np.maximum(value - qp.upper[p_controls(qp) :], qp.lower[p_controls(qp) :] - value)
    assert np.sum(violation > 1e-6) <= s["relaxed"] <= np.sum(violation > -1e-9)
    best = qp.objective(s.x, s.u)
    for _ in range(20):
        u = np.clip(
            s.u + 1e-3 * rng.normal(size=s.u.shape), *(b[: s.u.size].reshape(s.u.shape) for b in (qp.lower, qp.upper))
        )
        x = s.x.copy()
        for k in range(shape.ns):
            x[k + 1] = qp.problem.S[k] @ np.append(x[k], u[k]) + qp.problem.b[k]
        assert qp.objective(x, u) >= best - 1e-9 * (1 + abs(best))


def test_single_precision() -> None:
    rng = np.random.default_rng(4)
    for name in ("bounds", "state bounds"):
        s = solver(SHAPES[name], "single")
        for kind in ("mixed", "equations", "none active"):
            qp = drawn(rng, SHAPES[name], kind)
            assert s.run(qp) == "OK"
            near(qp, s, 1e-2)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", ["bounds", "general", "free"])
def test_the_template_is_cpp_too(name: str, precision: str, tmp_path: Path, need: object) -> None:
    need("cxx")  # type: ignore[operator]
    (tmp_path / "riccati.cpp").write_text(solver_source(SHAPES[name], RiccatiActiveSet(), precision))
    flags = ["-std=c++17", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror"]
    unused = ["-Wno-unused-function", "-Wno-unused-variable"]
    subprocess.run(["g++", "-fsyntax-only", *flags, *unused, "riccati.cpp"], check=True, cwd=tmp_path)


@pytest.mark.parametrize("cap", [0, -1, 1.5, True, "many"])
def test_options_check_themselves(cap: object) -> None:
    with pytest.raises(OptionError, match="max_iterations"):
        RiccatiActiveSet(max_iterations=cap)  # type: ignore[arg-type]
    assert REGISTRY["riccati_active_set"] is RiccatiActiveSet
