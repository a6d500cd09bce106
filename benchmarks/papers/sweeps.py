"""Second-order sensitivities of an interval come from three sweeps (TSP) or from forward over adjoint (FOA)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, RK4, ExplicitRungeKutta
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Kernel, lift
from nmpc_codegen.ir.sweep import Call, For, LoopedRoutine, Node, Slice, unroll

SWEEPS = {"tsp": "symmetric", "foa": "forward_over_adjoint"}


def curved(problem: Problem, component: Any, scheme: str) -> LoopedRoutine:
    """Return the routine for x_next, S, gradient and Hessian of an interval; the node adds no terms."""
    nz = problem.nx + problem.nu
    zeros = ca.Function("zeros", [], [ca.SX.zeros(nz), ca.SX.zeros(nz * nz)])
    start = Call(zeros, (), (Slice("g", nz), Slice("Q", nz * nz)))
    routine = component.lift_hessian(problem, SWEEPS[scheme], "curved", start, ())
    assert isinstance(routine, LoopedRoutine)
    return routine


#: Leaves of the propagation, and its buffers besides derivatives of phi.
LEAVES = {"tsp": ("bend", "accumulate", "sum"), "foa": ("bar", "update_bars")}
BUFFERS = {"tsp": ("Xs", "kappa", "Z", "Sx", "H"), "foa": ("Xs", "Zs", "Sx", "adj", "adjS", "ubarS")}


def dense(nz: int) -> Problem:
    """Return a problem with nz - 1 states and one control, in which every derivative depends on all of them.

    One Euler step is one recursion z+ = phi(z).
    """
    ocp = OCP("dense", T=1.0, N=1)
    x, u = ocp.state("x", size=nz - 1), ocp.control("u")
    M = np.random.default_rng(nz).uniform(0.1, 1, (nz - 1, nz))
    ocp.dynamics(ca.sin(M @ ca.vertcat(x, u)) ** 2)
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(nz))
    return classify(ocp)


def products(nodes: Sequence[Node], routine: LoopedRoutine, leaves: tuple[str, ...], at: dict[str, int]) -> int:
    """Count the multiplications in the given leaves, with loops multiplied out."""
    total = 0
    for node in nodes:
        if isinstance(node, For):
            total += sum(products(node.body, routine, leaves, {**at, node.index: value}) for value in node.values(at))
        elif node.leaf.name().startswith(leaves):
            total += routine.leaves[node.leaf.name()].count.mul
    return total


def program(routine: LoopedRoutine) -> Kernel:
    """Return a sweep as one straight-line program, in which common terms are computed once; lower triangle of H."""
    symbols = [ca.SX.sym(port.name, port.size) for port in routine.inputs]
    outputs = unroll(routine.sweep).call(symbols)
    outputs[-1] = ca.sparsify(ca.tril(outputs[-1]))
    return lift(ca.Function("curved", symbols, outputs), "curved", routine.doc, routine.inputs, routine.outputs)


def points(problem: Problem, n: int) -> dict[str, np.ndarray]:
    """Draw random points around the initial state, with controls inside their bounds."""
    random = np.random.default_rng(0)
    box = {r.index: (max(r.lower, -1e4), min(r.upper, 1e4)) for r in problem.rows if r.kind == "control"}
    low, high = np.array([box.get(j, (-1.0, 1.0)) for j in range(problem.nu)]).T
    return {
        "x": problem.x_initial * (1 + 0.02 * random.standard_normal((n, problem.nx))),
        "u": random.uniform(low, high, (n, problem.nu)),
        "p": np.tile(problem.p_value, (n, 1)),
        "dt": np.full((n, 1), problem.dt[0]),
        "lam": random.standard_normal((n, problem.nx)),
    }


def disagreement(problem: Problem, steps: int) -> float:
    """Return the largest difference of the Hessians of an interval by both sweeps, relative to the largest element."""
    data, worst = points(problem, 5), 0.0
    routines = [curved(problem, ExplicitRungeKutta(RK4, steps, "none"), scheme) for scheme in SWEEPS]
    for i in range(5):
        given = [[data[port.name][i] for port in r.inputs] for r in routines]
        H = [np.tril(np.array(unroll(r.sweep).call(g)[-1].full())) for r, g in zip(routines, given, strict=True)]
        worst = max(worst, float(np.abs(H[0] - H[1]).max() / np.abs(H[0]).max()))
    return worst
