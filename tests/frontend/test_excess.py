"""smooth_excess: its limits, its derivatives, and what it refuses."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, ProblemError, smooth_excess
from nmpc_codegen.frontend.classify import classify


def test_it_is_the_distance_from_the_interval_up_to_its_width() -> None:
    h = np.linspace(-3, 3, 61)
    x = ca.SX.sym("x")
    s = ca.Function("s", [x], [smooth_excess(-1, x, 2, 1e-3)])
    exact = np.maximum(np.maximum(-1 - h, h - 2), 0)
    found = np.array([float(s(v)) for v in h])
    assert np.all(found > exact)
    assert np.abs(found - exact).max() <= 0.51e-3


def test_sides_without_a_bound_cost_nothing_and_derivatives_exist_everywhere() -> None:
    x, w = ca.SX.sym("x", 2), ca.SX.sym("w")
    value = smooth_excess([-np.inf, 0], x, [1, np.inf], w)
    at = ca.Function("s", [x, w], [value, ca.jacobian(value, x), ca.hessian(ca.sum1(value), x)[0]])
    for point in ([1.0, 0.0], [-50.0, 50.0], [1e100, -1e100]):
        v, J, H = (np.asarray(r) for r in at(point, 0.1))
        assert np.isfinite(v).all()
        assert np.isfinite(J).all()
        assert np.all(np.diag(H) >= 0)
    assert float(at([1.0, 5.0], 0.1)[0][0]) == 0.05


def test_a_cost_of_excesses_is_smooth_for_the_compiler() -> None:
    ocp = OCP("excess", T=1.0, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.stage_cost(u**2 + 10 * smooth_excess(-0.5, x, 0.5, 0.01), integrate=True)
    assert classify(ocp).path.cost_rate is not None


def test_symbols_of_either_kind() -> None:
    x = ca.MX.sym("x", 2)
    value = ca.Function("s", [x], [smooth_excess([-np.inf, 0], x, [1, np.inf], 0.1)])([3.0, -2.0])
    np.testing.assert_allclose(np.asarray(value).ravel(), [2, 2], atol=3e-3)


def test_what_makes_no_sense_is_refused() -> None:
    x = ca.SX.sym("x", 2)
    with pytest.raises(ProblemError, match="exceeds upper"):
        smooth_excess(1, x, 0, 0.1)
    with pytest.raises(ProblemError, match="width must be positive"):
        smooth_excess(0, x, 1, 0.0)
    with pytest.raises(ProblemError, match="width must be numbers"):
        smooth_excess(0, x, 1, np.nan)
    with pytest.raises(ProblemError, match="width has shape"):
        smooth_excess(0, x, 1, [0.1, 0.2])
    with pytest.raises(ProblemError, match="width must be a scalar"):
        smooth_excess(0, x, 1, x)
    with pytest.raises(ProblemError, match="lower has shape"):
        smooth_excess([0, 0, 0], x, 1, 0.1)
