"""Discrete map: four treatments of output rows in single shooting, by Gauss-Newton and quasi-Newton steps.

What it shows: `AdjointShooting(rows=...)` and `method=...` on one problem; a dynamics that is a discrete map with a
parameter per node; a first guess of the controls from a stabilising feedback.

The output z = x_1 + x_2 + 0.1 u_1 + 0.2 u_2 has to stay between -0.1 and 0.1, and single shooting has no variables but
the controls, so that the rows become terms of the cost:

 * "augmented_lagrangian": take it unless there is a reason not to; it needs no weight and ends at the rows themselves;
 * "smooth_l1": take it for soft rows, and where a weight that exceeds all multipliers is known;
 * "lumped": take it where such a weight is not known and one multiplier of all rows is wanted instead of one of each;
 * "barrier": take it where plans must keep a distance from the rows, those that are not optimal yet, too.

The map is equation (6.31) of the thesis "Adjoint-based derivative evaluation methods for nonlinear model predictive
control", 2009, whose section 7.4 refers to it for penalties of outputs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, AdjointShooting, Options, build
from nmpc_codegen.runtime.controller import Solution

N, HIGHEST, LARGEST = 10, 0.1, 1.5
START = np.ones(2)
TOL = 1e-4
#: Terms of the rows, with the weight that two of them need.
TREATMENTS = {"augmented_lagrangian": None, "smooth_l1": 30.0, "lumped": 30.0, "barrier": None}
METHODS = ("gauss_newton", "quasi_newton")


def build_ocp(rows: bool = True) -> OCP:
    """J = 1/2 sum (z^2 + |u|^2) + 1/2 |x_N|^2, |u| <= 1.5 and, with ``rows``, |z| <= 0.1 at the nodes 1 .. N-1."""
    ocp = OCP("output_rows", N=N)
    x1, x2 = ocp.state("x1", initial=1.0), ocp.state("x2", initial=1.0)
    u1, u2 = ocp.control("u1"), ocp.control("u2")
    k = ocp.parameter("k", value=1.0)
    ocp.dynamics({x1: x1 / k + x2**2 + u1, x2: x2 * ca.sin(k) - k * x1 + u2}, discrete=True)
    z = x1 + x2 + 0.1 * u1 + 0.2 * u2
    ocp.least_squares(ca.vertcat(z, u1, u2), weight=np.ones(3))
    ocp.terminal_least_squares(ca.vertcat(x1, x2), weight=np.ones(2))
    ocp.subject_to(-LARGEST, ocp.u, LARGEST)
    if rows:
        ocp.subject_to(-HIGHEST, z, HIGHEST, name="z", at=range(1, N))
    return ocp


def first_guess() -> np.ndarray:
    """Controls (N, 2) of the feedback u_1 = -x_2^2, u_2 = k x_1 along its own path."""
    x1, x2, u = *START, np.zeros((N, 2))
    for k in range(1, N + 1):
        u[k - 1] = -(x2**2), k * x1
        x1, x2 = x1 / k, x2 * np.sin(k)
    return u


def plan(ocp: OCP, algorithm: AdjointShooting, tol: float = TOL) -> Solution:
    """Solve from the controls that stabilise the map."""
    controller = build(ocp, Options(algorithm=algorithm))
    controller.set_parameter("k", np.arange(1.0, N + 2))
    controller.u = first_guess()
    return controller.solve(START, tol=tol, max_iterations=2000)


def output_of(found: Solution) -> np.ndarray:
    """z at the nodes 0 .. N-1."""
    return np.asarray(found.x[:-1] @ [1.0, 1.0] + found.u @ [0.1, 0.2])


def draw(free: Solution, plans: dict[tuple[str, str], Solution], picture: str) -> None:
    """The output without and with rows, and the iterations of every treatment."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    nodes, found = np.arange(1, N), plans["gauss_newton", "augmented_lagrangian"]
    left.plot(nodes, output_of(free)[1:], "o-", color="0.55", markersize=4, label="without rows")
    left.plot(nodes, output_of(found)[1:], "o-", color="#1f5fa8", markersize=4, label="with rows")
    left.axhspan(HIGHEST, 0.5, color="#b3202c", alpha=0.12, linewidth=0)
    left.axhspan(-0.5, -HIGHEST, color="#b3202c", alpha=0.12, linewidth=0)
    left.set(xlabel="node", ylabel="z", ylim=(-0.5, 0.5), xticks=nodes)
    left.legend(frameon=False)
    for j, (method, color) in enumerate(zip(METHODS, ("#1f5fa8", "#c2571a"), strict=True)):
        counts = [plans[method, rows].iterations for rows in TREATMENTS]
        bars = right.barh(np.arange(len(counts)) + 0.38 * j - 0.19, counts, 0.36, color=color, label=method)
        right.bar_label(bars, padding=3, fontsize=8)
    right.set(xlabel=f"iterations of solve(), tol = {TOL:g}", yticks=range(len(TREATMENTS)), xscale="log")
    right.set_yticklabels(TREATMENTS)
    right.invert_yaxis()
    right.margins(x=0.2)
    right.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=2, fontsize=9)
    for axis in (left, right):
        axis.grid(alpha=0.25)
    figure.suptitle("Output rows of a discrete map as terms of the cost", fontsize=11)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/output_rows.png") -> dict[tuple[str, str], Solution]:
    """Solve with every treatment and method, compare them, and draw."""
    free = plan(build_ocp(rows=False), AdjointShooting())
    plans, ocp = {}, build_ocp()
    for method in METHODS:
        for rows, penalty in TREATMENTS.items():
            found = plans[method, rows] = plan(ocp, AdjointShooting(method=method, rows=rows, penalty=penalty))
            worst = np.abs(output_of(found)[1:]).max() - HIGHEST
            print(
                f"{method}, {rows:20}: {found.status.name}, {found.iterations:4} iterations, cost {found.cost:.5f}, "
                f"|z| - {HIGHEST} <= {worst:.1e}"
            )
    draw(free, plans, picture)
    return plans


if __name__ == "__main__":
    main(*sys.argv[1:])
