"""The strangers: their twins state the same problems, and their judges see what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nmpc_codegen import Status, build
from verification.strangers import house, remedies
from verification.strangers.loops import Judge, run
from verification.strangers.problems import CASES, STRANGERS, known
from verification.strangers.statement import Stranger
from verification.strangers.twin import NOMINAL, STARTS, Outcome, Twin, by_ipopt


def test_the_room_is_wide() -> None:
    strange = [s for s in STRANGERS if s not in CASES]
    assert len(strange) >= 15
    assert len({s.family for s in strange}) >= 8
    for suffix, count in (("", STARTS), (" nominal", NOMINAL)):
        assert all(len(by_ipopt()[f"{s.name}{suffix}"]) == count for s in STRANGERS)
    assert len(by_ipopt()) == 2 * len(STRANGERS)


@pytest.mark.few(4)
@pytest.mark.parametrize("name", [s.name for s in STRANGERS])
def test_the_twin_states_the_same_problem(name: str) -> None:
    """Cost and feasibility of IPOPT's plan, evaluated by the product."""
    stranger = known(name)
    twin, c = Twin(stranger), build(stranger.ocp(), stranger.options(), "test")
    x = stranger.initial(1)
    good, cost, X, U = twin.solve(x, *twin.guess(x))
    assert good
    c.x[...], c.u[...] = X, U
    assert c.cost == pytest.approx(cost, rel=1e-6, abs=1e-6)
    ends = [np.asarray(c.integrate(X[k], U[k], stranger.dt)) for k in range(stranger.N)]
    size = np.maximum(1.0, np.max(np.abs(X), axis=0))
    assert np.max(np.abs(np.array(ends) - X[1:]) / size) < 1e-6
    assert c.kkt().inequality <= 1e-5 * max(1.0, float(np.max(np.abs(X))))


@pytest.mark.parametrize("name", ["car", "storage"])
def test_a_loop_is_that_of_ipopt(name: str) -> None:
    stranger = known(name)
    (verdict,) = run(stranger, [0])
    assert verdict.lost == ""
    assert verdict.far == 0
    assert verdict.bad <= 0.05 * verdict.samples
    assert verdict.outcome.cost == pytest.approx(by_ipopt()[name][0].cost, rel=0.1, abs=0.1)


def test_the_committed_loops_are_those_of_the_twin() -> None:
    found, kept = Twin(known("fishing")).run(3), by_ipopt()["fishing"][3]
    assert found.cost == pytest.approx(kept.cost, rel=1e-4)
    assert found.distance == pytest.approx(kept.distance, abs=1e-4)


def _far(stranger: Stranger) -> float:
    twin = Twin(stranger)
    x = stranger.initial(0)
    X, U = twin.guess(x)
    for k in range(stranger.N):
        X[k + 1] = np.asarray(twin.step(X[k], U[k])).ravel()
    judge = Judge(twin)
    assert judge.residual(X, U, x, False) < 1e-9
    X[3] += 0.5 * np.max(np.abs(X), axis=0)
    return judge.residual(X, U, x, False)


def test_the_judge_sees_a_gap_and_a_row() -> None:
    assert _far(known("fishing")) > 0.1
    stranger = known("quaternion")
    twin = Twin(stranger)
    x = np.zeros(6)
    X, U = twin.guess(x)
    U[:, 0], U[:, 1] = 9.81, 1.0
    assert Judge(twin).residual(X, U, x, False) < 1e-9
    U[4, 2] = 0.5
    assert Judge(twin).residual(X, U, x, False) >= 0.25


def test_a_loop_that_is_worse_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a twin's loop that costs nothing, violates nothing and ends at the goal."""
    stranger = replace(known("drone"), reach=1e-12)
    ideal = {stranger.name: [Outcome(0.0, 0.0, 0.0, 0)] * STARTS}
    monkeypatch.setattr("verification.strangers.loops.by_ipopt", lambda: ideal)
    (verdict,) = run(stranger, [0])
    assert "from the goal" in verdict.lost
    assert verdict.statuses[Status.OK.name] > 50


@pytest.mark.filterwarnings("ignore:.*the cost has no curvature")
def test_the_house_is_heated_without_curvature_in_any_control() -> None:
    """Every sample is OK, within a hundredth of the costs of converged samples; the report names the controls."""
    controller = build(house.ocp(), house.options(), "test")
    statuses, cost = house.run(controller)
    assert statuses == {"OK": house.SAMPLES}
    assert cost == pytest.approx(house.OPTIMUM, rel=0.01)
    assert any("pump, heat[0], heat[1]" in text for text in controller.description.report.choices)
    assert any("no curvature in pump" in text for text in controller.description.report.warnings)


@pytest.mark.slow
def test_remedies_are_counted() -> None:
    """One of them is flown: without a relaxation, samples of an epidemic have no solution."""
    trial = next(t for t in remedies.TRIALS if t.failure == "INFEASIBLE" and t.where.startswith("seir"))
    (before, n), (after, m) = trial.before(), trial.after()
    assert before > 0 == after
    assert n == m
