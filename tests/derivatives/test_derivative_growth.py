"""How the operations grow: exponents over the horizon and over the states; formulas that ignore structure."""

from __future__ import annotations

import pytest

from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.derivative_model import derivative_model
from verification.adjoint import measured, problems

COUNTED = (10, 25, 50, 100, 200, 400, 800)


def operations(N: int, method: str) -> int:
    """Of one gradient of the map; methods with matrices compute them first."""
    counts = measured.counts(problems.discrete_map, N)
    first = counts.sensitivities.total if method in ("forward", "adjoint_matrices") else 0
    return counts.all[f"gradient_{method}"].total + first


@pytest.mark.parametrize(
    ("method", "expected"), [("adjoint", 1), ("adjoint_matrices", 1), ("forward", 2), ("finite_differences", 2)]
)
def test_exponents_of_gradients(method: str, expected: int) -> None:
    """O(N) of the adjoint methods, O(N^2) of the others."""
    found = measured.exponent(COUNTED, [operations(N, method) for N in COUNTED])
    assert found == pytest.approx(expected, abs=0.05)


def test_counts_of_any_horizon_are_those_of_its_own_model() -> None:
    for N in (1, 2, 7):
        case = problems.discrete_map(N)
        own = Counts(derivative_model(case.ocp, case.outputs, None, case.options)).all
        assert measured.counts(problems.discrete_map, N).all == own


@pytest.mark.slow
def test_growth_with_the_states() -> None:
    """6.7 is quadratic in nx, 6.8 linear, so that it wins from some nx on, later for longer horizons."""

    def model(N: int, nx: int) -> problems.Case:
        return problems.rod(nx, N, unroll="none")

    small, large = (measured.integration(model(10, nx)) for nx in (40, 80))
    assert large[0] / small[0] == pytest.approx(4, abs=0.3)
    assert large[1] / small[1] == pytest.approx(2, abs=0.1)
    found = [measured.crossover(lambda nx, N=N: model(N, nx), N, 64) for N in (4, 8)]
    assert 2 < found[0] < found[1] < 64
    for N, nx in zip((4, 8), found, strict=True):
        before, after = measured.integration(model(N, nx - 1)), measured.integration(model(N, nx))
        assert before[0] <= before[1]
        assert after[1] < after[0]
