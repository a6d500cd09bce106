"""init() stores the declared values, whatever they are.

GCC 12 with AVX-512 turns the memcpy of a constant table into a broadcast of its first number if equal numbers are
followed by zeros only; generated code copies such tables by loops.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    AdjointShooting,
    AugmentedLagrangian,
    NoCondensing,
    Options,
    RealTimeIteration,
    RiccatiActiveSet,
    build,
)


@pytest.mark.few(4)
@pytest.mark.parametrize("equal", [1, 2, 3, 5, 7, 11])
@pytest.mark.parametrize("profile", ["fast", "test"])
def test_tables_that_begin_with_equal_numbers_and_end_with_zeros(equal: int, profile: str, compiler: None) -> None:
    declared = np.where(np.arange(12) < equal, 0.5, 0.0)
    ocp = OCP("equal", T=1.0, N=2)
    x = [ocp.state(f"x{i}", initial=value) for i, value in enumerate(declared)]
    u = ocp.control("u")
    ocp.dynamics({x_i: u - x_i for x_i in x})
    ocp.least_squares(ca.vertcat(*x, u), weight=np.eye(13), reference=[*declared, 0.0])
    ocp.subject_to(-1, u, 1)
    c = build(ocp, Options(condensing=NoCondensing(), qp=RiccatiActiveSet()), profile=profile)
    np.testing.assert_array_equal(c.x, np.tile(declared, (3, 1)))
    np.testing.assert_array_equal(c.view("xhat"), declared)
    np.testing.assert_array_equal(c.view("yref"), np.tile([*declared, 0.0], (2, 1)))
    np.testing.assert_array_equal(c.u, 0.0)


def _plant(way: str) -> OCP:
    """A pump and a heater, whose references are stated beside their residuals, or in them."""
    ocp = OCP("plant", T=2.0, N=10)
    h, T = ocp.state("h", initial=0.2), ocp.state("T", initial=20.0)
    s, q = ocp.control("s"), ocp.control("q")
    rated = ocp.parameter("rated", value=1.5)
    ocp.dynamics({h: s * s - h, T: q - (T - 15)})
    if way == "beside":
        for signal, reference, weight in ((h, 1.0, 1.0), (s, 1.5, 0.1), (T, 25.0, 1.0), (q, 4.0, 0.1)):
            ocp.least_squares(signal, weight=weight, reference=reference)
    else:
        for residual, weight in ((h - 1, 1.0), (s - rated, 0.1), (T - 25, 1.0), (2 * (q - 4), 0.1 / 4)):
            ocp.least_squares(residual, weight=weight)
    ocp.subject_to(-5, s, 5)
    return ocp


@pytest.mark.parametrize("algorithm", [RealTimeIteration(), AugmentedLagrangian(), AdjointShooting()])
def test_references_stated_in_both_ways_fly_alike(algorithm: RealTimeIteration) -> None:
    """The first plan, and the sizes that references tell."""
    both = [build(_plant(way), Options(algorithm=algorithm), "test") for way in ("beside", "inside")]
    assert both[0].description.scales == both[1].description.scales
    x = np.array([0.2, 20.0])
    for c in both:
        np.testing.assert_array_equal(c.u, np.tile([1.5, 4.0], (10, 1)))
    for _ in range(20):
        u = [c.step(x) for c in both]
        np.testing.assert_allclose(u[0], u[1], rtol=1e-9, atol=1e-9)
        x = np.ravel(both[0].integrate(x, u[0], 0.2))


def test_a_reset_begins_where_parameters_and_references_of_residuals_want_it() -> None:
    """s - rated = its reference, 2 (q - 4) = its reference; a bound counts."""
    c = build(_plant("inside"), profile="test")
    c.set_parameter("rated", 2.5)
    c.set_reference([0.0, 0.25, 0.0, 1.0])
    c.reset()
    np.testing.assert_allclose(c.u, np.tile([2.75, 4.5], (10, 1)))
    c.set_parameter("rated", 9.0)
    c.reset()
    np.testing.assert_allclose(c.u[:, 0], 5.0)


def test_a_residual_that_does_not_tell_its_control() -> None:
    """Two controls, a state, a square, or a factor of 0: the plan begins at 0."""
    for name, residual in {
        "two": lambda u, v, x, g: u + v - 1,
        "state": lambda u, v, x, g: u - x,
        "square": lambda u, v, x, g: u * u - 1,
        "factor": lambda u, v, x, g: g * u - 1,
    }.items():
        ocp = OCP(f"of_{name}", T=1.0, N=3)
        x, u, v = ocp.state("x", initial=1.0), ocp.control("u"), ocp.control("v")
        g = ocp.parameter("g", value=0.0)
        ocp.dynamics({x: u + v - x})
        ocp.least_squares(residual(u, v, x, g), weight=1.0)
        ocp.least_squares(ca.vertcat(x, 0.1 * u, v), weight=0.1)
        c = build(ocp, profile="test")
        np.testing.assert_array_equal(c.u, 0.0)
