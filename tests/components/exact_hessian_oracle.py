"""Regularised matrices by numpy.linalg.eigh, and Hessian blocks of the Lagrangian by CasADi, node by node."""

from __future__ import annotations

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.trajectory import (
    CLASSICAL,
    Data,
    Point,
    Tableau,
    interval_map,
    node_cost,
    node_rows,
    scaled_weight,
)

Array = np.ndarray


def regularized(H: Array, mirror: bool, floor: float, scale: float | None = None) -> Array:
    """V max(|Lambda|, eps) V' or V max(Lambda, eps) V', eps = floor max|Lambda|; ``scale`` replaces a zero maximum."""
    values, V = np.linalg.eigh(H)
    largest = np.abs(values).max() or scale or 0.0
    changed = np.maximum(np.abs(values) if mirror else values, floor * largest)
    return np.asarray(V * changed @ V.T)


def units_of(H: Array, floor: float) -> Array:
    """Curvature that is typical of every variable: the diagonal, at least floor times its largest entry, enlarged in
    turn where an entry beside it exceeds the geometric mean of two units."""
    diagonal = np.abs(np.diag(H))
    unit = np.maximum(diagonal, floor * diagonal.max())
    unit[unit == 0] = 1.0
    for i in range(len(H)):
        for j in range(i):
            excess = abs(H[i, j]) / np.sqrt(unit[i] * unit[j])
            unit[[i, j]] *= max(1.0, excess)
    return np.asarray(unit)


def regularized_reduced(H: Array, mirror: bool, floor: float) -> Array:
    """The same for the reduced Hessian in units of its variables, where a mirrored eigenvalue is raised by a tenth of
    the most negative one, and the largest eigenvalue counts as at least 1."""
    root = np.sqrt(units_of(H, floor))
    values, V = np.linalg.eigh(H / np.outer(root, root))
    mirrored = np.where(values < 0, -values - 0.1 * values.min(), values)
    changed = np.maximum(mirrored if mirror else values, floor * max(1.0, np.abs(values).max()))
    return np.asarray(np.outer(root, root) * (V * changed @ V.T))


def blocks(problem: Problem, point: Point, data: Data, integrator: Tableau = CLASSICAL) -> tuple[list[Array], Array]:
    """Q_k = d2 (l_k + q_k + lam_{k+1}' Phi_k + mu_k' h_k) / dz^2 with eta' r in the first, and Q_N."""
    N, nx, nu = problem.N, problem.nx, problem.nu
    x, u = ca.SX.sym("x", nx), ca.SX.sym("u", nu)
    z = ca.vertcat(x, u)
    Phi, cost, rows = interval_map(problem, integrator), node_cost(problem.path), node_rows(problem.path)

    def r(first: ca.SX, last: ca.SX) -> ca.SX:
        return ca.SX(0) if problem.coupled is None else ca.dot(point.eta, problem.coupled(first, last))

    found = []
    for k in range(N):
        p = data.p[k]
        end, q = Phi(x, u, p, problem.dt[k])
        W = scaled_weight(problem, data.W[k], k)
        L = q + cost(x, u, p, problem.dt[k], data.yref[k], W) + ca.dot(point.lam[k + 1], end)
        L += ca.dot(point.mu[k], rows(x, u, p)) + (r(x, point.x[N]) if k == 0 else 0)
        H = ca.Function("H", [x, u], [ca.hessian(L, z)[0]])
        found.append(np.array(H(point.x[k], point.u[k])))
    L = node_cost(problem.terminal)(x, ca.SX(0, 1), data.p[N], 0, data.yref_N, data.W_N)
    L += ca.dot(point.mu_N, node_rows(problem.terminal)(x, ca.SX(0, 1), data.p[N])) + r(point.x[0], x)
    return found, np.array(ca.Function("H", [x], [ca.hessian(L, x)[0]])(point.x[N]))
