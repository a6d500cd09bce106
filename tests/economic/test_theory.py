"""Theorem 8, Corollary 9, Lemmas 4 to 6 and Figures 1 and 2, by the prototypes of the benchmark."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import require_tool

from benchmarks.lib.economic import artificial, evaporation, figure3, figure4, rotation, timing


def test_theorem_8_and_corollary_9() -> None:
    assert evaporation.reduced_hessian_error() <= 1e-8
    assert evaporation.first_step_error() <= 1e-8
    assert evaporation.first_step_dual_error(False) == pytest.approx(0.508, rel=0.01)
    assert evaporation.first_step_dual_error(True) <= 1e-8


def test_exact_hessian_needs_the_active_rows() -> None:
    """Without them its reduced Hessian has a negative eigenvalue for every node where the row is active."""
    assert evaporation.negative_eigenvalues(with_rows=True) == 0
    assert evaporation.negative_eigenvalues(with_rows=False) == evaporation.N - 1


def test_lemma_4() -> None:
    assert rotation.lemma4_error(rotation.linear) <= 1e-8
    assert rotation.lemma4_error(rotation.quadratic) <= 1e-8


def test_lemma_5() -> None:
    """Equal iterates for a linear storage function on the map and for any on the nodes."""
    assert rotation.lemma5_error() <= 1e-8


def test_lemma_5_does_not_hold_for_a_nonlinear_storage_function_on_the_map() -> None:
    """The first iterate, from a plan without gaps, agrees; the second is 1.57 kPa apart; later ones converge."""
    first, second, third, fourth = rotation.distances(rotation.quadratic, "map", exact=False)
    assert first <= 1e-9
    assert second > 1
    assert rotation.control_distance() == pytest.approx(1.57, rel=0.01)
    assert second > third > fourth


def test_lemma_6() -> None:
    """Exact Hessians: the first iterate agrees for consistent multipliers, the second does not."""
    first, second, *_ = rotation.distances(rotation.quadratic, "map", exact=True)
    assert first <= 1e-9
    assert second > 1e-3


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


def test_figure_2() -> None:
    """Both forms have one solution; the rotated one needs no more steps."""
    original, rotated = artificial.run(False), artificial.run(True)
    np.testing.assert_allclose(original.plan.u, rotated.plan.u, rtol=0, atol=1e-6)
    assert evaporation.steps_to(rotated.sizes, 1e-6) <= evaporation.steps_to(original.sizes, 1e-6)


def test_generated_controllers_of_figure_3() -> None:
    """50 samples: every sample is solved, M follows the NumPy steps with H; so short a run favours the identity."""
    found, failed, last = figure3.losses(2.0, 50, figure3.SCHEMES[:4])
    assert failed == 0
    assert 0.3 < last < 1.5
    assert abs(found[figure3.INDEFINITE] - found["M"]) <= 1e-8
    assert abs(found["exact"] - found["M"]) <= 1e-5
    assert found["identity"] < 0, "its pressure has not settled yet"


@pytest.mark.slow
def test_figure_3() -> None:
    found, _, last = figure3.losses(2.0)
    assert figure3.ordered(found)
    assert abs(found["exact"] - found["M"]) <= 1e-6
    assert last <= 1e-3


@pytest.mark.slow
def test_figure_4() -> None:
    """A foreseen side step of 1 m: exact and M agree, LETEMPC is worse, the identity diverges."""
    assert figure4.ordered(figure4.losses(1.0, True))


def test_times_in_c() -> None:
    """The evaporation process with M: every sample is solved, and a push needs QP iterations."""
    require_tool("cc")
    loop = timing.LOOPS[1]
    t = timing.timed(loop, loop.tuned(), exact=False, runs=1, steps=60)
    assert t.failed == 0
    assert t.qp_iterations > 0
    assert 0 < t.feedback < t.total
