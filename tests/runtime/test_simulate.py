"""simulate.py, on a linear plant, which has a closed form."""

from __future__ import annotations

import io
import json
import sys
from collections import Counter
from pathlib import Path

import casadi as ca
import matplotlib as mpl
import numpy as np
import pytest
from numpy.typing import NDArray

from nmpc_codegen import OCP, Options, RealTimeIteration, build
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.controller import Controller, Status
from nmpc_codegen.runtime.loops.progress import LONG_RUN
from nmpc_codegen.runtime.loops.simulate import simulate
from nmpc_codegen.runtime.records.trace import Trace
from verification import problems
from verification.routes import PURE

Array = NDArray[np.float64]
X0 = np.array([1.0, 0.0])
mpl.use("Agg")


def exact(x: Array, u: Array, dt: float) -> Array:
    """Constant acceleration."""
    return np.array([x[0] + dt * x[1] + dt**2 / 2 * u[0], x[1] + dt * u[0]])


def in_python(k: int, ctrl: Controller) -> None:
    """What makes simulate() take its samples in Python."""


def test_the_log_is_the_loop(toy: Controller) -> None:
    twin = toy.copy()
    log = simulate(toy, X0, 12)
    x = X0
    for k in range(12):
        np.testing.assert_array_equal(log.u[k], twin.step(x))
        assert log.cost[k] == twin.cost
        assert log.status[k] == twin.status
        x = exact(x, log.u[k], 0.1)
        np.testing.assert_allclose(log.x[k + 1], x, rtol=1e-13, atol=1e-15)
        x = log.x[k + 1]
    np.testing.assert_allclose(log.t, 0.1 * np.arange(13), rtol=1e-15)
    assert (log.time_ns > 0).all()
    assert log.u[0] == -5.0


def test_warm_start_is_solve_before_the_first_sample(toy: Controller) -> None:
    twin = toy.copy()
    seen: list[int] = []
    log = simulate(toy, X0, 3, before=lambda k, _: seen.append(k), warm_start=True)
    assert seen == [0, 0, 1, 2]
    twin.solve(X0)
    np.testing.assert_array_equal(log.u[0], twin.step(X0))


def test_a_sampling_time_that_is_not_that_of_the_shift_is_an_error(toy: Controller) -> None:
    with pytest.raises(ControllerError, match=r"dt is 0.25, .*shifted by 0.1 s.*sampling_time=0.25"):
        simulate(toy, X0, 1, dt=0.25)
    assert simulate(toy, X0, 1, dt=0.1 + 1e-12).t[1] == pytest.approx(0.1)


def test_long_samples_are_cut_into_the_controllers_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    toy = build(problems.toy(), Options(algorithm=PURE), "test")
    steps: list[float] = []
    original = Controller.integrate

    def recorded(self: Controller, x: Array, u: Array, dt: float) -> Array:
        steps.append(dt)
        return original(self, x, u, dt)

    monkeypatch.setattr(Controller, "diagnose", lambda self: "")
    monkeypatch.setattr(Controller, "integrate", recorded)
    log = simulate(toy, X0, 1, dt=0.25, before=in_python)
    np.testing.assert_allclose(steps, [0.25 / 3] * 3)
    np.testing.assert_allclose(log.x[1], exact(X0, log.u[0], 0.25), rtol=1e-13)
    steps.clear()
    simulate(toy, X0, 1, dt=0.1 + 0.1 + 0.1, before=in_python)
    assert len(steps) == 3
    steps.clear()
    simulate(toy, X0, 1, dt=0.02, before=in_python)
    assert steps == [0.02]


def test_own_plant_disturbance_and_reference(toy: Controller) -> None:
    def target(k: int, ctrl: Controller) -> None:
        ctrl.set_reference({"p": 0.3 if k >= 20 else 0.0})
        ctrl.set_terminal_reference({"p": 0.3 if k >= 20 else 0.0})

    log = simulate(
        toy,
        [0.2, 0.0],
        60,
        plant=lambda x, u, dt: exact(x, 0.9 * u, dt).tolist(),
        disturbance=lambda k, x: np.array([0.0, 0.1 if k == 40 else 0.0]),
        before=target,
    )
    assert abs(log.x[20, 0]) < 0.05
    assert log.x[40, 0] == pytest.approx(0.3, abs=0.02)
    kick = log.x[41] - exact(log.x[40], 0.9 * log.u[40], 0.1)
    np.testing.assert_allclose(kick, [0.0, 0.1], atol=1e-14)


def test_the_plant_cannot_change_the_log(toy: Controller) -> None:
    def careless(x: Array, u: Array, dt: float) -> Array:
        u[:] = 77.0
        x += 1.0
        return x

    log = simulate(toy, X0, 1, plant=careless)
    np.testing.assert_array_equal(log.x, [X0, X0 + 1.0])
    assert log.u[0] == -5.0


