"""Sizes of states, controls, rows and costs, from what a problem declares."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from nmpc_codegen import OCP, Options, ProblemError, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.scales import Scales, scales


def cart(**more: float) -> OCP:
    """p'' = F / 2."""
    ocp = OCP("cart", T=2.0, N=10)
    p, v, F = ocp.state("p", **more), ocp.state("v"), ocp.control("F")
    ocp.dynamics({p: v, v: F / 2})
    ocp.least_squares(ca.vertcat(p, v, F), weight=[4, 1, 0.01])
    return ocp


def of(ocp: OCP) -> Scales:
    return scales(classify(ocp))


def test_declared_scales_are_taken() -> None:
    """Whatever bounds and initial values say."""
    ocp = cart(scale=7.0, initial=100.0)
    ocp.subject_to(-50, ocp.x[0], 50)
    assert of(ocp).z[0] == 7.0


def test_bounds_initial_values_and_references() -> None:
    """Half the width, the magnitude of a single bound, the largest of all."""
    ocp = OCP("sizes", T=1.0, N=4)
    a, b, c, d = ocp.state("a", initial=0.5), ocp.state("b"), ocp.state("c"), ocp.state("d", initial=-3)
    u = ocp.control("u")
    ocp.dynamics({a: u, b: u, c: u, d: u})
    ocp.least_squares(ca.vertcat(c, u), weight=1, reference=[-9, 0])
    ocp.subject_to(290, a, 310)
    ocp.subject_to(-np.inf, b, 20)
    ocp.subject_to(-2, u, 6)
    np.testing.assert_array_equal(of(ocp).z, [10, 20, 9, 3, 4])


def test_what_a_control_of_its_size_changes() -> None:
    """States of which nothing is known: the response of one interval, recomputed by the matrix exponential; a control
    of which nothing is known: what changes a known state by its size over the horizon."""
    ocp = cart()
    ocp.subject_to(-3, ocp.u, 3)
    step = expm(0.2 * np.array([[0, 1, 0], [0, 0, 0.5], [0, 0, 0]]))[:2, 2]
    np.testing.assert_allclose(of(ocp).z, [*(3 * step), 3], rtol=1e-12)
    z = of(cart(initial=1.0)).z
    assert z[2] == pytest.approx(1.0 / (0.25 * 2.0**2))  # p(2) = F / 4 t^2
    np.testing.assert_array_equal(of(cart()).z[2], 1.0)


@pytest.mark.parametrize(
    ("row", "size", "offset"),
    [
        (lambda p, v, u: u**2, 4.0, 0.0),
        (lambda p, v, u: u**2 - 16, 4.0, -16.0),
        (lambda p, v, u: u**2 / 16 - 1, 0.25, -1.0),
        (lambda p, v, u: 3 - 2 * (v - 1), 10.0, 5.0),
        (lambda p, v, u: p * (p - 3), 18.0, 0.0),
        (lambda p, v, u: ca.sqrt(p**2 + v**2), np.sqrt(34), 0.0),
        (lambda p, v, u: ca.cos(p) * v, 5.0, 0.0),
        (lambda p, v, u: ca.if_else(p > 0, v, -v), 10.0, 0.0),
        (lambda p, v, u: ca.fabs(p) ** 1.5, 3**1.5, 0.0),
    ],
)
def test_rows(row: object, size: float, offset: float) -> None:
    """Terms at the scales of their variables (3, 5, 2), which do not cancel, beside a constant."""
    ocp = OCP("rows", T=1.0, N=4)
    p, v, u = ocp.state("p", scale=3), ocp.state("v", scale=5), ocp.control("u", scale=2)
    ocp.dynamics({p: v, v: u})
    ocp.least_squares(u, weight=1)
    ocp.subject_to(-np.inf, row(p, v, u) + 0 * u, 10)  # type: ignore[operator]
    found = of(ocp)
    assert found.rows[0] == pytest.approx(size)
    assert found.offsets[0] == pytest.approx(offset)


def test_costs() -> None:
    """C = max W_ii scale_i^2, and forces sqrt(C H); a residual has a scale of its own."""
    ocp = OCP("costs", T=1.0, N=4)
    p, u = ocp.state("p", scale=3), ocp.control("u", scale=2)
    ocp.dynamics({p: u})
    ocp.least_squares(ca.vertcat(p - 1, u), weight=[2, 0.5])
    found = of(ocp)
    assert found.cost == 18.0
    np.testing.assert_allclose(found.forces, [np.sqrt(18 * 2), np.sqrt(18 * 0.5)])
    ocp.least_squares(p * u, weight=1, scale=10.0)
    assert of(ocp).cost == 100.0


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan, [1.0, 2.0], "much"])
def test_scales_that_are_none(value: object) -> None:
    ocp = OCP("none", T=1.0, N=4)
    with pytest.raises(ProblemError, match="state 'p': scale"):
        ocp.state("p", scale=value)
    with pytest.raises(ProblemError, match="control 'u': scale"):
        ocp.control("u", scale=value)


def stick(**more: float) -> OCP:
    """A pendulum upright, whose open loop grows by e^21 over the horizon."""
    ocp = OCP("stick", T=3.0, N=40)
    th, w, u = ocp.state("th", **more), ocp.state("w", **more), ocp.control("u")
    ocp.dynamics({th: w, w: 49 * ca.sin(th) + u})
    ocp.least_squares(ca.vertcat(th, w, u), weight=[10, 1, 0.1])
    ocp.subject_to(-20, u, 20)
    return ocp


def test_growth_is_no_size() -> None:
    """A declared scale stays, and an unknown one is no larger than what a control could do without growth."""
    np.testing.assert_array_equal(of(stick(scale=0.5)).z[:2], 0.5)
    assert 1e-3 < of(stick()).z[0] < 1.0
    small = build(stick(), Options(precision="single"), profile="test")
    np.testing.assert_allclose(small.step([4e-4, 0]), build(stick(), profile="test").step([4e-4, 0]), rtol=1e-3)


def test_bounds_that_stand_for_none() -> None:
    """They are no size, and change no control."""
    controls = []
    for bound in (np.inf, 1e20):
        ocp = OCP("free", T=5.0, N=10)
        x, u = ocp.state("x"), ocp.control("u")
        ocp.dynamics({x: u})
        ocp.least_squares(ca.vertcat(x, u), weight=[10, 1])
        ocp.subject_to(-bound, x, bound)
        ocp.subject_to(-bound, u, bound)
        assert np.max(of(ocp).z) <= 1.0
        controls.append(build(ocp, profile="test").step([5.0]))
    np.testing.assert_allclose(controls[0], controls[1], rtol=1e-9)


def test_an_initial_value_that_is_a_rounding_error() -> None:
    """As one that was computed: what a control changes is the size."""
    ocp = cart(initial=1e-20)
    ocp.subject_to(-3, ocp.u, 3)
    plain = cart()
    plain.subject_to(-3, plain.u, 3)
    np.testing.assert_array_equal(of(ocp).z, of(plain).z)


def test_discrete_maps_and_costs_of_all_stages() -> None:
    """x+ = 2 x + u without its growth; the start and the longest interval count."""
    ocp = OCP("map", N=5)
    x, u = ocp.state("x"), ocp.control("u", scale=4.0)
    ocp.dynamics({x: 2 * x + u}, discrete=True)
    ocp.least_squares(u, weight=1)
    assert of(ocp).z[0] == pytest.approx(4.0)
    ocp = OCP("start", intervals=[0.1, 0.5])
    x, u = ocp.state("x", scale=2.0), ocp.control("u", scale=1.0)
    ocp.dynamics({x: u})
    ocp.least_squares(u, weight=6.0, scale_with_dt=True)
    assert of(ocp).cost == 3.0
    ocp.free_initial(x)
    ocp.start_least_squares(x - 1, weight=5.0)
    assert of(ocp).cost == 20.0
    ocp.stage_cost(50 * u**2, integrate=True)
    assert of(ocp).forces[1] == pytest.approx(np.sqrt(25 * (3.0 + 50)))
