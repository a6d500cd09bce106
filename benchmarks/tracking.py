"""Tracking problems: accuracy against IPOPT, closed loops against sqpmethod, CSTR scenario.

    python -m benchmarks.tracking [--json FILE] [--only accuracy,times,...]

Equal to IPOPT: per component, relative to max(1, its largest value), controls and states to 1e-6, the cost to 1e-8. If
there are several optima, IPOPT started at our solution must return it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from benchmarks.lib import command
from benchmarks.lib.report import Report
from examples import cstr
from nmpc_codegen import Controller, Status, build, generate
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.oracle.reference import Point, Reference
from nmpc_codegen.oracle.trajectory import (
    kkt_residuals,
    node_data,
)
from verification.closed_loop import closed_loop
from verification.peers import QUIET, available, time_sqpmethod
from verification.scenarios import CSTR, EXAMPLES, FIGURE_6, FIGURE_6_STEPS, Example

TOTAL_US = {"cstr": 8.0, "quadrotor": 50.0, "chain5": 600.0}
PAPER_WORST_US = 404.0  # [H11] 4.2, a CPU of 2011
SLOWEST_PEER = 1e6  # us

# Accuracy -------------------------------------------------------------------------------------------------------------


def relative(a: Array, b: Array) -> float:
    """Largest difference per component, relative to max(1, largest |b| of the component)."""
    return float(np.max(np.abs(a - b) / np.maximum(1.0, np.max(np.abs(b), axis=0, initial=0.0)), initial=0.0))


def accuracy(report: Report, examples: Sequence[Example] = EXAMPLES) -> None:
    """Every example against IPOPT, both from the initial iterate; KKT residuals recomputed in NumPy."""
    for example in examples:
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


# Times ----------------------------------------------------------------------------------------------------------------


def times(report: Report, examples: Sequence[Example] = EXAMPLES, runs: int = 15, steps: int | None = None) -> None:
    """Closed loops in C."""
    for example in examples:
        name = example.name
        ocp = example.make()
        t = closed_loop(
            generate(ocp, example.options), name, example.scenario(), runs=runs, steps=steps or example.steps
        )
        n = t.samples
        report.add(f"{name}_total_us", t.total, "us", limit=TOTAL_US.get(name), n=n)
        report.add(f"{name}_feedback_us", t.feedback, "us", n=n)
        report.add(f"{name}_total_median_us", t.total_median, "us", n=n)
        report.add(f"{name}_worst_us", t.worst, "us", n=n)
        report.add(f"{name}_failed_steps", t.failed, n=n)
        report.add(f"{name}_qp_iterations", t.qp_iterations, "per step", n=n)
        report.add(f"{name}_qp_iterations_max", t.qp_iterations_max, "per step", n=n)


def peers(report: Report, examples: Sequence[Example] = EXAMPLES, seconds: float = 2.0) -> None:
    """CasADi's sqpmethod on the same closed loops, with every QP plugin that this CasADi ships; called after times().

    A plugin that needs more than SLOWEST_PEER per step is not run on the larger examples that follow.
    """
    ours = {key: record.value for key, record in report.worst().items()}
    for plugin in QUIET:
        if not available(plugin):
            report.add(f"sqpmethod_{plugin}_missing", 1, profile="casadi")
            continue
        slow = False
        for example in examples:
            name = example.name
            key = f"sqpmethod_{plugin}_{name}"
            if slow:
                report.add(
                    f"{key}_left_out", 1, case=f"over {SLOWEST_PEER / 1e6:g} s per step before", profile="casadi"
                )
                continue
            ocp = example.make()
            plant = build(ocp, example.options, profile="fast").integrate
            peer = time_sqpmethod(
                classify(ocp), plant, example.scenario(), example.tableau, qpsol=plugin, seconds=seconds
            )
            slow = peer.total > SLOWEST_PEER
            report.add(f"{key}_us", peer.total, "us", profile="casadi", n=peer.steps)
            if f"{name}_total_us" in ours:
                report.add(f"{name}_ratio_to_{plugin}", ours[f"{name}_total_us"] / peer.total, n=peer.steps)


# Scenario of figure 6 -------------------------------------------------------------------------------------------------


def figure_6(report: Report, steps: int = FIGURE_6_STEPS, runs: int = 15) -> None:
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


# Sizes ----------------------------------------------------------------------------------------------------------------


#: Functions whose operations are reported, those of condensing or of stages, depending on the package.
COUNTED = {
    "linearize", "condense_hessian", "condense_gradient", "condense_expand",
    "riccati_factorize", "riccati_backward", "riccati_forward",
}  # fmt: skip


PARTS: dict[str, Callable[[Report], None]] = {
    "times": times,
    "peers": peers,
    "figure_6": figure_6,
    "accuracy": accuracy,
}


def main() -> None:
    """All figures."""
    parser = command.parser(__doc__, PARTS)
    options = parser.parse_args()
    names, report = command.chosen(parser, options, PARTS), Report("tracking")
    note = f"; CasADi {ca.__version__}, NumPy {np.__version__}"
    command.measure(report, names, lambda name: PARTS[name](report), options.json, note)


if __name__ == "__main__":
    main()
