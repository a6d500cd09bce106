"""Peers measured in the same run: CasADi's own sqpmethod with qpOASES, one iteration per sample, warm-started."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.problem import Array, Problem
from nmpc_codegen.reference import interval_map


class SqpMethod:
    """Multiple-shooting NLP of a Gauss-Newton problem without general rows, one full SQP step per call.

    The dynamics are expanded to SX and the Gauss-Newton Hessian is handed over, so that it solves what we solve.
    """

    def __init__(self, problem: Problem, qpsol: str = "qpoases") -> None:
        if problem.path.nh or problem.terminal.nh or problem.np:
            raise ValueError(f"{problem.name}: the peer takes neither general rows nor parameters")
        self.problem = problem
        N, nx, nu = problem.N, problem.nx, problem.nu
        Phi = interval_map(problem)
        X = [ca.SX.sym(f"x{k}", nx) for k in range(N + 1)]
        U = [ca.SX.sym(f"u{k}", nu) for k in range(N)]
        z = ca.vertcat(*[v for k in range(N) for v in (X[k], U[k])], X[N])
        gaps = [Phi(X[k], U[k], ca.SX(0, 1), problem.dt[k])[0] - X[k + 1] for k in range(N)]
        residual, weight = self._residuals(X, U)
        f = ca.dot(residual, weight @ residual) / 2
        J = ca.jacobian(residual, z)
        lam_f, lam_g = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", N * nx)
        p = ca.SX.sym("p", 0)
        hessian = ca.Function("nlp_hess_l", [z, p, lam_f, lam_g], [lam_f * (J.T @ weight @ J)])
        options = {
            "qpsol": qpsol,
            "max_iter": 1,
            "print_header": False,
            "print_iteration": False,
            "print_status": False,
            "print_time": False,
            "error_on_fail": False,
            "hess_lag": hessian,
            "qpsol_options": {"printLevel": "none", "error_on_fail": False, "print_time": False}
            if qpsol == "qpoases"
            else {},
        }
        self.solver = ca.nlpsol("peer", "sqpmethod", {"x": z, "f": f, "g": ca.vertcat(*gaps)}, options)
        self.lower, self.upper = self._bounds()
        self.guess: dict[str, Any] = {}

    def _residuals(self, X: list[Any], U: list[Any]) -> tuple[Any, Any]:
        path, terminal = self.problem.path, self.problem.terminal
        y = ca.Function("y", [path.x, path.u], [path.y])
        y_N = ca.Function("y_N", [terminal.x], [terminal.y])
        residuals = [y(x, u) - path.reference for x, u in zip(X, U, strict=False)]
        weights = [path.weight] * len(U)
        if terminal.ny:
            residuals.append(y_N(X[-1]) - terminal.reference)
            weights.append(terminal.weight)
        return ca.vertcat(*residuals), ca.diagcat(*weights)

    def _bounds(self) -> tuple[Array, Array]:
        p = self.problem
        nz = p.nx + p.nu
        lower, upper = np.full(p.N * nz + p.nx, -np.inf), np.full(p.N * nz + p.nx, np.inf)
        for row in p.rows:
            for k in range(p.N) if row.kind == "control" else row.nodes:
                position = k * nz + row.index + (p.nx if row.kind == "control" else 0)
                lower[position], upper[position] = row.lower, row.upper
        return lower, upper

    def reset(self) -> None:
        """Forget the plan: next start is the origin."""
        self.guess = {}

    def step(self, xhat: Array) -> Array:
        """One SQP iteration from the last plan; returns u_0."""
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[: self.problem.nx] = upper[: self.problem.nx] = xhat
        solution = self.solver(lbx=lower, ubx=upper, lbg=0, ubg=0, **self.guess)
        self.guess = {"x0": solution["x"], "lam_x0": solution["lam_x"], "lam_g0": solution["lam_g"]}
        return np.array(solution["x"][self.problem.nx : self.problem.nx + self.problem.nu]).ravel()


def time_sqpmethod(
    problem: Problem, plant: Any, x0: Sequence[float], *, amplitude: float, period: int, steps: int = 300, runs: int = 3
) -> float:
    """Minimum over runs of the median time of a step, us, called from Python."""
    peer = SqpMethod(problem)
    medians = []
    for _ in range(runs):
        rng = np.random.default_rng(1)
        x, times = np.array(x0, dtype=float), []
        peer.reset()
        for n in range(steps):
            if n % period == 0:
                x = x + amplitude * rng.uniform(-1, 1, x.size)
            start = time.perf_counter()
            u = peer.step(x)
            times.append(1e6 * (time.perf_counter() - start))
            x = plant(x, u, problem.dt[0])
        medians.append(float(np.median(times)))
    return min(medians)
