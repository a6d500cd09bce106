"""Flights: the bits of simulate(), whatever the threads and blocks; summaries against the samples."""

from __future__ import annotations

import copy
import pickle
import signal
import threading
import time
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    AugmentedLagrangian,
    Batch,
    Controller,
    ControllerError,
    Online,
    Options,
    RealTimeIteration,
    Status,
    Uniform,
    batch,
    build,
    simulate,
)
from nmpc_codegen.frontend.horizon import with_horizon
from tests.runtime.batch.problems import N, car, reactor

F, STEPS = 20, 14
RNG = np.random.default_rng(3)
X0 = np.array([1.0, 0.0, 0.0, 0.0]) + 0.2 * RNG.normal(size=(F, 4))
MASSES = RNG.uniform(0.8, 1.2, (F, 1))
TRACKS = 0.3 * RNG.normal(size=(F, 12))
GAINS = RNG.uniform(0.1, 0.5, (F, 9, 2))

VARIANTS: dict[str, tuple[OCP, Options]] = {
    "by node": (car(), Options(online=Online(parameter="node", reference="node", bounds="node"))),
    "shared": (car(scaled=True), Options(online=Online(parameter="shared", reference="shared"))),
    "single": (car(), Options(precision="single")),
    "time and rate": (car(rate=True, time=True), Options()),
    "augmented Lagrangian": (car(), Options(algorithm=AugmentedLagrangian())),
}


def replay(ctrl: Controller, flights: Any, i: int) -> tuple[float, dict[str, float]]:
    """Fly flight i by calls of single controllers; return its cost and the violations of its rows."""
    plant, x, cost, dt = ctrl.copy(), X0[i].copy(), 0.0, 0.25
    values: dict[str, list[float]] = {name: [] for name in flights.rows}
    by_node = ctrl.description.online["parameter"] == "node"
    before = 0.0
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
        if ctrl.description.augmentation.time:
            cost += 0.01 * np.sin(k * dt) * x[1] * dt
        if plant.known.size:
            plant.known[...] = ctrl.known
        x = plant.integrate(x, u, dt).astype(np.float64) + flights.disturbance(i)[k]
        np.testing.assert_array_equal(x, flights.x[i, k + 1])
        outside = {"a": abs(u[0]) - 2, "v": abs(x[1]) - 1, "curve": x[0] ** 2 + x[1] - 1.2}
        outside["rate"], before = abs(u[0] - before) / dt - 1.0, float(u[0])
        for name, of_row in values.items():
            of_row.append(float(outside[name]))
    return cost, {name: max(0.0, *of_row) for name, of_row in values.items()}


@pytest.mark.parametrize("name", VARIANTS)
def test_a_flight_is_a_loop_of_single_calls(name: str) -> None:
    ctrl = build(*VARIANTS[name], "test")
    task: dict[str, Any] = {
        "parameters": {"m": MASSES, "k": GAINS},
        "references": {"p": TRACKS},
        "disturbance": [0.1, 0.4, 0.01, 0.01],
        "noise": Uniform({"v": 0.02}),
        "plant_parameters": {"k[1]": 0.3},
        "seed": 5,
    }
    many = Batch(ctrl, F, 2)
    flights = many.simulate(X0, STEPS, record=True, **task)
    for i in (0, 7, F - 1):
        twin = ctrl.copy()
        cost, violations = replay(twin, flights, i)
        np.testing.assert_array_equal(many[i]._memory, twin._memory)
        rounding = 1e-6 if ctrl.description.precision == "single" else 1e-12
        np.testing.assert_allclose(flights.cost[i], cost, rtol=rounding)
        np.testing.assert_allclose(flights.violation[i], list(violations.values()), atol=rounding)
        assert not np.any(flights.noise(i)[:, 1] == flights.disturbance(i)[:, 1])
    for row in ("v", "curve"):
        assert flights.violation[:, flights.rows.index(row)].any()
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


def test_a_plant_with_another_horizon() -> None:
    """Data by node of plants that have more nodes than the controller, and fewer: the bits of simulate()."""
    ctrl = build(car(), None, "test")
    for N_of_plant in (2, 40):
        plant = build(with_horizon(car(), N_of_plant), None, "test", name="long_car")
        gains = {"k": np.full((1, 1, 2), 0.2), "m": 1.1}
        flights = Batch(ctrl, 1).simulate(X0, STEPS, plant=plant, plant_parameters=gains, record=True)
        twin = plant.copy()
        twin.set_parameters(k=[0.2, 0.2], m=1.1)
        log = simulate(ctrl.copy(), X0[3], STEPS, plant=twin.integrate)
        np.testing.assert_array_equal(log.x, flights.x[3])  # type: ignore[index]


