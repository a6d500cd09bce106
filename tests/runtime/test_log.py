"""The log of a closed loop as a file, as tables, in a notebook, and what its picture shows."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib as mpl
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    Controller,
    ControllerError,
    ExtraError,
    Log,
    Online,
    Options,
    Status,
    build,
    generate,
    simulate,
)
from nmpc_codegen.pictures.style import BOUND_COLOR, DOUBT_COLOR, FAILURE_COLOR, HARD, REFERENCE_COLOR, SOFT

mpl.use("Agg")

COMPUTING = "computing time\n[µs]"


def tank() -> OCP:
    """A tank in hours, with a reference, a soft and a hard bound, a row and a parameter."""
    ocp = OCP("tank", T=2.0, N=10, time_unit="h")
    level, flow = ocp.state("level", unit="m", initial=1.0), ocp.control("flow", unit="m^3/h")
    leak = ocp.parameter("leak", value=0.1, unit="1/h")
    ocp.dynamics({level: flow - leak * level})
    ocp.least_squares(level, 1.0, reference=1.5, names=["target"])
    ocp.least_squares(flow, 0.1)
    ocp.subject_to(-1, flow, 1)
    ocp.subject_to(0, level, 1.4, soft=(1, 1))
    ocp.subject_to(-2, level * flow, 2, name="power")
    return ocp


def change(k: int, c: Controller) -> None:
    """Reference and parameter jump; the bounds become crossed."""
    if k == 10:
        c.set_reference({"target": 0.7})
    if k == 20:
        c.set_parameter("leak", 0.3)
    if k == 38:
        c.set_bounds("power", 1.5, 2.0)


@pytest.fixture(scope="module")
def log() -> Log:
    """Forty samples, in which the reference, the leak and the state jump; the bounds become crossed at the end."""
    return simulate(build(tank(), profile="test"), [1.0], 40, before=change, disturbance=lambda k, x: [0.5 * (k == 30)])


def test_it_records_reference_and_parameters(log: Log) -> None:
    np.testing.assert_array_equal(log.y[:, 0], np.where(np.arange(40) < 10, 1.5, 0.7))
    np.testing.assert_array_equal(log.p[:, 0], np.where(np.arange(40) < 20, 0.1, 0.3))
    assert [(t.name, t.unit, t.signal) for t in log.references] == [("target", "m", "level"), ("flow", "m^3/h", "flow")]
    assert [(t.name, t.unit) for t in log.parameters] == [("leak", "1/h")]


def test_what_is_fixed_is_recorded_too() -> None:
    fixed = Options(online=Online(reference="fixed", parameter="fixed"))
    found = simulate(build(tank(), fixed, "test"), [1.0], 2)
    np.testing.assert_array_equal(found.y, [[1.5, 0.0]] * 2)
    np.testing.assert_array_equal(found.p, [[0.1]] * 2)


@pytest.mark.parametrize("kind", ["path", "text", "stream"])
def test_save_and_load(log: Log, tmp_path: Path, kind: str) -> None:
    stream = io.BytesIO()
    file = {"path": tmp_path / "loop.log", "text": str(tmp_path / "loop.npz"), "stream": stream}[kind]
    log.save(file)
    stream.seek(0)
    again = Log.load(file)
    pairs = [(value, getattr(again, name)) for name, value in vars(log).items() if name != "plans"]
    assert log.plans is not None
    assert again.plans is not None
    pairs += [(value, getattr(again.plans, name)) for name, value in vars(log.plans).items()]
    for value, other in pairs:
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(other, value)
            assert other.dtype == value.dtype
        else:
            assert other == value
    assert again.summary() == log.summary()
    assert list(again.reasons) == list(log.reasons)


def test_other_files_are_refused(log: Log, tmp_path: Path) -> None:
    ctrl = build(tank(), profile="test")
    ctrl.save(tmp_path / "state.npz")
    (tmp_path / "text.npz").write_text("loop")
    log.save(tmp_path / "cut.npz")
    whole = (tmp_path / "cut.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[:300])
    (tmp_path / "flipped.npz").write_bytes(whole[:200] + bytes([whole[200] ^ 255]) + whole[201:])
    replace(log, x=log.x[:10]).save(tmp_path / "short.npz")
    replace(log, status=log.status + 70).save(tmp_path / "status.npz")
    np.save(tmp_path / "array.npz.npy", log.x)
    (tmp_path / "array.npz.npy").rename(tmp_path / "array.npz")
    (tmp_path / "empty.npz").write_bytes(b"")
    for name in (
        "empty.npz",
        "state.npz",
        "text.npz",
        "cut.npz",
        "flipped.npz",
        "short.npz",
        "status.npz",
        "array.npz",
    ):
        with pytest.raises(ControllerError, match=rf"{name} is not a log that Log.save\(\) wrote"):
            Log.load(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        Log.load(tmp_path / "missing.npz")


def test_dataframe(log: Log) -> None:
    pytest.importorskip("pandas")
    frame = log.to_dataframe()
    assert frame.index.name == "time [h]"
    np.testing.assert_array_equal(frame["x"]["level"], log.x[:, 0])
    np.testing.assert_array_equal(frame["u"]["flow"].to_numpy()[:-1], log.u[:, 0])
    np.testing.assert_array_equal(frame["y"]["target"].to_numpy()[:-1], log.y[:, 0])
    assert frame["u"]["flow"].isna().tolist() == [False] * 40 + [True]
    assert frame["status"].iloc[0] == "OK"
    assert (frame["status"] == "OK").sum() == np.sum(log.status == 0)
    assert {first for first, _ in frame.columns} == {"x", "u", "h", "p", "y", "status", "cost", "time_ns"}


def test_dataset(log: Log) -> None:
    """Over one dimension of time, so that states and references can be subtracted."""
    pytest.importorskip("xarray")
    found = log.to_xarray()
    assert dict(found.sizes) == {"time": 41, "state": 1, "control": 1, "row": 1, "parameter": 1, "residual": 2}
    np.testing.assert_array_equal(found.x.sel(state="level"), log.x[:, 0])
    away = found.x.sel(state="level") - found.y.sel(residual="target")
    np.testing.assert_array_equal(away[:-1], log.x[:-1, 0] - log.y[:, 0])
    assert np.isnan(away[-1])
    assert found.time.attrs["units"] == "h"
    assert found.control_unit.values.tolist() == ["m^3/h"]
    assert (found.status.values[0], found.status.values[-1]) == ("OK", "")


def test_a_dataset_without_rows_parameters_and_residuals(tmp_path: Path) -> None:
    """It has no variable without entries, which files cannot hold."""
    pytest.importorskip("xarray")
    ocp = OCP("bare", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.stage_cost(x**2 + u**2)
    found = simulate(build(ocp, profile="test"), [1.0], 3).to_xarray()
    assert set(found.data_vars) == {"x", "u", "status", "cost", "time_ns"}
    assert dict(found.sizes) == {"time": 4, "state": 1, "control": 1}


@pytest.mark.parametrize(("method", "package"), [("to_dataframe", "pandas"), ("to_xarray", "xarray")])
def test_a_missing_extra_is_named(log: Log, monkeypatch: pytest.MonkeyPatch, method: str, package: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ExtraError, match=rf"Log.{method}\(\) needs the package {package}: .*nmpc-codegen\[notebook\]"):
        getattr(log, method)()


def test_without_matplotlib(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ExtraError, match=r"plot\(\) needs the package matplotlib: .*nmpc-codegen\[plot\]"):
        log.plot("loop.png")


def test_picture(log: Log, tmp_path: Path) -> None:
    """The reference of the level, its soft and the flow's hard bounds, marks, times, the unit of time, a legend."""
    assert np.flatnonzero(log.status == Status.RELAXED).tolist() == [38, 39]
    figure = log.plot(tmp_path / "tank.png")
    axes = {axis.get_ylabel(): axis for axis in figure.axes}
    assert list(axes) == ["level [m]", "flow [m³/h]", "power", "leak [1/h]", COMPUTING]
    assert axes[COMPUTING].get_xlabel() == "time [h]"
    np.testing.assert_array_equal(axes[COMPUTING].lines[0].get_ydata(), log.time_ns / 1e3)
    level = {str(line.get_color()): line for line in axes["level [m]"].lines}
    np.testing.assert_array_equal(level[REFERENCE_COLOR].get_ydata(), [*log.y[:, 0], log.y[-1, 0]])
    dashes = [line._unscaled_dash_pattern for line in (level[BOUND_COLOR], axes["flow [m³/h]"].lines[1])]
    assert dashes == [(0, SOFT[1]["linestyle"][1]), (0, HARD[1]["linestyle"][1])]
    np.testing.assert_array_equal(level[DOUBT_COLOR].get_xdata(), log.t[[38, 39]])
    assert FAILURE_COLOR not in level
    said = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"reference", "hard bound", "soft bound"} < said


