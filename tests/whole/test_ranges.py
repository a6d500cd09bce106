"""Bounds of parameters and ranges of initial states: what is refused, and warnings at their corners."""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    ControllerError,
    ExplicitRungeKutta,
    Online,
    Options,
    ProblemError,
    ProblemWarning,
    Status,
    export,
    generate,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.runtime.open_folder import open_package


def mass(bounds: Any = (0.1, 10.0), of_k: Any = None) -> OCP:
    ocp = OCP("mass", T=1.0, N=5)
    x, v, f = ocp.state("x", initial=1.0), ocp.state("v"), ocp.control("f")
    m, k = ocp.parameter("m", value=0.5, bounds=bounds), ocp.parameter("k", size=2, value=[1.0, 2.0], bounds=of_k)
    ocp.dynamics({x: v, v: (f - k[0] * x - k[1] * v) / m})
    ocp.least_squares(ca.vertcat(x, v, f), weight=[1, 1, 0.1])
    return ocp


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("layout", ["node", "shared"])
def test_values_outside_of_the_bounds_are_refused_and_nothing_is_written(layout: Any, tmp_path: Any) -> None:
    export(mass(), Options(online=Online(parameter=layout)), tmp_path)
    ctrl = open_package(tmp_path, profile="test")
    before = ctrl._memory.copy()
    for call in (
        lambda: ctrl.set_parameter("m", -1.0),
        lambda: ctrl.set_parameter("m", 10.1),
        lambda: ctrl.set_parameters({"k": 3.0}, m=0.0),
    ):
        with pytest.raises(ControllerError, match=r"parameter 'm': .* is outside of 0\.1 \.\. 10, its bounds"):
            call()
    number = ctrl._package.ffi.new("mass_real[]", [-1.0])
    values = ctrl._package.ffi.new("mass_real[]", [1.0, 1.0, np.nan])
    assert Status(ctrl._call("set_parameter", ctrl._s, 0, -1, number)) == Status.BAD_ARGUMENT
    if layout == "node":
        assert Status(ctrl._call("set_parameter_range", ctrl._s, 0, 0, 3, values)) == Status.BAD_ARGUMENT
        with pytest.raises(ControllerError, match="is outside of"):
            ctrl.set_parameter("m", [1.0, 2.0, 3.0, 4.0, 5.0, 11.0])
    np.testing.assert_array_equal(ctrl._memory, before)
    ctrl.set_parameter("m", 10.0)
    assert "0.1 .. 10" in (tmp_path / "mass.h").read_text()


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ((1.0, 2.0), r"parameter 'm': bounds: the declared value 0\.5 is not between 1 and 2"),
        ((2.0, 1.0), "is not between"),
        (3.0, r"must be \(lower, upper\)"),
        (("a", 2.0), "must be numbers"),
        (([0.1, 0.2], 2.0), "has shape"),
    ],
)
def test_bounds_that_are_no_range(bounds: Any, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        mass(bounds)


def test_one_end_may_be_open() -> None:
    sources = generate(mass((0.1, np.inf)))
    assert sources.description.parameters[0].high == (np.inf,)
    assert type(sources.description).from_json(sources.description.to_json()) == sources.description
    assert len(classify(mass((0.1, np.inf))).corners) == 1


def test_corners() -> None:
    found = [where for where, _ in classify(mass((0.1, 10.0), of_k=(0.0, [5.0, 2.0]))).corners]
    assert found[0] == ""
    assert set(found[1:]) == {f"m = {m}, k[0] = {a}, k[1] = {b}" for m in ("0.1", "10") for a in "05" for b in "02"}
    ocp = OCP("many", T=1.0, N=2)
    x, p = ocp.state("x", size=3, initial_range=(-1, 1)), ocp.parameter("p", size=3, bounds=(-1, 1))
    ocp.dynamics({x: p})
    ocp.free_initial(x)
    ocp.least_squares(x, weight=1)
    assert len(classify(ocp).corners) == 1 + 2 * 6


@pytest.mark.parametrize(
    ("where", "message"),
    [
        (
            "unstable",
            r"a reference with m = 0\.005, level = .*, where the model has the eigenvalue -1",
        ),
        ("derivative", r"no finite derivatives: .*sqrt.* \(with level = 0\)"),
    ],
)
def test_warnings_look_at_the_corners(where: str, message: str) -> None:
    ocp = OCP("corner", T=1.0, N=10)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    level = ocp.state("level", initial=1.0, initial_range=(0.0 if where == "derivative" else 0.5, 2.0))
    m = ocp.parameter("m", value=0.5, bounds=(0.005, 1.0) if where == "unstable" else None)
    ocp.dynamics({x: u - 0.5 * x / m, level: u - ca.sqrt(level)})
    ocp.least_squares(ca.vertcat(x, level, u), weight=1, reference=[0, 1, 0])
    with pytest.warns(ProblemWarning, match=message):
        generate(ocp, Options(integrator=ExplicitRungeKutta()))


def test_ranges_without_a_problem_are_silent() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        generate(mass())


def test_a_corner_where_the_model_is_not_finite() -> None:
    with pytest.warns(
        ProblemWarning, match=r"no finite derivatives: the equation of v .*denominator is 0.*\(with m = 0"
    ):
        generate(mass((0.0, 10.0)))
