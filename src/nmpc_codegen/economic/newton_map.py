"""The map of an interval by an implicit scheme is written as an expression, for derivatives at a steady state.

Every stage takes two Newton steps from the point of the previous stage. At a steady state they start at the solution:
the error of one step is quadratic in f, and the error of two steps has four factors of f, so that value, first, second
and third derivatives of the map there are exact.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression, Function
from nmpc_codegen.oracle.trajectory import Tableau, with_maps

NEWTON_STEPS = 2


def newton_map(problem: Problem, scheme: Tableau) -> Function:
    """Return the function (x, u, p, dt) -> (Phi, q): state at the end of an interval, integral of the cost rate."""
    s = problem.path
    f = problem.dynamics(s.x, s.u, s.p)
    slopes = ca.Function("slopes", [s.x, s.u, s.p], [f, ca.jacobian(f, s.x)])
    rate = ca.Function("rate", [s.x, s.u, s.p], [ca.SX(0) if s.cost_rate is None else s.cost_rate])
    A, b = np.asarray(scheme.A, dtype=float), np.asarray(scheme.b, dtype=float)
    h = s.dt / scheme.steps
    x, q = s.x, ca.SX(0)
    for _ in range(scheme.steps):
        K: list[Any] = []
        X = x
        for i in range(len(b)):
            base = x + h * sum((A[i, j] * K[j] for j in range(i)), ca.SX.zeros(problem.nx))
            if A[i, i]:
                X = _solve_stage(slopes, X, base, h * A[i, i], s.u, s.p)
                K.append((X - base) / (h * A[i, i]))
            else:
                X = base
                K.append(slopes(X, s.u, s.p)[0])
            q = q + h * b[i] * rate(X, s.u, s.p)
        x = x + h * sum((b[i] * K[i] for i in range(len(b))), ca.SX.zeros(problem.nx))
    return ca.Function("Phi", [s.x, s.u, s.p, s.dt], [with_maps(problem, x, s.x, s.u, s.p, s.dt), q])


def _solve_stage(slopes: Function, X: Expression, base: Expression, ha: Expression, u: Any, p: Any) -> Expression:
    """Solve X = base + ha f(X) by Newton steps from X."""
    for _ in range(NEWTON_STEPS):
        f, f_x = slopes(X, u, p)
        X = X - _eliminate(ca.SX.eye(X.numel()) - ha * f_x, X - base - ha * f)
    return X


def _eliminate(M: Expression, r: Expression) -> Expression:
    """Return M^-1 r by elimination without row exchanges, which skips structural zeros."""
    n = M.shape[0]
    rows = [{j: M[i, j] for j in range(n) if M[i, j].nnz()} for i in range(n)]
    right = ca.vertsplit(ca.densify(r))
    for j in range(n):
        for i in range(j + 1, n):
            if j not in rows[i]:
                continue
            factor = rows[i].pop(j) / rows[j][j]
            for c, value in rows[j].items():
                if c > j:
                    rows[i][c] = rows[i].get(c, ca.SX(0)) - factor * value
            right[i] = right[i] - factor * right[j]
    for i in reversed(range(n)):
        for c, value in rows[i].items():
            if c > i:
                right[i] = right[i] - value * right[c]
        right[i] = right[i] / rows[i][i]
    return ca.vertcat(*right)
