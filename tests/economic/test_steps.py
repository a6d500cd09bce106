"""One SQP step against dense linear algebra, and the dual correction at the steady state."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import evaporation
from nmpc_codegen import ProblemError
from nmpc_codegen.economic import StageQp, corrected_multipliers, kkt_step


def random_qp(seed: int, N: int = 4, n: int = 2, m: int = 2) -> StageQp:
    """One row at the nodes 1..N-1, one at the end; H is indefinite on the whole space."""
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(N, n + m, n + m))
    return StageQp(
        A=rng.normal(size=(N, n, n)),
        B=rng.normal(size=(N, n, m)),
        b=rng.normal(size=(N, n)),
        H=H + H.transpose(0, 2, 1),
        g=rng.normal(size=(N, n + m)),
        C=[rng.normal(size=(int(k > 0), n + m)) for k in range(N)],
        c=[rng.normal(size=int(k > 0)) for k in range(N)],
        H_N=np.diag([1.0, -2.0]),
        g_N=rng.normal(size=n),
        D=rng.normal(size=(1, n)),
        d=rng.normal(size=1),
    )


def gradients(qp: StageQp, step: object) -> list[np.ndarray]:
    """Derivatives of the Lagrangian in every dw_k and dx_N, and the violations of the equations, stage by stage."""
    dx, du, lam, mu, nu = step.dx, step.du, step.lam, step.mu, step.nu  # type: ignore[attr-defined]
    N, n = len(qp.A), qp.A.shape[1]
    found = []
    for k in range(N):
        w = np.concatenate([dx[k], du[k]])
        slope = qp.H[k] @ w + qp.g[k] + np.hstack([qp.A[k], qp.B[k]]).T @ lam[k + 1] + qp.C[k].T @ mu[k]
        slope[:n] -= lam[k]
        found += [slope, qp.A[k] @ dx[k] + qp.B[k] @ du[k] + qp.b[k] - dx[k + 1], qp.C[k] @ w - qp.c[k]]
    found += [qp.H_N @ dx[N] + qp.g_N - lam[N] + qp.D.T @ nu, qp.D @ dx[N] - qp.d]
    return found


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_step_solves_its_conditions(seed: int) -> None:
    qp, dx0 = random_qp(seed), np.array([1.0, -2.0])
    step = kkt_step(qp, dx0)
    np.testing.assert_allclose(step.dx[0], dx0, rtol=0, atol=1e-9)
    size = max(1.0, float(np.abs(step.lam).max()), float(np.abs(step.dx).max()), float(np.abs(step.du).max()))
    assert max(float(np.abs(part).max(initial=0)) for part in gradients(qp, step)) <= 1e-8 * size
    assert step.dw.shape == (4, 4)


@pytest.mark.filterwarnings("ignore::scipy.sparse.linalg.MatrixRankWarning")
def test_dependent_rows_are_an_error() -> None:
    qp = random_qp(0)
    double = [np.vstack([C, C]) for C in qp.C]
    twice = StageQp(**{**vars(qp), "C": double, "c": [np.concatenate([c, c]) for c in qp.c]})
    with pytest.raises(ProblemError, match="singular"):
        kkt_step(twice, np.zeros(2))


def test_first_step_and_dual_correction() -> None:
    """Corollary 9: the same primal step with M and H from the steady state; corrected, the same multipliers."""
    t, N = evaporation.tuned(), 30

    def step(H: np.ndarray) -> object:
        rows = [t.C if k else t.C[:0] for k in range(N)]
        gradient = -np.hstack([t.A - np.eye(2), t.B]).T @ t.lam_s - t.C.T @ t.mu_s  # dl / dw at the steady state
        qp = StageQp(
            *(np.tile(a, (N, *(1 for _ in a.shape))) for a in (t.A, t.B, np.zeros(2), H, gradient)),
            C=rows,
            c=[np.zeros(len(r)) for r in rows],
            H_N=np.zeros((2, 2)),
            g_N=np.zeros(2),
            D=np.eye(2),
            d=np.zeros(2),
        )
        return kkt_step(qp, np.array([10.0, 1.0]))

    exact, tuned = step(t.H), step(t.M)
    corrected = corrected_multipliers(t, tuned)  # type: ignore[arg-type]
    np.testing.assert_allclose(tuned.du, exact.du, rtol=0, atol=1e-9)  # type: ignore[attr-defined]
    scale = np.abs(exact.lam).max()  # type: ignore[attr-defined]
    assert np.abs(tuned.lam - exact.lam).max() > 1e-3 * scale  # type: ignore[attr-defined]
    assert np.abs(corrected.lam - exact.lam).max() <= 1e-10 * scale  # type: ignore[attr-defined]
    np.testing.assert_allclose(corrected.mu[1:], exact.mu[1:], rtol=0, atol=1e-8)  # type: ignore[attr-defined]
