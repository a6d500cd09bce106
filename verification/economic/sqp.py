"""NumPy runs the SQP of an economic problem with full steps, a fixed working set, and a Hessian by name.

The functions of a node come from CasADi, the step from kkt_step(); the generated code is not used. Hessians:
"exact" (of the Lagrangian at the iterate, indefinite), "tuned" (M), "corrected" (M, with the dual correction),
"identity".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.economic import StageQp, Step, Tuning, corrected_multipliers, kkt_step
from nmpc_codegen.economic.stage import SteadyStage

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan has x (N+1, n), u (N, m), lam (N+1, n), and mu of the working set at the nodes 1..N-1 (N, rows)."""

    x: Array
    u: Array
    lam: Array
    mu: Array

    @property
    def w(self) -> Array:
        return np.hstack([self.x[:-1], self.u])


@dataclass(frozen=True, eq=False)
class Shooting:
    """The problem starts at x_0 and ends at x_N = x_s.

    ``rows``: indices of the path rows that are equations at the nodes 1..N-1.
    """

    stage: SteadyStage
    N: int
    rows: tuple[int, ...]
    bounds: Array
    x_end: Array

    def functions(
        self, extra: Callable[[ca.SX, ca.SX], ca.SX] | None = None, cost: Callable[[ca.SX], ca.SX] | None = None
    ) -> ca.Function:
        """Return (w, lam_next, mu) -> (Phi, [A B], gradient, C, h, Hessian of the Lagrangian).

        ``extra``: a further stage cost of (x, Phi), with which a problem is rotated; ``cost``: of w, instead of l.
        """
        s, n = self.stage, self.stage.nx
        lam, mu = ca.SX.sym("lam", n), ca.SX.sym("mu", len(self.rows))
        l = s.cost if cost is None else cost(s.w)  # noqa: E741
        l = l if extra is None else l + extra(s.x, s.Phi)  # noqa: E741
        h = ca.vertcat(ca.SX(0, 1), *(s.rows.h[i] for i in self.rows))
        L = l + ca.dot(lam, s.Phi) + ca.dot(mu, h)
        out = [s.Phi, ca.jacobian(s.Phi, s.w), ca.gradient(l, s.w), ca.jacobian(h, s.w), h, ca.hessian(L, s.w)[0]]
        return ca.Function("node", [s.w, lam, mu], [ca.densify(o) for o in out])


def steady_plan(tuning: Tuning, N: int) -> Plan:
    """Return the steady state with its multipliers at every node."""
    return Plan(
        x=np.tile(tuning.x_s, (N + 1, 1)),
        u=np.tile(tuning.u_s, (N, 1)),
        lam=np.tile(tuning.lam_s, (N + 1, 1)),
        mu=np.tile(tuning.mu_s, (N, 1)),
    )


def quadratic_program(
    problem: Shooting, node: ca.Function, plan: Plan, hessian: Array | None, end: tuple[Array, Array] | None = None
) -> StageQp:
    """Return the subproblem at a plan; ``hessian`` None: exact. ``end``: gradient and Hessian of a cost of x_N."""
    n, N = problem.stage.nx, problem.N
    columns = [np.asarray(v) for v in node.map(N)(plan.w.T, plan.lam[1:].T, plan.mu.T)]
    Phi, AB, g, C, h, H = (np.array(np.split(v, N, axis=1)) for v in columns)
    on = [k > 0 for k in range(N)]
    empty = np.zeros((0, AB.shape[2]))
    gradient_N, hessian_N = (np.zeros(n), np.zeros((n, n))) if end is None else end
    return StageQp(
        A=AB[:, :, :n],
        B=AB[:, :, n:],
        b=Phi[:, :, 0] - plan.x[1:],
        H=H if hessian is None else np.tile(hessian, (N, 1, 1)),
        g=g[:, :, 0],
        C=[C[k] if on[k] else empty for k in range(N)],
        c=[problem.bounds - h[k].ravel() if on[k] else np.zeros(0) for k in range(N)],
        H_N=hessian_N,
        g_N=gradient_N,
        D=np.eye(n),
        d=problem.x_end - plan.x[-1],
    )


def stepped(plan: Plan, step: Step) -> Plan:
    """Return the plan after a full step."""
    mu = np.array([m if len(m) else np.zeros(plan.mu.shape[1]) for m in step.mu])
    return Plan(plan.x + step.dx, plan.u + step.du, step.lam, mu)


def iterate(
    problem: Shooting, tuning: Tuning, x0: Array, name: str, iterations: int, start: Plan | None = None
) -> tuple[Plan, list[float], list[float]]:
    """Take full steps from the steady state; return the last plan, step sizes, and the residuals before the steps.

    A step size is the largest component; a residual is the Euclidean norm of the optimality conditions, with gaps.
    """
    node = problem.functions()
    size = problem.stage.nx + tuning.B.shape[1]
    hessian = {"exact": None, "tuned": tuning.M, "corrected": tuning.M, "identity": np.eye(size)}[name]
    plan = steady_plan(tuning, problem.N) if start is None else start
    sizes, residuals = [], []
    for _ in range(iterations):
        qp = quadratic_program(problem, node, plan, hessian)
        residuals.append(residual(qp, plan, x0))
        step = kkt_step(qp, x0 - plan.x[0])
        sizes.append(float(max(np.abs(step.dx).max(), np.abs(step.du).max())))
        plan = stepped(plan, corrected_multipliers(tuning, step) if name == "corrected" else step)
        if not np.isfinite(sizes[-1]) or sizes[-1] > 1e8:
            break
    return plan, sizes, residuals


def residual(qp: StageQp, plan: Plan, x0: Array) -> float:
    """Return the norm of the optimality conditions at the plan: stationarity in x_0..x_{N-1}, u; gaps; rows; x_0."""
    AB = np.concatenate([qp.A, qp.B], axis=2)
    slope = qp.g + np.einsum("kij,ki->kj", AB, plan.lam[1:])
    slope[:, : plan.x.shape[1]] -= plan.lam[:-1]
    for k, C in enumerate(qp.C):
        if len(C):
            slope[k] += C.T @ plan.mu[k]
    parts = [slope.ravel(), qp.b.ravel(), *qp.c, qp.d, x0 - plan.x[0]]
    return float(np.linalg.norm(np.concatenate(parts)))
