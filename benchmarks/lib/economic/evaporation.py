"""The evaporation process: its tuning, Theorem 8 and Corollary 9 of [Z20], Figure 1."""

from __future__ import annotations

import numpy as np

from benchmarks.lib.report import Report
from verification.economic.evaporation import (
    PAPER,
    admissible,
    figure1,
    figure1_order,
    first_step_dual_error,
    first_step_error,
    negative_eigenvalues,
    reduced_hessian_error,
    refused_with_reason,
    steps_to,
    tuning,
)


def measure_tuning(report: Report) -> None:
    """Steady state against the paper, feasibility of the program for both eta, spectrum of M."""
    t = tuning()
    error = np.abs(np.array([*t.x_s, *t.u_s, t.cost]) - PAPER)
    report.add("evaporation_steady_error", error[:4].max(), limit=1e-3, case="(x, u) against the paper", profile="")
    report.add("evaporation_cost_error", error[4], limit=5e-3, case="6210.38, printed with two decimals", profile="")
    report.add("sdp_eta0_infeasible", refused_with_reason(), limit=1, at_least=True, profile="")
    values = np.linalg.eigvalsh(t.M)
    report.add("sdp_eta1_feasible", float(values[0] > 0), limit=1, at_least=True, profile="")
    report.add("evaporation_least_eigenvalue", values[0], profile="")
    report.add("evaporation_largest_eigenvalue", values[-1], profile="")
    report.add("evaporation_beta", t.beta, profile="")


def measure_theory(report: Report) -> None:
    """Theorem 8 and Corollary 9."""
    report.add("reduced_hessian_error", reduced_hessian_error(), limit=1e-8, case="|Z'MZ - Z'HZ| / |Z'HZ|", profile="")
    report.add("first_step_error", first_step_error(), limit=1e-8, case="relative to the step", profile="")
    report.add("first_step_dual_error", first_step_dual_error(False), case="multipliers of M", profile="")
    report.add("first_step_dual_error_corrected", first_step_dual_error(True), case="dual correction", profile="")


def measure_figure1(report: Report) -> None:
    """Exact quadratic, M linear with a fast rate, identity slow; the solution satisfies all rows and signs."""
    runs = figure1()
    for name, (_, sizes, _) in runs.items():
        for i, size in enumerate(sizes[:6]):
            report.add("figure1_step", size, case=f"{name}, step {i + 1}", profile="")
        report.add("figure1_steps_to_1e-6", steps_to(sizes, 1e-6), case=name, profile="")
    report.add("figure1_order", figure1_order(), limit=1, at_least=True, profile="")
    report.add("figure1_negative_eigenvalues", negative_eigenvalues(True), limit=0, case="active rows", profile="")
    report.add("figure1_negative_without_rows", negative_eigenvalues(False), case="without the active rows", profile="")
    report.add("figure1_solution_admissible", admissible(runs["exact"][0]), limit=1, at_least=True, profile="")
