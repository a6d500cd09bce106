"""Operations of derivative functions are counted over horizons and states, and exponents are fitted to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.derivative_model import DerivativeModel, derivative_model
from verification.adjoint.problems import Case

#: Exponents are fitted to horizons of at least this length.
LEAST = 100

#: Column of Table 6.7: (N, t_f in hours) of its rows, the step length in hours, the powers that the thesis expects.
SCENARIOS: dict[str, tuple[list[tuple[int, float]], float, tuple[int, int]]] = {
    "t_f = 1 h": ([(5 * i, 1.0) for i in range(1, 21)], 1 / 1000, (0, 1)),
    "N = 100": ([(100, i / 20) for i in range(1, 21)], 1 / 2000, (1, 1)),
    "T_s = 1/100 h": ([(5 * i, i / 20) for i in range(1, 21)], 1 / 200, (1, 2)),
}


@cache
def _model(make: Callable[[int], Case]) -> DerivativeModel:
    case = make(LEAST)
    return derivative_model(case.ocp, case.outputs, None, case.options)


def counts(make: Callable[[int], Case], N: int) -> Counts:
    """Return the counts of a case for the horizon N; the functions of an interval are the same for all horizons."""
    model = _model(make)
    problem = replace(model.problem, N=N, dt=(model.problem.dt[0],) * N)
    return Counts(replace(model, problem=problem))


def structure_ignored(counts: Counts) -> int:
    """Count the operations of the impulse response matrix if block (n, k) has n - k - 1 products with A of its own."""
    products = sum((counts.N - d) * (d - 1) for d in range(1, counts.N))
    return counts.insertion.total + 2 * counts.nx**2 * counts.nu * products


def exponent(horizons: Sequence[float], values: Sequence[float], least: float = LEAST) -> float:
    """Return the slope of log(value) over log(N), N >= ``least``."""
    pairs = [(N, v) for N, v in zip(horizons, values, strict=True) if least <= N]
    logs = np.log(np.array(pairs, float))
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])


def integration(case: Case) -> tuple[int, int]:
    """Count the operations of Algorithms 6.7 and 6.8."""
    counts = Counts(derivative_model(case.ocp, case.outputs, None, case.options))
    return counts.sensitivities.total, counts.responses.total


def crossover(make: Callable[[int], Case], N: int, most: int = 100) -> int:
    """Return the least nx from which 6.8 takes fewer operations than 6.7, by bisection.

    The difference of their operations has one sign change.
    """

    def alternative_wins(nx: int) -> bool:
        before, after = integration(make(nx))
        return after < before

    low, high = 2, most
    if not alternative_wins(high):
        return -1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if alternative_wins(middle) else (middle, high)
    return high
