"""CasADi's sqpmethod as a peer: one Gauss-Newton step per sample is the step of the generated code."""

from __future__ import annotations

import numpy as np
import pytest

from verification import problems
from verification.peers import SqpMethod, available

X0 = (2.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("plugin", ["qpoases", "daqp", "hpipm"])
def test_peer_takes_the_same_steps(plugin: str) -> None:
    """One full Gauss-Newton step per sample from the same start gives the controls of the generated code."""
    if not available(plugin):
        pytest.skip(f"this CasADi has no {plugin}")
    problem, c = problems.problem("crane_weight"), problems.controller("crane_weight")
    other, x = SqpMethod(problem, qpsol=plugin), np.array(X0)
    c.x[:] = x
    for _ in range(4):
        u = c.step(x)
        np.testing.assert_allclose(other.step(x), u, rtol=0, atol=1e-6)
        x = c.integrate(x, u, 0.3)


def test_peer_refuses_what_it_cannot_solve() -> None:
    with pytest.raises(ValueError, match="neither general rows nor parameters"):
        SqpMethod(problems.problem("path_rows"))
