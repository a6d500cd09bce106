"""Distance from the converged solution along a closed loop, for some numbers of iterations and penalties.

Hours, Shukla and Jones, theorem 4.1 (error against successful iterations), theorem 4.2 and corollary 4.1 (errors of
real-time iterates), in numbers, on the crane with terminal weights.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.lib.report import Report
from examples import crane
from nmpc_codegen import OCP, AugmentedLagrangian, Options, build

ITERATIONS, PENALTIES, SAMPLES = (1, 2, 3, 5, 10), (10.0, 100.0, 1000.0), 30
X0 = np.array([2.0, 0.0, 0.0, 0.0])


def problem() -> OCP:
    """The crane with terminal weights."""
    return crane.build_ocp(terminal_constraint=False)


def errors(iterations: int, penalty: float) -> np.ndarray:
    """|u - u*| over the plan at every sample, (SAMPLES,), along the loop of the controller itself."""
    chosen = AugmentedLagrangian(iterations=iterations, penalty=penalty, shift="repeat")
    tracked, exact = build(problem(), Options(algorithm=chosen)), build(problem(), Options())
    tracked.solve(X0, tol=1e-9, max_iterations=300)
    x, found = X0.copy(), []
    for _ in range(SAMPLES):
        u = tracked.step(x)
        solution = exact.solve(x, tol=1e-10)
        found.append(np.abs(tracked.u - solution.u).max())
        x = np.asarray(tracked.integrate(x, u, 0.3))
    return np.array(found)


def convergence(penalty: float) -> np.ndarray:
    """|u - u_end| after 1, 2, ... iterations of one sample with fixed multipliers."""
    iterates = []
    for iterations in range(1, 13):
        c = build(problem(), Options(algorithm=AugmentedLagrangian(iterations=iterations, penalty=penalty, proximal=0)))
        c.step(X0)
        iterates.append(c.u.copy())
    return np.array([np.abs(u - iterates[-1]).max() for u in iterates[:-1]])


def measure(report: Report, _scale: float) -> None:
    """Mean error of every pair, and the convergence of the primal iterations."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for penalty in PENALTIES:
        means = []
        for iterations in ITERATIONS:
            found = errors(iterations, penalty)
            means.append(float(found.mean()))
            report.add("tracking_error", means[-1], case=f"M = {iterations}, rho = {penalty:g}")
        left.loglog(ITERATIONS, means, marker="o", label=f"rho = {penalty:g}")
        steps = convergence(penalty)
        right.semilogy(range(1, len(steps) + 1), np.maximum(steps, 1e-16), marker="o")
        report.add("primal_error_after_5", float(steps[4]), case=f"rho = {penalty:g}")
    left.set_xlabel("iterations M per sample")
    left.set_ylabel("mean distance from the converged controls")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", frameon=False, ncols=3)
    right.set_xlabel("iterations in one sample")
    right.set_ylabel("distance from the minimiser")
    Path("out").mkdir(exist_ok=True)
    figure.savefig("out/augmented_lagrangian_tracking.png", dpi=85)
