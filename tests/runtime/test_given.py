"""Definition of a weight: symmetric positive semidefinite up to the rounding of a product of matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.runtime.given import checked_weight


@given(st.integers(0, 10_000), st.integers(1, 12), st.floats(1e-200, 1e200))
def test_a_product_is_a_weight(seed: int, n: int, scale: float) -> None:
    """T' Q T as computed, for any order of its sums; one part in a million is not rounding."""
    rng = np.random.default_rng(seed)
    T, Q = rng.normal(size=(n, n)), np.diag(rng.uniform(0, 1, n))
    W = scale * (T.T @ (Q @ T) + np.triu(rng.uniform(-1, 1, (n, n)), 1) * 8 * np.finfo(float).eps)
    checked = checked_weight(W, "weight", ProblemError)
    np.testing.assert_array_equal(checked, checked.T)
    np.testing.assert_allclose(checked, W, atol=1e-13 * np.abs(W).max())
    if n > 1:
        W[0, 1] += 1e-6 * np.abs(W).max()
        with pytest.raises(ProblemError, match=r"a difference of 1e-06 of the largest entry is more than rounding"):
            checked_weight(W, "weight", ProblemError)
