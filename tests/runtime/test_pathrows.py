"""General path rows along a closed loop: their values against NumPy, and their axes in the plot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib as mpl
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    Controller,
    FullCondensing,
    NoCondensing,
    Online,
    Options,
    RealTimeIteration,
    build,
    simulate,
)
from nmpc_codegen.runtime.records.log import Log

mpl.use("Agg")


def cart(name: str) -> OCP:
    """A cart with rows of every kind; the first four have their own axes."""
    ocp = OCP(name, T=2.0, N=5)
    p, v = ocp.state("p", initial=1.0), ocp.state("v")
    F, m = ocp.control("F"), ocp.parameter("m", value=0.5)
    ocp.dynamics({p: v, v: F / m})
    ocp.least_squares(ca.vertcat(p, v, F), [10, 1, 0.1])
    ocp.subject_to(-1, F, 1)
    ocp.subject_to(-2, F * v, 2, name="power")
    ocp.subject_to(-3, v + 0.1 * p**2 + m, 3, name="speed", soft=(1e2, 1e1))
    ocp.subject_to(-4, F + p, 4, at="start", name="first")
    ocp.subject_to(-5, F - p, 5, at=[1, 3], name="some")
    ocp.subject_to(-0.9, v, 0.8, soft=(10, 1))
    ocp.subject_to(-0.7, F, 0.6, soft=(10, 1), name="gentle")
    ocp.subject_to(-7, p * v, 7, at="end")
    ocp.subject_to(-8, F * p, 8, at=[2], name="alone")
    return ocp


NAMES = ("power", "speed", "first_start", "some", "gentle")
OPTIONS: dict[str, Options] = {
    "condensed": Options(condensing=FullCondensing()),
    "stages": Options(condensing=NoCondensing(), online=Online(parameter="shared")),
    "moved": Options(algorithm=RealTimeIteration(shift="repeat")),
    "fixed": Options(online=Online(parameter="fixed", bounds="fixed")),
    "single": Options(precision="single"),
}


def values(log: Log, m: Any) -> Any:
    """The rows with their own axes, in NumPy."""
    p, v, F = log.x[:-1, 0], log.x[:-1, 1], log.u[:, 0]
    return np.column_stack([F * v, v + 0.1 * p**2 + m, F + p, F - p, F])


@pytest.mark.parametrize("case", OPTIONS)
def test_values_along_the_loop(case: str) -> None:
    """For a shifted plan, and for a mass of the model that changes during the run."""
    ctrl = build(cart(f"cart_{case}"), OPTIONS[case], profile="test")
    changes = case != "fixed"

    def heavier(k: int, c: Controller) -> None:
        if changes and k == 6:
            c.set_parameter("m", 0.75)

    twin = ctrl.copy()
    log = simulate(ctrl, [1.0, 0.0], 12, before=heavier)
    assert tuple(trace.name for trace in log.rows) == NAMES
    m = np.where((np.arange(12) >= 6) & changes, 0.75, 0.5)
    np.testing.assert_allclose(log.h, values(log, m), rtol=1e-5 if case == "single" else 1e-13, atol=1e-6)
    general = [i for i, limit in enumerate(log.limits) if limit.array == "h"]
    np.testing.assert_allclose(log.upper[:, general], [[2, 3, 4, 5, 0.6]] * 12, rtol=1e-7)
    np.testing.assert_allclose(log.lower[:, general], [[-2, -3, -4, -5, -0.7]] * 12, rtol=1e-7)
    for k in range(12):  # the loop is not disturbed
        heavier(k, twin)
        np.testing.assert_array_equal(twin.step(log.x[k]), log.u[k])


def test_axes_of_rows(tmp_path: Path) -> None:
    """Each row has its own axis with its present bounds; a soft row on a bare state is drawn with the state."""
    ctrl = build(cart("cart_condensed"), OPTIONS["condensed"], profile="test")
    ctrl.set_bounds("power", -0.1, 0.1)
    log = simulate(ctrl, [1.0, 0.0], 12)
    figure = log.plot(tmp_path / "rows.png")
    axes = {axis.get_ylabel(): axis for axis in figure.axes if axis.get_visible()}
    assert tuple(axes) == ("p", "v", "F", *NAMES, "computing time\n[µs]")
    drawn = axes["power"].lines[0]
    np.testing.assert_array_equal(drawn.get_ydata(), log.h[:, 0])
    np.testing.assert_array_equal(drawn.get_xdata(), log.t[:-1])
    assert sorted(line.get_ydata()[0] for line in axes["power"].lines[1:]) == [-0.1, 0.1]
    assert all(line.is_dashed() for line in axes["power"].lines[1:])
    simple = {limit.name: (limit.array, limit.column, limit.soft) for limit in log.limits}
    assert simple["v"] == ("x", 1, True)
    assert simple["F"] == ("u", 0, False)
    np.testing.assert_array_equal(log.lower[:, [limit.name == "v" for limit in log.limits]], [[-0.9]] * 12)


def test_no_samples(tmp_path: Path) -> None:
    log = simulate(build(cart("cart_condensed"), OPTIONS["condensed"], profile="test"), [1.0, 0.0], 0)
    assert log.h.shape[0] == 0
    log.plot(tmp_path / "empty.png")


def test_a_package_without_rows_or_linearisation(toy: Controller) -> None:
    log = simulate(toy, [1.0, 0.0], 3)
    assert (log.h.shape, log.rows) == ((3, 0), ())
    assert str(log) == log.summary()
    assert repr(log) == "<Log toy: 3 samples over 0.3 s, OK 3; x (4, 2), u (3, 1)>"
