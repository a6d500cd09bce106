"""init() stores the declared values, whatever they are.

GCC 12 with AVX-512 turns the memcpy of a constant table into a broadcast of its first number if equal numbers are
followed by zeros only; generated code copies such tables by loops.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, NoCondensing, Options, RiccatiActiveSet, build


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
