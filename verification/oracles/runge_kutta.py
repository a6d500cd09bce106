"""NumPy computes explicit Runge-Kutta steps and their forward sensitivities from the definition of the tableau.

    X_i = x + h sum_j a_ij K_j,   K_i = f(X_i, u, p),   x+ = x + h sum_i b_i K_i
    K_i' = f_x(X_i) X_i' + (0, f_u(X_i)),   the same combinations of the derivatives with respect to (x, u)

The models and their Jacobians are written by hand; ``complex_step`` checks them independently.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Function = Callable[[Array, Array, Array], Array]

#: (a, b) of every scheme, entered independently from the literature: Butcher tableaus, [H11] figure 1.
SCHEMES: dict[str, tuple[list[list[float]], list[float]]] = {
    "Euler": ([[0]], [1]),
    "Midpoint": ([[0, 0], [1 / 2, 0]], [0, 1]),
    "Heun": ([[0, 0], [1, 0]], [1 / 2, 1 / 2]),
    "SSPRK3": ([[0, 0, 0], [1, 0, 0], [1 / 4, 1 / 4, 0]], [1 / 6, 1 / 6, 2 / 3]),
    "RK4": ([[0, 0, 0, 0], [1 / 2, 0, 0, 0], [0, 1 / 2, 0, 0], [0, 0, 1, 0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
}

ORDERS = {"Euler": 1, "Midpoint": 2, "Heun": 2, "SSPRK3": 3, "RK4": 4}


@dataclass(frozen=True)
class Model:
    """xdot = f(x, u, p) with its Jacobians f_x (nx, nx) and f_u (nx, nu)."""

    f: Function
    fx: Function
    fu: Function


def integrate(model: Model, scheme: str, steps: int, dt: float, x: Array, u: Array, p: Array) -> tuple[Array, Array]:
    """Return x(dt) and S = d x(dt) / d(x, u), (nx, nx + nu)."""
    a, b = SCHEMES[scheme]
    h = dt / steps
    nx, nu = len(x), len(u)
    x, S = np.array(x), np.hstack([np.eye(nx), np.zeros((nx, nu))])
    for _ in range(steps):
        K: list[Array] = []
        D: list[Array] = []
        for row in a:
            X = x + h * sum(c * k for c, k in zip(row, K, strict=False))
            dX = S + h * sum(c * d for c, d in zip(row, D, strict=False))
            K.append(model.f(X, u, p))
            D.append(model.fx(X, u, p) @ dX + np.hstack([np.zeros((nx, nx)), model.fu(X, u, p)]))
        x = x + h * sum(w * k for w, k in zip(b, K, strict=True))
        S = S + h * sum(w * d for w, d in zip(b, D, strict=True))
    return x, S


def complex_step(f: Callable[[Array], Array], z: Array) -> Array:
    """Return the Jacobian of an analytic f, exact to rounding: Im f(z + i e) / e."""
    step = 1e-30
    columns = [np.imag(f(z + 1j * step * e)) / step for e in np.eye(len(z))]
    return np.stack(columns, axis=-1)


# The crane of [H11] 4.1: x = (p, v, phi, omega), u = (a), no parameter --------------------------------------------


def _crane_f(x: Array, u: Array, p: Array) -> Array:
    return np.array([x[1], u[0], x[3], -9.81 * np.sin(x[2]) - u[0] * np.cos(x[2]) - 0.2 * x[3]])


def _crane_fx(x: Array, u: Array, p: Array) -> Array:
    J = np.zeros((4, 4), np.result_type(x, u))
    J[0, 1] = J[2, 3] = 1
    J[3, 2] = -9.81 * np.cos(x[2]) + u[0] * np.sin(x[2])
    J[3, 3] = -0.2
    return J


def _crane_fu(x: Array, u: Array, p: Array) -> Array:
    return np.array([[0], [1], [0], [-np.cos(x[2])]])


# A reactor: x = (c, T), u = (q, w), p = (k, E): Arrhenius rate, a quotient ------------------------------------------


def _reactor_f(x: Array, u: Array, p: Array) -> Array:
    rate = p[0] * x[0] * np.exp(-p[1] / x[1])
    return np.array([u[0] * (1 - x[0]) - rate, u[0] * (1 - x[1]) + 2 * rate - u[1] * (x[1] - 0.5) / (1 + u[1])])


def _reactor_fx(x: Array, u: Array, p: Array) -> Array:
    r = p[0] * np.exp(-p[1] / x[1])
    dT = r * x[0] * p[1] / x[1] ** 2
    return np.array([[-u[0] - r, -dT], [2 * r, -u[0] + 2 * dT - u[1] / (1 + u[1])]])


def _reactor_fu(x: Array, u: Array, p: Array) -> Array:
    return np.array([[1 - x[0], 0], [1 - x[1], -(x[1] - 0.5) / (1 + u[1]) ** 2]])


# Two tanks and a drag: x = (h_1, h_2, v), u = (q, f), p = (d): square roots, a power --------------------------------


def _tanks_f(x: Array, u: Array, p: Array) -> Array:
    s0, s1 = np.sqrt(x[0]), np.sqrt(x[1])
    return np.array([u[0] - p[0] * s0, p[0] * (s0 - s1), u[1] / x[0] - p[0] * x[2] * np.sqrt(1 + x[2] ** 2)])


def _tanks_fx(x: Array, u: Array, p: Array) -> Array:
    r0, r1 = 0.5 * p[0] / np.sqrt(x[0]), 0.5 * p[0] / np.sqrt(x[1])
    root = np.sqrt(1 + x[2] ** 2)
    return np.array([[-r0, 0, 0], [r0, -r1, 0], [-u[1] / x[0] ** 2, 0, -p[0] * (root + x[2] ** 2 / root)]])


def _tanks_fu(x: Array, u: Array, p: Array) -> Array:
    return np.array([[1, 0], [0, 0], [0, 1 / x[0]]])


MODELS = {
    "crane": Model(_crane_f, _crane_fx, _crane_fu),
    "reactor": Model(_reactor_f, _reactor_fx, _reactor_fu),
    "tanks": Model(_tanks_f, _tanks_fx, _tanks_fu),
}

#: (x, u, p) where the models are smooth.
POINTS: dict[str, tuple[Array, Array, Array]] = {
    "crane": (np.array([2.0, 0.3, 0.7, -0.4]), np.array([0.6]), np.zeros(0)),
    "reactor": (np.array([0.6, 0.9]), np.array([0.7, 0.4]), np.array([3.0, 1.3])),
    "tanks": (np.array([0.8, 1.4, -0.6]), np.array([0.5, 1.1]), np.array([0.7])),
}
