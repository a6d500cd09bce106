"""Condensing by brute force: one big linear system for all states, eliminated with a dense solver.

    min  sum_k 1/2 (dx_k, du_k)' Q_k (dx_k, du_k) + g_k'(dx_k, du_k) + 1/2 dx_N' Q_N dx_N + g_N' dx_N
    s.t. dx_{k+1} = A_k dx_k + B_k du_k + b_k,   rows  C dx_k + D du_k + h

The dynamics are E X = F dx_0 + B du + b with X = (dx_1, .., dx_N) and a block bidiagonal E; X is eliminated by solve().
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class StageData:
    """S (N, nx, nx + nu) = [A B], b (N, nx), Q (N, nz, nz) symmetric, g (N, nz), Q_N, g_N; z = (x, u)."""

    S: Array
    b: Array
    Q: Array
    g: Array
    Q_N: Array
    g_N: Array

    @property
    def N(self) -> int:
        return int(self.S.shape[0])

    @property
    def nx(self) -> int:
        return int(self.S.shape[1])

    @property
    def nu(self) -> int:
        return int(self.S.shape[2]) - self.nx


@dataclass(frozen=True)
class Condensed:
    """Cost 1/2 du'H du + (g + Hx dx_0)'du + const; states x = X0 dx_0 + U du + c, shapes ((N+1) nx, .)."""

    H: Array
    Hx: Array
    g: Array
    X0: Array
    U: Array
    c: Array


def condense(d: StageData) -> Condensed:
    """Eliminate all states but the first."""
    N, nx, nu = d.N, d.nx, d.nu
    E = np.eye(N * nx)
    F, B = np.zeros((N * nx, nx)), np.zeros((N * nx, N * nu))
    for k in range(N):
        rows = slice(k * nx, (k + 1) * nx)
        B[rows, k * nu : (k + 1) * nu] = d.S[k][:, nx:]
        if k == 0:
            F[rows] = d.S[0][:, :nx]
        else:
            E[rows, (k - 1) * nx : k * nx] = -d.S[k][:, :nx]
    first = np.hstack([np.eye(nx), np.zeros((nx, N * nu))])
    x = np.vstack([first, np.linalg.solve(E, np.hstack([F, B]))])
    c = np.concatenate([np.zeros(nx), np.linalg.solve(E, d.b.ravel())])
    full, constant = np.vstack([x, np.hstack([np.zeros((N * nu, nx)), np.eye(N * nu)])]), np.append(c, np.zeros(N * nu))
    Q, g = _cost(d)
    H = full.T @ Q @ full
    gradient = full.T @ (g + Q @ constant)
    return Condensed(H[nx:, nx:], H[nx:, :nx], gradient[nx:], x[:, :nx], x[:, nx:], c)


def _cost(d: StageData) -> tuple[Array, Array]:
    """Hessian and gradient in the order (x_0, .., x_N, u_0, .., u_{N-1})."""
    N, nx, nu = d.N, d.nx, d.nu
    n = (N + 1) * nx + N * nu
    Q, g = np.zeros((n, n)), np.zeros(n)
    for k in range(N):
        at = np.r_[k * nx : (k + 1) * nx, (N + 1) * nx + k * nu : (N + 1) * nx + (k + 1) * nu]
        Q[np.ix_(at, at)] += d.Q[k]
        g[at] += d.g[k]
    Q[N * nx : (N + 1) * nx, N * nx : (N + 1) * nx] += d.Q_N
    g[N * nx : (N + 1) * nx] += d.g_N
    return Q, g


def condense_row(c: Condensed, d: StageData, k: int, J: Array, value: float) -> tuple[Array, Array, float]:
    """Row J (dx_k, du_k) + value as a row of the QP: coefficients of du and of dx_0, and its value at zero."""
    nx, nu = d.nx, d.nu
    x = slice(k * nx, (k + 1) * nx)
    a = J[:nx] @ c.U[x]
    if k < d.N:
        a[k * nu : (k + 1) * nu] += J[nx:]
    return a, J[:nx] @ c.X0[x], value + J[:nx] @ c.c[x]


def multipliers(d: StageData, dx: Array, du: Array, extra: Array) -> Array:
    """lam (N+1, nx) from stationarity of the Lagrangian in every state, one big adjoint system.

    dx (N+1, nx), du (N, nu); extra (N+1, nx): gradient of the rows and bounds times their multipliers.
    """
    N, nx = d.N, d.nx
    Q, g = _cost(d)
    gradient = (Q @ np.concatenate([dx.ravel(), du.ravel()]) + g)[: (N + 1) * nx] + extra.ravel()
    M = np.eye((N + 1) * nx)
    for k in range(N):
        M[k * nx : (k + 1) * nx, (k + 1) * nx : (k + 2) * nx] = -d.S[k][:, :nx].T
    return np.linalg.solve(M, gradient).reshape(N + 1, nx)
