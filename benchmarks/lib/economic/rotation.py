"""Rotation of the evaporation process by storage functions: Lemmas 4, 5 and 6 of [Z20] on SQP iterates.

The storage functions are Lambda(x) = c'(x - x_s) and 100 |x - x_s|^2, on the map, l + Lambda(x) - Lambda(Phi(x, u)), or
on the nodes, l_k + Lambda(x_k) - Lambda(x_{k+1}).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.lib.economic.evaporation import START, shooting, tuning
from benchmarks.lib.economic.sqp import Array, Plan, quadratic_program, steady_plan, stepped
from benchmarks.lib.report import Report
from nmpc_codegen.economic import kkt_step

N = 200
LINEAR, QUADRATIC = np.array([3.0, -2.0]), 100.0
#: Steps to the solution; steps that are compared.
CONVERGED, COMPARED = 10, 4
Storage = Callable[[Any], Any]


def linear(x: Any) -> Any:
    """c'(x - x_s)."""
    return ca.dot(ca.DM(LINEAR), x - tuning().x_s)


def quadratic(x: Any) -> Any:
    """100 |x - x_s|^2."""
    return QUADRATIC * ca.sumsqr(x - tuning().x_s)


def iterates(storage: Storage | None, on: str, *, exact: bool, steps: int) -> list[Plan]:
    """Plans after 0, 1, ... full steps; a rotated problem starts from lam + grad Lambda where its form needs it."""
    problem, plan = shooting(N), steady_plan(tuning(), N)
    slope, bend = _derivatives(storage)
    node = problem.functions()
    if storage is not None and on == "map":
        node = problem.functions(lambda x, x_next: storage(x) - storage(x_next))
        plan = replace(plan, lam=plan.lam + slope(plan.x))
    found = [plan]
    for _ in range(steps):
        end = (slope(plan.x[-1:])[0], bend) if storage is not None and on == "map" else None
        qp = quadratic_program(problem, node, plan, None if exact else tuning().M, end)
        if storage is not None and on == "nodes":
            qp = replace(qp, g=_on_nodes(qp.g, slope(plan.x)))
        plan = stepped(plan, kkt_step(qp, START - plan.x[0]))
        found.append(plan)
    return found


def _on_nodes(g: Array, slope: Array) -> Array:
    """The gradient with grad Lambda(x_k) of the node itself and -grad Lambda(x_k) of the node before."""
    found = g.copy()
    found[:, : slope.shape[1]] += slope[:-1]
    found[1:, : slope.shape[1]] -= slope[1:-1]
    return found


def _derivatives(storage: Storage | None) -> tuple[Callable[[Array], Array], Array]:
    """(states (n, 2) -> gradients (n, 2), Hessian) of a storage function of at most second order."""
    x = ca.SX.sym("x", 2)
    bend, slope = ca.hessian(ca.SX(0) if storage is None else storage(x), x)
    gradient = ca.Function("slope", [x], [ca.densify(slope)])
    H = np.asarray(ca.Function("bend", [x], [ca.densify(bend)])(np.zeros(2)), dtype=float)
    return lambda states: np.array([np.asarray(gradient(row), dtype=float).ravel() for row in states]), H


def lemma4_error(storage: Storage = quadratic) -> float:
    """lam_rot - (lam + grad Lambda) at the solution, relative to lam."""
    plain = iterates(None, "map", exact=True, steps=CONVERGED)[-1]
    rotated = iterates(storage, "map", exact=True, steps=CONVERGED)[-1]
    slope, _ = _derivatives(storage)
    return float(np.abs(rotated.lam - plain.lam - slope(plain.x)).max() / np.abs(plain.lam).max())


def distances(storage: Storage, on: str, *, exact: bool) -> list[float]:
    """Largest difference in (x, u) between the iterates 1, 2, ... of the original and of the rotated problem."""
    pairs = zip(*(iterates(s, on, exact=exact, steps=COMPARED) for s in (None, storage)), strict=True)
    return [float(max(np.abs(a.x - b.x).max(), np.abs(a.u - b.u).max())) for a, b in pairs][1:]


def control_distance() -> float:
    """Largest difference in u of the second iterates with M, for the quadratic storage function on the map."""
    plain, rotated = (iterates(s, "map", exact=False, steps=2)[2] for s in (None, quadratic))
    return float(np.abs(plain.u - rotated.u).max())


def lemma5_error() -> float:
    """The worst difference of iterates with M where they must be equal, relative to the first step."""
    size = float(np.abs(iterates(None, "map", exact=False, steps=1)[1].u - tuning().u_s).max())
    worst = max(*distances(linear, "map", exact=False), *distances(quadratic, "nodes", exact=False))
    return worst / size


def measure(report: Report) -> None:
    """Lemma 4, 5 and 6."""
    report.add("lemma4_error", lemma4_error(), limit=1e-8, case="100 |x - x_s|^2 on the map", profile="")
    report.add("lemma5_error", lemma5_error(), limit=1e-8, case="linear on the map, quadratic on nodes", profile="")
    first, second, *_ = distances(quadratic, "map", exact=False)
    report.add("lemma5_first_iterate", first, limit=1e-6, case="quadratic on the map", profile="")
    report.add("lemma5_second_iterate", second, limit=1e-2, at_least=True, case="quadratic on the map", profile="")
    report.add("lemma5_second_control", control_distance(), case="quadratic on the map, u", profile="")
    first, second, *_ = distances(quadratic, "map", exact=True)
    report.add("lemma6_first_iterate", first, limit=1e-6, case="exact Hessian, quadratic on the map", profile="")
    report.add("lemma6_second_iterate", second, limit=1e-4, at_least=True, case="exact Hessian, quadratic", profile="")
