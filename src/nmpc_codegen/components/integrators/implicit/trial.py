"""An implicit scheme is tried in NumPy at points of the problem, before any C is written.

The trial takes the same Newton steps from the same start as templates/integrators/implicit; CasADi computes f and its
derivatives.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from nmpc_codegen.components.integrators.implicit.stage_kernels import stage_kernels
from nmpc_codegen.components.integrators.tableau import ButcherTableau
from nmpc_codegen.frontend.problem import Array, Problem

#: Corrections up to this size are rounding.
ROUNDING = 1e-13


class End(NamedTuple):
    """The end of an interval has derivatives S = d x_next / d(x, u) and the last corrections of the stages."""

    x: Array
    S: Array
    left: Array


class Trial:
    """A trial runs a scheme on one problem; ``size`` (nx,) holds scales of the states."""

    def __init__(self, problem: Problem, size: Array, tableau: ButcherTableau) -> None:
        kernels = stage_kernels(problem)
        given = [kernels.x, kernels.u, kernels.p]
        J = ca.densify(ca.jacobian(kernels.f, kernels.z))
        self._f, self._slopes = ca.Function("f", given, [kernels.f]), ca.Function("J", given, [kernels.f, J])
        self.problem, self.nx, self.nv = problem, problem.nx, kernels.nv
        self.start: Array = problem.algebra.first if problem.algebra else np.zeros(0)
        self.sizes = np.array([*size, *(problem.algebra.scale if problem.algebra else ())])
        self.a, self.b, self.block = np.array(tableau.a, float), np.array(tableau.b, float), tableau.block

    def interval(self, x: Array, u: Array, p: Array, dt: float, steps: int, newton: int) -> End:
        """Integrate over dt; the result is NaN if a stage cannot be solved."""
        nx, nz = self.nx, self.nx + self.problem.nu
        start, x, S, left = x, np.array(x, dtype=float), np.eye(nx, nz), np.zeros(nx)
        point = np.concatenate([x, self.start])
        with np.errstate(all="ignore"):
            for _ in range(steps):
                x, S, point, more = self._step(x, point, S, u, p, dt / steps, newton)
                left += more
                if not np.all(np.isfinite(x)):
                    break
        if self.problem.jump is not None:
            rows = list(self.problem.maps)
            value, slopes = self.problem.jump_slopes(start, u, [*p, *np.zeros(self.problem.solved)], dt)
            x[rows], S[rows] = value.full().ravel(), slopes.full()
        for i, j in self.problem.noise:
            x[i], S[i, nx + j] = x[i] + u[j], 1.0
        return End(x, S, left)

    def _step(
        self, x: Array, point: Array, S: Array, u: Array, p: Array, h: float, newton: int
    ) -> tuple[Array, Array, Array, Array]:
        count, nx = len(self.b), self.nx
        K, columns = np.zeros((count, nx)), np.zeros((count, *S.shape))
        left, point = np.zeros(nx), np.concatenate([x, point[nx:]])
        for first in range(0, count, self.block):
            own = slice(first, first + self.block)
            bases = x + h * self.a[own, :first] @ K[:first]
            moved = S + h * np.tensordot(self.a[own, :first], columns[:first], 1)
            A = h * self.a[own, own]
            if not A.any():
                f, J = self._at(bases[0], u, p)
                K[first], point = f, bases[0]
                columns[first] = J[:, :nx] @ moved[0]
                columns[first][:, nx:] += J[:, nx:]
                continue
            X, Js, M, more = self._solve(np.tile(point, (self.block, 1)), bases, u, p, A, newton)
            left += more
            point = X[-1]
            K[own] = _solve(A, X[:, :nx] - bases)
            columns[own] = self._columns(Js, M, A, moved)
        return x + h * self.b @ K, S + h * np.tensordot(self.b, columns, 1), point, left

    def _columns(self, Js: Array, M: Array, A: Array, moved: Array) -> Array:
        """Return the derivatives of the slopes of a block."""
        nx, nv, block = self.nx, self.nv, self.block
        rest = np.zeros((block, nv, moved.shape[-1]))
        rest[:, :nx] = moved
        rest[:, :nx, nx:] += np.tensordot(A, Js[:, :nx, nv:], 1)
        rest[:, nx:, nx:] += Js[:, nx:, nv:]
        Z = _solve(M, rest.reshape(block * nv, -1)).reshape(rest.shape)
        return np.asarray(np.tensordot(_solve(A, np.eye(block)), Z[:, :nx] - moved, 1))

    def _at(self, X: Array, u: Array, p: Array) -> tuple[Array, Array]:
        f, J = self._slopes(X, u, p)
        return np.asarray(f, dtype=float).ravel(), np.asarray(J, dtype=float)

    def _solve(
        self, X: Array, bases: Array, u: Array, p: Array, A: Array, newton: int
    ) -> tuple[Array, Array, Array, Array]:
        """Return the points of a block, derivatives and Newton matrix at the points before, and last corrections."""
        nx, nv, block = self.nx, self.nv, self.block

        def rest(f: Array) -> Array:
            return np.hstack([X[:, :nx] - bases - A @ f[:, :nx], -f[:, nx:]]).ravel()

        for _ in range(newton):
            f, Js = map(np.array, zip(*(self._at(each, u, p) for each in X), strict=True))
            parts = np.zeros((block, nv, block, nv))
            parts[:, :nx] = -np.einsum("ij,jrc->irjc", A, Js[:, :nx, :nv])
            for i in range(block):
                parts[i, :nx, i, :nx] += np.eye(nx)
                parts[i, nx:, i] = -Js[i, nx:, :nv]
            M = parts.reshape(block * nv, block * nv)
            change = _solve(M, rest(f)).reshape(X.shape)
            X = X - change
            if np.all(np.abs(change) <= ROUNDING * (self.sizes + np.abs(X))) or not np.all(np.isfinite(change)):
                break
        f = np.array([np.asarray(self._f(each, u, p), dtype=float).ravel() for each in X])
        change = _solve(M, rest(f)).reshape(X.shape)
        return X - change, Js, M, np.sum(np.abs(change[:, :nx]), axis=0)


def _solve(M: Array, b: Array) -> Array:
    """Return M^-1 b; NaN if M is singular."""
    try:
        return np.asarray(np.linalg.solve(M, b), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(b, np.nan)
