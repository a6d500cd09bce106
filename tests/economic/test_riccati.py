"""Cost-to-go: known solutions, dynamic programming, strictly active rows, problems without a solution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmpc_codegen import ProblemError
from nmpc_codegen.economic.cost_to_go import cost_to_go, eliminate
from nmpc_codegen.economic.linear_quadratic import LinearQuadratic, frequency_function
from nmpc_codegen.economic.semidefinite import ConvexityProof, Weights, convexify
from verification.economic.rotated import random_problem


def by_dynamic_programming(lq: LinearQuadratic, S: np.ndarray, steps: int = 3000) -> np.ndarray:
    """P of W = H - Hcal(S), backwards from 0 with rows C w = 0 by their null space, minus S."""
    W, n, m = lq.H - lq.rotate(S), lq.n, lq.m
    AB, P = np.hstack([lq.A, lq.B]), np.zeros((n, n))
    for _ in range(steps):
        G = W + AB.T @ P @ AB
        a = len(lq.C)
        K = np.block([[G[n:, n:], lq.C[:, n:].T], [lq.C[:, n:], np.zeros((a, a))]])
        u = -np.linalg.solve(K, np.vstack([G[n:, :n], lq.C[:, :n]]))[:m]
        w = np.vstack([np.eye(n), u])
        new = w.T @ G @ w
        if np.abs(new - P).max() < 1e-14 * np.abs(new).max():
            break
        P = new
    return P - S


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 1))
def test_rotated_problem(seed: int, rows: int) -> None:
    """The cost-to-go of a rotated problem is that of the convex one minus the storage, indefinite or not."""
    lq, S = random_problem(seed, rows=rows)
    found = cost_to_go(lq)
    expected = by_dynamic_programming(lq, S)
    assert np.abs(found.P - expected).max() <= 1e-7 * np.abs(expected).max()
    assert found.residual < 1e-9
    w = np.vstack([np.eye(lq.n), -found.K])
    bellman = w.T @ (lq.H + lq.rotate(found.P)) @ w
    assert np.abs(bellman).max() <= 1e-6 * np.abs(found.P).max()


def test_some_are_indefinite() -> None:
    """The property above would prove little otherwise."""
    signs = [np.linalg.eigvalsh(cost_to_go(random_problem(seed)[0]).P)[[0, -1]] for seed in range(5)]
    assert any(low < 0 < high for low, high in signs)


def test_row_of_a_state_confines_the_state() -> None:
    """x_1 = 0 for ever: a double integrator with one control has no freedom left."""
    A, B = np.array([[1.0, 0.1], [0.0, 0.5]]), np.array([[1.0, 0.0], [0.0, 1.0]])
    r = eliminate(LinearQuadratic(A, B, np.eye(4), np.array([[1.0, 0.0, 0.0, 0.0]])))
    assert r.T.shape == (2, 1)
    assert abs(r.T[0, 0]) < 1e-12
    assert r.N.shape[1] == 1
    next_state = A @ r.T + B @ r.Kc
    assert np.abs(next_state[0]).max() < 1e-12
    assert np.abs(B @ r.N)[0].max() < 1e-12


@pytest.mark.parametrize(
    "lq",
    [
        LinearQuadratic(np.eye(1) * 2, np.zeros((1, 1)), np.eye(2), np.zeros((0, 2))),  # unstable, no control
        LinearQuadratic(np.eye(1), np.zeros((1, 1)), np.eye(2), np.zeros((0, 2))),  # an integrator nobody moves
        LinearQuadratic(np.eye(1) * 0.5, np.eye(1), np.diag([-1.0, 0.1]), np.zeros((0, 2))),  # cost without a bound
        LinearQuadratic(np.eye(1) * 0.9, np.eye(1), np.diag([1.0, -5.0]), np.zeros((0, 2))),
    ],
)
def test_no_solution_is_an_error(lq: LinearQuadratic) -> None:
    with pytest.raises(ProblemError, match=r"no stabilising solution|no control moves a mode"):
        cost_to_go(lq)


# Frequency function ---------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 1))
def test_frequency_function_decides(seed: int, rows: int) -> None:
    """It is positive exactly where the semidefinite program has a solution."""
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(seed, n=2, m=1, rows=rows)
    shifted = LinearQuadratic(lq.A, lq.B, lq.H - rng.uniform(0, 4) * np.eye(3), lq.C)
    found = frequency_function(shifted)
    if 0 < abs(found.least) < 1e-3:
        return  # too close for a numerical solver
    solved = convexify(shifted, Weights(), np.ones(3))
    assert isinstance(solved, ConvexityProof) == found.positive


def test_frequency_function_without_freedom() -> None:
    """Rows that fix every motion leave nothing to be negative."""
    lq = LinearQuadratic(np.eye(1) * 0.5, np.eye(1), -np.eye(2), np.eye(2))
    assert frequency_function(lq).least == np.inf


def test_frequency_function_value() -> None:
    """x+ = a x + u, q x^2 + r u^2: pi = (q + r |z - a|^2) / (1 + |z - a|^2) in units where q and r have size 1."""
    a, q, r = 0.5, -1.0, 1.0
    lq = LinearQuadratic(np.array([[a]]), np.eye(1), np.diag([q, r]), np.zeros((0, 2)))
    distance = (1 - a) ** 2  # least at theta = 0
    assert frequency_function(lq).least == pytest.approx((q + r * distance) / (1 + distance), rel=1e-9)
    assert frequency_function(lq).theta == pytest.approx(0.0, abs=1e-3)
