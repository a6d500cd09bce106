"""Errors of all methods, normwise, against CasADi on the whole simulation and complex steps in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.lib.adjoint import problems
from benchmarks.lib.adjoint.oracle import complex_step, normwise
from benchmarks.lib.adjoint.problems import Array, Case
from benchmarks.lib.report import Report
from nmpc_codegen import derivatives

LIMIT = 1e-12


def by_hand(case: Case) -> Callable[[Array], Array]:
    """(J, z) of complex controls, in NumPy without CasADi: the map (6.31) or the reactor."""
    if case.name.startswith("map"):
        return lambda u: _map(case, u)
    return lambda u: _reactor(case, u)


def _map(case: Case, u: Array) -> Array:
    x, J, z = case.x0.astype(complex), 0j, []
    for i, (u1, u2) in enumerate(u):
        k = i + 1
        z.append(x[0] + x[1] + 0.1 * u1 + 0.2 * u2)
        J += 0.5 * (z[-1] ** 2 + u1**2 + u2**2)
        x = np.array([x[0] / k + x[1] ** 2 + u1, x[1] * np.sin(k) - k * x[0] + u2])
    return np.array([J + 0.5 * (x[0] ** 2 + x[1] ** 2), *z])


def _reactor(case: Case, u: Array) -> Array:
    x, J, z = case.x0.astype(complex), 0j, []
    Q, R = problems.REACTOR_WEIGHTS
    h = problems.SAMPLE / problems.STEPS

    def rhs(x: Array, v: Array) -> Array:
        return np.array(problems.reactor_rates(x, v, np.exp))

    for v in u:
        z += [x[1], x[2]]
        J += 0.5 * (
            Q[0] * (x[1] - 750) ** 2 + Q[1] * (x[2] - 90) ** 2 + R[0] * (v[0] - 8) ** 2 + R[1] * (v[1] + 3) ** 2
        )
        for _ in range(problems.STEPS):
            k1 = rhs(x, v)
            k2 = rhs(x + h / 2 * k1, v)
            k3 = rhs(x + h / 2 * k2, v)
            k4 = rhs(x + h * k3, v)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array([J, *z])


def expected(case: Case) -> list[tuple[str, Array, Array]]:
    """(oracle, gradient, impulse response matrix)."""
    whole = case.model.derivatives(case.x0, case.u, case.p)
    found = [("CasADi", whole["gradient"], whole["impulse_response"])]
    if not case.name.startswith("rod"):
        columns = complex_step(by_hand(case), case.u)
        found.append(("complex step", columns[0].reshape(case.u.shape), columns[1:]))
    return found


def measure(report: Report, folder: Path) -> None:
    """gradient_error, impulse_response_error; those of finite differences beside them."""
    for case in (problems.discrete_map(10), problems.discrete_map(100), problems.reactor(), problems.rod(40, 20)):
        tools: Any = derivatives.build(case.ocp, case.outputs, case.options)
        if case.p.size:
            tools.p[...] = case.p
        for oracle, gradient, Xi in expected(case):
            where = f"{case.name}, N = {tools.N}, {oracle}"
            _add(report, "gradient_error", where, tools.gradient, case, gradient)
            _add(report, "impulse_response_error", where, tools.impulse_response, case, Xi)


def _add(report: Report, key: str, where: str, function: Callable[..., Array], case: Case, expected: Array) -> None:
    """The worst of the exact methods, and finite differences under a key of their own."""
    errors = {m: normwise(function(case.x0, case.u, m), expected) for m in derivatives.GRADIENTS}
    rough = errors.pop("finite_differences")
    worst = max(errors, key=lambda m: errors[m])
    report.add(key, errors[worst], case=f"{where}: worst is {worst}", n=len(errors), limit=LIMIT)
    report.add(f"finite_difference_{key}", rough, case=where)
