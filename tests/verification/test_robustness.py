"""Random QPs are what they say, and an answer that is wrong is counted; so are controllers that do not recover."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from conftest import require_tool

from examples import crane
from nmpc_codegen import Controller, Options, Status, build
from verification.closed_loop import Scenario
from verification.oracles.stage_qp import StageQP, distance, row_values
from verification.oracles.stage_qp_random import condensed_rows
from verification.qp import verdicts as qps
from verification.qp.certificate import least_violation
from verification.qp.draw import CLASSES, SHAPES, draw, multipliers_of_dynamics
from verification.qp.judge import LIMITS, judge
from verification.qp.stage_package import SCALARS, SOLVERS, Answer, options, rounded, stage_ocp
from verification.robustness import episodes, returns, work
from verification.robustness.hostile import Data
from verification.robustness.subjects import Candidate, candidates
from verification.routes import PURE

FEASIBLE = tuple(kind for kind in CLASSES if kind != "infeasible")
SMALL = SHAPES.index(min(SHAPES))  # numbers that are equal to it modulo the number of shapes have the smallest shape


def small(kind: str, number: int = 0) -> StageQP:
    return draw(kind, SMALL + len(SHAPES) * number)


@functools.cache
def controller(solver: str, precision: str) -> Controller:
    require_tool("cc")
    return build(stage_ocp(SHAPES[SMALL]), options(solver, precision), profile="test")


def test_thirteen_classes() -> None:
    assert len(CLASSES) == 13


@pytest.mark.parametrize("precision", SCALARS)
@pytest.mark.parametrize("kind", FEASIBLE)
def test_built_around_an_optimum(kind: str, precision: str) -> None:
    """In the numbers that a solver gets: nothing is left of the optimality conditions but rounding."""
    for number in range(12):
        qp = draw(kind, number)
        data = rounded(qp, precision)
        assert qp.optimum is not None
        found = judge(data, qp.optimum, multipliers_of_dynamics(qp), LIMITS[precision])
        rounding = 16 * np.finfo(SCALARS[precision]).eps
        assert found.violation <= rounding
        assert found.stationarity <= rounding
        assert np.all(data.lower <= data.upper)
        assert np.all(data.lower_u <= data.upper_u)


def test_infeasible_ones_are() -> None:
    for number in range(24):
        qp = draw("infeasible", number)
        assert least_violation(qp, *condensed_rows(qp)) > 1e-8


def test_classes_have_what_they_are_named_for() -> None:
    for number in range(12):
        qp = draw("equalities in excess", number)
        assert np.sum((qp.rows.kind == 1) & (qp.lower == qp.upper)) > qp.shape.N * qp.shape.nu
        assert np.max(np.linalg.matrix_rank(draw("semidefinite", number).Q)) <= 2
        qp = draw("nearly linear", number)
        assert np.max(np.abs(qp.Q)) < 1e-4 * np.max(np.abs(qp.g))
        assert np.all(np.isfinite([qp.lower_u, qp.upper_u]))
        qp = draw("integer", number)
        assert all(np.array_equal(a, np.round(a)) for a in (qp.S, qp.b, qp.Q, qp.g, qp.C, qp.c, qp.dx0))


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_qp_reaches_the_solver(solver: str) -> None:
    """The minimiser of a well-conditioned QP is the one it was built around."""
    for number in range(20):
        qp = small("plain", number)
        found = qps.solve(controller(solver, "double"), qp, "double")
        assert found.status == Status.OK
        assert distance(qp, found.point) <= 1e-9
        assert qps.verdict_of(qp, found, "double") is None


def perturbed(found: Answer, part: str) -> Answer:
    """The answer with its largest entry moved by far more than the limits of both precisions."""
    if part == "lam":
        return dataclasses.replace(found, lam=found.lam + 0.1)
    values = getattr(found.point, part).copy()
    values.flat[np.argmax(np.abs(values))] *= 0.5
    return dataclasses.replace(found, point=dataclasses.replace(found.point, **{part: values}))


@pytest.mark.parametrize("part", ["dx", "du", "mult", "mult_u", "lam"])
@pytest.mark.parametrize("precision", SCALARS)
def test_a_wrong_answer_is_counted(part: str, precision: str) -> None:
    """The first QP of which this part is not zero; a multiplier that has nothing to say may have any value."""
    for qp in (small("plain", number) for number in range(20)):
        found = qps.solve(controller("dense", precision), qp, precision)
        if part == "lam" or np.any(getattr(found.point, part)):
            break
    assert qps.verdict_of(qp, found, precision) is None
    assert qps.verdict_of(qp, perturbed(found, part), precision) is not None
    given_up = dataclasses.replace(perturbed(found, part), status=Status.STALLED)
    assert qps.verdict_of(qp, given_up, precision) is None


def test_a_row_that_is_barely_violated_is_seen() -> None:
    """Moved out of its bound by ten times the limit it is wrong, by a tenth of it not; a NaN is wrong."""
    qp = small("plain", 1)
    assert qp.optimum is not None
    lam = multipliers_of_dynamics(qp)
    value = row_values(qp, qp.optimum.dx, qp.optimum.du)
    m = int(np.argmin(np.abs(value - qp.lower)))
    for factor, wrong in ((10.0, True), (0.1, False)):
        off = factor * LIMITS["double"] * (1 + np.max(np.abs(value)))
        for side in (1.0, -1.0):
            lower, upper = qp.lower.copy(), qp.upper.copy()
            lower[m] = value[m] + off if side > 0 else -np.inf
            upper[m] = np.inf if side > 0 else value[m] - off
            moved = dataclasses.replace(qp, lower=lower, upper=upper)
            assert (judge(moved, qp.optimum, lam, LIMITS["double"]).violation > LIMITS["double"]) is wrong
    nothing = dataclasses.replace(qp.optimum, du=np.full_like(qp.optimum.du, np.nan))
    assert judge(qp, nothing, lam, LIMITS["double"]).wrong(LIMITS["double"])


def test_rounding_at_zero_is_no_error() -> None:
    """A control at its bound 0, and nothing else that has a size: 1e-17 beside it is as good."""
    qp = small("integer", 149)
    assert qp.optimum is not None
    assert not np.any(qp.optimum.du)
    beside = dataclasses.replace(qp.optimum, du=qp.optimum.du - 1e-17)
    assert not judge(qp, beside, multipliers_of_dynamics(qp), LIMITS["double"]).wrong(LIMITS["double"])


def test_a_multiplier_of_the_wrong_sign_is_seen() -> None:
    """Stationary, but with a multiplier that pulls: no optimum."""
    qp = draw("plain", 0)
    assert qp.optimum is not None
    swapped = dataclasses.replace(qp, lower=np.full_like(qp.lower, -np.inf), upper=np.full_like(qp.upper, np.inf))
    assert np.any(qp.optimum.mult != 0.0)
    found = judge(swapped, qp.optimum, multipliers_of_dynamics(qp), LIMITS["double"])
    assert found.violation <= 1e-12
    assert found.stationarity > 1e-3


def test_replay_prints_the_data_and_the_residuals(capsys: pytest.CaptureFixture[str]) -> None:
    require_tool("cc")
    qps.replay(f"thin/{SMALL}/dense/double")
    text = capsys.readouterr().out
    assert "lower_u =" in text
    assert "answer: Verdict" in text


def test_a_row_with_a_multiplier_is_at_its_bound() -> None:
    """Eliminated states lose the digits that the nearly linear cost leaves in single precision."""
    require_tool("cc")
    qp = draw("nearly linear", 420)
    controller = build(stage_ocp(qp.shape), options("dense", "single"), profile="test")
    assert qps.verdict_of(qp, qps.solve(controller, qp, "single"), "single") is None


# Bad data -------------------------------------------------------------------------------------------------------------


@functools.cache
def subject() -> tuple[Candidate, Controller]:
    """The cart with a parameter and its default options."""
    require_tool("cc")
    chosen = next(c for c in candidates() if c.subject.name == "parameters")
    return chosen, build(chosen.subject.make(), chosen.options, profile="test")


def job(count: int) -> tuple[Controller, np.ndarray, np.ndarray, int, int]:
    chosen, controller = subject()
    number = [str(c) for c in candidates()].index(str(chosen))
    return controller.copy(), chosen.subject.rest, chosen.subject.spread, number, count


def test_combinations_cover_everything() -> None:
    chosen = candidates()
    assert len({c.subject.name for c in chosen}) >= 11
    seen = {tuple(c.label.split(", ")) for c in chosen if not c.label.startswith("chosen")}
    for place, words in enumerate((SOLVERS, SCALARS, ("Gauss-Newton", "exact"))):
        assert {label[place] for label in seen} == set(words)
    assert {label[3] for label in seen} == {f"shift {moves}" for moves in (None, "repeat", "periodic", "resample")}


def test_episodes_of_a_good_controller() -> None:
    """All data of the cart are spoilt in turn, and the controller is back each time."""
    out = episodes.run(job(60))
    assert out.episodes == out.compared == 60
    assert out.lockups == 0
    assert {"state", "plan", "reference", "weight", "parameter", "bounds"} <= set(out.recovery)


@pytest.mark.parametrize(
    ("label", "number"),
    [
        ("crane, interior, double, exact, shift repeat", 147),  # a multiplier of a state without a row is NaN
        ("unbounded, riccati, double, exact, shift repeat", 63),  # restarts with the controls that have failed
        ("general_rows, interior, double, exact, shift resample", 93),  # multipliers of 1e149 in the Hessian
    ],
)
def test_a_controller_finds_back(label: str, number: int) -> None:
    """Episodes after which controllers have stayed elsewhere."""
    require_tool("cc")
    seed, chosen = next((i, c) for i, c in enumerate(candidates()) if str(c) == label)
    controller = build(chosen.subject.make(), chosen.options, profile="test")
    out = episodes.Outcome()
    with np.errstate(all="ignore"):
        episodes.Loop(controller, chosen.subject.rest, chosen.subject.spread, seed).episode(out, number)
    assert out.episodes == out.compared == 1
    assert out.lockups == 0
    assert not out.other_solutions


def test_what_stands_at_a_solution_is_told_from_what_does_not() -> None:
    """IPOPT and the KKT residuals confirm the plan of a controller that has converged, and no other one."""
    loop = episodes.Loop(*job(0)[:4])
    peace = loop.peaceful[1]
    loop.c._memory[:] = peace.memory
    assert "in peace" in loop._other_solution(peace)
    loop.c._memory[:] = peace.memory
    loop.c.step = lambda xhat: loop.c.u[0]  # type: ignore[method-assign]
    loop.c.u[0] *= 0.9
    assert loop._other_solution(peace) == ""


def test_a_datum_that_stays_bad_is_a_lockup(monkeypatch: pytest.MonkeyPatch) -> None:
    """Data that are not restored, and a controller that is never OK again."""
    monkeypatch.setattr(Data, "restore", lambda self: None)
    out = episodes.run(job(20))
    assert sum(out.elsewhere.values()) > 0
    monkeypatch.undo()
    real = Controller.step
    monkeypatch.setattr(Controller, "step", lambda self, x: real(self, x * np.nan if self.samples_seen() else x))
    monkeypatch.setattr(
        Controller, "samples_seen", broken_after(episodes.STATES * episodes.SETTLING + 1), raising=False
    )
    out = episodes.run(job(2))
    assert out.never_ok


def broken_after(samples: int) -> object:
    """True once it has been asked so often."""
    asked = iter(range(10**6))
    return lambda self: next(asked) >= samples


def test_returns_of_a_good_controller() -> None:
    out = returns.run(job(2000))
    assert out.returns >= 2000
    assert not out.violations
    assert len(out.status) >= 4


def test_a_broken_contract_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A control that is not written, one beyond its bound, a status that does not exist."""
    out = returns.Outcome()
    u = np.array([[0.5], [np.nan], [1.1], [-1.0], [0.0]])
    out.judge(u, np.array([0, 0, 0, 2, 99]), np.array([-1.0]), np.array([1.0]))
    assert out.violations == {"control not finite": 1, "control outside its bounds": 1, "unknown status": 1}
    monkeypatch.setattr(returns.Assault, "sample", lambda self, way: 0)
    assert returns.run(job(32)).violations["control not finite"] == 32


