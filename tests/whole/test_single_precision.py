"""Single precision: a start at the edge of what the rows allow, and the default tolerance of solve()."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from examples import crane
from nmpc_codegen import OCP, Options, Status, build


@pytest.mark.few(3)
@pytest.mark.parametrize("solve", [True, False])
@pytest.mark.parametrize("start", [2.00400734, 2.00399852, 2.00400829, 2.00399804])
def test_a_start_at_the_edge(start: float, solve: bool) -> None:
    """x_N = 0 can just, or just not, be reached, which rounding decides: the crane moves as in double precision."""
    single = build(crane.build_ocp(), Options(precision="single", solve=solve), profile="test")
    double = build(crane.build_ocp(), profile="test")
    x = np.array([start, 0, 0, 0])
    for sample in range(50):
        u = single.step(x)
        if sample == 0:
            np.testing.assert_allclose(u, double.step(x), atol=1e-3)
        assert single.status == Status.OK or (sample == 0 and single.status == Status.RELAXED)
        x = double.integrate(x, u, 0.3)
    assert np.max(np.abs(x)) < 1e-2


def test_the_default_tolerance_is_within_reach() -> None:
    """And the solution is that of double precision, as far as single precision carries."""
    ocp = OCP("vdp", T=2.0, N=20)
    x, v, u = ocp.state("x", initial=1.0), ocp.state("v", initial=0.5), ocp.control("u")
    ocp.dynamics({x: v, v: (1 - x**2) * v - x + u})
    ocp.least_squares(ca.vertcat(x, v, u), weight=[1, 1, 0.1])
    ocp.terminal_least_squares(ca.vertcat(x, v), weight=10)
    ocp.subject_to(-1, u, 1)
    single = build(ocp, Options(precision="single"), profile="test").solve([1, 0.5])
    double = build(ocp, profile="test").solve([1, 0.5])
    assert single.status == double.status == Status.OK
    assert double.kkt.relative <= 1e-8 < single.kkt.relative <= 1e-4
    np.testing.assert_allclose(single.u, double.u, atol=2e-3)
