"""Gradient of a cost with respect to all controls: by finite differences, forward and backward in time.

What it shows: nmpc_codegen.derivatives, generated C functions for the gradient of the cost and for the impulse response
matrix of single shooting, without a controller; parameters that differ from node to node; a dynamics that is a discrete
map; exact operation counts, which say how the methods grow with the horizon.

The model is equation (6.31) of the NTNU thesis of 2009 on adjoint derivatives in NMPC: its map depends on the number of
the sample, k = 1, 2, ..., and is stabilised by u_1 = -x_2^2, u_2 = k x_1.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, derivatives

HORIZONS = (10, 20, 40, 80, 160, 320)
LABELS = {
    "finite_differences": "finite differences",
    "forward": "forward, with matrices",
    "adjoint_matrices": "adjoint, with matrices",
    "adjoint": "adjoint, with products",
}
COLOURS = {"finite_differences": "0.45", "forward": "#c2571a", "adjoint_matrices": "#7aa6d6", "adjoint": "#1f5fa8"}


def output(ocp: OCP) -> Any:
    """z = x_1 + x_2 + 0.1 u_1 + 0.2 u_2."""
    return ocp.x[0] + ocp.x[1] + 0.1 * ocp.u[0] + 0.2 * ocp.u[1]


def build_ocp(N: int = 10) -> OCP:
    """x_1+ = x_1 / k + x_2^2 + u_1, x_2+ = x_2 sin k - k x_1 + u_2; J = 1/2 sum (z^2 + |u|^2) + 1/2 |x_N|^2."""
    ocp = OCP("adjoint_gradient", N=N)
    x1, x2 = ocp.state("x1", initial=1.0), ocp.state("x2", initial=1.0)
    u1, u2 = ocp.control("u1"), ocp.control("u2")
    k = ocp.parameter("k", value=1.0)
    ocp.dynamics({x1: x1 / k + x2**2 + u1, x2: x2 * ca.sin(k) - k * x1 + u2}, discrete=True)
    ocp.least_squares(ca.vertcat(output(ocp), u1, u2), weight=np.ones(3), names=["z", "u1", "u2"])
    ocp.terminal_least_squares(ca.vertcat(x1, x2), weight=np.ones(2))
    return ocp


def stabilised(N: int) -> tuple[np.ndarray, np.ndarray]:
    """States (N + 1, 2) and controls (N, 2) of the stabilised model from (1, 1)."""
    x, u = np.ones((N + 1, 2)), np.zeros((N, 2))
    for i in range(N):
        k = i + 1
        u[i] = -(x[i, 1] ** 2), k * x[i, 0]
        x[i + 1] = x[i, 0] / k, x[i, 1] * np.sin(k)
    return x, u


def operations(N: int) -> dict[str, int]:
    """Operations of the gradient by each method; those with matrices compute them first."""
    counts = derivatives.operations(build_ocp(N))
    first = counts["sensitivities"].total
    return {m: counts[f"gradient_{m}"].total + first * (m in ("forward", "adjoint_matrices")) for m in LABELS}


def draw(u: np.ndarray, gradient: np.ndarray, picture: str) -> None:
    """Controls with their gradient, and the operations of each method over the horizon."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    samples = np.arange(1, len(u) + 1)
    for j, colour in enumerate(("#1f5fa8", "#c2571a")):
        left.step(samples, u[:, j], where="post", color=colour, linestyle="--", linewidth=1.2, label=f"$u_{j + 1}$")
        left.plot(samples, gradient[:, j], "o-", color=colour, markersize=4, label=rf"$\partial J/\partial u_{j + 1}$")
    left.set(xlabel="k", title="controls and gradient", xticks=samples)
    left.legend(frameon=False, ncols=2)
    counts = [operations(N) for N in HORIZONS]
    for method, label in LABELS.items():
        right.loglog(HORIZONS, [c[method] for c in counts], "o-", color=COLOURS[method], markersize=4, label=label)
    right.set(xlabel="N", ylabel="operations", title="one gradient")
    right.legend(frameon=False)
    for axis in (left, right):
        axis.grid(alpha=0.25)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


def main(picture: str = "out/adjoint_gradient.png") -> dict[str, np.ndarray]:
    """Build the functions, compare the methods along the stabilised trajectory, and draw."""
    ocp = build_ocp()
    tools = derivatives.build(ocp, output(ocp), output_names=["z"])
    tools.p[:, 0] = np.arange(1, tools.N + 2)
    x, u = stabilised(tools.N)
    run = tools.simulate(x[0], u)
    print(f"J = {run.cost:.6f}; distance of the simulation from the formula {np.abs(run.x - x).max():.1e}")
    found = {method: tools.gradient(x[0], u, method) for method in derivatives.GRADIENTS}
    for method, gradient in found.items():
        print(f"{method:20} differs from the adjoint method by {np.abs(gradient - found['adjoint']).max():.1e}")
    row = tools.impulse_response(x[0], u, "adjoint", rows=[(tools.N - 1, "z")])
    print(f"dz_9 / du_9 = {row[0, -2:]}, one row of the impulse response matrix")
    draw(u, found["adjoint"], picture)
    return found


if __name__ == "__main__":
    main(*sys.argv[1:])
