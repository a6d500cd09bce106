"""Closed loops of the augmented Lagrangian start from initial plans, and are compared with loops of converged plans.

A loop has converged if it costs at most a hundredth more than that of a controller that solves its problem in every
sample, and if the gaps of its last plan are small in the scales of the states. Samples that are OK although a gap of
the plan is large are counted. Gaps are recomputed with the Runge-Kutta scheme of the oracle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from examples import bioreactor, cart_pole, crane, cstr, quadrotor
from nmpc_codegen import (
    OCP,
    RK4,
    AugmentedLagrangian,
    Controller,
    ExplicitRungeKutta,
    Options,
    RealTimeIteration,
    Status,
    build,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.trajectory import CLASSICAL, interval_map, node_cost

Array = np.ndarray
STARTS, SAMPLES = 10, 200
DEARER, VIOLATION, FAR = 0.01, 1e-3, 0.1
#: Productivity of the optimal orbit of the bioreactor, g/(L h), and its period in samples.
ORBIT, PERIOD = 3.0548, 20


def van_der_pol() -> OCP:
    """Return the OCP of an oscillator whose control is too weak to hold it everywhere."""
    ocp = OCP("van_der_pol", T=2.0, N=15)
    x, v, u = ocp.state("x", initial=1.0), ocp.state("v", initial=0.5), ocp.control("u")
    ocp.dynamics({x: v, v: (1 - x**2) * v - x + u})
    ocp.least_squares(ca.vertcat(x, v, u), weight=[1, 1, 0.1])
    ocp.terminal_least_squares(ca.vertcat(x, v), weight=10)
    ocp.subject_to(-1, u, 1)
    return ocp


@dataclass(frozen=True, eq=False)
class Case:
    """A case is a problem with the box home +- spread of its first states; ``steps`` of RK4 per interval."""

    name: str
    make: Callable[[], OCP]
    home: Array
    spread: Array
    steps: int = 2
    algorithm: Mapping[str, Any] = field(default_factory=dict)

    def options(self, precision: Any = "double") -> Options:
        """Return options with the augmented Lagrangian."""
        scheme = ExplicitRungeKutta(RK4, steps=self.steps)
        return Options(scheme, algorithm=AugmentedLagrangian(**self.algorithm), precision=precision)

    def starts(self) -> list[Array]:
        """Return the first states."""
        random = np.random.default_rng(7)
        return [self.home + self.spread * random.uniform(-1, 1, self.home.size) for _ in range(STARTS)]


@dataclass
class Outcome:
    """A loop has a cost, the largest gap of its last plan, samples not OK, and samples OK with a large gap."""

    cost: float = 0.0
    gap: float = 0.0
    bad: int = 0
    far: int = 0


def cases() -> tuple[Case, ...]:
    """Return examples and van der Pol's oscillator, with one and with three iterations per sample."""
    hovering = np.array([0.5] * 3 + [0.0] * 9)
    box, far = np.array([0.4, 0.2, 0.1, 0.1]), np.array([0.1, 0.1, 2.0, 2.0])
    fermenter, start = lambda: bioreactor.build_ocp(soft=True), bioreactor.START
    return (
        Case("quadrotor", lambda: quadrotor.build_ocp((0.0, 0.0, 0.0)), np.zeros(12), hovering, 1),
        Case("van der Pol, M = 1", van_der_pol, np.zeros(2), np.ones(2), algorithm={"iterations": 1}),
        Case("van der Pol, M = 3", van_der_pol, np.zeros(2), np.ones(2)),
        Case("cart_pole", cart_pole.build_ocp, np.zeros(4), np.array([0.2, 0.2, 0.1, 0.1])),
        Case("crane", crane.build_ocp, np.zeros(4), box),
        Case("cstr", cstr.build_ocp, cstr.START, far),
        Case("bioreactor", fermenter, start, 0.1 * start, bioreactor.STEPS, {"shift": "periodic"}),
    )


class Bench:
    """A bench has one interval of a case as the plant, and computes the gaps of a plan."""

    def __init__(self, case: Case) -> None:
        problem: Problem = classify(case.make())
        self.case, self.accumulators = case, list(problem.accumulators)
        Phi = interval_map(problem, replace(CLASSICAL, steps=case.steps))
        x, u, path = ca.SX.sym("x", problem.nx), ca.SX.sym("u", problem.nu), problem.path
        end, rate = Phi(x, u, problem.p_value, problem.dt[0])
        weight = np.diag(path.weight) if path.weight.ndim == 1 else path.weight
        cost = rate + node_cost(path)(x, u, problem.p_value, problem.dt[0], path.reference, weight)
        self._stage = ca.Function("stage", [x, u], [end, cost])
        self._ends = ca.Function("ends", [x, u], [end]).map(problem.N)

    def gaps(self, plan: Controller) -> Array:
        """Return the largest |Phi(x_k, u_k) - x_{k+1}| of every state."""
        X, U = np.asarray(plan.x, dtype=float), np.asarray(plan.u, dtype=float)
        return np.asarray(np.max(np.abs(np.asarray(self._ends(X[:-1].T, U.T)).T - X[1:]), axis=0))

    def run(self, plan: Controller, start: Array, step: Callable[[Array], Array]) -> Outcome:
        """Run a loop from a state."""
        x, out = start.copy(), Outcome()
        x[self.accumulators] = 0.0
        size = np.abs(x)
        rounding = np.sqrt(np.finfo(plan.x.dtype).eps)
        for _ in range(SAMPLES):
            u = step(x)
            now = np.max(np.abs(np.asarray(plan.x, dtype=float)), axis=0)
            size = np.maximum(size, now)
            gap, known = self.gaps(plan), np.where(size > 0, size, 1.0)
            out.bad += plan.status != Status.OK
            out.far += plan.status == Status.OK and bool(np.any(gap > FAR * np.maximum(now, rounding * known)))
            end, cost = self._stage(x, u)
            x, out.cost, out.gap = np.asarray(end).ravel(), out.cost + float(cost), float(np.max(gap / known))
            if not np.all(np.abs(x) < 1e6 * np.maximum(1.0, size)):
                return replace(out, cost=np.inf)
            x[self.accumulators] = 0.0
        return out


def converged_cost(bench: Bench, starts: list[Array]) -> list[float]:
    """Return the cost of loops whose plan is solved in every sample; for the bioreactor that of the optimal orbit."""
    case = bench.case
    if case.name == "bioreactor":
        return [-ORBIT * SAMPLES / PERIOD] * len(starts)
    plan = build(case.make(), Options(ExplicitRungeKutta(RK4, steps=case.steps), algorithm=RealTimeIteration()))
    found = []
    for start in starts:
        plan.reset()
        plan.x[...] = start
        found.append(bench.run(plan, start, lambda x: plan.solve(x, tol=1e-8, max_iterations=200).u[0]).cost)
    return found


def judge(case: Case, count: int = STARTS, precision: Any = "double") -> tuple[list[bool], list[Outcome]]:
    """Return whether each of the first loops of a case has converged, and their outcomes."""
    bench, starts = Bench(case), case.starts()[:count]
    plan = build(case.make(), case.options(precision))
    loops = []
    for start in starts:
        plan.reset()
        loops.append(bench.run(plan, start, plan.step))
    best = converged_cost(bench, starts)
    good = [o.cost <= b + DEARER * abs(b) and o.gap <= VIOLATION for o, b in zip(loops, best, strict=True)]
    return good, loops