def test_no_steps(toy: Controller, tmp_path: Path) -> None:
    log = simulate(toy, X0, 0)
    assert (log.x.shape, log.u.shape, log.t.tolist()) == ((1, 2), (0, 1), [0.0])
    assert "0 samples" in log.summary()
    log.plot(tmp_path / "empty.png")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"steps": -1}, "steps is -1; expected an integer >= 0"),
        ({"steps": 2.0}, "steps is 2.0"),
        ({"steps": 10**12}, "steps is 1000000000000; expected at most 13421772, whose log takes 2 GiB"),
        ({"steps": 10**30}, "steps is 10+; expected at most"),
        ({"x0": [1.0]}, r"x0 has shape \(1,\); expected \(2,\)"),
        ({"x0": [1.0, np.nan]}, "x0 is not finite"),
        ({"dt": 0.0}, "dt is 0.0; expected a positive number"),
        ({"dt": "0.1"}, "dt is '0.1'"),
        ({"plant": lambda x, u, dt: x[:1]}, r"the plant's state after sample 0 has shape \(1,\)"),
        ({"plant": lambda x, u, dt: x + np.inf}, "the plant's state after sample 0 is not finite"),
        ({"disturbance": lambda k, x: "gust"}, "the disturbance of sample 0 is no array of numbers"),
    ],
)
def test_mistakes(toy: Controller, arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        simulate(toy, **{"x0": X0, "steps": 2, **arguments})  # type: ignore[arg-type]


def test_a_discrete_map_has_its_own_interval(toy_files: dict[str, str]) -> None:
    description = json.loads(toy_files["toy.json"]) | {"discrete": True, "time_unit": "samples"}
    ctrl = load({**toy_files, "toy.json": json.dumps(description)}, "toy", "test")
    with pytest.raises(ControllerError, match=r"discrete map of dt = 0.1: leave dt out"):
        simulate(ctrl, X0, 2, dt=0.2)
    assert simulate(ctrl, X0, 2, dt=0.1).time_unit == "samples"


def test_summary(toy: Controller) -> None:
    toy.set_bounds("box", [-np.inf, -0.1], [np.inf, 0.1])
    log = simulate(toy, [0.0, 5.0], 12)
    assert not log.ok
    counts = Counter(Status(status).name for status in log.status)
    assert set(counts) != {"OK"}
    assert all(f"{name} {count}" in log.summary() for name, count in counts.items())
    assert "12 samples over 1.2 s" in log.summary()
    assert simulate(toy, [0.01, 0.0], 3).ok


def test_plot(toy: Controller, tmp_path: Path) -> None:
    log = simulate(toy, X0, 12)
    figure = log.plot(tmp_path / "toy.png")
    assert (tmp_path / "toy.png").read_bytes().startswith(b"\x89PNG")
    assert [axis.get_ylabel() for axis in figure.axes] == ["p [m]", "v [m/s]", "a [m/s²]", "computing time\n[µs]"]
    position, _, control, _ = figure.axes
    np.testing.assert_array_equal(position.lines[0].get_ydata(), log.x[:, 0])
    assert [line.get_ydata()[0] for line in position.lines[1:]] == [0.0]
    assert control.lines[0].get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(control.lines[0].get_ydata()[:-1], log.u[:, 0])
    assert sorted(line.get_ydata()[0] for line in control.lines[1:]) == [-5.0, 0.0, 5.0]
    assert [line.is_dashed() for line in control.lines[1:]] == [True, True, False]


def test_plot_without_a_file_is_a_pyplot_figure(toy: Controller) -> None:
    from matplotlib import pyplot

    figure = simulate(toy, X0, 3).plot()
    assert figure.number in pyplot.get_fignums()
    pyplot.close(figure)


@pytest.mark.parametrize(
    ("unit", "label"), [("m/s^2", "a [m/s²]"), ("s^-1", "a [s⁻¹]"), ("", "a"), ("m^10", "a [m¹⁰]")]
)
def test_labels(unit: str, label: str) -> None:
    assert Trace("a", unit).label == label


@pytest.mark.parametrize(
    ("steps", "terminal", "shown"), [(LONG_RUN, True, True), (LONG_RUN, False, False), (5, True, False)]
)
def test_progress_bar_on_long_runs_at_a_terminal(
    toy: Controller, monkeypatch: pytest.MonkeyPatch, steps: int, terminal: bool, shown: bool
) -> None:
    stream = io.StringIO()
    stream.isatty = lambda: terminal  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", stream)
    simulate(toy, X0, steps)
    assert ("toy" in stream.getvalue()) == shown


def test_a_plant_that_explodes_says_from_where(toy: Controller) -> None:
    message = r"after sample 0 is not finite: \[nan, 0\.0\]; it moved from p = 0\.1, v = 0\.2, .*the sample: OK: solved"
    with pytest.raises(ControllerError, match=message):
        simulate(toy, [0.1, 0.2], 3, plant=lambda x, u, dt: [np.nan, 0.0])


# -- data over the samples --------------------------------------------------------------------------------------------


def test_arrays_over_the_samples_move_along(toy: Controller) -> None:
    """Node j of sample k has row k + j, the last one holds, before() comes last. Oracle: the setters by hand."""
    price, target = np.linspace(1.0, 2.0, 8), np.arange(24.0).reshape(8, 3) / 100
    seen: list[tuple[Array, Array, Array]] = []

    def look(k: int, c: Controller) -> None:
        seen.append((c.view("p")[:, 0].copy(), c.view("yref").copy(), c.view("lower")[:, 0].copy()))

    by_hand = toy.copy()
    data = {"parameters": {"m": price}, "references": target, "bounds": {"a": (-price, 7.0)}}
    log = simulate(toy, {"p": 0.2}, 9, before=look, **data)  # type: ignore[arg-type]
    for k, (m, y, lower) in enumerate(seen):
        np.testing.assert_array_equal(m, price[np.minimum(k + np.arange(5), 7)])
        np.testing.assert_array_equal(y, target[np.minimum(k + np.arange(4), 7)])
        np.testing.assert_array_equal(lower, [-price[min(k, 7)]] * 2)  # Online(bounds="shared")

    def tell(k: int, c: Controller) -> None:
        c.set_parameter("m", price[np.minimum(k + np.arange(5), 7)])
        c.set_reference(target[np.minimum(k + np.arange(5), 7)])
        c.set_bounds("a", -price[min(k, 7)], 7.0)

    np.testing.assert_array_equal(log.u, simulate(by_hand, [0.2, 0.0], 9, before=tell).u)


def test_forecasts_where_samples_are_shorter_than_intervals() -> None:
    """A node takes the row of the last sample at or before its time."""
    ctrl = controller_of_slow_grid()
    seen: list[Array] = []
    simulate(
        ctrl,
        {"x": 1.0},
        3,
        dt=0.1,
        parameters={"m": np.arange(20.0)},
        references={"x": np.arange(20.0)},
        before=lambda k, c: seen.append(np.hstack([c.view("p")[:, 0], c.view("yref")[:, 0], c.view("yref_N")])),
    )
    ahead = np.array([0, 1, 3, 6])
    for k, row in enumerate(seen):
        np.testing.assert_array_equal(row, np.hstack([k + ahead, k + ahead]))


def controller_of_slow_grid() -> Controller:
    ocp = OCP("slow_grid", intervals=[0.1, 0.2, 0.3])
    x, u, m = ocp.state("x"), ocp.control("u"), ocp.parameter("m", value=1.0)
    ocp.dynamics({x: u - 0.1 * m * x})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ocp.terminal_least_squares(x, weight=1.0)
    return build(ocp, Options(algorithm=RealTimeIteration(sampling_time=0.1)), "test")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"parameters": [1.0]}, r"parameters is list; expected \{name: table over the samples\}"),
        ({"parameters": {"m": []}}, r"parameters: 'm' has shape \(0,\); expected a number or \(n,\)"),
        ({"parameters": {"mass": 1.0}}, "no parameter 'mass'"),
        ({"parameters": {"d": np.zeros((4, 3))}}, r"parameters: 'd' has shape \(4, 3\); expected a number or \(n, 2\)"),
        ({"parameters": {"d": [1.0, 2.0]}}, r"parameters: 'd' has shape \(2,\); expected a number or \(n, 2\)"),
        ({"bounds": {"box": ([-1.0, -2.0], 1.0)}}, r"bounds: 'box' has shape \(2,\); expected a number or \(n, 2\)"),
        ({"references": np.zeros((3, 2))}, r"references has shape \(3, 2\); expected a number or \(n, 3\)"),
        ({"parameters": {"m": 2.0}, "bounds": {"zz": (0, 1)}}, "no row 'zz'"),
        ({"before": 3}, "before is 3; expected a function"),
        ({"bounds": {"a": 1.0}}, r"bounds of 'a' is 1.0; expected \(lower, upper\)"),
        ({"references": {"q": 1.0}}, "no residual 'q'"),
        ({"x0": {"q": 1.0}}, "x0: no state 'q'; those that exist: 'p', 'v'"),
        ({"x0": {"p": [1.0, 2.0]}}, "x0: 'p' has shape"),
    ],
)
def test_wrong_data_over_the_samples(toy: Controller, data: dict[str, object], message: str) -> None:
    arguments, before = {"x0": X0, "steps": 3, **data}, toy._memory.copy()
    with pytest.raises(ControllerError, match=message):
        simulate(toy, **arguments)  # type: ignore[arg-type]
    np.testing.assert_array_equal(toy._memory, before)
