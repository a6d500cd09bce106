"""The Van de Vusse reactor, Fig. 7.3: soft rows with growing weights against IPOPT's solution with hard rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.lib.adjoint.integral import cost_of, optimum
from benchmarks.lib.report import Report
from examples import vandevusse
from nmpc_codegen import build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, node_data
from nmpc_codegen.runtime.controller import Solution

#: First and last steps of ramps; the last one is that of the example.
RAMPS = ((10, 30), (40, 60), vandevusse.RAMP)


def measure(report: Report, folder: Path) -> None:
    """Errors of states and controls relative to the largest value of each, and what every weight violates."""
    problem, plans = classify(vandevusse.build_ocp()), dict[str, Solution]()
    solver = Reference(problem, replace(CLASSICAL, steps=4))
    data = node_data(problem, x0=vandevusse.steady_state(vandevusse.ENDS[0]))
    weights = list(vandevusse.WEIGHTS.values())
    for first, last in RAMPS:
        reference = vandevusse.ramp(first, last)
        exact = solver.solve(replace(data, yref=reference[:-1]))
        if not exact.success:
            raise RuntimeError(f"IPOPT: {exact.status}")
        largest = np.abs(exact.mu_x).max(axis=0)[1:3]
        for name, multiplier, weight in zip(vandevusse.HIGHEST, largest, weights, strict=True):
            most = vandevusse.PENALTIES[-1] * weight
            report.add("vandevusse_multiplier", float(multiplier), case=f"{name}, ramp {first}..{last}", limit=most)
    for penalty in vandevusse.PENALTIES:
        controller = build(vandevusse.build_ocp(penalty), vandevusse.options())
        case = f"penalty {penalty:g}"
        plans[case] = found = vandevusse.plan(controller, reference)
        over = np.maximum(found.x[1:, 1:3] - list(vandevusse.HIGHEST.values()), 0.0).max(axis=0)
        for name, excess in zip(vandevusse.HIGHEST, over, strict=True):
            report.add(f"vandevusse_excess_{name}", float(excess), case=case)
        report.add("vandevusse_status", found.status, case=case)
        report.add("vandevusse_iterations", found.iterations, case=case)
        report.add("vandevusse_products", controller.stats.cg_iterations, case=case)
        report.add("vandevusse_seconds", found.time_ns / 1e9, "s", case=case)
        if penalty == vandevusse.PENALTIES[-1]:
            error = max(relative(found.u, exact.u), relative(found.x, exact.x))
            report.add("vandevusse_error", error, case=case, limit=1e-3)
    for penalty in vandevusse.INTEGRAL_PENALTIES:
        controller = build(vandevusse.build_integral_ocp(penalty), vandevusse.options())
        case = f"integral, penalty {penalty:g}"
        plans[case] = found = vandevusse.plan(controller, reference)
        gap = cost_of(found.u, reference, penalty) / optimum(reference, penalty, reference[:-1, 2:]) - 1
        report.add("integral_cost_gap", gap, case=case, limit=1e-2)
        report.add("integral_status", found.status, case=case, limit=0)
        report.add("integral_iterations", found.iterations, case=case)
        for name, excess in zip(vandevusse.HIGHEST, vandevusse.excess(controller, found).max(axis=0), strict=True):
            report.add(f"integral_excess_{name}", float(excess), case=case)
    picture = folder / "figure_7_3.png"
    vandevusse.draw(plans, reference, str(picture))
    print(picture)


def relative(found: np.ndarray, exact: np.ndarray) -> float:
    """Largest error of a column relative to its largest value."""
    return float((np.abs(found - exact).max(axis=0) / np.abs(exact).max(axis=0)).max())
