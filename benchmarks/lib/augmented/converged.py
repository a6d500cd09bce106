"""solve() of the augmented Lagrangian against IPOPT."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.lib.report import Report
from examples import bioreactor, crane, cstr, quadrotor
from nmpc_codegen import RK4, AugmentedLagrangian, ExplicitRungeKutta, Options, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, node_data

#: Example -> problem, Runge-Kutta steps per interval.
CASES = {
    "crane": (crane.build_ocp, 2),
    "cstr": (cstr.build_ocp, 2),
    "bioreactor": (lambda: bioreactor.build_ocp("a", periodic=False), 3),
    "quadrotor": (quadrotor.build_ocp, 1),
}


def measure(report: Report, _scale: float) -> None:
    """Largest distance of the controls from those of IPOPT, from the declared initial states."""
    for name, (make, steps) in CASES.items():
        ocp = make()
        problem = classify(ocp)
        controller = build(
            ocp, Options(integrator=ExplicitRungeKutta(RK4, steps=steps), algorithm=AugmentedLagrangian())
        )
        solution = controller.solve(problem.x_initial, tol=1e-9, max_iterations=300)
        found = Reference(problem, replace(CLASSICAL, steps=steps)).solve(node_data(problem, x0=problem.x_initial))
        error = float(np.abs(solution.u - found.u).max()) if found.success else np.nan
        report.add(f"{name}_u_error", error, limit=1e-5)
        report.add("kkt_relative", solution.kkt.relative, case=name, limit=1e-9)
        report.add("solve_iterations", solution.iterations, case=name)
