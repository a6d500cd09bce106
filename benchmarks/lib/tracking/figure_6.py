"""Figure 6 of [H11]: three set points of the stirred tank reactor; bounds, and the time of the worst step."""

from __future__ import annotations

import numpy as np

from benchmarks.lib.report import Report
from examples import cstr
from nmpc_codegen import Controller, Status, build, generate
from nmpc_codegen.frontend.problem import Array
from verification.closed_loop import closed_loop
from verification.scenarios import CSTR, FIGURE_6, FIGURE_6_STEPS

PAPER_WORST_US = 404.0  # [H11] 4.2, a CPU of 2011


def measure(report: Report, steps: int = FIGURE_6_STEPS, runs: int = 15) -> None:
    """Three set points of the CSTR: bounds of the predicted states and of the plant, worst-case time of a step."""
    predicted, plant, failed = violations(build(CSTR.make(), CSTR.options, profile="fast"), steps)
    report.add("cstr_bound_violation", predicted, "degC", limit=1e-10, n=steps)
    report.add("cstr_plant_violation", plant, "degC", n=steps)
    report.add("cstr_figure6_failed_steps", failed, limit=0, n=steps)
    refined = build(cstr.build_ocp(intervals=cstr.REFINED), cstr.options(), profile="fast")
    predicted, plant, failed = violations(refined, steps)
    report.add("cstr_bound_violation", predicted, "degC", case="refined grid", limit=1e-10, n=steps)
    report.add("cstr_refined_plant_violation", plant, "degC", n=steps)
    report.add("cstr_figure6_failed_steps", failed, case="refined grid", limit=0, n=steps)
    t = closed_loop(generate(CSTR.make(), CSTR.options), "cstr", FIGURE_6, runs=runs, steps=steps)
    report.add("cstr_figure6_worst_us", t.worst, "us", case="paper: 404", limit=PAPER_WORST_US, n=t.samples)
    report.add("cstr_figure6_total_us", t.total, "us", n=t.samples)
    report.add("cstr_figure6_qp_iterations_max", t.qp_iterations_max, "per step", case="paper: 21", n=t.samples)


def violations(controller: Controller, steps: int) -> tuple[float, float, int]:
    """Largest violation at the predicted nodes 1..N of every step, and of the plant at the samples (degC); failures."""
    x = np.array(FIGURE_6.x0, dtype=float)
    predicted, plant, failed = -np.inf, -np.inf, 0
    for n in range(steps):
        if n % FIGURE_6.period == 0:
            y, y_N = FIGURE_6.set_points[n // FIGURE_6.period]
            controller.set_reference(y)
            controller.set_terminal_reference(y_N)
        u = controller.step(x)
        failed += controller.status != Status.OK
        predicted = max(predicted, below_bounds(controller.x[1:]))
        x = np.asarray(controller.integrate(x, u, FIGURE_6.dt))
        plant = max(plant, below_bounds(x))
    return predicted, plant, failed


def below_bounds(x: Array) -> float:
    """Largest violation of th >= 98, thK >= 92, degC; negative inside."""
    return float(np.max(np.array([98.0, 92.0]) - x[..., 2:4]))
