"""Quasi-Newton steps to convergence: the reactor and the discrete map with every treatment of their output rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.lib.report import Report
from examples import output_rows, vandevusse
from nmpc_codegen import OCP, AdjointShooting, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, node_data

#: Of solve() on the reactor.
TOL, MOST = 1e-3, 2000


def measure(report: Report) -> None:
    """Cost relative to IPOPT's with hard rows, iterations, and the status."""
    problem = classify(output_rows.build_ocp())
    data = replace(node_data(problem, x0=output_rows.START), p=np.arange(1.0, output_rows.N + 2)[:, None])
    exact = Reference(problem, CLASSICAL).solve(data, u=output_rows.first_guess())
    for rows, penalty in output_rows.TREATMENTS.items():
        algorithm = AdjointShooting(method="quasi_newton", rows=rows, penalty=penalty)
        found = output_rows.plan(output_rows.build_ocp(), algorithm)
        _add(report, f"map (6.31), {rows}", found.cost / exact.cost - 1, found.iterations, found.status)
    problem, reference = classify(vandevusse.build_ocp()), vandevusse.ramp()
    data = node_data(problem, x0=vandevusse.steady_state(vandevusse.ENDS[0]))
    exact = Reference(problem, replace(CLASSICAL, steps=4)).solve(replace(data, yref=reference[:-1]))
    hard, soft = vandevusse.build_ocp(), vandevusse.build_ocp(vandevusse.PENALTIES[-1])
    cases: dict[str, tuple[OCP, AdjointShooting]] = {
        "hard rows, augmented Lagrangian": (hard, AdjointShooting(method="quasi_newton")),
        "soft rows, augmented Lagrangian": (soft, AdjointShooting(method="quasi_newton")),
        "soft rows, smooth l1": (soft, AdjointShooting(method="quasi_newton", rows="smooth_l1")),
    }
    for case, (ocp, algorithm) in cases.items():
        controller = build(ocp, replace(vandevusse.options(), algorithm=algorithm))
        found = vandevusse.plan(controller, reference, TOL, MOST)
        _add(report, f"reactor, {case}", found.cost / exact.cost - 1, found.iterations, found.status)


def _add(report: Report, case: str, gap: float, iterations: int, status: int) -> None:
    report.add("quasi_newton_cost_gap", abs(gap), case=case, limit=1e-3)
    report.add("quasi_newton_status", status, case=case, limit=0)
    report.add("quasi_newton_iterations", iterations, case=case)
