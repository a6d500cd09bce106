"""A diagonally implicit scheme in NumPy: what it does at points of the problem, before any C is written.

The same Newton steps from the same start as in templates/integrators/implicit, with f and its derivatives by CasADi.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from nmpc_codegen.components.integrators.tableau import ButcherTableau
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.frontend.scales import scales

#: Size of a correction that is rounding.
ROUNDING = 1e-13


class End(NamedTuple):
    """The end of an interval, its derivatives S = d x_next / d(x, u), and the last corrections of its stages."""

    x: Array
    S: Array
    left: Array


class Trial:
    """A scheme for one problem."""

    def __init__(self, problem: Problem, tableau: ButcherTableau) -> None:
        x, u, p = problem.path.x, problem.path.u, problem.path.p
        f = ca.densify(problem.dynamics(x, u, p))
        J = ca.densify(ca.jacobian(f, ca.vertcat(x, u)))
        self._f, self._slopes = ca.Function("f", [x, u, p], [f]), ca.Function("J", [x, u, p], [f, J])
        self.problem, self.nx = problem, problem.nx
        self.size = scales(problem).z[: problem.nx]
        self.a, self.b = (np.array(part, dtype=float) for part in (tableau.a, tableau.b))

    def interval(self, x: Array, u: Array, p: Array, dt: float, steps: int, newton: int) -> End:
        """Integrate over dt; NaN where a stage cannot be solved."""
        nx, nz = self.nx, self.nx + self.problem.nu
        start, x, S, left = x, np.array(x, dtype=float), np.eye(nx, nz), np.zeros(nx)
        with np.errstate(all="ignore"):
            for _ in range(steps):
                x, S, more = self._step(x, S, u, p, dt / steps, newton)
                left += more
        if self.problem.jump is not None:
            rows = list(self.problem.maps)
            value, slopes = self.problem.jump_slopes(start, u, p, dt)
            x[rows], S[rows] = value.full().ravel(), slopes.full()
        return End(x, S, left)

    def _step(self, x: Array, S: Array, u: Array, p: Array, h: float, newton: int) -> tuple[Array, Array, Array]:
        slopes: list[Array] = []
        columns: list[Array] = []
        left = np.zeros(self.nx)
        forcing, X = np.zeros_like(S), x
        for i, row in enumerate(self.a):
            base = x + h * sum((row[j] * K for j, K in enumerate(slopes)), np.zeros_like(x))
            moved = S + h * sum((row[j] * K for j, K in enumerate(columns)), np.zeros_like(S))
            ha = h * row[i]
            if not ha:
                f, J = self._at(base, u, p)
                forcing[:, self.nx :] = J[:, self.nx :]
                slopes.append(f)
                columns.append(J[:, : self.nx] @ moved + forcing)
                continue
            X, J, M, more = self._solve(X, base, u, p, ha, newton)
            left += more
            forcing[:, self.nx :] = J[:, self.nx :]
            slopes.append((X - base) / ha)
            columns.append((_solve(M, moved + ha * forcing) - moved) / ha)
        end = x + h * sum((b * K for b, K in zip(self.b, slopes, strict=True)), np.zeros_like(x))
        return end, S + h * sum((b * K for b, K in zip(self.b, columns, strict=True)), np.zeros_like(S)), left

    def _at(self, X: Array, u: Array, p: Array) -> tuple[Array, Array]:
        f, J = self._slopes(X, u, p)
        return np.asarray(f, dtype=float).ravel(), np.asarray(J, dtype=float)

    def _solve(
        self, X: Any, base: Array, u: Array, p: Array, ha: float, newton: int
    ) -> tuple[Array, Array, Array, Array]:
        """The point of a stage, derivatives and Newton matrix at the point before, and the last correction."""
        for _ in range(newton):
            f, J = self._at(X, u, p)
            M = np.eye(self.nx) - ha * J[:, : self.nx]
            change = _solve(M, X - base - ha * f)
            X = X - change
            if np.all(np.abs(change) <= ROUNDING * (self.size + np.abs(X))):
                break
        f = np.asarray(self._f(X, u, p), dtype=float).ravel()
        change = _solve(M, X - base - ha * f)
        return X - change, J, M, np.abs(change)


def _solve(M: Array, b: Array) -> Array:
    """M^-1 b; NaN if M is singular."""
    try:
        return np.asarray(np.linalg.solve(M, b), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(b, np.nan)
