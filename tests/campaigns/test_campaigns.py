"""Flights of a campaign are functions of their number: in any parts, by any workers, again and again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from nmpc_codegen import ControllerError, build
from nmpc_codegen.campaigns import Box, Campaign, Normal, Uniform, campaign
from nmpc_codegen.campaigns.flying import work
from nmpc_codegen.campaigns.flying.fly import Flyer
from nmpc_codegen.campaigns.stated.distributions import Points
from tests.campaigns.problems import cart, point

#: What does not depend on the clock.
COLUMNS = ("number", "start", "drawn", "samples", "ended", "failed", "broken", "cost", "violation", "last")
TABLE = np.where(np.arange(30) < 10, 0.0, 0.3)

VARIANTS: dict[str, dict[str, Any]] = {
    "defaults": {},
    "everything": {
        "starts": {"p": Box(0.2, 1.8), "v": Normal(0.1)},
        "parameters": {"m": Normal(0.05), "wind": np.linspace(-0.2, 0.2, 40)[:, None]},
        "known": {"goal": TABLE[None] * np.linspace(0, 0.6, 40)[:, None]},
        "references": {"v": Box(-0.05, 0.05), "F": TABLE},
        "disturbance": {"v": 0.02},
        "noise": Uniform(0.01),
        "added": 0.01 * np.sin(np.arange(60)).reshape(30, 2),
        "steps": 30,
        "seed": 7,
    },
    "arrays": {
        "starts": np.random.default_rng(0).uniform([0, -0.2], [1.5, 0.2], (40, 2)),
        "added": 0.01 * np.random.default_rng(1).normal(size=(40, 20, 2)),
        "references": np.tile([0.1, 0.0, 0.0], (20, 1)),
        "known": {"goal": 0.05},
        "steps": 20,
    },
    "quasi-random": {"sets": 5, "seed": 3, "noise": 0.01},
}


def equal(a: Campaign, b: Campaign) -> None:
    """All that does not depend on the clock is equal to the bit."""
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(a.flown, name), getattr(b.flown, name), err_msg=name)
    np.testing.assert_array_equal(a.reasons, b.reasons)


@pytest.mark.parametrize("name", VARIANTS)
def test_replays_are_the_flights(name: str) -> None:
    """simulate(), which shares no loop with the compiled one, has the same states and statuses to the bit."""
    result = campaign(cart(), 40, **VARIANTS[name])
    for number in (0, 17, 39):
        log, again = result.replay(number), result._with_samples(number)
        np.testing.assert_array_equal(log.x, again.x[0])
        np.testing.assert_array_equal(log.u, again.u[0])
        np.testing.assert_array_equal(log.x[-1], result.flown.last[number])
        np.testing.assert_array_equal(log.x[0], result.flown.start[number])
        counts = [int(np.sum(log.status == i)) for i in range(result.flown.samples.shape[1])]
        assert counts == result.flown.samples[number].tolist()


def test_replays_of_another_plant_and_of_rates() -> None:
    plant = build(cart(), name="true_cart")
    words: dict[str, Any] = {"parameters": {"m": Box(0.6, 1.8)}, "known": {"goal": Box(-0.1, 0.1)}, "steps": 25}
    for ocp, more in ((cart(), {"plant": plant}), (cart(rate=True), {})):
        result = campaign(ocp, 10, **words, **more)
        for number in (0, 9):
            np.testing.assert_array_equal(result.replay(number).x[-1], result.flown.last[number])


@pytest.mark.parametrize("name", VARIANTS)
def test_parts_do_not_matter(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = campaign(cart(), 40, **VARIANTS[name])
    monkeypatch.setattr(work, "FIRST", 3)
    monkeypatch.setattr(work, "MOST", 7)
    equal(whole, campaign(cart(), 40, **VARIANTS[name]))


def test_more_flights_begin_with_the_same() -> None:
    few, many = campaign(cart(), 10, noise=0.01), campaign(cart(), 30, noise=0.01)
    np.testing.assert_array_equal(few.flown.last, many.flown.last[:10])
    other = campaign(cart(), 10, noise=0.01, seed=1)
    assert not np.any(other.flown.start[:, 0] == few.flown.start[:, 0])


def test_what_is_drawn() -> None:
    """Uniform and normal, independent, as SciPy has them."""
    result = campaign(cart(), 4000, starts={"p": Box(-1, 2), "v": Normal(0.3)}, parameters={"m": Box(0.5, 1)}, steps=1)
    drawn = np.column_stack([result.flown.start, result.flown.drawn])
    assert result.flown.labels.drawn == ("plant.m", "known.goal")
    expected = stats.uniform(-1, 3), stats.norm(0, 0.3), stats.uniform(0.5, 0.5), stats.uniform(-0.2, 0.4)
    for values, known in zip(drawn.T, expected, strict=True):
        assert stats.kstest(values, known.cdf).pvalue > 1e-3
    assert np.max(np.abs(np.corrcoef(drawn.T) - np.eye(4))) < 0.06


def test_quasi_random_points() -> None:
    points = Points(5, 3, sets=4, length=16)
    whole = points.at(0, 64)
    sobol = qmc.Sobol(3, rng=np.random.default_rng([5, 2])).random(16)
    np.testing.assert_allclose(whole[32:48], sobol, atol=1e-15)
    np.testing.assert_array_equal(points.at(13, 30), whole[13:43])
    assert qmc.discrepancy(whole[:16]) < qmc.discrepancy(Points(5, 3).at(0, 16))


def test_what_is_flown_without_a_word() -> None:
    """Ranges where there are some: starts by ``initial_range`` or a tenth of the bounds; parameters of the model differ
    from those of the controller, others are known to it."""
    result = campaign(cart(), 500)
    start, (mass, goal) = result.flown.start, result.flown.drawn.T
    assert result.job.statement.steps == 50
    assert 0.5 <= start[:, 0].min() < 0.52 < 1.48 < start[:, 0].max() <= 1.5
    assert 0.055 < np.abs(start[:, 1]).max() <= 0.06
    assert 0.5 <= mass.min() < 0.55 < 1.9 < mass.max() <= 2.0
    assert np.abs(goal).max() <= 0.2
    np.testing.assert_allclose(result.flown.last[:, 0], goal, atol=0.05)  # which the controllers know
    near = campaign(point(), 100)
    assert 0.18 < np.abs(near.flown.start - 1).max() <= 0.2


def test_statuses_and_costs_are_those_of_the_batch() -> None:
    result = campaign(cart(), 25, noise=0.01)
    s = result.job.statement
    flights = Flyer(result.job, 1).simulate(s.data(0, 25, s.given), 0, record=True)
    np.testing.assert_array_equal(result.flown.cost, flights.cost)
    np.testing.assert_array_equal(result.flown.ended, flights.status[:, -1])
    assert (result.flown.seconds[:, 1] >= result.flown.seconds[:, 0]).all()
    assert (result.flown.seconds > 0).all()


def test_a_table_has_the_verdicts(tmp_path: Any) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    result = campaign(cart(), 25, noise=0.01, progress=False)
    frame = result.to_dataframe()
    np.testing.assert_array_equal(frame["cost"], result.flown.cost)
    assert (frame["reason"] != "NONE").tolist() == result.lost.tolist()
    assert set(result.flown.labels.drawn) <= {f"{kind}.{name}" for kind, name in frame.columns}
    result.to_parquet(tmp_path / "cart.parquet")
    flat = pandas.read_parquet(tmp_path / "cart.parquet")
    assert flat["number"].tolist() == list(range(25))
    assert flat["reason"].tolist() == frame["reason"].tolist()


WRONG: tuple[tuple[dict[str, Any], str], ...] = (
    ({"flights": 0}, "flights is 0"),
    ({"steps": 0}, "steps is 0"),
    ({"seed": -1}, "seed is -1"),
    ({"flights": 10, "sets": 3}, "divides the 10 flights"),
    ({"starts": {"q": Box(0, 1)}}, "no 'q'"),
    ({"starts": Box(1, 0)}, "expected lower <= upper"),
    ({"starts": {"p": Box(0, np.nan)}}, "p"),
    ({"starts": np.zeros((3, 2)), "flights": 4}, "starts"),
    ({"starts": Normal(-1)}, "standard deviations >= 0"),
    ({"parameters": {"x": 1}}, "no 'x'"),
    ({"parameters": {"m": Box(0.1, 1)}}, "its bounds are 0.5, 2"),
    ({"parameters": {"m": 1.0}, "known": {"m": [1.0], "goal": "a"}}, "goal"),
    ({"parameters": {"wind": np.zeros((3, 4))}}, "flights first"),
    ({"references": {"q": 1}}, "no 'q'"),
    ({"disturbance": {"q": 1}}, "q"),
    ({"added": np.zeros((3, 2))}, "added"),
    ({"success": "home"}, "set point"),
    ({"success": {"q": 1}}, "no state 'q'"),
    ({"success": {"p": 0.1}}, "reference of a residual"),
    ({"success": lambda flown: 1}, "True or False"),
    ({"tolerance": {"q": 1}}, "no row 'q'"),
    ({"against": "best"}, "against"),
    ({"compared": 5}, "with against="),
    ({"against": "solve", "compared": 0}, "compared is 0"),
    ({"folder": 3}, "folder is 3"),
    ({"tolerance": 0.1}, "tolerance is 0.1"),
    ({"tolerance": {"wall": -1}}, "'wall'"),
    ({"tolerance": {"wall": np.nan}}, "'wall'"),
    ({"parameters": [("m", 1)]}, "parameters is"),
    ({"parameters": {"m": np.linspace(0.6, 1, 10)}}, "a table over samples"),
    ({"device": "tpu"}, "device"),
    ({"plant": 3}, "plant"),
    ({"executor": 3}, "submit"),
)


@pytest.mark.parametrize(("words", "text"), WRONG, ids=[str(i) for i in range(len(WRONG))])
def test_wrong_arguments(words: dict[str, Any], text: str) -> None:
    with pytest.raises(ControllerError, match=text):
        campaign(cart(), **{"flights": 10, **words})


def test_true_and_believed_values_of_a_parameter() -> None:
    """Plants have what parameters= says, controllers what known= says; a plant of another package has its own names."""
    both = campaign(cart(), 20, parameters={"m": Box(1.5, 2.0)}, known={"m": Box(0.6, 0.7)}, steps=20)
    assert {"plant.m", "known.m"} <= set(both.flown.labels.drawn)
    m = both.flown.drawn[3, both.flown.labels.drawn.index("plant.m")]
    plant = build(cart())
    plant.set_parameter("m", m)
    log = both.replay(3)
    np.testing.assert_allclose(plant.integrate(log.x[0], log.u[0], 0.25), log.x[1], atol=1e-12)
    windy = cart()
    windy.parameter("drag", value=0.0)
    richer = build(windy, name="richer")
    named = campaign(cart(), 10, plant=richer, parameters={"drag": Box(0, 1)}, steps=5)
    assert "plant.drag" in named.flown.labels.drawn


def test_normal_numbers_stay_within_bounds() -> None:
    result = campaign(cart(), 2000, parameters={"m": Normal(1.0)}, steps=1)
    m = result.flown.drawn[:, result.flown.labels.drawn.index("plant.m")]
    known = stats.truncnorm(-0.5, 1.0, 1.0, 1.0)
    assert stats.kstest(m, known.cdf).pvalue > 1e-3
    assert 0.5 <= m.min() < m.max() <= 2.0


def test_success_is_judged_on_all_flights_together(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """Whatever the parts, and whether they are kept."""
    words: dict[str, Any] = {"success": lambda flown: flown.cost <= np.median(flown.cost)}
    whole = campaign(cart(), 60, **words)
    monkeypatch.setattr(work, "MOST", 7)
    equal(whole, campaign(cart(), 60, folder=tmp_path, **words))
    assert whole.lost.sum() == 30
