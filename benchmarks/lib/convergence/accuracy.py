"""Tracking examples against IPOPT.

Equal to IPOPT: per component, relative to max(1, its largest value), controls and states to 1e-6, the cost to 1e-8. If
there are several optima, IPOPT started at our solution must return it.
"""

from __future__ import annotations

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import Status, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.oracle.reference import Point, Reference
from nmpc_codegen.oracle.trajectory import kkt_residuals, node_data
from verification.scenarios import EXAMPLES


def relative(a: Array, b: Array) -> float:
    """Largest difference per component, relative to max(1, largest |b| of the component)."""
    return float(np.max(np.abs(a - b) / np.maximum(1.0, np.max(np.abs(b), axis=0, initial=0.0)), initial=0.0))


def measure(report: Report, asked: Run) -> None:
    """Every example against IPOPT, both from the initial iterate; KKT residuals recomputed in NumPy."""
    for example in asked.cases(EXAMPLES):
        problem, x0 = classify(example.make()), example.x0()
        ours = build(example.make(), example.options, profile="fast").solve(x0, tol=1e-10, max_iterations=1000)
        data, ipopt = node_data(problem, x0=x0), Reference(problem, example.tableau)
        ref, case = ipopt.solve(data), "plain"
        if not ref.success or relative(ours.u, ref.u) > 1e-6:
            ref, case = ipopt.solve(data, x=ours.x, u=ours.u), "IPOPT from ours"
        point = Point(**{name: np.array(getattr(ours, name), dtype=float) for name in Point.__dataclass_fields__})
        cost_error = abs(ours.cost - ref.cost) / abs(ref.cost) if ref.success else np.nan
        report.add(f"{example.name}_u_error", relative(ours.u, ref.u), case=case, limit=1e-6, n=problem.N)
        report.add(f"{example.name}_x_error", relative(ours.x, ref.x), case=case, limit=1e-6, n=problem.N + 1)
        report.add(f"{example.name}_cost_error", cost_error, case=case, limit=1e-8)
        report.add(f"{example.name}_kkt", kkt_residuals(problem, point, data, example.tableau).worst, case=case)
        report.add(f"{example.name}_not_ok", int(ours.status != Status.OK) + int(not ref.success), case=case, limit=0)
        report.add(f"{example.name}_sqp_iterations", ours.iterations, case=case)
