"""A closed loop can have any controller; in one of them IPOPT solves every sample to convergence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from nmpc_codegen import OCP, Controller
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, node_data

Step = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed loop has states (samples + 1, nx), controls (samples, nu), and the cost of all samples."""

    x: np.ndarray
    u: np.ndarray
    cost: float


def loop_of(
    step: Step, plant: Controller, x0: np.ndarray, references: np.ndarray, weight: np.ndarray, dt: float
) -> Loop:
    """Simulate u = step(x, reference) at every sample.

    The cost is 1/2 |(x, u) - reference|^2 with a diagonal weight (nx + nu,).

    ``references``: (samples, nx + nu).
    """
    x, states, controls, cost = np.array(x0, dtype=float), [np.array(x0, dtype=float)], [], 0.0
    for reference in references:
        u = np.asarray(step(x, reference), dtype=float)
        off = np.concatenate([x, u]) - reference
        cost += float(off @ (weight * off)) / 2
        x = np.asarray(plant.integrate(x, u, dt), dtype=float)
        states.append(x)
        controls.append(u)
    return Loop(np.array(states), np.array(controls), cost)


def converged(ocp: OCP, steps: int) -> Step:
    """Return the control law of IPOPT with ``steps`` RK4 steps per interval, started at its last solution."""
    problem = classify(ocp)
    solver, last = Reference(problem, replace(CLASSICAL, steps=steps)), dict[str, np.ndarray]()

    def step(x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        yref = np.tile(reference, (problem.N, 1))
        data = replace(node_data(problem, x0=x), yref=yref, yref_N=reference[: problem.terminal.ny])
        found = solver.solve(data, **last)
        if not found.success:
            found = solver.solve(data)
        if not found.success:
            raise RuntimeError(f"IPOPT: {found.status} at x = {x}")
        last.update(x=found.x, u=found.u)
        return np.asarray(found.u[0])

    return step


def follows(controller: Controller, counts: list[tuple[int, int, int]] | None = None) -> Step:
    """Return the control law of a controller whose references are set before every sample.

    ``counts`` collects (products, simulations, status) of every sample.
    """
    dims = controller.dims

    def step(x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        controller.set_reference(reference)
        if dims.ny_N:
            controller.set_terminal_reference(reference[: dims.ny_N])
        u = controller.step(x)
        if counts is not None:
            counts.append((controller.stats.cg_iterations, controller.stats.simulations, controller.status))
        return u

    return step
