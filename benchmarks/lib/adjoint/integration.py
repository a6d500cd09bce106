"""Integration of sensitivities, Algorithms 6.7 and 6.8: Figs. 6.11 to 6.13 with Table 6.7, and Fig. 6.15 over states.

The thesis used a variable step size, which starts over at every sample. Here the step length is the same in all rows of
a scenario, up to rounding to whole steps, so that the growth is that of the integration length: t_f for 6.7, N t_f / 2
for 6.8.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.lib.adjoint import drawing, measured, problems
from benchmarks.lib.adjoint.problems import Case
from benchmarks.lib.report import Report
from nmpc_codegen import derivatives
from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.model import derivative_model


@dataclass(frozen=True)
class Scenario:
    """A column of Table 6.7: rows (N, t_f) in hours, the step length, what varies, and the growth that is expected."""

    figure: str
    title: str
    rows: tuple[tuple[int, float], ...]
    step: float  # h
    axis: str
    growth: tuple[float, float]  # exponents of 6.7 and 6.8
    timed: tuple[int, ...]  # positions of rows that are compiled, too

    def case(self, row: int) -> Case:
        """The reactor with the grid of a row."""
        N, length = self.rows[row]
        steps = max(1, math.ceil(length / N / self.step - 1e-9))
        return problems.reactor(N, length / N, steps, unroll="step")


SOME = (1, 9, 19)
SCENARIOS = (
    Scenario(
        "figure_6_11",
        "t_f = 1 h, T_s = t_f / N",
        tuple((5 * i, 1.0) for i in range(1, 21)),
        1 / 1000,
        "N",
        (0.0, 1.0),
        SOME,
    ),
    Scenario(
        "figure_6_12",
        "N = 100, T_s = t_f / N",
        tuple((100, i / 20) for i in range(1, 21)),
        1 / 2000,
        "t_f [h]",
        (1.0, 1.0),
        SOME,
    ),
    Scenario(
        "figure_6_13",
        "T_s = 1/100 h, N = t_f / T_s",
        tuple((5 * i, i / 20) for i in range(1, 21)),
        1 / 200,
        "N",
        (1.0, 2.0),
        SOME,
    ),
)


def integration(case: Case) -> tuple[int, int]:
    """Operations of Algorithms 6.7 and 6.8."""
    counts = Counts(derivative_model(case.ocp, case.outputs, None, case.options))
    return counts.sensitivities.total, counts.responses.total


def measure_scenarios(report: Report, folder: Path) -> None:
    """Figs. 6.11 to 6.13: one picture each, 6.7 on the left, 6.8 on the right, operations above times."""
    for scenario in SCENARIOS:
        operations = [integration(scenario.case(row)) for row in range(len(scenario.rows))]
        seconds = []
        for row in scenario.timed:
            timed = measured.compiled(scenario.case(row))
            all_k = timed.seconds("gradient_alternative")  # 6.8 for all k; 6.9 adds a few products to it
            seconds.append((timed.seconds("sensitivities"), all_k))
        where = [float(N if scenario.axis == "N" else length) for N, length in scenario.rows]
        figure, axes = drawing.axes(2, 2)
        for column, (word, colour) in enumerate((("Algorithm 6.7", "#c2571a"), ("Algorithm 6.8", "#3a8a4f"))):
            counted, timed_at = [o[column] for o in operations], [where[row] for row in scenario.timed]
            axes[0, column].plot(where, counted, "o-", color=colour, markersize=3)
            axes[0, column].set(title=f"{word}: {scenario.title}", ylabel="operations", ylim=(0, 1.1 * max(counted)))
            spent = [1e3 * s[column] for s in seconds]
            axes[1, column].plot(timed_at, spent, "o-", color=colour, markersize=3)
            axes[1, column].set(xlabel=scenario.axis, ylabel="time [ms]", ylim=(0, 1.1 * max(spent)))
            half = len(where) // 2
            slope = measured.exponent(where[half:], counted[half:], 0.0)
            pace = measured.exponent(timed_at[-3:], spent[-3:], 0.0)
            what = f"{word}, {scenario.title}"
            name = f"{scenario.figure}_{'6_7' if column == 0 else '6_8'}"
            off = abs(slope - scenario.growth[column])
            report.add(f"{name}_exponent", slope, case=f"{what}, operations", profile="")
            report.add(
                "integration_exponent_off", off, case=f"{what}: expected {scenario.growth[column]:g}", limit=0.15
            )
            report.add(f"{name}_time_exponent", pace, case=f"{what}, times")
        for axis in axes.flat:
            axis.grid(alpha=0.25)
        drawing.save(figure, folder, scenario.figure)


# Heat rod ------------------------------------------------------------------------------------------------------------

STATES = (5, 10, 20, 40, 60, 80, 100, 140, 200)
TIMED_STATES = (5, 10, 20, 40)
HORIZONS = (5, 10, 20)


def crossover(make: Callable[[int], Case], N: int, most: int = 100) -> int:
    """Least nx from which 6.8 takes fewer operations than 6.7, by bisection; their difference has one sign change."""

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


def _rod(N: int, nx: int) -> Case:
    return problems.rod(nx, N, unroll="none")


def measure_states(report: Report, folder: Path) -> None:
    """Fig. 6.15: both algorithms over the number of states of the rod, N = 10, two controls; where 6.8 wins."""
    N = 10
    operations = [integration(_rod(N, nx)) for nx in STATES]
    seconds = []
    for nx in TIMED_STATES:
        timed = measured.compiled(_rod(N, nx))
        seconds.append((timed.seconds("sensitivities"), timed.seconds("gradient_alternative")))
    figure, axes = drawing.axes(1, 2)
    for axis, x, values, label in (
        (axes[0, 0], STATES, operations, "operations"),
        (axes[0, 1], TIMED_STATES, [tuple(1e3 * s for s in pair) for pair in seconds], "time [ms]"),
    ):
        axis.plot(x, [v[0] for v in values], "o-", color="#c2571a", markersize=3, label="Algorithm 6.7")
        axis.plot(x, [v[1] for v in values], "o-", color="#3a8a4f", markersize=3, label="Algorithm 6.8")
        axis.set(xlabel="nx", ylabel=label, title=f"heat rod, N = {N}, nu = 2")
        axis.legend(frameon=False)
        axis.grid(alpha=0.25)
    drawing.save(figure, folder, "figure_6_15")
    for column, word, expected in ((0, "6.7", 2.0), (1, "6.8", 1.0)):
        slope = measured.exponent(STATES, [o[column] for o in operations])
        report.add(f"states_{word.replace('.', '_')}_exponent", slope, case="rod, nx >= 100, operations", profile="")
        off = abs(slope - expected)
        report.add("states_exponent_off", off, case=f"{word}: expected {expected:g}", limit=0.15, profile="")
    for horizon in HORIZONS:
        found = crossover(partial(_rod, horizon), horizon)
        report.add(f"crossover_nx_N{horizon}", found, "states", case=f"rod, nu = 2, N = {horizon}", profile="")
    times = np.log([[s[0] for s in seconds], [s[1] for s in seconds]])
    report.add("crossover_nx_time", _crossing(times), "states", case="rod, nu = 2, N = 10, times, interpolated")


def _crossing(logs: np.ndarray) -> float:
    """nx at which the interpolated times cross; NaN if they do not."""
    difference = logs[1] - logs[0]
    for i in range(len(TIMED_STATES) - 1):
        if difference[i] > 0 >= difference[i + 1]:
            share = difference[i] / (difference[i] - difference[i + 1])
            return float(TIMED_STATES[i] + share * (TIMED_STATES[i + 1] - TIMED_STATES[i]))
    return math.nan


def measure_rod(report: Report, folder: Path) -> None:
    """Fig. 6.14: zero-input and zero-state response of the rod of 50 states, one end controlled."""
    N, nx = 240, 50
    case = problems.rod(nx, N, sample=1.0, heated=False)
    tools = derivatives.build(case.ocp, None, case.options)
    still = np.zeros((N, 1))
    free = tools.simulate(case.x0, still).x
    forced = tools.simulate(np.zeros(nx), np.sin(2 * np.pi * np.arange(N) / 120)[:, None]).x
    figure, axes = drawing.axes(1, 2, height=3.6)
    place, t = np.arange(1, nx + 1) / (nx + 1), np.arange(N + 1) * 1.0
    for axis, values, title, low in (
        (axes[0, 0], free, "zero-input response", 0.0),
        (axes[0, 1], forced, "zero-state response", -1.0),
    ):
        cmap = "coolwarm" if low else "inferno"
        picture = axis.pcolormesh(place, t, values, cmap=cmap, shading="nearest", vmin=low, vmax=1.0)
        axis.set(xlabel="place along the rod", ylabel="t [s]", title=title)
        figure.colorbar(picture, ax=axis)
    drawing.save(figure, folder, "figure_6_14")
    A = 0.5 * (np.diag(-2 * np.ones(nx)) + np.diag(np.ones(nx - 1), 1) + np.diag(np.ones(nx - 1), -1))
    hA = A
    step = sum(np.linalg.matrix_power(hA, i) / math.factorial(i) for i in range(5))
    error = np.abs(free[-1] - np.linalg.matrix_power(step, N) @ case.x0).max() / np.abs(case.x0).max()
    report.add("rod_error", error, case="zero-input response against powers of the matrix of a step", limit=1e-12)
