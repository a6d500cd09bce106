"""A controller at rest: every sample is OK with one QP, and units decide nothing."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import require_tool

from nmpc_codegen import Status
from verification.robustness import at_rest

DRAWS, MORE = 16, 200


@pytest.mark.filterwarnings("ignore:.*AdjointShooting simulates")
@pytest.mark.parametrize(
    "seed", [*range(DRAWS), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(DRAWS, MORE))]
)
def test_samples_at_rest_are_ok(seed: int) -> None:
    require_tool("cc")
    package, out = at_rest.run(seed)
    assert not out.wrong, f"{package}: {out}"


def test_what_is_wrong_is_seen() -> None:
    """A plan of denormal numbers, another control, and a status that is not OK."""
    require_tool("cc")
    (number,) = (n for n, p in enumerate(at_rest.packages()) if str(p) == "standstill default")
    c, out = at_rest._built(number).copy(), at_rest.Outcome()
    c.x[3, 0] = 1e-310
    at_rest._judge(c, out, "here")
    assert set(out.wrong) == {"denormal"}
    other = c.copy()
    other.u[0] += 0.1
    at_rest._compare(c, other, out, "beside")
    assert out.wrong["another control"] == 1
    c.step([np.nan, 0])
    at_rest._judge(c, out, "there")
    assert out.wrong[Status.NOT_FINITE.name] == 1
    assert "here" in str(out)


@pytest.mark.few(5)
@pytest.mark.parametrize("name", at_rest.IN_UNITS)
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, at_rest.UNITS))])
def test_units_decide_nothing(name: str, seed: int) -> None:
    require_tool("cc")
    assert at_rest.differences(name, seed) == []