@pytest.mark.parametrize("method", ["plot", "plot_convergence"])
def test_the_first_figure_may_switch_interactive_mode_on(
    log: Log, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    """As the display of a notebook does while pyplot makes its first figure: that stays."""
    plt = pytest.importorskip("matplotlib.pyplot")
    make = plt.figure

    def figure(*args: Any, **more: Any) -> Any:
        mpl.rcParams["interactive"] = True
        return make(*args, **more)

    with mpl.rc_context({"interactive": False}):
        monkeypatch.setattr(plt, "figure", figure)
        drawn = log.plot() if method == "plot" else build(tank(), profile="test").solve([1.0]).plot_convergence()
        assert mpl.is_interactive()
        plt.close(drawn)


def test_violated_bounds_and_far_references_are_drawn(tmp_path: Path) -> None:
    """Although the curve is constant and never comes near them; its axis has plain numbers."""
    ocp = OCP("stuck", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), 1.0)
    ocp.subject_to(-1, x, 1, soft=(1, 1))
    ocp.subject_to(-40, u, 40)
    ctrl = build(ocp, profile="test")
    axes = simulate(ctrl, [5.0], 3, plant=lambda x, u, dt: x).plot(tmp_path / "stuck.png").axes
    assert {0.0, 1.0, 5.0} <= {line.get_ydata()[0] for line in axes[0].lines}
    assert axes[0].get_ylim()[0] < 0 < 5 < axes[0].get_ylim()[1]
    assert not axes[0].yaxis.get_major_formatter().get_useOffset()


