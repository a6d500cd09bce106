"""Single cold starts of problems that were slow once, with default options."""

from __future__ import annotations

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from examples import bioreactor
from nmpc_codegen import ExplicitRungeKutta, Options, build
from nmpc_codegen.frontend.classify import classify
from verification.convergence.problems import problems

LIMIT = 20


def measure(report: Report, asked: Run) -> None:
    """Cart and pole, discs: iterations; the bioreactor in reading (a): the largest KKT residual."""
    known = {p.name: p for p in problems()}
    for name in asked.cases(("cart_pole", "discs")):
        problem = known[name]
        ctrl = build(problem.make(), problem.options(), profile="fast")
        found = ctrl.solve(np.array(classify(problem.make()).x_initial))
        iterations = found.iterations if found.status.name == "OK" else np.inf
        report.add(f"{name}_iterations", iterations, case=found.status.name, limit=LIMIT)
    ctrl = build(bioreactor.build_ocp("a"), Options(ExplicitRungeKutta(steps=3)), profile="fast")
    found = ctrl.solve(ctrl.x[0].copy(), tol=1e-10)
    worst = max(vars(found.kkt).values())
    report.add("bioreactor_a_kkt", worst, case=f"{found.status.name}, {found.iterations} iterations", limit=1e-9)