@pytest.mark.parametrize("dt", [0.25, 0.4])
def test_a_flight_is_a_log_of_simulate(dt: float) -> None:
    """Without data that change, with a sample of two integrations, and disturbances that are given."""
    ctrl = build(car(), Options(algorithm=RealTimeIteration(shift=None)), "test")
    given = 0.01 * RNG.normal(size=(STEPS, 4))
    flights = Batch(ctrl, 1).simulate(X0, STEPS, dt, added=given, record=True)
    assert flights.x is not None
    for i in (0, 3):
        log = simulate(ctrl.copy(), X0[i], STEPS, dt, disturbance=lambda k, _: given[k])
        for part in ("x", "u", "status"):
            np.testing.assert_array_equal(getattr(log, part), getattr(flights, part)[i])
        worst = float(np.max(log.x[1:, 0] ** 2 + log.x[1:, 1] - 1.2))
        assert flights.violation[i, flights.rows.index("curve")] == pytest.approx(max(0.0, worst), abs=1e-12)


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


def mixer() -> OCP:
    """The algebraic variable q z = x, which must stay below 1, a full weight, and what no sample can be judged by: rows
    of two nodes, of the end, and of an accumulator."""
    ocp = OCP("mixer", T=2.0, N=4)
    x, u, total = ocp.state("x", initial=0.5), ocp.control("u"), ocp.state("total")
    q, z = ocp.parameter("q", value=1.0), ocp.algebraic("z", initial=0.5)
    ocp.algebraic_equation(q * z + 0.01 * z**3 - x)
    ocp.dynamics({x: u, total: x})
    ocp.accumulator(total)
    ocp.least_squares(ca.vertcat(x, u), [[2.0, 0.5], [0.5, 1.0]], reference=[1.0, 0.0], names=["x", "u"])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-np.inf, z, 1, name="z")
    ocp.subject_to(-np.inf, total, 3, name="total", soft=(1, 1))
    ocp.subject_to(0, x, 5, at=[2, 3], name="gate", soft=(1, 1))
    ocp.subject_to(0, x, 5, at="end", name="last", soft=(1, 1))
    return ocp


@pytest.mark.parametrize("weight", ["fixed", "shared", "node"])
def test_rows_and_costs_of_the_true_plant(weight: Any) -> None:
    """What the parameters of the plant say, not those of the controller; the rows of the whole path alone."""
    ctrl = build(mixer(), Options(online=Online(weight=weight)), "test")
    starts = np.array([[0.5, 0.0], [0.2, 0.0]])
    flights = Batch(ctrl, 1).simulate(starts, 20, plant_parameters={"q": np.array([[0.8], [1.0]])}, record=True)
    assert flights.rows == ("u", "z")
    assert flights.x is not None
    assert flights.u is not None
    y = np.concatenate([flights.x[:, :-1, :1] - 1.0, flights.u], axis=2)
    cost = 0.5 * np.einsum("fki,ij,fkj->f", y, [[2.0, 0.5], [0.5, 1.0]], y)
    np.testing.assert_allclose(flights.cost, cost, rtol=1e-12)
    twin = ctrl.copy()
    twin.set_parameter("q", 0.8)
    z = [twin.algebraic(x, u)[0] for x, u in zip(flights.x[0], flights.u[0], strict=False)]
    assert flights.violation[0, 1] == pytest.approx(max(z) - 1.0, rel=1e-9)
    assert flights.violation[0, 1] > 0.1 > flights.violation[1, 1]
    np.testing.assert_array_equal(flights.hard, [True, True])
    np.testing.assert_array_equal(flights.wrong, [True, False])
    assert "row 'z': violated in 1 flight" in str(flights)


def test_a_hard_row_that_is_not_known_is_wrong() -> None:
    """log(x) at a state that a gust has made negative, while the controller is told a positive one."""
    ocp = OCP("log", T=1.0, N=4)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), [1.0, 1.0], reference=[1.0, 0.0])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-5, ca.log(x), 5, name="log")
    added = np.zeros((2, 6, 1))
    added[1, -1] = -3.0
    flights = batch(ocp, 1).simulate([[1.0], [1.0]], 6, added=added)
    np.testing.assert_array_equal(np.isnan(flights.violation[:, flights.rows.index("log")]), [False, True])
    np.testing.assert_array_equal(flights.wrong, [False, True])


def test_a_start_outside_is_no_violation_but_an_end_is() -> None:
    ocp = OCP("wall", T=2.0, N=10)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), [1.0, 0.1])
    ocp.subject_to(-9, u, 9)
    ocp.subject_to(-np.inf, 1.0000001 * x, 0.5, name="general")
    ocp.subject_to(-np.inf, x, 0.6, name="bare")
    added = np.zeros((20, 1))
    added[-1] = 2.0
    many = batch(ocp, 1)
    assert not many.simulate([[0.9]], 20).wrong.any()
    late = many.simulate([[0.1]], 20, added=added)
    np.testing.assert_allclose(late.violation, [[0.0, 1.5, 1.4]], atol=1e-6)
    assert late.wrong.all()


