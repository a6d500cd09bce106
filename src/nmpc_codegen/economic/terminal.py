"""ocp.lqr_terminal_cost() uses the cost-to-go of the linear-quadratic regulator at the steady state as terminal cost.

    tracking:  V_f = 1/2 (x - x_s)' P (x - x_s)
    economic:  V_f = (lam_s - D' mu_s)' (x - x_s) + 1/2 (x - x_s)' P (x - x_s)

D are the slopes of the strictly active rows that are also imposed at node N, and mu_s their multipliers: the problem
itself states these rows at x_N, so the cost-to-go must not contain them. With only lam_s they would have no multiplier
at x_N, and the plan could leave them there, away from the steady state.

P solves the Riccati equation of the discrete map, which depends on the integrator; the OCP therefore only records the
request, and this stage, Problem -> Problem, answers it when the options are known. A positive semidefinite P of a
tracking cost becomes a least-squares residual x - x_s with the weight P, whose reference can be changed at run time;
all else is a general cost. Without the linear term an economic controller does not come to rest at the steady state.

Source: Zanon and Faulwasser, "Economic MPC without terminal constraints: gradient-correcting end penalties enforce
asymptotic stability", Journal of Process Control 63 (2018).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg

from nmpc_codegen.economic.cost_to_go import CostToGo, cost_to_go
from nmpc_codegen.economic.linear_quadratic import LinearQuadratic, curvature_scaling, linear_quadratic
from nmpc_codegen.economic.stage import SteadyStage, magnitudes, steady_stage
from nmpc_codegen.economic.stationary import SteadyState, solve_steady_state
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import flag, vector
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array, LqrRequest, Problem, Stage
from nmpc_codegen.options import Options

#: Largest gap Phi(x, u) - x of a given steady state, and slope of the cost at the references, relative to their size.
GAP, SLOPE = 1e-6, 1e-7
#: Entries below this fraction of the largest one, in typical units of w, are rounding errors.
NOISE = 1e-14
#: A direction counts as inside a subspace if the part outside, in units of the curvature, is at most this value.
OUTSIDE = 1e-6
SEMIDEFINITE = -1e-12  # least eigenvalue of a weight, relative to the largest


@dataclass(frozen=True, eq=False)
class TerminalCost:
    """A terminal cost has the numbers of a cost-to-go.

    Attributes:
        P: (nx, nx), with zero rows for cyclic states.
        lam: (nx,), multipliers of the dynamics at the steady state.
        slope: (nx,), gradient of the cost-to-go at x_s: lam - D' mu_s, or zero for tracking.
        K: (nu, nx), the feedback.
        x_s: (nx,), steady state.
        u_s: (nu,), control at the steady state.
        economic: True for an economic cost.
        residual: residual of the Riccati equation.
        active: names of the strictly active rows.
    """

    P: Array
    lam: Array
    slope: Array
    K: Array
    x_s: Array
    u_s: Array
    economic: bool
    residual: float
    active: tuple[str, ...]

    @property
    def semidefinite(self) -> bool:
        """Return True if P is positive semidefinite up to rounding."""
        values = np.linalg.eigvalsh(self.P)
        return bool(values[0] >= SEMIDEFINITE * max(abs(values[-1]), np.finfo(float).tiny))


def lqr_terminal_cost(
    ocp: OCP, options: Options | None = None, *, economic: bool = False, x: Any = None, u: Any = None
) -> TerminalCost:
    """Compute the numbers of ocp.lqr_terminal_cost().

    Args:
        ocp: the problem.
        options: its integrator defines the discrete map.
        economic: as in ocp.lqr_terminal_cost().
        x: as in ocp.lqr_terminal_cost().
        u: as in ocp.lqr_terminal_cost().
    """
    problem = replace(classify(ocp), terminal_lqr=None)
    given = [
        None if part is None else vector(part, size, f"lqr_terminal_cost: {name}")
        for name, part, size in (("x", x, problem.nx), ("u", u, problem.nu))
    ]
    return terminal_cost(problem, LqrRequest(flag(economic, "lqr_terminal_cost: economic"), *given), options)


def with_terminal_cost(problem: Problem, options: Options | None = None) -> Problem:
    """Return the problem with the terminal cost that it requests, or unchanged if it requests none.

    Args:
        problem: the result of classify().
        options: their integrator defines the discrete map.

    Raises:
        ProblemError: there is no steady state, or the Riccati equation has no solution.
    """
    if problem.terminal_lqr is None:
        return problem
    request, problem = problem.terminal_lqr, replace(problem, terminal_lqr=None)
    found = terminal_cost(problem, request, options)
    if found.semidefinite and not found.economic:
        return replace(problem, terminal=_with_residual(problem, found))
    x = problem.terminal.x - found.x_s
    cost = ca.dot(found.slope, x) + ca.dot(x, ca.DM(found.P) @ x) / 2
    before = problem.terminal.cost
    terminal = replace(problem.terminal, cost=cost if before is None else before + cost)
    return replace(problem, terminal=terminal, uses=problem.uses | {"general cost"})


def terminal_cost(problem: Problem, request: LqrRequest, options: Options | None) -> TerminalCost:
    """Solve for the steady state and its cost-to-go."""
    stage = steady_stage(problem, options)
    steady = _economic_point(stage, request) if request.economic else _tracking_point(stage, request)
    lq = linear_quadratic(stage, steady, gauss_newton=not request.economic)
    found = cost_to_go(lq, stage.names)
    _refuse_open_end(lq, found)
    return _spread(stage, steady, found, request.economic, lq.active)


def _refuse_open_end(lq: LinearQuadratic, found: CostToGo) -> None:
    """Raise ProblemError if x_N may leave the subspace on which the cost-to-go is finite."""
    if lq.D is None or found.subspace.shape[1] == lq.n:
        return
    unit = curvature_scaling(lq)[: lq.n, None]
    inside = scipy.linalg.orth(found.subspace / unit)
    free = scipy.linalg.null_space(lq.scale(curvature_scaling(lq)).D) if len(lq.D) else np.eye(lq.n)
    if np.abs(free - inside @ (inside.T @ free)).max(initial=0.0) > OUTSIDE:
        raise ProblemError(
            f"lqr_terminal_cost: behind node N, only some of the states that the rows at node N allow can stay on the "
            f"strictly active rows ({', '.join(lq.active)}), so the cost-to-go is infinite next to the steady state; "
            "end the plan in it instead: best = nmpc_codegen.economic.steady_state(ocp, options), "
            "ocp.subject_to(best.x, ocp.x, best.x, at='end')"
        )


def _economic_point(stage: SteadyStage, request: LqrRequest) -> SteadyState:
    x, u = request.x, request.u
    if x is None and u is None:
        return solve_steady_state(stage)
    problem = stage.problem
    return solve_steady_state(stage, (problem.x_initial if x is None else x, np.zeros(problem.nu) if u is None else u))


def _tracking_point(stage: SteadyStage, request: LqrRequest) -> SteadyState:
    """Return the given steady state, else that of the references; its multipliers are zero."""
    if stage.gauss_newton is None:
        raise ProblemError("lqr_terminal_cost: the stage cost is no least squares; use economic=True")
    if request.x is None or request.u is None:
        if request.x is not None or request.u is not None:
            raise ProblemError("lqr_terminal_cost: give both x and u of the steady state, or neither")
        found = solve_steady_state(stage)
        slope = float(np.abs(stage.jacobians(found.w)[1].full()).max())
        curvature = np.abs(ca.Function("H", [stage.w], [stage.gauss_newton])(found.w).full()).max()
        if slope > SLOPE * float(curvature) * max(1.0, float(np.abs(found.w).max())):
            raise ProblemError(
                f"lqr_terminal_cost: the references are no steady state (the cost has the slope {slope:.2g} at the "
                "nearest one); give x= and u= of a steady state, or use economic=True"
            )
        x, u, size = found.x, found.u, found.size
    else:
        x, u = request.x[list(stage.kept)], request.u
        size = magnitudes(stage, np.concatenate([x, u]))
    w = np.concatenate([x, u])
    Phi, cost, h = (part.full().ravel() for part in stage.values(w))
    gap = float(np.abs(Phi - x).max())
    if not gap <= GAP * max(1.0, float(np.abs(w).max())):
        raise ProblemError(f"lqr_terminal_cost: x and u are no steady state: one interval moves a state by {gap:.3g}")
    rows = stage.rows
    for name, lower, value, upper, l1 in zip(rows.names, rows.lower, h, rows.upper, rows.penalty, strict=True):
        if l1 == np.inf and not lower - GAP * (1 + abs(value)) <= value <= upper + GAP * (1 + abs(value)):
            raise ProblemError(
                f"lqr_terminal_cost: the steady state violates the row '{name}': {value:.6g} is not in "
                f"{lower:.6g} .. {upper:.6g}"
            )
    equations = tuple(i for i in range(len(h)) if rows.lower[i] == rows.upper[i] and rows.penalty[i] > 0)
    return SteadyState(x, u, np.zeros(stage.nx), np.zeros(len(h)), float(cost[0]), equations, gap, size)


def _spread(
    stage: SteadyStage, steady: SteadyState, found: CostToGo, economic: bool, active: tuple[str, ...]
) -> TerminalCost:
    """Return the matrices for all states of the problem."""
    problem, kept = stage.problem, list(stage.kept)
    P, K, lam = np.zeros((problem.nx, problem.nx)), np.zeros((problem.nu, problem.nx)), np.zeros(problem.nx)
    P[np.ix_(kept, kept)], K[:, kept], lam[kept] = found.P, found.K, steady.lam
    slope = lam.copy()
    end = stage.terminal_rows
    at_end = ca.Function("G", [stage.x], [ca.jacobian(end.h, stage.x)])(steady.x).full()
    for i in steady.active:
        if stage.rows.names[i] in end.names:
            slope[kept] -= steady.mu[i] * at_end[end.names.index(stage.rows.names[i])]
    # Rounding errors would cost operations in the generated code.
    d = steady.size[: stage.nx]
    unit = np.zeros(problem.nx)
    unit[kept] = d
    scaled = P * np.outer(unit, unit)
    largest = max(float(np.abs(scaled).max(initial=0.0)), float(np.abs(slope * unit).max(initial=0.0)))
    P[np.abs(scaled) <= NOISE * largest] = 0.0
    slope[np.abs(slope * unit) <= NOISE * largest] = 0.0
    x_s = np.where(np.abs(steady.x) <= NOISE * d, 0.0, steady.x)
    return TerminalCost(P, lam, slope, K, stage.full(x_s), steady.u, economic, found.residual, active)


def _with_residual(problem: Problem, found: TerminalCost) -> Stage:
    """Return the terminal stage with 1/2 |x - x_s|^2_P added to its least squares; cyclic states are left out."""
    stage = problem.terminal
    kept = [i for i in range(problem.nx) if i not in problem.cyclic]
    names = [problem.state_names[i] for i in kept]
    free = [f"{name}_lqr" if name in stage.y_names else name for name in names]
    weight = np.zeros((stage.ny + len(kept), stage.ny + len(kept)))
    weight[: stage.ny, : stage.ny] = stage.weight
    weight[stage.ny :, stage.ny :] = found.P[np.ix_(kept, kept)]
    return replace(
        stage,
        y=ca.densify(ca.vertcat(stage.y, *(stage.x[i] for i in kept))),
        y_names=(*stage.y_names, *free),
        reference=np.concatenate([stage.reference, found.x_s[kept]]),
        weight=weight,
        scale_with_dt=(*stage.scale_with_dt, *(False for _ in kept)),
    )
