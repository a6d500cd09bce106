"""Verdicts against samples that are judged here, intervals against the binomial distribution, pictures."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from nmpc_codegen import ControllerError, Options, RealTimeIteration, build, simulate
from nmpc_codegen.campaigns import Box, Campaign, Reason, campaign
from nmpc_codegen.campaigns.flying.fly import Flyer
from nmpc_codegen.campaigns.judging.verdict import interval_of_share
from nmpc_codegen.runtime.loops.flown import Flown
from tests.campaigns.problems import cart, point

ROUGH = {"added": np.where(np.arange(40)[:, None] == 20, [0.0, 0.8], 0.0), "steps": 40}


@pytest.fixture(scope="module")
def rough() -> Campaign:
    """Flights that a gust pushes, some of them through the wall."""
    return campaign(cart(), 300, success={"p": Box(-0.3, 0.12)}, parameters={"m": Box(0.5, 2.0)}, **ROUGH)


def test_reasons_are_those_of_the_samples(rough: Campaign) -> None:
    s = rough.job.statement
    x = Flyer(rough.job, 2).simulate(s.data(0, 300, s.given), 0, record=True).x
    assert x is not None
    wall = np.maximum(-1 - (x[:, 1:, 0] + 0.3 * x[:, 1:, 1]), x[:, 1:, 0] + 0.3 * x[:, 1:, 1] - 2).max(axis=1)
    np.testing.assert_allclose(rough.flown.violations("wall"), np.maximum(0, wall), atol=1e-12)
    limit = rough.rules.allowed[rough.flown.labels.rows.index("wall")]
    assert 0.005 < limit < 0.05
    arrived = (x[:, -1, 0] >= -0.3) & (x[:, -1, 0] <= 0.12)
    expected = np.where(wall > limit, Reason.ROW, np.where(~arrived, Reason.NOT_ARRIVED, Reason.NONE))
    np.testing.assert_array_equal(rough.reasons, expected)
    assert 0 < np.sum(rough.reasons == Reason.NOT_ARRIVED) < 300
    assert rough.share == np.mean(expected != 0)


def test_set_points_and_tolerances() -> None:
    """References that are drawn, tables, declared ones; rows that are soft, and rows that may be broken."""
    for references in ({"x": Box(-0.5, 0.5)}, {"x": np.where(np.arange(30) < 29, 0.0, 0.3)}, None):
        near = campaign(point(), 50, references=references, success={"x": 0.02}, steps=30)
        goal = near.flown.drawn[:, 0] if near.flown.labels.drawn else np.full(50, 0.3 if references else 0.0)
        np.testing.assert_array_equal(near.lost, np.abs(near.flown.last[:, 0] - goal) > 0.02)
        assert near.lost.all() == isinstance(references, dict) * (len(near.flown.labels.drawn) == 0)
    wide = campaign(point(), 50, success="set point", steps=30)
    assert not wide.lost.any()
    strict = campaign(cart(), 50, tolerance={"v": 0.0, "wall": np.inf}, **ROUGH)
    soft = [j for j, name in enumerate(strict.flown.labels.rows) if name == "v"]
    np.testing.assert_array_equal(strict.lost, (strict.flown.violation[:, soft] > 0).any(axis=1))
    assert strict.lost.any()


def test_states_that_are_not_finite_and_failures_at_the_end() -> None:
    """Hand-made flights: each reason, the first one that holds; the order of the worst."""
    result = campaign(point(), 6, success=lambda flown: flown.final("x") < 5)
    f: Flown = result.flown
    ended, broken = f.ended.copy(), f.broken.copy()
    violation, last, cost = f.violation.copy(), f.last.copy(), np.arange(6.0)
    ended[0], broken[1], last[2, 0], violation[3, 0], violation[4, 0] = 3, 7, 9.0, np.nan, 0.5
    made = replace(f, ended=ended, broken=broken, violation=violation, last=last, cost=cost)
    reasons = result.rules.judge(made, np.zeros((6, 0)))
    R = Reason
    assert reasons.tolist() == [R.ENDS_FAILING, R.NOT_FINITE, R.NOT_ARRIVED, R.ROW, R.ROW, R.NONE]
    at_once = replace(made, broken=np.where(broken == 7, 0, broken))
    assert result.rules.judge(at_once, np.zeros((6, 0)))[1] == R.NOT_FINITE
    other = replace(result, flown=made, reasons=reasons)
    assert other.worst(6) == [1, 3, 4, 2, 0, 5]
    assert "after sample 7" in other.verdict(1)
    assert "the last sample failed" in other.verdict(0)
    said = str(other)
    assert "1: the state was not finite" in said
    assert "not known in 1" in said


def test_a_flight_that_is_not_finite_replays_up_to_there() -> None:
    """A state that doubles in every sample, and is lost for a controller that can do little about it."""
    import casadi as ca

    from nmpc_codegen import OCP

    ocp = OCP("unstable", T=1.0, N=4)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: x**3 + u})
    ocp.least_squares(ca.vertcat(x, u), [1.0, 0.1])
    ocp.subject_to(-0.1, u, 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = campaign(ocp, 5, starts={"x": Box(0.9, 2.0)}, steps=20)
    assert (result.reasons == Reason.NOT_FINITE).all()
    number = result.worst(1)[0]
    broken = int(result.flown.broken[number])
    log = result.replay(number)
    assert len(log.u) == broken == result.flown.broken.min()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        compared = campaign(ocp, 5, starts={"x": Box(0.9, 2.0)}, steps=20, against="solve")
    assert np.isnan(compared.losses).all()
    np.testing.assert_array_equal(log.x, result._with_samples(number).x[0, : broken + 1])  # type: ignore[index]


@pytest.mark.parametrize(("lost", "flights"), [(0, 10), (3, 100), (50, 60), (10, 10)])
def test_the_interval_is_that_of_clopper_and_pearson(lost: int, flights: int) -> None:
    """At its ends, so many or fewer, or so many or more, have a probability of 2.5 %."""
    low, high = interval_of_share(np.arange(flights) < lost)
    assert low == 0 if lost == 0 else binom.sf(lost - 1, flights, low) == pytest.approx(0.025)
    assert high == 1 if lost == flights else binom.cdf(lost, flights, high) == pytest.approx(0.025)


def test_the_interval_of_sets_covers() -> None:
    """Sets of a share of 0.3: 95 % of the intervals hold it."""
    random, covered = np.random.default_rng(4), 0
    for _ in range(300):
        lost = random.uniform(size=800) < 0.3
        low, high = interval_of_share(lost, np.arange(800) // 100)
        covered += low <= 0.3 <= high
    assert 0.9 < covered / 300 <= 0.99


def test_reference_loops() -> None:
    """By solve(): the cost of simulate(law="solve"), summed here. By IPOPT: nearly the same."""
    ocp = cart()
    result = campaign(ocp, 6, against="solve", compared=3, parameters={"m": 1.2}, known={"goal": 0.1}, steps=30)
    assert result.best is not None
    assert np.isnan(result.best[3:]).all()
    c = build(ocp)
    c.set_parameter("goal", 0.1)
    plant = c.copy()
    plant.set_parameters(m=1.2)
    log = simulate(c, result.flown.start[0], 30, plant=plant.integrate, law="solve")
    y = np.column_stack([log.x[:-1, 0] - 0.1, log.x[:-1, 1], log.u])
    assert result.best[0] == pytest.approx(0.5 * np.sum(y**2 * [1, 0.1, 0.01]), rel=1e-9)
    assert np.abs(result.losses[:3]).max() < 0.01
    assert "cost of 3 flights beside loops with solve() in every sample" in str(result)
    same = {"parameters": {"m": 1.2}, "known": {"goal": 0.1}, "steps": 30}
    ipopt = campaign(ocp, 6, against="ipopt", compared=1, **same)
    assert ipopt.best is not None
    assert ipopt.best[0] == pytest.approx(result.best[0], rel=1e-5)
    same |= {"references": {"v": 0.3}}  # of the end, too
    found = [campaign(ocp, 1, against=law, compared=1, **same).best for law in ("solve", "ipopt")]
    assert found[1][0] == pytest.approx(found[0][0], rel=1e-5)


def test_a_poor_controller_is_found() -> None:
    """With one iteration, without relaxation and shift it does worse; the same flights."""
    poor = Options(algorithm=RealTimeIteration(shift=None, iterations=1, relaxation=None))
    good, bad = campaign(cart(), 100, **ROUGH), campaign(cart(), 100, poor, **ROUGH)
    np.testing.assert_array_equal(good.flown.start, bad.flown.start)
    assert np.median(bad.flown.cost) > np.median(good.flown.cost)


def test_pictures_and_words(rough: Campaign, tmp_path: Path) -> None:
    for name, plot in (("a", rough.plot), ("b", rough.plot_distributions), ("c", rough.plot_lost)):
        plot(tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    low, high = rough.interval
    assert f"lost: {rough.lost.sum()}" in str(rough)
    assert repr(rough).startswith("<Campaign cart: ")
    assert low < rough.share < high
    found = rough.as_dict()
    assert found["lost"] == rough.lost.sum()
    assert sum(found["reasons"].values()) == found["lost"]
    with pytest.raises(ControllerError, match="number of a flight"):
        rough.replay(300)
    for wrong in (0, 1, -1, float("nan")):
        with pytest.raises(ControllerError, match="between 0 and 1"):
            rough.interval_at(wrong)
    with pytest.raises(ControllerError, match="worst"):
        rough.worst(-1)
    late = next(int(n) for n in rough.flown.number if rough.reasons[n] == Reason.NOT_ARRIVED)
    assert "p is " in rough.verdict(late)
    assert "not within -0.3 .. 0.12" in rough.verdict(late)


def test_what_is_allowed_follows_from_the_bound() -> None:
    """Of an obstacle whose squared distance becomes large: a hundredth of its bound, not of the distance."""
    import casadi as ca

    from nmpc_codegen import OCP

    ocp = OCP("far", T=1.0, N=4)
    x, y, u = ocp.state("x", initial=-20.0), ocp.state("y"), ocp.control("u", size=2)
    ocp.dynamics({x: 10 * u[0], y: u[1]})
    ocp.least_squares(ca.vertcat(x, y, u), [1, 1, 1, 1])
    ocp.subject_to(2.25, x**2 + (y - 1) ** 2, np.inf, name="obstacle")
    ocp.subject_to(-1, u, 1)
    result = campaign(ocp, 2, steps=2)
    assert result.rules.allowed[result.flown.labels.rows.index("obstacle")] == pytest.approx(0.0225)
