"""Linear-quadratic problems get an indefinite Hessian from a convex one by a rotation."""

from __future__ import annotations

import numpy as np

from nmpc_codegen.economic.linear_quadratic import LinearQuadratic


def random_problem(seed: int, n: int = 3, m: int = 2, rows: int = 0) -> tuple[LinearQuadratic, np.ndarray]:
    """Return a convex problem rotated by a storage function x' S x, and S; H = W + Hcal(S) is indefinite."""
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    root = rng.normal(size=(n + m, n + m))
    S = rng.normal(size=(n, n)) * 5
    C = np.hstack([rng.normal(size=(rows, n)), rng.normal(size=(rows, m))])
    plain = LinearQuadratic(A, B, root @ root.T + 0.1 * np.eye(n + m), C)
    return LinearQuadratic(A, B, plain.H + plain.rotate(S + S.T), C), S + S.T
