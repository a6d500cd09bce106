"""Theorem 8, Corollary 9 and Figure 1, in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from verification.economic import evaporation


def test_theorem_8_and_corollary_9() -> None:
    assert evaporation.reduced_hessian_error() <= 1e-8
    assert evaporation.first_step_error() <= 1e-8
    assert evaporation.first_step_dual_error(False) == pytest.approx(0.508, rel=0.01)
    assert evaporation.first_step_dual_error(True) <= 1e-8


def test_exact_hessian_needs_the_active_rows() -> None:
    """Without them its reduced Hessian has a negative eigenvalue for every node where the row is active."""
    assert evaporation.negative_eigenvalues(with_rows=True) == 0
    assert evaporation.negative_eigenvalues(with_rows=False) == evaporation.N - 1


@pytest.mark.slow
def test_figure_1() -> None:
    """Sizes of the first steps as printed in the documentation; order of the schemes; an admissible solution."""
    runs = evaporation.figure1()
    np.testing.assert_allclose(runs["tuned"][1][:3], [191.9, 31.36, 0.823], rtol=0.01)
    assert evaporation.figure1_order() == 1
    assert evaporation.admissible(runs["exact"][0]) == 1
    np.testing.assert_allclose(runs["tuned"][0].u, runs["exact"][0].u, rtol=0, atol=1e-8)
    exact = runs["exact"][1]
    assert exact[4] < 10 * exact[3] ** 2  # quadratic
