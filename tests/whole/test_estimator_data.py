"""Estimators whose plants have parameters that change or are unknown, and data far from what is expected."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, ControllerError, Options, Status, build, simulate


def test_an_unknown_parameter_is_a_state_of_the_estimator() -> None:
    """A constant, too; the others stay parameters, of which the past keeps its values."""
    ocp = OCP("tank", T=2.0, N=20)
    h, q = ocp.state("h", initial=1.0), ocp.control("q")
    leak, area = ocp.parameter("leak", value=0.1), ocp.parameter("area", value=2.0)
    ocp.dynamics({h: (q - leak * h) / area})
    observer = build(ocp.estimator(N=6, measure={"h": h}, noise_std={"h": 1e-3}, process_std={leak: 0.0}), None, "test")
    assert observer.names.states == ("h", "leak")
    assert observer.names.parameters == ("area",)
    x = 1.0
    for k in range(60):
        wide = 2.0 if k < 30 else 3.0
        observer.set_parameter("area", wide)
        estimated = observer.step([x], [0.5])
        for _ in range(100):
            x += 1e-3 * (0.5 - 0.25 * x) / wide
        assert observer.status is Status.OK
    np.testing.assert_allclose(estimated[1], 0.25, atol=1e-3)


@pytest.mark.parametrize("kind", ["mhe", "ekf"])
def test_known_parameters_that_change_act_when_they_hold(kind: Any) -> None:
    """In the measurement of their sample, and in the interval behind it; reset() keeps the present ones."""
    ocp = OCP("gain", T=1.0, N=5)
    x, u = ocp.state("x", initial=1.5), ocp.control("u")
    g, d = ocp.parameter("g", value=1.0), ocp.parameter("d", bounds=(-9, 9))
    ocp.dynamics({x: u + d})
    ocp.least_squares(ca.vertcat(x, u), weight=[1, 0.001], reference=[2, 0])
    stated: dict[str, Any] = {"measure": {"y": g * x}, "noise_std": {"y": 0.01}, "initial_std": {x: 1e-3}}
    observer, k = build(ocp.estimator(N=5, kind=kind, **stated), None, "test"), np.arange(15)
    given: dict[str, Any] = {"estimator": observer, "seed": None, "parameters": {"g": 1.0 + k % 4, "d": np.sin(k)}}
    for _ in range(2):  # the second loop begins anew
        log = simulate(build(ocp, None, "test"), [1.5], 15, **given)
        assert log.estimates is not None
        assert not log.estimates.status.any()
        np.testing.assert_allclose(log.estimates.x, log.x[:15], atol=1e-9)
    observer.reset()
    np.testing.assert_allclose(observer.step([3.0 * 1.5], [0.0]), 1.5, atol=1e-9)
    with pytest.raises(ControllerError, match=r"parameter 'd': 10 is outside of -9 .. 9"):
        observer.set_parameter("d", 10.0)
    with pytest.raises(ControllerError, match="parameters hold from the next sample on"):
        observer.set_parameter("d", 1.0, node=0)


def test_bounds_of_unknown_parameters() -> None:
    """They are rows of the estimator, and what the controller is told is inside them."""
    ocp = OCP("tank", T=10.0, N=10)
    h, q = ocp.state("h", initial=1.0), ocp.control("q")
    c = ocp.parameter("c", value=0.2, bounds=(0, 1))
    ocp.dynamics({h: q - c * h})
    ocp.least_squares(ca.vertcat(h, q), weight=[1, 0.1], reference=[1, 0.2])
    ocp.subject_to(0, q, 2)
    stated: dict[str, Any] = {"process_std": {h: 0.02, c: 0.01}, "initial_std": {h: 0.1, c: 0.3}}
    for kind in ("mhe", "ekf"):
        observer = build(ocp.estimator(N=10, kind=kind, measure={"h": h}, noise_std={"h": 0.1}, **stated), None, "test")
        log = simulate(build(ocp, None, "test"), [1.0], 60, estimator=observer, parameters={"c": np.full(60, 0.02)})
        assert log.ok
        assert log.p.min() >= 0
        assert observer.names.rows == ("c",)


@pytest.mark.parametrize("kind", ["mhe", "ekf"])
def test_a_huge_measurement_is_forgotten(kind: Any) -> None:
    """Its sample is not OK, or the estimate is right again after some others; nothing stays poisoned."""
    ocp = OCP("reactor", T=2.0, N=20)
    c, T, Tc = ocp.state("c", initial=0.8), ocp.state("T", initial=330.0), ocp.control("Tc")
    r = 7.2e10 * ca.exp(-8750 / T) * c
    ocp.dynamics({c: (1 - c) - r, T: (350 - T) + 209.2 * r + 2.09 * (Tc - T)})
    stated: dict[str, Any] = {"process_std": {"c": 0.01, "T": 0.2}, "initial_std": {"c": 0.3, "T": 5}}
    observer = build(ocp.estimator(N=10, kind=kind, measure={"T": T}, noise_std={"T": 0.3}, **stated), None, "test")
    statuses = []
    for k in range(70):
        found = observer.step([500.0 if k == 30 else 350.0], [300.0])
        statuses.append(observer.status)
        assert np.all(np.abs(found) < 1e15)
        assert np.all(np.isfinite(observer.covariance))
    assert statuses[:30] == [Status.OK] * 30
    assert statuses[-20:] == [Status.OK] * 20
    assert abs(found[1] - 350) < 1


def test_a_start_that_is_hardly_known() -> None:
    """The arrival cost of directions that nothing tells is lost in rounding only beyond a ratio of 1e7."""
    ocp = OCP("diffuse", T=1.0, N=10)
    x = ocp.state("x", size=2)
    ocp.dynamics({x: ca.vertcat(x[0] + 0.1 * x[1], x[1])}, discrete=True)
    ranges: tuple[tuple[Any, float], ...] = (("double", 1e5), ("single", 20.0))
    for precision, wide in ranges:
        stated: dict[str, Any] = {"measure": {"y": x[0]}, "noise_std": {"y": 0.1}, "process_std": {x: [0, 0.01]}}
        pair = [
            build(ocp.estimator(N=5, kind=kind, **stated, initial_std={x: wide}), Options(precision=precision), "test")
            for kind in ("mhe", "ekf")
        ]
        rng = np.random.default_rng(0)
        for k in range(30):
            y = [3 + 0.2 * k + 0.1 * rng.normal()]
            window, filter_ = (observer.step(y) for observer in pair)
        assert np.max(np.abs(window - filter_) / pair[1].std) < 0.05
