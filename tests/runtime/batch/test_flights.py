"""Flights: the bits of simulate(), whatever the threads and blocks; summaries against the samples."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from nmpc_codegen import (
    OCP,
    AugmentedLagrangian,
    Batch,
    Controller,
    ControllerError,
    Online,
    Options,
    Status,
    Uniform,
    build,
    simulate,
)
from tests.runtime.batch.problems import N, car, reactor

Array = NDArray[np.float64]
F, STEPS = 20, 14
RNG = np.random.default_rng(3)
X0 = np.array([1.0, 0.0, 0.0, 0.0]) + 0.2 * RNG.normal(size=(F, 4))
MASSES = RNG.uniform(0.8, 1.2, (F, 1))
TRACKS = 0.3 * RNG.normal(size=(F, 12))
GAINS = RNG.uniform(0.1, 0.5, (F, 9, 2))

VARIANTS: dict[str, tuple[OCP, Options]] = {
    "by node": (car(), Options(online=Online(parameter="node", reference="node"))),
    "shared": (car(scaled=True), Options(online=Online(parameter="shared", reference="shared"))),
    "single": (car(), Options(precision="single")),
    "time and rate": (car(rate=True, time=True), Options()),
    "augmented Lagrangian": (car(), Options(algorithm=AugmentedLagrangian())),
}


def replay(ctrl: Controller, flights: Any, i: int) -> tuple[float, float]:
    """Fly flight i by calls of single controllers; return its cost and the violation of its soft row."""
    plant, x, cost, violation, dt = ctrl.copy(), X0[i].copy(), 0.0, 0.0, 0.25
    by_node = ctrl.description.online["parameter"] == "node"
    for k in range(STEPS):
        ahead, gains = np.minimum(k + np.arange(N + 1), 11), np.minimum(k + np.arange(N + 1), 8)
        now = TRACKS[i, min(k, 11)]
        ctrl.set_parameters(m=MASSES[i, 0], k=GAINS[i, gains if by_node else gains[0]])
        ctrl.set_reference({"p": TRACKS[i, ahead] if ctrl.description.online["reference"] == "node" else now})
        plant.set_parameters(m=MASSES[i, 0], k=[GAINS[i, gains[0], 0], 0.3])
        u = ctrl.step(x + flights.noise(i)[k])
        assert ctrl.status == flights.status[i, k]
        np.testing.assert_array_equal(u, flights.u[i, k])
        scale = 0.25 if any(ctrl.description.program.scaled) else 1.0
        error = np.concatenate([x, u]) - [now, 0, 0, 0, 0]
        cost += 0.5 * scale * float(np.sum(error**2 * [1, 1, 0.1, 0.1, 0.1]))
        if ctrl.description.inner.time:
            cost += 0.01 * np.sin(k * dt) * x[1] * dt
        violation = max(violation, x[0] ** 2 + x[1] - 1.2)
        if plant.known.size:
            plant.known[...] = ctrl.known
        x = plant.integrate(x, u, dt).astype(np.float64) + flights.disturbance(i)[k]
        np.testing.assert_array_equal(x, flights.x[i, k + 1])
    return cost, violation


@pytest.mark.parametrize("name", VARIANTS)
def test_a_flight_is_a_loop_of_single_calls(name: str) -> None:
    ctrl = build(*VARIANTS[name], "test")
    task: dict[str, Any] = {
        "parameters": {"m": MASSES, "k": GAINS},
        "references": {"p": TRACKS},
        "disturbance": 0.01,
        "noise": Uniform({"v": 0.02}),
        "plant_parameters": {"k[1]": 0.3},
        "seed": 5,
    }
    many = Batch(ctrl, F, 2)
    flights = many.simulate(X0, STEPS, record=True, **task)
    row = flights.rows.index("curve")
    for i in (0, 7, F - 1):
        twin = ctrl.copy()
        cost, violation = replay(twin, flights, i)
        np.testing.assert_array_equal(many[i]._memory, twin._memory)
        rounding = 1e-6 if ctrl.description.precision == "single" else 1e-12
        np.testing.assert_allclose(flights.cost[i], cost, rtol=rounding)
        np.testing.assert_allclose(flights.violation[i, row], violation, atol=rounding)
    assert (flights.violation[:, row] > 0).any()
    again = Batch(ctrl, 1, 1).simulate(X0, STEPS, **task)
    for part in ("status_counts", "failed", "lost", "cost", "violation", "last"):
        np.testing.assert_array_equal(getattr(again, part), getattr(flights, part))
    later = Batch(ctrl, 1, 3).simulate(X0[5:9], STEPS, first=5, **{**task, **of_some(slice(5, 9))})
    np.testing.assert_array_equal(later.last, flights.last[5:9])
    np.testing.assert_array_equal(flights.last, flights.x[:, -1])
    assert repr(flights).startswith("<Flights car: 20 of 14 samples, ")
    assert "row 'curve': violated in" in flights.summary()


def of_some(some: slice) -> dict[str, Any]:
    return {"parameters": {"m": MASSES[some], "k": GAINS[some]}, "references": {"p": TRACKS[some]}}


def test_a_flight_is_a_log_of_simulate() -> None:
    """Without data that change, with a longer sample than an interval, and disturbances that are given."""
    ctrl = build(car(), None, "test")
    given = 0.01 * RNG.normal(size=(STEPS, 4))
    flights = Batch(ctrl, 1).simulate(X0, STEPS, added=given, record=True)
    for i in (0, 3):
        log = simulate(ctrl.copy(), X0[i], STEPS, disturbance=lambda k, _: given[k])
        for part in ("x", "u", "status"):
            np.testing.assert_array_equal(getattr(log, part), getattr(flights, part)[i])
        row = flights.rows.index("curve")
        np.testing.assert_allclose(
            flights.violation[i, row], max(0.0, (log.h[:, 0] - 1.2).max()) if log.h.size else 0.0, atol=1e-12
        )


def test_algebraic_variables_of_rows() -> None:
    ctrl = build(reactor(), None, "test")
    starts = np.linspace(0.2, 1.5, 9)[:, None]
    flights = Batch(ctrl, 1, 2).simulate(starts, 10, record=True)
    for i in (0, 8):
        log = simulate(ctrl.copy(), starts[i], 10)
        np.testing.assert_array_equal(log.x, flights.x[i])  # type: ignore[index]
        worst = float(np.max(log.z[:, 0] + 0.05 * log.u[:, 0] - 0.6))
        assert flights.violation[i, flights.rows.index("warm")] == pytest.approx(max(0.0, worst), abs=1e-12)
    assert flights.violation.max() > 0.01


def test_a_plant_of_another_package() -> None:
    ctrl, other = build(car(), None, "test"), build(car(scaled=True), Options(solve=False), "test")
    other.set_parameter("m", 1.3)
    flights = Batch(ctrl, F, 2).simulate(X0, STEPS, plant=other, record=True)
    log = simulate(ctrl.copy(), X0[2], STEPS, plant=other.integrate)
    np.testing.assert_array_equal(log.x, flights.x[2])  # type: ignore[index]
    plants = Batch(other, F)
    plants.set_parameter("m", MASSES[:, 0])
    flights = Batch(ctrl, 1, 2).simulate(X0, STEPS, plant=plants, record=True)
    log = simulate(ctrl.copy(), X0[2], STEPS, plant=plants[2].integrate)
    np.testing.assert_array_equal(log.x, flights.x[2])  # type: ignore[index]


def test_a_flight_ends_where_the_plant_is_not_finite() -> None:
    ocp = OCP("burst", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: x**3 + u})
    ocp.least_squares(ca.vertcat(x, u), np.eye(2))
    ocp.subject_to(-1, u, 1)
    ctrl = build(ocp, None, "test")
    flights = Batch(ctrl, 1, 2).simulate([[0.1], [40.0], [0.2]], 30, record=True)
    assert flights.lost[0] == flights.lost[2] == -1
    k = int(flights.lost[1])
    assert 0 <= k < 5
    assert flights.x is not None
    assert flights.status is not None
    assert np.isfinite(flights.x[1, : k + 1]).all()
    assert not np.isfinite(flights.x[1, k + 1])
    assert (flights.status[1, k + 1 :] == -1).all()
    assert flights.status_counts[1].sum() == k + 1
    assert flights.failed[1] == next((j for j, s in enumerate(flights.status[1]) if s > 0 and Status(s).is_failure), -1)
    assert "1 whose state was not finite" in flights.summary()
    empty = Batch(ctrl, 1).simulate(np.zeros((0, 1)), 4)
    assert len(empty) == 0
    assert "0 flights" in str(empty)
    nothing = Batch(ctrl, 2).simulate(np.zeros((2, 1)), 0)
    np.testing.assert_array_equal(nothing.last, np.zeros((2, 1)))


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ({"X0": X0[:3]}, r"X0 has shape \(3, 4\); expected \(20, 4\)"),
        ({"X0": np.where(X0[2, 1] == X0, np.inf, X0)}, "X0 holds a NaN or an infinity"),
        ({"steps": -1}, "steps is -1"),
        ({"seed": 1.5}, "seed is 1.5"),
        ({"dt": 0.3}, "dt is 0.3, but the plan is shifted by 0.25"),
        ({"parameters": {"mass": 1.0}}, "no parameter 'mass'"),
        ({"parameters": {"m": np.ones((3, 2))}}, r"parameters: 'm' has shape \(3, 2\); expected a number, \(n,\)"),
        ({"parameters": {"m": 11.0}}, "11 is outside of 0.1 .. 10"),
        ({"parameters": [1.0]}, "parameters is list"),
        ({"references": {"q": 1.0}}, "no residual 'q'"),
        ({"references": np.zeros((4, 3))}, "references: '' has shape"),
        ({"noise": {"q": 1.0}}, "noise: no state 'q'"),
        ({"added": np.zeros((STEPS, 3))}, r"added has shape \(14, 3\)"),
        ({"plant_parameters": {"mass": 1.0}}, "no parameter 'mass'"),
    ],
)
def test_bad_input(task: dict[str, Any], message: str) -> None:
    many = Batch(build(car(), None, "test"), F)
    before = many.memory.copy()
    with pytest.raises(ControllerError, match=message):
        many.simulate(**{"X0": X0, "steps": STEPS, **task})
    np.testing.assert_array_equal(many.memory, before)


def test_plants_that_do_not_fit() -> None:
    many = Batch(build(car(), None, "test"), F)
    single = build(car(), Options(precision="single"), "test")
    rate = build(car(rate=True), None, "test")
    for plant, message in (
        (build(reactor(), None, "test"), "reactor has the states"),
        (single, "another precision"),
        (rate, "time or previous controls"),
        (Batch(build(car(), None, "test"), 3), "a batch of 3"),
    ):
        with pytest.raises(ControllerError, match=message):
            many.simulate(X0, STEPS, plant=plant)
