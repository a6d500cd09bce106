"""Derivatives of single-shooting problems follow by independent routes: CasADi on the simulation, complex steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Model:
    """A model is given by its expressions: f(x, u, p), a cost of path and end, and outputs.

    The map of an interval is written independently of the package. ``steps``: classical Runge-Kutta steps per interval
    of length dt_k; 0: f is the map itself. ``rate``: integrated by the same scheme, as one more state.
    """

    x: Any
    u: Any
    p: Any
    f: Any
    cost: Any
    terminal: Any
    z: Any
    dt: tuple[float, ...]
    steps: int
    rate: Any = 0.0

    def interval(self, x: Any, u: Any, p: Any, dt: float) -> tuple[Any, Any]:
        """Return x_next and the integral of the rate."""
        if not self.steps:
            return ca.Function("f", [self.x, self.u, self.p], [self.f])(x, u, p), 0.0
        F = ca.Function("F", [self.x, self.u, self.p], [ca.vertcat(self.f, self.rate)])
        n, h = self.x.numel(), dt / self.steps
        y = ca.vertcat(x, 0)
        for _ in range(self.steps):
            k1 = F(y[:n], u, p)
            k2 = F((y + h / 2 * k1)[:n], u, p)
            k3 = F((y + h / 2 * k2)[:n], u, p)
            k4 = F((y + h * k3)[:n], u, p)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return y[:n], y[n]

    def hessians(self, x0: Array, u: Array, p: Array, lam: Array) -> Array:
        """Return d2 (lam_k' Phi(x_k, u_k, p_k)) / d(x, u)^2 of every interval along the simulation, (N, nz, nz)."""
        x, found = x0, []
        for k, dt in enumerate(self.dt):
            following = self.interval(self.x, self.u, ca.DM(p[k]), dt)[0]
            H = ca.hessian(ca.dot(lam[k], following), ca.vertcat(self.x, self.u))[0]
            values = ca.Function("H", [self.x, self.u], [following, ca.densify(H)])(x, u[k])
            x, block = (np.array(v) for v in values)
            found.append(block)
        return np.array(found)

    def derivatives(self, x0: Array, u: Array, p: Array) -> dict[str, Array]:
        """Return J, x, z, dJ/du (N, nu), dz/du, and the Jacobian of all states with respect to all controls."""
        N, nu = u.shape
        U = ca.SX.sym("U", N * nu)
        cost = ca.Function("l", [self.x, self.u, self.p], [self.cost])
        end = ca.Function("l", [self.x, self.p], [self.terminal])
        g = ca.Function("g", [self.x, self.u, self.p], [self.z])
        states: list[Any] = [ca.SX(ca.DM(x0))]
        outputs: list[Any] = []
        J: Any = 0
        for k in range(N):
            uk, pk = U[k * nu : (k + 1) * nu], ca.DM(p[k])
            outputs.append(g(states[k], uk, pk))
            following, integral = self.interval(states[k], uk, pk, self.dt[k])
            J = J + cost(states[k], uk, pk) + integral
            states.append(following)
        J = J + end(states[N], ca.DM(p[N]))
        z, x = ca.vertcat(*outputs), ca.vertcat(*states)
        results = [J, x, z, ca.jacobian(J, U), ca.jacobian(z, U), ca.jacobian(x, U)]
        values = [np.array(v) for v in ca.Function("all", [U], results)(u.reshape(-1))]
        return {
            "J": values[0].item(),
            "x": values[1].reshape(N + 1, -1),
            "z": values[2].reshape(N, -1),
            "gradient": values[3].reshape(N, nu),
            "impulse_response": values[4].reshape(-1, N * nu),
            "responses": values[5].reshape(N + 1, -1, N, nu).transpose(2, 0, 1, 3),
        }


def complex_step(function: Callable[[Array], Array], u: Array) -> Array:
    """Return d function / du by complex perturbations, exact to rounding: (outputs, inputs)."""
    h = 1e-40
    columns = []
    for i in range(u.size):
        moved = u.astype(complex).reshape(-1)
        moved[i] += 1j * h
        columns.append(np.ravel(function(moved.reshape(u.shape))).imag / h)
    return np.array(columns).T


def normwise(found: Array, expected: Array) -> float:
    """Return |found - expected| / |expected| in the Frobenius norm; the absolute error where ``expected`` is zero."""
    scale = float(np.linalg.norm(expected))
    return float(np.linalg.norm(np.asarray(found, float) - expected)) / (scale if scale else 1.0)
