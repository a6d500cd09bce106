"""gcc and clang, from -O0 to -O3 and for AVX-512, produce the same controller; only rounding differs."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import require_tool

from examples import crane
from nmpc_codegen import Options, build, generate
from tests.verification import disagreement
from tests.verification.disagreement import LIMIT, builds, replays
from verification import scenarios
from verification.rendered import texts
from verification.routes import PURE
from verification.samples import SAMPLES
from verification.timed import TIMED, Sample

CASES = {sample.name.removeprefix("timed "): sample for sample in TIMED}
#: As a plain export is compiled for firmware, where GCC 12 has vectorised two sums of a loop wrongly.
CASES["pure crane"] = Sample("timed crane", crane.build_ocp, Options(algorithm=PURE, solve=False))
CASES["cart_pole"] = Sample("cart_pole", scenarios.CART_POLE.make, scenarios.CART_POLE.options)

QUICK = ("pure crane",)


@pytest.mark.parametrize(
    "name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in CASES if name not in QUICK)]
)
def test_builds_agree(name: str) -> None:
    for tool in ("gcc", "clang"):
        require_tool(tool)
    sample = CASES[name]
    x = disagreement.record(build(sample.make(), sample.options), scenarios.of_sample(sample), 60)
    u, status = replays(generate(sample.make(), sample.options), x, builds())
    assert disagreement.disagreement(u) <= LIMIT
    assert (status == status[0]).all()


def test_a_wrong_build_is_seen() -> None:
    """A package without the bounds does not agree; NaN is no agreement."""
    require_tool("gcc")
    named = {sample.name: sample for sample in SAMPLES}
    x = np.random.default_rng(1).uniform(-1, 1, (6, 2))
    two = [("gcc", "-O0"), ("gcc", "-O1")]
    u, status = replays(texts(named["controls dense"]), x, two)
    assert u.shape == (2, 6, 1)
    assert status.shape == (2, 6)
    assert disagreement.disagreement(u) <= 1e-5  # single precision
    other, _ = replays(texts(named["bare dense"]), x, two[:1])
    assert disagreement.disagreement(np.concatenate([u[:1], other])) > 1e-3
    assert np.isnan(disagreement.disagreement(np.array([[[1.0]], [[np.nan]]])))
