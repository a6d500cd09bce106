"""CasADi's sqpmethod with its QP plugins, one iteration per sample: another route to a Gauss-Newton step."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.oracle.reference import CLASSICAL, Tableau, interval_map

#: Options of each plugin: no output, and a failed QP does not end the closed loop.
QUIET: dict[str, dict[str, Any]] = {
    "qpoases": {"printLevel": "none", "error_on_fail": False, "print_time": False},
    "daqp": {"error_on_fail": False, "print_time": False},
    "hpipm": {"error_on_fail": False, "print_time": False},
}


def available(qpsol: str) -> bool:
    """True if this CasADi ships the plugin."""
    return bool(ca.has_conic(qpsol))


class SqpMethod:
    """Multiple-shooting NLP of a Gauss-Newton problem without general rows, one full SQP step per call.

    The dynamics are expanded to SX and the Gauss-Newton Hessian is passed, so that the problem is the same as ours;
    variables are (x_0, u_0, x_1, ...) and the gaps are ordered stage by stage, the structure that HPIPM detects.
    """

    def __init__(self, problem: Problem, integrator: Tableau = CLASSICAL, qpsol: str = "qpoases") -> None:
        if problem.path.nh or problem.terminal.nh or problem.np:
            raise ValueError(f"{problem.name}: the peer takes neither general rows nor parameters")
        self.problem = problem
        N, nx, nu = problem.N, problem.nx, problem.nu
        Phi = interval_map(problem, integrator)
        X = [ca.SX.sym(f"x{k}", nx) for k in range(N + 1)]
        U = [ca.SX.sym(f"u{k}", nu) for k in range(N)]
        z = ca.vertcat(*[v for k in range(N) for v in (X[k], U[k])], X[N])
        gaps = [Phi(X[k], U[k], ca.SX(0, 1), problem.dt[k])[0] - X[k + 1] for k in range(N)]
        p = ca.SX.sym("p", problem.path.ny + problem.terminal.ny)
        residual, weight = self._residuals(X, U, p)
        f = ca.dot(residual, weight @ residual) / 2
        J = ca.jacobian(residual, z)
        lam_f, lam_g = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", N * nx)
        hessian = ca.Function("nlp_hess_l", [z, p, lam_f, lam_g], [ca.triu(lam_f * (J.T @ weight @ J))])
        options: dict[str, Any] = {
            "qpsol": qpsol,
            "max_iter": 1,
            "print_header": False,
            "print_iteration": False,
            "print_status": False,
            "print_time": False,
            "error_on_fail": False,
            "hess_lag": hessian,
            "qpsol_options": QUIET.get(qpsol, {}),
        }
        self.solver = ca.nlpsol("peer", "sqpmethod", {"x": z, "p": p, "f": f, "g": ca.vertcat(*gaps)}, options)
        self.lower, self.upper = self._bounds()
        self.reset()

    def _residuals(self, X: list[Any], U: list[Any], p: Any) -> tuple[Any, Any]:
        path, terminal = self.problem.path, self.problem.terminal
        y = ca.Function("y", [path.x, path.u], [path.y])
        y_N = ca.Function("y_N", [terminal.x], [terminal.y])
        residuals = [y(x, u) - p[: path.ny] for x, u in zip(X, U, strict=False)]
        weights = [path.weight] * len(U)
        if terminal.ny:
            residuals.append(y_N(X[-1]) - p[path.ny :])
            weights.append(terminal.weight)
        return ca.vertcat(*residuals), ca.sparsify(ca.diagcat(*weights))

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
        """Discard the plan: the next one starts at the measured state and the control reference."""
        self.guess: dict[str, Any] = {}
        self.reference = np.concatenate([self.problem.path.reference, self.problem.terminal.reference])

    def _start(self, xhat: Array) -> Array:
        p = self.problem
        u = [self.reference[at] if at >= 0 else 0.0 for at in p.control_reference]
        return np.concatenate([np.tile(np.concatenate([xhat, u]), p.N), xhat])

    def step(self, xhat: Array) -> Array:
        """One SQP iteration from the last plan; returns u_0."""
        nx, nu = self.problem.nx, self.problem.nu
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[:nx] = upper[:nx] = xhat
        guess = self.guess or {"x0": self._start(xhat)}
        solution = self.solver(p=self.reference, lbx=lower, ubx=upper, lbg=0, ubg=0, **guess)
        self.guess = {"x0": solution["x"], "lam_x0": solution["lam_x"], "lam_g0": solution["lam_g"]}
        return np.array(solution["x"][nx : nx + nu]).ravel()


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Discard banners that the library of a solver writes to the file descriptor of stdout."""
    saved, sink = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    try:
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(sink)
