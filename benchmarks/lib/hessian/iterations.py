"""SQP iterations with exact Hessians and with Gauss-Newton."""

from __future__ import annotations

import dataclasses

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.lib.report import Report
from examples import cstr, quadrotor
from nmpc_codegen import Controller, ExactHessian, GaussNewton, Options, build
from verification.scenarios import CSTR, QUADROTOR

TOLERANCE = 1e-10
LONG = 1000


def residuals(controller: Controller, x0: np.ndarray, iterations: int) -> list[float]:
    """Largest KKT residual after 1, 2, ... iterations of solve() from the initial iterate; each run restarts there."""
    found = []
    for n in range(1, iterations + 1):
        solution = controller.copy().solve(x0, tol=TOLERANCE, max_iterations=n)
        found.append(max(dataclasses.astuple(solution.kkt)))
        if solution.iterations < n:
            break
    return found


def measure(report: Report) -> None:
    """SQP iterations to 1e-10 from the initial iterate: exact Hessians at the reduced level, and Gauss-Newton."""
    table = Table(title="largest KKT residual after every iteration")
    for name in ("", "CSTR, exact", "CSTR, Gauss-Newton", "quadrotor, exact", "quadrotor, Gauss-Newton"):
        table.add_column(name, justify="right")
    columns = []
    quadrotor_x0 = np.array([1.0, 1.0, 1.0, *np.zeros(9)])
    for name, make, options, x0, limit in (
        ("cstr", cstr.build_ocp, CSTR.options, cstr.START, 8),
        ("quadrotor", quadrotor.build_ocp, QUADROTOR.options, quadrotor_x0, 30),
    ):
        for word, hessian in (("", ExactHessian()), ("_gauss_newton", GaussNewton())):
            chosen = Options(integrator=options.integrator, hessian=hessian)
            controller = build(make(), chosen, "fast")
            controller.x[...] = x0
            solution = controller.copy().solve(x0, tol=TOLERANCE, max_iterations=LONG)
            last = max(dataclasses.astuple(solution.kkt))
            iterations = solution.iterations if last <= TOLERANCE else np.nan
            case = f"{solution.status.name}, residual {last:.1e}"
            report.add(f"{name}{word}_iterations", iterations, case=case, limit=None if word else limit)
            columns.append(residuals(controller, x0, min(solution.iterations, 40)))
    for n in range(max(map(len, columns))):
        table.add_row(str(n + 1), *(f"{c[n]:.1e}" if n < len(c) else "" for c in columns))
    Console(width=140).print(table)
