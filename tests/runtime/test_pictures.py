"""Plans, bounds and rows that a log keeps, and what its pictures show of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from nmpc_codegen import (
    OCP,
    AdjointShooting,
    Controller,
    ControllerError,
    FullCondensing,
    Log,
    NoCondensing,
    Options,
    build,
    simulate,
)
from nmpc_codegen.components.qp import RiccatiInteriorPoint
from nmpc_codegen.pictures.style import HARD, break_label, columns_of

mpl.use("Agg")

#: A layout that does not fit is a warning of matplotlib.
pytestmark = pytest.mark.filterwarnings("error")

STEPS = 40


def drone(name: str = "drone") -> OCP:
    """A point mass in a plane with an obstacle that moves, a soft and hard bounds, a row of the controls."""
    ocp = OCP(name, T=2.0, N=10)
    px, py = ocp.state("px", unit="m"), ocp.state("py", unit="m")
    vx, vy = ocp.state("vx", unit="m/s"), ocp.state("vy", unit="m/s")
    ax, ay = ocp.control("ax", unit="m/s^2"), ocp.control("ay", unit="m/s^2")
    middle, mass = ocp.parameter("middle", value=1.5), ocp.parameter("mass", value=1.0)
    ocp.dynamics({px: vx, py: vy, vx: ax / mass, vy: ay / mass})
    ocp.least_squares(ca.vertcat(px, py, vx, vy, ax, ay), [10, 10, 1, 1, 0.1, 0.1], reference=[3, 2, 0, 0, 0, 0])
    ocp.subject_to(-2, ax, 2)
    ocp.subject_to(-2, ay, 2)
    ocp.subject_to(0.25, (px - middle) ** 2 + (py - 1.0) ** 2, np.inf, name="obstacle")
    ocp.subject_to(-1.4, vx, 1.4, soft=(10, 10))
    ocp.subject_to(-np.inf, ax + ay, 3.5, name="effort")
    return ocp


def change(k: int, c: Controller) -> None:
    """The obstacle and the bound of one control move."""
    c.set_parameter("middle", 1.5 - 0.01 * k)
    c.set_bounds("ax", -2 + 0.02 * k, 2 - 0.02 * k)


OPTIONS: dict[str, Options] = {
    "condensed": Options(condensing=FullCondensing()),
    "stages": Options(condensing=NoCondensing(), qp=RiccatiInteriorPoint()),
}


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(build(drone(), OPTIONS["condensed"], "test"), [0, 0, 0, 0], STEPS, before=change)


@pytest.mark.parametrize("case", OPTIONS)
def test_plans_and_rows_against_the_controller(case: str) -> None:
    """Plans of every third sample, and the rows along them in NumPy; active where a multiplier is, for an interior
    point, too."""
    ctrl = build(drone(f"drone_{case}"), OPTIONS[case], "test")
    twin = ctrl.copy()
    log = simulate(ctrl, [0, 0, 0, 0], STEPS, before=change, plans=3)
    plans = log.plans
    assert plans is not None
    assert plans.sample.tolist() == list(range(0, STEPS, 3))
    assert [trace.name for trace in plans.rows] == ["ax", "ay", "obstacle", "vx", "effort"]
    for k in range(STEPS):
        change(k, twin)
        twin.step(log.x[k])
        if k % 3:
            continue
        n = k // 3
        np.testing.assert_array_equal(plans.x[n], twin.x)
        np.testing.assert_array_equal(plans.u[n], twin.u)
        (px, py, vx, _), (ax, ay) = twin.x.T, twin.u.T
        expected = [
            np.min(2 - 0.02 * k - np.abs(ax)),
            np.min(2 - np.abs(ay)),
            np.min(((px - 1.5 + 0.01 * k) ** 2 + (py - 1) ** 2 - 0.25)[1:]),
            np.min(1.4 - np.abs(vx[1:])),
            np.min(3.5 - ax - ay),
        ]
        np.testing.assert_allclose(plans.distance[n], expected, rtol=1e-9, atol=1e-12)
        assert plans.multiplier[n, 0] == twin.mu_u[np.argmax(np.abs(twin.mu_u[:, 0])), 0]
        assert plans.active[n, 0] == np.sum(2 - 0.02 * k - np.abs(ax) < 1e-7)
        assert plans.active[n, 1] == np.sum(2 - np.abs(ay) < 1e-7)
    assert plans.active[:, :2].max() > 0
    assert log.residual.shape == (STEPS,)
    assert log.residual[-1] == twin.stats.residual


def test_bounds_as_they_were(log: Log, tmp_path: Path) -> None:
    """They move with the samples, also in the picture, and belong to the nodes where they hold."""
    bounds = {limit.name: i for i, limit in enumerate(log.limits)}
    np.testing.assert_allclose(log.upper[:, bounds["ax"]], 2 - 0.02 * np.arange(STEPS))
    np.testing.assert_array_equal(log.lower[:, bounds["obstacle"]], 0.25)
    np.testing.assert_array_equal(log.bounds("ax")[1], log.upper[:, bounds["ax"]])
    assert [side[0] for side in log.bounds("vy")] == [-np.inf, np.inf]
    with pytest.raises(ControllerError, match="there is no 'mass'; expected one of px, py, vx, vy, ax, ay, obstacle"):
        log.bounds("mass")
    assert [log.limits[bounds[name]].delay for name in ("ax", "vx", "effort")] == [0.0, pytest.approx(0.2), 0.0]
    assert log.limits[bounds["vx"]].soft
    axis = next(a for a in log.plot(tmp_path / "bounds.png").axes if a.get_ylabel() == "ax [m/s²]")
    drawn = [line for line in axis.lines if line.get_color() == HARD[1]["color"]]
    np.testing.assert_allclose(drawn[1].get_ydata()[:-1], log.upper[:, bounds["ax"]])
    np.testing.assert_allclose(drawn[1].get_xdata()[:-1], log.t[:-1])


def test_bounds_by_names_of_rows(log: Log) -> None:
    """A row on a bare signal has the axis of the signal, and its own name."""
    ocp = drone("named")
    ocp.subject_to(-1.0, ocp.x[3], 1.2, name="climb", soft=(1, 1))
    ocp.subject_to(-1.0, 2 * ocp.x[3], 5.0, name="vy")
    found = simulate(build(ocp, OPTIONS["condensed"], "test"), [0, 0, 0, 0], 3)
    assert [trace.name for trace in found.rows] == ["obstacle", "effort", "vy"]
    assert [side[0] for side in found.bounds("climb")] == [-1.0, 1.2]
    with pytest.raises(ControllerError, match="'vy' is a signal and a row; expected a row with a name of its own"):
        found.bounds("vy")


def test_equations_are_active_and_not_violated_by_rounding(tmp_path: Path) -> None:
    """In both precisions, with active sets and interior points."""
    for qp, precision in ((None, "double"), (RiccatiInteriorPoint(), "double"), (None, "single")):
        ocp = OCP("goal", T=2.0, N=10)
        p, v = ocp.state("p", initial=1.0), ocp.state("v")
        u = ocp.control("u")
        ocp.dynamics({p: v, v: u})
        ocp.least_squares(ca.vertcat(p, v, u), [1.0, 1.0, 0.1])
        ocp.subject_to(0, ca.vertcat(p, v), 0, at="end", name="goal")
        log = simulate(build(ocp, Options(precision=precision, qp=qp), "test"), [1.0, 0.0], 12)  # type: ignore[arg-type]
        assert log.plans is not None
        assert [trace.name for trace in log.plans.rows] == ["goal[0]_end", "goal[1]_end"]
        np.testing.assert_array_equal(log.plans.active, 1)
        assert (log.plans.distance >= -log.plans.rounding).all()
        assert "violated" not in {t.get_text() for t in log.plot_rows(file=tmp_path / "r.png").legends[0].get_texts()}


def test_an_algorithm_without_multipliers(tmp_path: Path) -> None:
    """Rows are active at their bounds, and the picture says why there is no multiplier."""
    ocp = OCP("shot", T=1.0, N=5)
    x, u = ocp.state("x", initial=2.0), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), [1.0, 0.01])
    ocp.subject_to(-0.3, u, 0.3)
    log = simulate(build(ocp, Options(algorithm=AdjointShooting()), "test"), [2.0], 4)
    assert log.plans is not None
    assert (log.plans.active > 0).all()
    texts = [text.get_text() for axis in log.plot_rows(file=tmp_path / "r.png").axes for text in axis.texts]
    assert np.isnan(log.plans.multiplier).all()
    assert "the algorithm keeps none" in texts


def test_plans_at_uneven_samples(log: Log, tmp_path: Path) -> None:
    """As a recording keeps them: those of every so many samples, and the next one of which there is a plan."""
    assert log.plans is not None
    kept = [0, 1, 10, 20, 30]
    some = {name: getattr(log.plans, name)[kept] for name in ("sample", "x", "u", "distance", "multiplier", "active")}
    figure = replace(log, plans=replace(log.plans, **some)).plot_plans(10, tmp_path / "plans.png")
    starts = next(line for line in figure.axes[0].lines if line.get_marker() == ".")
    np.testing.assert_allclose(starts.get_xdata(), log.t[[0, 10, 20, 30]])


def test_long_names_are_broken() -> None:
    assert break_label("euler_angles_of_body[0] [rad]") == ["euler_angles_", "of_body[0]", "[rad]"]
    assert break_label("computing time [µs]") == ["computing time", "[µs]"]
    assert break_label("speed [km/h]") == ["speed [km/h]"]


def test_parameters_that_change_are_drawn(log: Log, tmp_path: Path) -> None:
    labels = [axis.get_ylabel() for axis in log.plot(tmp_path / "moved.png").axes]
    assert "middle" in labels
    assert "mass" not in labels


@pytest.mark.parametrize(("count", "columns"), [(1, [1]), (9, [9]), (11, [6, 5]), (18, [9, 9]), (19, [7, 6, 6])])
def test_columns_are_filled_to_the_bottom(count: int, columns: list[int]) -> None:
    assert columns_of(count) == columns


def test_odd_counts_leave_no_hole(tmp_path: Path) -> None:
    """Every axis is seen, and the lowest ones of both columns end at the same height and name the time."""
    ocp = OCP("many", T=1.0, N=3)
    x, u = ocp.state("x", size=9), ocp.control("u")
    ocp.dynamics({x: -x + u})
    ocp.least_squares(ca.vertcat(x, u), 1.0)
    figure = simulate(build(ocp, profile="test"), np.ones(9), 3).plot(tmp_path / "many.png")
    assert len(figure.axes) == 11
    assert all(axis.get_visible() for axis in figure.axes)
    lowest = figure.axes[5], figure.axes[10]
    assert [axis.get_xlabel() for axis in lowest] == ["time [s]"] * 2
    assert lowest[0].get_position().y0 == pytest.approx(lowest[1].get_position().y0, abs=1e-3)
    assert lowest[1].get_ylabel() == "computing time\n[µs]"
    assert figure.axes[6].yaxis.label.get_window_extent().x0 > figure.axes[0].get_window_extent().x1


@pytest.mark.parametrize(
    ("draw", "axes"),
    [
        (lambda log, file: log.plot_plans(5, file), 6),
        (lambda log, file: log.plot_rows(file=file), 10),
        (lambda log, file: log.plot_rows(["obstacle", "vx"], file), 4),
        (lambda log, file: log.plot_times(file=file), 1),
        (lambda log, file: log.plot_times(1e-3, file), 1),
        (lambda log, file: log.plot_xy("px", "py", every=5, file=file), 1),
        (lambda log, file: log.compare(replace(log, x=log.x + 1), file=file), 10),
    ],
)
def test_pictures(log: Log, tmp_path: Path, draw: Any, axes: int) -> None:
    """Each names its axes, and is written."""
    figure = draw(log, tmp_path / "picture.png")
    assert len(figure.axes) == axes
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
    assert figure.axes[-1].get_xlabel()


def test_a_log_from_a_file_has_the_same_pictures(log: Log, tmp_path: Path) -> None:
    log.save(tmp_path / "log.npz")
    again = Log.load(tmp_path / "log.npz")
    for name, draw in {
        "xy": lambda a, f: a.plot_xy("px", "py", file=f),
        "rows": lambda a, f: a.plot_rows(file=f),
    }.items():
        draw(log, tmp_path / f"{name}_0.png")
        draw(again, tmp_path / f"{name}_1.png")
        assert (tmp_path / f"{name}_0.png").read_bytes() == (tmp_path / f"{name}_1.png").read_bytes()


def test_the_obstacle_is_where_it_was(log: Log, tmp_path: Path) -> None:
    """Circles round its first, middle and last place, and nothing of rows that depend on other states."""
    axis = log.plot_xy("px", "py", file=tmp_path / "xy.png").axes[0]
    circles = [p for c in axis.collections for p in c.get_paths() if len(p.vertices) > 40]
    middles = {round(float(np.mean([p.vertices[:, 0].min(), p.vertices[:, 0].max()])), 2) for p in circles}
    assert middles == {1.5, 1.3, 1.11}
    for path in circles:
        radius = np.hypot(
            path.vertices[:, 0] - np.mean([path.vertices[:, 0].min(), path.vertices[:, 0].max()]),
            path.vertices[:, 1] - 1.0,
        )
        assert np.max(np.abs(radius - 0.5)) < 0.01
    assert len(log.plot_xy("vx", "vy", file=tmp_path / "v.png").axes[0].collections) == 0


def test_films(log: Log, tmp_path: Path) -> None:
    """A picture for every tenth sample, which differ."""
    log.animate(tmp_path / "time.gif", every=10)
    log.animate(tmp_path / "plane.gif", ("px", "py"), every=10)
    for name in ("time", "plane"):
        with Image.open(tmp_path / f"{name}.gif") as film:
            assert film.n_frames == STEPS / 10 + 1  # and the last sample
            first = film.convert("RGB").tobytes()
            film.seek(2)
            assert film.convert("RGB").tobytes() != first


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda log, p: log.plot_plans(0), "plot_plans.*every is 0; expected an integer >= 1"),
        (lambda log, p: log.plot_rows(["wall"]), "there is no row wall; expected some of ax, ay, obstacle, vx, effort"),
        (lambda log, p: log.plot_xy("px", "z"), "there is no state 'z'; expected one of px, py, vx, vy"),
        (lambda log, p: log.plot_times(-1.0), "dt is -1.0; expected a positive number"),
        (lambda log, p: log.animate(p / "a.avi"), "ends in '.avi'; expected .gif or .mp4"),
        (lambda log, p: log.animate(fps=0), "fps is 0"),
        (lambda log, p: log.animate(xy="px"), "xy is 'px'; expected the names of two states"),
        (lambda log, p: log.plot_xy("px", "px"), "'px' over itself; expected two states"),
        (lambda log, p: log.plot_rows([]), "rows is empty"),
        (lambda log, p: log.plot_rows("wall"), "there is no row wall"),
        (lambda log, p: log.compare(5), "5 is no log"),
        (lambda log, p: log.compare(log, ("a",)), "expected two"),
        (lambda log, p: log.compare(replace(log, time_unit="h")), "one log is in s, the other in h"),
        (lambda log, p: replace(log, plans=None).plot_plans(), r"no plans; expected one of simulate\(..., plans=1\)"),
        (lambda log, p: replace(log, plans=None).plot_rows(), "no plans"),
    ],
)
def test_mistakes_in_pictures(log: Log, tmp_path: Path, call: Any, message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        call(log, tmp_path)


def test_no_plans_on_request_and_few_in_a_long_loop() -> None:
    ctrl = build(drone(), OPTIONS["condensed"], "test")
    assert simulate(ctrl, [0, 0, 0, 0], 4, plans=0).plans is None
    found = simulate(ctrl, [0, 0, 0, 0], 2500).plans
    assert found is not None
    assert found.sample.tolist() == list(range(0, 2500, 3))
    with pytest.raises(ControllerError, match="plans is -1; expected an integer >= 0"):
        simulate(ctrl, [0, 0, 0, 0], 4, plans=-1)


def test_a_solution_is_drawn_and_shown(tmp_path: Path) -> None:
    """The obstacle ahead over the nodes, with its bound; the names and units of states in a table."""
    ctrl = build(drone(), OPTIONS["condensed"], "test")
    found = ctrl.solve([0, 0, 0, 0])
    axes = {axis.get_ylabel(): axis for axis in found.plot(tmp_path / "plan.png").axes}
    assert list(axes) == ["px [m]", "py [m]", "vx [m/s]", "vy [m/s]", "ax [m/s²]", "ay [m/s²]", "obstacle", "effort"]
    px, py = found.x[:, :2].T
    values = (px - 1.5) ** 2 + (py - 1) ** 2
    np.testing.assert_allclose(axes["obstacle"].lines[0].get_ydata()[1:], values[1:], rtol=1e-12)
    assert np.nanmin(axes["obstacle"].lines[1].get_ydata()) == 0.25
    page = found._repr_html_()
    for word in ("Solution drone", "vx", "m/s", "stationarity", "OK: solved"):
        assert word in page
    with pytest.raises(ControllerError, match="was not made by solve"):
        replace(found, plan=None).plot()


def test_iterations_have_whole_numbers(tmp_path: Path) -> None:
    found = build(drone(), OPTIONS["condensed"], "test").solve([0, 0, 0, 0], max_iterations=3)
    ticks = found.plot_convergence(tmp_path / "convergence.png").axes[1].get_xticks()
    np.testing.assert_array_equal(ticks, np.round(ticks))