def test_plants_are_copies() -> None:
    """One that is the batch itself, one of its controllers, and a batch of plants, whatever the threads."""
    ctrl = build(car(), None, "test")
    table = {"m": 1 + 0.1 * np.sin(np.arange(STEPS))}
    expected = Batch(ctrl, F, 1).simulate(X0, STEPS, parameters=table, plant=ctrl.copy())
    for threads in (1, 3):
        many = Batch(ctrl, F, threads)
        flights = many.simulate(X0, STEPS, parameters=table, plant=many[3])
        np.testing.assert_array_equal(flights.last, expected.last)
    heavy = Batch(ctrl, F).simulate(X0, STEPS, plant=ctrl, plant_parameters={"m": 3.0})
    many = Batch(ctrl, F)
    np.testing.assert_array_equal(many.simulate(X0, STEPS, plant=many, plant_parameters={"m": 3.0}).last, heavy.last)
    plants = Batch(ctrl, F)
    before = plants.memory.copy()
    Batch(ctrl, F).simulate(X0, STEPS, plant=plants, plant_parameters={"m": 3.0})
    np.testing.assert_array_equal(plants.memory, before)


def test_an_interrupt_stops_long_flights() -> None:
    """Of the process that waits; the batch goes on afterwards."""
    many = Batch(build(car(), None, "test"), 1, 2)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have it ignored
    timer = threading.Timer(0.5, signal.pthread_kill, [threading.main_thread().ident, signal.SIGINT])
    timer.start()
    start = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            many.simulate(X0, 300_000)
    finally:
        signal.signal(signal.SIGINT, handler)
    assert time.monotonic() - start < 10.0
    assert len(many.simulate(X0, 3)) == F


def test_flights_and_batches_can_be_kept() -> None:
    many = Batch(build(car(), None, "test"), F)
    flights = many.simulate(X0, 3, disturbance=0.1)
    again = pickle.loads(pickle.dumps(flights))
    np.testing.assert_array_equal(again.last, flights.last)
    np.testing.assert_array_equal(again.disturbance(3), flights.disturbance(3))
    for twin in (pickle.loads(pickle.dumps(many)), many.copy(), copy.deepcopy(many)):
        np.testing.assert_array_equal(twin.memory, many.memory)
        before = many.memory.copy()
        twin.step(X0)
        np.testing.assert_array_equal(many.memory, before)
    with pytest.raises(ControllerError, match="flight 20; expected an integer between 0 and 19"):
        flights.noise(F)


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
        ({"parameters": {"m": np.ones((3, 2))}}, r"parameters: 'm' has shape \(3, 2\); expected a number or \(n,\)"),
        ({"parameters": {"m": 11.0}}, "11 is outside of 0.1 .. 10"),
        ({"parameters": [1.0]}, "parameters is list"),
        ({"references": {"q": 1.0}}, "no residual 'q'"),
        ({"references": np.zeros((4, 3))}, "references has shape"),
        ({"noise": {"q": 1.0}}, "noise: no state 'q'"),
        ({"added": np.zeros((STEPS, 3))}, r"added has shape \(14, 3\)"),
        ({"plant_parameters": {"mass": 1.0}}, "no parameter 'mass'"),
        ({"plant": "car"}, "plant is 'car'; expected a Controller or a Batch"),
        ({"parameters": {"k": np.ones((2, 2)), "k[0]": 1.0}}, "parameters: 'k\\[0\\]' is given twice"),
        ({"steps": 10**8}, "steps is 100000000; expected at most"),
    ],
)
def test_bad_input(task: dict[str, Any], message: str) -> None:
    many = Batch(build(car(), None, "test"), F)
    before = many.memory.copy()
    with pytest.raises(ControllerError, match=message):
        many.simulate(**{"X0": X0, "steps": STEPS, **task})
    np.testing.assert_array_equal(many.memory, before)


def slow_map() -> Controller:
    """A discrete map with the states of the car."""
    ocp = OCP("slow", T=0.4 * N, N=N)
    p, v, r = ocp.state("p"), ocp.state("v"), ocp.state("r", size=2)
    a = ocp.control("a")
    ocp.dynamics({p: p + 0.4 * v, v: v + 0.4 * a, r: r}, discrete=True)
    ocp.least_squares(ca.vertcat(p, a), [1.0, 1.0])
    return build(ocp, None, "test")


def test_plants_that_do_not_fit() -> None:
    many = Batch(build(car(), None, "test"), F)
    single = build(car(), Options(precision="single"), "test")
    rate = build(car(rate=True), None, "test")
    for plant, message in (
        (build(reactor(), None, "test"), "reactor has the states"),
        (single, "has the precision 'single'"),
        (rate, "time or previous controls"),
        (slow_map(), "is a map of 0.4, a sample takes 0.25"),
        (Batch(build(car(), None, "test"), 3), "a batch of 3"),
    ):
        with pytest.raises(ControllerError, match=message):
            many.simulate(X0, STEPS, plant=plant)
