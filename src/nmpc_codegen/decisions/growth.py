"""The growth of the open loop over the horizon costs accuracy if condensing eliminates the states.

    dx_k = sum_j Phi(k, j + 1) B_j du_j + ...,   Phi(k, j) = A_{k-1} ... A_j

If the open loop grows by a factor c over these intervals, the entries of the condensed Hessian grow by c^2, and that
part of them that decides on the controls falls below their rounding errors: the relative error of the controls is about
4 c^2 eps. A recursion over the stages has no such products.

The factor must not depend on the units of the states. Let M_l hold the largest magnitude of every entry of Phi(k, j)
over all k - j <= l. In the best diagonal units T the largest sum of a row of T^-1 M_l T is the spectral radius of M_l;
the factor is this radius, for the states that the controls reach.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.components.base import Condensing, Integrator, Transition, spell
from nmpc_codegen.components.condensing import NoCondensing
from nmpc_codegen.components.integrators import ImplicitRungeKutta
from nmpc_codegen.decisions.trials import Trials
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.completion.first_plan import points
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.ir.casadi_types import Function
from nmpc_codegen.package.struct_layout import EPS, Precision

#: Relative error of the controls above which the compiler does not choose the condensing that causes it, and warns of a
#: stated one. In double precision, the check before OK sometimes takes larger errors for failures.
AVOIDED: Mapping[Precision, float] = {"double": 1e-7, "single": 1e-4}
#: Relative error above which a stated condensing is refused.
REFUSED = 1e-3
#: Growth over the horizon above which single shooting loses plans.
SIMULATED = 200.0
Marks = NDArray[np.bool_]

#: Entries of products are limited to this number.
LARGEST = 1e100


@dataclass(frozen=True)
class Growth:
    """Growth over l intervals is ``factors[l - 1]``; ``factors`` is empty if no stated point has finite derivatives."""

    factors: tuple[float, ...]
    precision: Precision

    def factor(self, intervals: int) -> float:
        """Return the growth if the states of this number of intervals depend on the first state and the controls."""
        return self.factors[min(intervals, len(self.factors)) - 1] if self.factors else 1.0

    def error(self, intervals: int, precision: Precision | None = None) -> float:
        """Return the estimated relative error of the controls, at most 1."""
        return min(1.0, 4.0 * self.factor(intervals) ** 2 * EPS[precision or self.precision])

    def describe(self, intervals: int) -> str:
        """Describe the factor and the digits that remain."""
        left, given = (abs(math.log10(e)) for e in (self.error(intervals), EPS[self.precision]))
        return (
            f"the open loop grows by a factor of {self.factor(intervals):.2g} over {intervals} intervals, whose square "
            f"in the Hessian leaves the controls about {left:.0f} of {given:.0f} digits in {self.precision} precision"
        )

    def spares(self, problem: Problem, condensing: Condensing) -> bool:
        """Return True if condensing loses little accuracy, a relative error of at most AVOIDED."""
        return self.error(_intervals(problem, condensing)) <= AVOIDED[self.precision]

    def warning(self, problem: Problem, condensing: Condensing) -> tuple[str, ...]:
        """Return a warning if a condensing component loses much accuracy.

        Raises:
            OptionError: the component loses too much accuracy.
        """
        intervals = _intervals(problem, condensing)
        if self.error(intervals) > REFUSED:
            offers = [_remedy(problem)]
            if self.error(intervals, "double") <= REFUSED:
                offers.append('precision "double" (--set precision=double)')
            raise OptionError(
                f"condensing {spell(condensing)} cannot work: {self.describe(intervals)}; use {' or '.join(offers)}"
            )
        if self.spares(problem, condensing):
            return ()
        advice = _remedy(problem) if intervals > 1 else "shorter intervals"
        return (f"condensing {condensing.name}: {self.describe(intervals)}; try {advice}",)

    def of_simulation(self, algorithm: str, intervals: int) -> tuple[str, ...]:
        """Return a warning if an algorithm simulates its plans and small errors of their controls make them diverge."""
        factor = self.factor(intervals)
        if factor <= SIMULATED:
            return ()
        return (
            f"{algorithm} simulates its plans, and the open loop grows by a factor of {factor:.2g} over {intervals} "
            "intervals: try RealTimeIteration(), or a shorter horizon",
        )

    def left_out(self, problem: Problem, candidates: Iterable[Condensing]) -> tuple[str, ...]:
        """Return the reason for not choosing candidates that lose much accuracy; empty if there are none."""
        lossy = {c.name: _intervals(problem, c) for c in candidates if not self.spares(problem, c)}
        if not lossy:
            return ()
        return (f"condensing: {', '.join(lossy)} not considered; {self.describe(min(lossy.values()))}",)


def _intervals(problem: Problem, condensing: Condensing) -> int:
    """Return the number of consecutive intervals whose states are functions of earlier states: all, or one."""
    return problem.N if condensing.gives == "condensed" else 1


def _remedy(problem: Problem) -> str:
    """Return the replacement for a condensing that loses accuracy."""
    if problem.uses <= NoCondensing.supports:
        return "condensing NoCondensing() (--set condensing=none) with a QP solver on stages"
    return "a shorter horizon, or a measured x_0 (without free_initial())"


def growth(trials: Trials, integrator: Integrator, precision: Precision) -> Growth:
    """Return the largest growth at the stated points: the first plan, and the references of the states.

    Points without finite derivatives do not count.
    """
    problem, found = trials.problem, []
    if isinstance(integrator, ImplicitRungeKutta):
        transition = trials.slopes(integrator)
    else:
        transition = _interval_derivatives(problem, integrator)
    with np.errstate(all="ignore"):
        for at, x, u in ((corner, *point) for _, corner in problem.corners for point in points(corner)):
            lengths = {dt: transition(x, u, at.p_value, dt) for dt in set(problem.dt)}
            if all(np.all(np.isfinite(S)) for S in lengths.values()):
                found.append(_factors(np.array([lengths[dt] for dt in problem.dt]), problem.uniform))
    return Growth(tuple(float(c) for c in np.max(found, axis=0)) if found else (), precision)


def _interval_derivatives(problem: Problem, integrator: Integrator) -> Transition:
    """Return [A B] of an interval as a function, by steps of RK4, or by the discrete map."""
    step = _step(problem)
    longest = math.inf if problem.discrete else integrator.longest_step(problem)
    return lambda x, u, p, dt: _interval(step, problem, x, u, p, dt, max(1, round(dt / longest)))


def _step(problem: Problem) -> Function:
    """Return ((x, S), (u, p, h)) -> (x_next, S_next): one integration step, or the discrete map, with sensitivities."""
    x, u, p, h = problem.path.x, problem.path.u, problem.path.p, ca.SX.sym("h")
    if problem.discrete:
        x_next = ca.densify(problem.dynamics(x, u, p))
    else:
        slope = ca.Function("slope", [x, ca.vertcat(u, p)], [problem.dynamics(x, u, p)])
        x_next = ca.simpleRK(slope, 1, 4).expand()(x, ca.vertcat(u, p), h)
    S = ca.SX.sym("S", problem.nx, problem.nx + problem.nu)
    A, B = ca.jacobian(x_next, x), ca.jacobian(x_next, u)
    S_next = ca.densify(A @ S + ca.horzcat(ca.SX(problem.nx, problem.nx), B))
    state, data = ca.vertcat(x, ca.vec(S)), ca.vertcat(u, p, h)
    return ca.Function("step", [state, data], [ca.vertcat(x_next, ca.vec(S_next))])


def _interval(step: Function, problem: Problem, x: Array, u: Array, p: Array, dt: float, steps: int) -> Array:
    """Return [A B] of an interval of length dt from x."""
    start = np.concatenate([x, np.eye(problem.nx, problem.nx + problem.nu).ravel(order="F")])
    end = step.fold(steps)(start, np.concatenate([u, p, [dt / steps]]))
    S: Array = np.array(end, dtype=np.float64)[problem.nx :, 0].reshape(problem.nx, -1, order="F")
    if problem.jump is not None:
        S[list(problem.maps)] = problem.jump_slopes(x, u, p, dt)[1].full()
    for i, j in problem.noise:
        S[i, problem.nx + j] = 1.0
    return S


def _factors(S: Array, uniform: bool) -> Array:
    """Return the growth over 1, 2, ..., N intervals, from [A_k B_k] of every interval, (N, nx, nx + nu)."""
    N, nx = len(S), S.shape[1]
    reached = _reachable_states(S)
    A = np.clip(S[:, reached][:, :, :nx][:, :, reached], -LARGEST, LARGEST)
    products = np.broadcast_to(np.eye(len(A[0])), A.shape)[: 1 if uniform else N]
    largest, found = np.abs(products[0]), []
    for lag in range(N):
        found.append(max(1.0, float(np.max(np.abs(np.linalg.eigvals(largest)), initial=0.0))))
        count = 1 if uniform else N - lag
        # Phi(j + lag + 1, j) = A_{j + lag} Phi(j + lag, j)
        products = np.clip(A[lag : lag + count] @ products[:count], -LARGEST, LARGEST)
        largest = np.maximum(largest, np.max(np.abs(products), axis=0, initial=0.0))
    return np.array(found)


def _reachable_states(S: Array) -> Marks:
    """Return flags of the states that a control reaches, directly or through other states."""
    nx = S.shape[1]
    depends = np.any(S != 0.0, axis=0)
    reached: Marks = np.any(depends[:, nx:], axis=1)
    for _ in range(nx):
        reached = reached | np.any(depends[:, :nx] & reached, axis=1)
    return reached