def test_a_reference_of_another_expression_is_not_drawn(tmp_path: Path) -> None:
    """A residual may have the name of a state and be something else."""
    ocp = OCP("named", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x - 0.5, u), 1.0, names=["x", "u"])
    axis = simulate(build(ocp, profile="test"), [1.0], 3).plot(tmp_path / "named.png").axes[0]
    assert len(axis.lines) == 1


def test_texts(log: Log) -> None:
    assert "40 samples over 8 h" in log.summary()
    assert "first RELAXED: sample 38, t = 7.6 h" in log.summary()
    page = log._repr_html_()
    for word in ("Log tank", "level", "m^3/h", "power", "least"):
        assert word in page
    assert simulate(build(tank(), profile="test"), [1.0], 0)._repr_html_()


@pytest.mark.usefixtures("compiler")
def test_notebooks_show_problem_and_controller() -> None:
    ocp = tank()
    page = ocp._repr_html_()
    for word in (
        "OCP tank",
        "N=10 intervals over 2 h",
        "flow",
        "m^3/h",
        "soft, violation v costs 1 v + ½ 1 v²",
        "½ (target)²",
        "1.4",
    ):
        assert word in page
    assert "still missing" not in page
    assert repr(ocp) == ("<OCP tank: N=10 intervals over 2 h; states level; controls flow; parameters leak; rows: 3>")
    ctrl = build(ocp, profile="test")
    ctrl.step([1.0])
    ctrl.set_bounds("power", -0.25, 0.125)
    page = ctrl._repr_html_()
    for word in ("Controller tank", "N=10 intervals over 2 h", "0.125", "1..10", "0..9", "target", "OK: solved"):
        assert word in page


def test_an_unfinished_problem_says_what_is_missing() -> None:
    ocp = OCP("open", N=3)
    assert "still missing: a state, a control, a cost" in ocp._repr_html_()
    r = ocp.state("r", size=20, unit="<m>")
    ocp.dynamics({"r[0]": 0.5 * r[0]}, discrete=True)
    page = ocp._repr_html_()
    assert "the dynamics of r[1], r[2]" in page
    assert "&lt;m&gt;" in page
    assert "... (20 in all)" in repr(ocp)


def test_a_discrete_state_lacks_no_dynamics() -> None:
    ocp = OCP("open", T=1.0, N=3)
    x, mode = ocp.state("x"), ocp.state("mode")
    ocp.dynamics({x: -x}, discrete={mode: 0.5 * mode})
    assert "still missing: a control, a cost" in ocp._repr_html_()


@pytest.mark.parametrize("unit", [5, "h\n", "a\0b", "h*/", "a|b"])
def test_units_of_time_are_printable(unit: object) -> None:
    with pytest.raises(ValueError, match="time_unit must be"):
        OCP("clock", T=1.0, N=2, time_unit=unit)  # type: ignore[arg-type]


def test_files_of_a_package_speak_of_the_unit_of_time() -> None:
    files = generate(tank())
    assert "#define TANK_DT 0.2 /* h: time between samples */" in files["tank.h"]
    assert "/* Call it every 0.2 h. " in files["README.md"]
    assert "10 intervals over 2 h" in files["README.md"]


def test_errors_speak_of_the_unit_of_time() -> None:
    with pytest.raises(ValueError, match="T must be a positive length in h"):
        OCP("clock", T=-1.0, N=2, time_unit="h")
    with pytest.raises(ControllerError, match=r"shifted by 0.2 h before every sample"):
        simulate(build(tank(), profile="test"), [1.0], 1, dt=0.5)
