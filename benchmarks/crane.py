"""The crane [H11 4.1]: accuracy against IPOPT, sensitivities, time against peers, quality of the generated C."""

from __future__ import annotations

import subprocess
import sys
import time

import casadi as ca
import numpy as np

from benchmarks.lib.closed_loop import closed_loop
from benchmarks.lib.counting import count_mismatches
from benchmarks.lib.peers import time_sqpmethod
from benchmarks.lib.quality import (
    compiler_warnings,
    foreign_external_symbols,
    sanitizer_findings,
    two_controllers_differ,
)
from benchmarks.lib.report import Report, arguments
from benchmarks.lib.scenarios import CRANE_LOOP
from benchmarks.lib.sensitivities import order_slopes, sensitivity_errors
from examples.crane import build_ocp
from nmpc_codegen import Options, build, generate
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Point, kkt_residuals, node_data, solve_reference

X0 = np.array([2.0, 0.0, 0.0, 0.0])
CASES = {"terminal constraint": True, "terminal weight": False}


def accuracy(report: Report) -> None:
    """Solution of the NLP against IPOPT's, and KKT residuals recomputed in NumPy; benchmarks.md defines equality."""
    for case, constraint in CASES.items():
        problem = classify(build_ocp(constraint))
        controller = build(build_ocp(constraint), profile="fast")
        ours = controller.solve(X0, tol=1e-10)
        ref = solve_reference(problem, x0=X0)

        def relative(a: np.ndarray, b: np.ndarray) -> float:
            return float(np.max(np.abs(a - b) / np.maximum(1.0, np.max(np.abs(b), axis=0))))

        report.add("crane_u_error", relative(ours.u, ref.u), case=case, limit=1e-6, n=problem.N)
        report.add("crane_x_error", relative(ours.x, ref.x), case=case, limit=1e-6, n=problem.N + 1)
        report.add("crane_cost_error", abs(ours.cost - ref.cost) / abs(ref.cost), case=case, limit=1e-8)
        point = Point(
            x=ours.x, u=ours.u, lam=ours.lam, mu_x=ours.mu_x, mu_u=ours.mu_u, mu=ours.mu, mu_N=ours.mu_N, eta=ours.eta
        )
        residuals = kkt_residuals(problem, point, node_data(problem, x0=X0))
        worst = max(residuals.stationarity, residuals.equality, residuals.inequality, residuals.complementarity)
        report.add("crane_kkt", worst, case=case, limit=1e-8)
        report.add("crane_lam_error", relative(ours.lam, ref.lam), case=case, n=problem.N + 1)
        report.add("crane_sqp_iterations", ours.iterations, case=case)


def single_precision(report: Report) -> None:
    """The same closed loop in single precision: distance of its states from those of the double-precision loop."""
    loops = []
    for precision in ("double", "single"):
        controller = build(build_ocp(), Options(precision=precision))
        x, states = X0.copy(), []
        for _ in range(50):
            u = controller.step(x)
            x = np.asarray(controller.integrate(x, u, 0.3), dtype=float)
            states.append(x)
        loops.append(np.array(states))
    report.add("crane_single_x_error", float(np.max(np.abs(loops[0] - loops[1]))), "m, rad", limit=1e-3, n=50)


def times(report: Report) -> None:
    """Closed loop in C, and CasADi's sqpmethod with qpOASES in the same run."""
    for case, constraint in CASES.items():
        ocp = build_ocp(constraint)
        t = closed_loop(generate(ocp), "crane", CRANE_LOOP)
        report.add("crane_total_us", t.total, "us", case=case, limit=2.6, n=t.samples)
        report.add("crane_feedback_us", t.feedback, "us", case=case, limit=1.0, n=t.samples)
        report.add("crane_total_median_us", t.total_median, "us", case=case, n=t.samples)
        report.add("crane_failed_steps", t.failed, case=case, n=t.samples)
        report.add("crane_qp_iterations", t.qp_iterations, "per step", case=case, n=t.samples)
        plant = build(ocp).integrate
        peer = time_sqpmethod(classify(ocp), plant, CRANE_LOOP)
        report.add("sqpmethod_total_us", peer.total, "us", case=case, profile="casadi", n=peer.steps)
        report.add("crane_ratio_to_sqpmethod", t.total / peer.total, case=case, n=t.samples)


def quality(report: Report) -> None:
    """Warnings, symbols, exact operation counts, sanitizers, and two controllers in one program."""
    for precision in ("double", "single"):
        for case, constraint in CASES.items():
            options = Options(precision=precision)
            sources = generate(build_ocp(constraint), options)
            label = f"{precision}, {case}"
            report.add("compiler_warnings", compiler_warnings(sources), case=label, limit=0, profile="C99, C++17")
            report.add("foreign_external_symbols", foreign_external_symbols(sources), case=label, limit=0)
            if precision == "double":  # single precision differs only in the spelling of literals and functions
                mismatches = count_mismatches(build_ocp(constraint), options)
                report.add("count_mismatch", len(mismatches), case=label, limit=0, profile="counting")
            report.add("sanitizer_findings", sanitizer_findings(sources), case=label, limit=0, profile="asan, ubsan")
    report.add("two_controllers_differ", two_controllers_differ(), limit=0, n=1)
    report.add("crane_ram_bytes", build(build_ocp()).nbytes, "bytes")


def sensitivities(report: Report) -> None:
    """Every tableau, straight-line and looped, against CasADi and the NumPy oracle; convergence orders."""
    for case, error, n in sensitivity_errors():
        report.add("sensitivity_error", error, case=case, limit=1e-12, n=n, profile="test")
    for case, error, n in order_slopes():
        report.add("order_slope_error", error, case=case, limit=0.1, n=n, profile="test")


IMPORT_TO_CONTROLLER = """
import sys, time
start = time.perf_counter()
from nmpc_codegen import build, export
from examples.crane import build_ocp
ocp = build_ocp()
export(ocp, None, sys.argv[1])
build(ocp)
print(time.perf_counter() - start)
"""


def export_time(report: Report) -> None:
    """Time from the import in Python to the loaded controller, with empty caches."""
    import os
    import tempfile

    seconds = []
    for _ in range(3):
        with tempfile.TemporaryDirectory() as folder:
            environment = {**os.environ, "NMPC_CODEGEN_CACHE": folder}
            command = [sys.executable, "-c", IMPORT_TO_CONTROLLER, folder]
            out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
            seconds.append(float(out))
    report.add("export_build_s", float(np.median(seconds)), "s", limit=3.0, n=len(seconds))


def main() -> None:
    """All figures."""
    options = arguments(__doc__ or "")
    report = Report("crane")
    start = time.perf_counter()
    for part in (export_time, times, accuracy, single_precision, sensitivities, quality):
        part(report)
    report.print()
    print(f"{time.perf_counter() - start:.0f} s; CasADi {ca.__version__}, NumPy {np.__version__}")
    if options.json:
        report.write(options.json)


if __name__ == "__main__":
    main()
