"""Measurements that are not what an estimator expects: outliers, sensors that fail for a while, wrong turns."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, Observer, Options, Status, build
from verification.robustness.sensors import FAULTS, FAULTY, Verdict, cart, fly

KINDS = ("mhe", "ekf")


def observe(kind: str, loss: str = "squares", **options: Any) -> Observer:
    """An estimator of the cart whose mass is not known."""
    ocp, statement = cart()
    return build(ocp.estimator(N=8, kind=kind, loss=loss, **statement), Options(**options), "test")  # type: ignore[arg-type]


class Moving:
    """The cart itself, with its sensor."""

    def __init__(self, seed: int) -> None:
        self.x, self.u, self.k = np.array([1.0, 0.0]), 0.0, 0
        self.rng = np.random.default_rng(seed)

    def sample(self, observer: Observer, error: float = 0.0) -> Any:
        """The estimate with a measurement that is wrong by ``error``; then the cart moves on."""
        found = observer.step([self.x[0] + 0.02 * self.rng.normal() + error], [self.u])
        self.u, self.k = float(np.sin(0.2 * self.k)), self.k + 1
        for _ in range(10):
            self.x = self.x + 0.01 * np.array([self.x[1], self.u - 0.2 * self.x[1]])
        return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("loss", ["squares", "huber"])
@pytest.mark.parametrize("size", [1.0, 1e3, 1e12, 1e30])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_one_wrong_measurement_does_not_settle(kind: str, loss: str, size: float, precision: str) -> None:
    """Its own sample says so where squares are the loss; the estimate stays what it was, and the mass in its range."""
    observer, plant = observe(kind, loss, precision=precision), Moving(0)
    for k in range(60):
        found = plant.sample(observer, size if k == 30 else 0.0)
        assert (observer.status is Status.OK) == (k != 30 or loss == "huber"), observer.diagnose()
        assert 0.2 <= found[2] <= 5
        assert observer.stats.measurement == "p"
        if k == 30:
            assert observer.stats.innovation == pytest.approx(min(size / 0.025, 1e9), rel=0.4)
            assert observer.stats.error == pytest.approx(size, rel=0.2)
            if loss == "squares":
                assert 'an outlier was left out; if that happens often, state loss="huber"' in observer.diagnose()
    assert abs(found[2] - 1) < 0.2


@pytest.mark.parametrize("kind", KINDS)
def test_a_plant_that_is_put_elsewhere_is_found_again(kind: str) -> None:
    """Nobody can tell it from a sensor that fails, so it takes some samples, which are not OK."""
    observer, plant = observe(kind), Moving(1)
    for k in range(80):
        found = plant.sample(observer)
        if k == 30:
            plant.x = plant.x + np.array([50.0, 0.0])
        if 30 < k <= 41:
            assert observer.status is Status.NOT_CONVERGED
        if k == 43:
            assert "the estimate began anew, and is OK after" in observer.diagnose()
    assert observer.status is Status.OK
    assert abs(found[0] - plant.x[0]) < 0.5
    assert abs(found[2] - 1) < 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_a_parameter_stays_in_its_range_whatever_rows_are_shared(kind: str) -> None:
    ocp, statement = cart()
    for rows in (True, False):
        observer = build(ocp.estimator(N=8, kind=kind, rows=rows, **statement), None, "test")  # type: ignore[arg-type]
        rng = np.random.default_rng(0)
        for _ in range(30):
            found = observer.step([100 * rng.normal()], [rng.normal()])
            assert 0.2 <= found[2] <= 5
            assert np.all(np.isfinite(observer.covariance))


def test_an_angle_with_a_full_turn_too_much_is_named() -> None:
    ocp = OCP("wheel", T=1.0, N=10)
    angle, rate = ocp.state("angle", unit="rad"), ocp.state("rate")
    ocp.dynamics({angle: rate, rate: 0})
    stated: dict[str, Any] = {"measure": {"angle": angle, "c": ca.cos(angle)}, "noise_std": {"angle": 0.01, "c": 0.1}}
    observer = build(
        ocp.estimator(N=5, process_std={rate: 0.01}, initial_std={angle: 1, rate: 1}, **stated), None, "test"
    )
    for k in range(40):
        turned = 0.2 * k
        observer.step({"angle": (turned + np.pi) % (2 * np.pi) - np.pi})
        if k == 15:
            assert observer.status is Status.OK
        if k == 16:
            assert "1 full turn of an angle: unwrap it before step()" in observer.diagnose()


def test_noise_that_is_larger_than_declared_is_told() -> None:
    """Five times: no sample of its own is an outlier for sure, all together are."""
    observer, plant = observe("mhe"), Moving(2)
    rng, statuses = np.random.default_rng(3), []
    for _ in range(120):
        plant.sample(observer, 0.1 * rng.normal())
        statuses.append(observer.status)
        if observer.status is Status.NOT_CONVERGED and "larger noise_std" in observer.diagnose():
            break
    assert Status.NOT_CONVERGED in statuses
    assert "larger noise_std" in observer.diagnose()


@pytest.mark.few(3)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("plant", FAULTY)
def test_sensors_that_fail_for_a_while(plant: str, kind: str) -> None:
    """No estimate is OK that is wrong, and two windows later all is well; no alarm where nothing has failed."""
    stated = FAULTY[plant]
    observer = build(stated.estimator(kind=kind), None, "test")
    found = {name: fly(stated, observer, fault, 3) for name, fault in FAULTS.items()}
    assert found == dict.fromkeys(FAULTS, Verdict("", 0))


def test_a_filter_that_believes_everything_would_fail() -> None:
    """The judgement of the fuzz sees an estimate that follows a sensor that is wrong."""
    plant = FAULTY["cart"]
    believed = build(plant.estimator(kind="ekf"), None, "test")

    class Blind:
        """An observer whose status is always OK."""

        status = Status.OK

        def __getattr__(self, name: str) -> Any:
            return getattr(believed, name)

    assert "OK with an error" in fly(plant, Blind(), FAULTS["biased"], 0).wrong  # type: ignore[arg-type]
