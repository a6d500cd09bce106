"""Second derivatives of Runge-Kutta schemes by the complex step on their hand-written first derivatives.

    H = d2 (lam' Phi + q) / d(x, u)^2 = d (S' lam + dq/dz) / dz,   exact to rounding

q is the integral of a rate by the same scheme: the last component of an extended model, on which no other depends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verification.oracles.runge_kutta import Array, Function, Model, complex_step, integrate


@dataclass(frozen=True)
class Rate:
    """A scalar rate l(x, u, p) with its gradients."""

    value: Function
    x: Function
    u: Function


def extended(model: Model, rate: Rate) -> Model:
    """(f, l) with the state (x, q)."""

    def cut(x: Array) -> Array:
        return x[:-1]

    return Model(
        f=lambda x, u, p: np.append(model.f(cut(x), u, p), rate.value(cut(x), u, p)),
        fx=lambda x, u, p: np.pad(np.vstack([model.fx(cut(x), u, p), rate.x(cut(x), u, p)]), ((0, 0), (0, 1))),
        fu=lambda x, u, p: np.vstack([model.fu(cut(x), u, p), rate.u(cut(x), u, p)]),
    )


@dataclass(frozen=True)
class Expansion:
    """x_next, S, gradient of q, and H."""

    x_next: Array
    S: Array
    g: Array
    H: Array


def expand(
    model: Model, scheme: str, steps: int, dt: float, x: Array, u: Array, p: Array, lam: Array, rate: Rate | None = None
) -> Expansion:
    """One interval of length dt."""
    nx = len(x)
    whole = model if rate is None else extended(model, rate)

    def gradient(z: Array) -> tuple[Array, Array, Array]:
        start = z[:nx] if rate is None else np.append(z[:nx], 0)
        x_next, S = integrate(whole, scheme, steps, dt, start, z[nx:], p)
        S = S[:, [j for j in range(S.shape[1]) if rate is None or j != nx]]
        g = np.zeros(len(z)) if rate is None else S[nx]
        return x_next[:nx], S[:nx], g

    z = np.concatenate([x, u])
    x_next, S, g = gradient(z)

    def slope(w: Array) -> Array:
        _, sensitivities, q = gradient(w)
        return np.asarray(sensitivities.T @ lam + q)

    return Expansion(x_next, S, g, complex_step(slope, z))
