"""Counts and times of derivative functions over the horizon, and exponents fitted to them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from nmpc_codegen import derivatives
from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.model import DerivativeModel, derivative_model
from nmpc_codegen.derivatives.toolbox import Derivatives
from nmpc_codegen.runtime.build import load_library
from verification.adjoint.counted import IGNORING_STRUCTURE
from verification.adjoint.problems import Case

#: Exponents are fitted to horizons of at least this length.
LEAST = 100

SECONDS = 0.02  # of one measurement, at least
REPEATS = 7

NAME = "tools"
UPPER = NAME.upper()


@dataclass(frozen=True, eq=False)
class Timed:
    """A compiled package at one point, also with the function that ignores structure, ready to be timed."""

    tools: Derivatives
    Xi: np.ndarray
    rows: Any

    def seconds(self, function: str) -> float:
        """CPU seconds of one call of a C function: the least mean of several runs."""
        call, arguments = self._call(function)
        n, spent = 1, _run(call, arguments, 1)
        while spent < SECONDS:
            n = max(2 * n, int(1.2 * n * SECONDS / max(spent, 1e-9)))
            spent = _run(call, arguments, n)
        return min(_run(call, arguments, n) / n for _ in range(REPEATS))

    def _call(self, function: str) -> tuple[Any, tuple[Any, ...]]:
        t, s = self.tools, self.tools._structs
        out = t._pointer(self.Xi)
        work = {"finite_differences": "trajectory", "adjoint": "nodes", "alternative": "response"}
        method = function.removeprefix("gradient_").removeprefix("impulse_response_")
        more: tuple[Any, ...] = (out,)
        if method == "finite_differences":
            more = (1e-8, out)
        if function.startswith("impulse_response_adjoint"):
            more = (self.rows, t.N * t.nout, out)
        if function == "sensitivities_alternative":
            return t._function(function), (s["data"], 0, s["response"])
        if function in ("simulate", "sensitivities"):
            return t._function(function), (s["data"], s["trajectory" if function == "simulate" else "linearization"])
        return t._function(function), (s["data"], s[work.get(method, "linearization")], *more)


def _run(call: Callable[..., Any], arguments: tuple[Any, ...], n: int) -> float:
    begin = time.process_time()
    for _ in range(n):
        call(*arguments)
    return time.process_time() - begin


def compiled(case: Case, profile: str = "fast") -> Timed:
    """The package of a case with the function that ignores structure, its data set and its matrices computed."""
    model = derivative_model(case.ocp, case.outputs, None, case.options)
    sources = dict(derivatives.generate(case.ocp, case.outputs, case.options, NAME))
    declared = f"{NAME}_status_t {NAME}_impulse_response_structure_ignored(\n"
    declared += f"    const {NAME}_data_t *d, {NAME}_linearization_t *m, {NAME}_real Xi[][{UPPER}_N][{UPPER}_NU]);\n"
    end = "/* end declarations */"
    sources[f"{NAME}.h"] = sources[f"{NAME}.h"].replace(end, declared + end)
    sources[f"{NAME}.c"] += IGNORING_STRUCTURE.read_text(encoding="utf-8")
    tools = Derivatives(model, NAME, *load_library(sources, NAME, profile))
    if case.p.size:
        tools.p[...] = case.p
    tools.simulate(case.x0, case.u)
    tools.sensitivities(case.x0, case.u)
    Xi = np.zeros((max(tools.N * tools.nout, 1), tools.N * tools.nu))
    return Timed(tools, Xi, tools._ffi.new("int[]", list(range(tools.N * tools.nout))))


@cache
def _model(make: Callable[[int], Case]) -> DerivativeModel:
    case = make(LEAST)
    return derivative_model(case.ocp, case.outputs, None, case.options)


def counts(make: Callable[[int], Case], N: int) -> Counts:
    """Counts of the case of any horizon: the functions of an interval are the same for all."""
    model = _model(make)
    problem = replace(model.problem, N=N, dt=(model.problem.dt[0],) * N)
    return Counts(replace(model, problem=problem))


def structure_ignored(counts: Counts) -> int:
    """Operations of the function of structure_ignored.c: block (n, k) takes n - k - 1 products with A."""
    products = sum((counts.N - d) * (d - 1) for d in range(1, counts.N))
    return counts.insertion.total + counts._advance_columns.total * products


def exponent(horizons: Sequence[float], values: Sequence[float], least: float = LEAST) -> float:
    """Slope of log(value) over log(N), N >= ``least``."""
    pairs = [(N, v) for N, v in zip(horizons, values, strict=True) if least <= N]
    logs = np.log(np.array(pairs, float))
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])


def integration(case: Case) -> tuple[int, int]:
    """Operations of Algorithms 6.7 and 6.8."""
    counts = Counts(derivative_model(case.ocp, case.outputs, None, case.options))
    return counts.sensitivities.total, counts.responses.total


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