def test_an_episode_can_be_seen_again(capsys: pytest.CaptureFixture[str]) -> None:
    chosen, _ = subject()
    episodes.replay(f"{chosen}/5", "test")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("converged")
    assert 1 + episodes.AGREED <= len(lines) - 1 <= 1 + episodes.LATER


# Work -----------------------------------------------------------------------------------------------------------------


def test_operations_of_a_recorded_loop() -> None:
    """At rest every sample costs the same; a set point that is far costs more where it comes, without bounds less."""
    require_tool("cxx")
    far, near = ((5.0, 0, 0, 0, 0), (5.0, 0, 0, 0)), ((0.0,) * 5, (0.0,) * 4)
    scenario = Scenario((0.0,) * 4, 0.3, 4, set_points=(near, far))
    loop = work.Loop("crane", lambda: crane.build_ocp(False), Options(algorithm=PURE), scenario)
    recorded = work.record(loop, 6, [])
    free = work.record(loop, 6, [0])
    counted, opened = work.count(loop, recorded, free, optimise=False)
    np.testing.assert_allclose(counted.u, recorded.u, rtol=0, atol=1e-9)
    assert np.all(counted.status == Status.OK)
    assert np.ptp(counted.operations[1:4]) == 0  # nothing is known yet of steps at the first sample
    assert counted.operations[4] > counted.operations[1] > 1000
    assert np.max(np.abs(free.u)) > 1.5 > np.max(np.abs(recorded.u))
    assert opened.operations[4] < counted.operations[4]
