"""The evaporation process reproduces [Z20]: tuning, statements about Hessians, multipliers and iterates, Figure 1."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg
import scipy.sparse

from examples import evaporation
from nmpc_codegen.economic import Tuning, corrected_multipliers, kkt_step
from nmpc_codegen.economic.stage import steady_stage
from nmpc_codegen.economic.steps import constraint_matrix
from nmpc_codegen.frontend.classify import classify
from verification.economic.sqp import Array, Plan, Shooting, iterate, quadratic_program, steady_plan, stepped

N = 200
START = np.array([35.0, 49.743])
PAPER = np.array([25.0, 49.743, 191.713, 215.888])
ITERATIONS = {"exact": 8, "tuned": 8, "corrected": 8, "identity": 40}


@cache
def tuning() -> Tuning:
    """Return M with eta = 1."""
    return evaporation.tuned(N)


@cache
def shooting(intervals: int = N) -> Shooting:
    """Return the problem with X2 = 25 at the nodes 1..N-1 and x_N = x_s."""
    t = tuning()
    stage = steady_stage(classify(evaporation.build_ocp(intervals)), evaporation.options())
    rows = tuple(stage.rows.names.index(name) for name in t.active)
    bounds = np.where(t.mu_s < 0, stage.rows.lower[list(rows)], stage.rows.upper[list(rows)])
    return Shooting(stage, intervals, rows, bounds, t.x_s)


def reduced_hessian_error() -> float:
    """Return |Z'MZ - Z'HZ| / |Z'HZ| in the largest norm, on the null space Z of x_0, dynamics and active rows."""
    t, problem = tuning(), shooting()
    exact = quadratic_program(problem, problem.functions(), steady_plan(t, N), None)
    rows = constraint_matrix(exact).toarray()
    Z = scipy.linalg.null_space(rows)
    M = scipy.sparse.block_diag([*(t.M for _ in range(N)), np.zeros((2, 2))])
    H = scipy.sparse.block_diag([*exact.H, np.zeros((2, 2))])
    reduced_M, reduced_H = Z.T @ (M @ Z), Z.T @ (H @ Z)
    return float(np.abs(reduced_M - reduced_H).max() / np.abs(reduced_H).max())


def negative_eigenvalues(with_rows: bool) -> int:
    """Count negative eigenvalues of the reduced exact Hessian at the steady state, with or without the active rows."""
    t, problem = tuning(), shooting()
    exact = quadratic_program(problem, problem.functions(), steady_plan(t, N), None)
    rows = constraint_matrix(exact).toarray()
    if not with_rows:
        keep = np.ones(len(rows), dtype=bool)
        keep[(N + 1) * 2 : (N + 1) * 2 + N - 1] = False
        rows = rows[keep]
    Z = scipy.linalg.null_space(rows)
    H = scipy.sparse.block_diag([*exact.H, np.zeros((2, 2))])
    return int(np.count_nonzero(np.linalg.eigvalsh(Z.T @ (H @ Z)) < 0))


def first_steps() -> tuple[object, object]:
    """Return the first steps from the steady state with the exact Hessian and with M."""
    t, problem = tuning(), shooting()
    node, plan = problem.functions(), steady_plan(t, N)
    return tuple(  # type: ignore[return-value]
        kkt_step(quadratic_program(problem, node, plan, hessian), START - plan.x[0]) for hessian in (None, t.M)
    )


def first_step_error() -> float:
    """Return the largest difference of the primal steps relative to the step."""
    exact, tuned = first_steps()
    difference = max(np.abs(exact.dx - tuned.dx).max(), np.abs(exact.du - tuned.du).max())  # type: ignore[attr-defined]
    return float(difference / max(np.abs(exact.dx).max(), np.abs(exact.du).max()))  # type: ignore[attr-defined]


def first_step_dual_error(corrected: bool) -> float:
    """Return the largest difference of the multipliers lam_1, ..., lam_N after the first step; they are of size 300.

    At node 0 the difference contains the multiple of X2 = 25, a row that node 0 does not have.
    """
    exact, tuned = first_steps()
    if corrected:
        tuned = corrected_multipliers(tuning(), tuned)  # type: ignore[arg-type]
    return float(np.abs(exact.lam - tuned.lam)[1:].max())  # type: ignore[attr-defined]


@cache
def figure1() -> dict[str, tuple[Plan, list[float], list[float]]]:
    """Return plans, sizes of the steps and residuals of every Hessian."""
    return {name: iterate(shooting(), tuning(), START, name, n) for name, n in ITERATIONS.items()}


def steps_to(sizes: list[float], tolerance: float) -> float:
    """Return the number of steps until one is shorter than the tolerance, or one more than there are."""
    return float(next((i + 1 for i, size in enumerate(sizes) if size < tolerance), len(sizes) + 1))


def inadmissible(plan: Plan) -> float:
    """Return 0 if the working set is right: path rows hold at the nodes 1..N-1, and mu has the sign of its bound."""
    stage = shooting().stage
    h = np.array([np.asarray(stage.values(w)[2], dtype=float).ravel() for w in plan.w])
    inside = np.all(h[1:] <= stage.rows.upper + 1e-8) and np.all(h[1:] >= stage.rows.lower - 1e-8)
    return float(not (inside and np.all(plan.mu[1:] * np.sign(tuning().mu_s) > 0)))


def span_error() -> float:
    """Return the distance of M - H from the span of Hcal(E) and C'C, E symmetric, relative to M - H."""
    t, basis, n = tuning(), [], len(tuning().A)
    AB = np.hstack([t.A, t.B])
    for i in range(n):
        for j in range(i + 1):
            E = np.zeros((n, n))
            E[i, j] = E[j, i] = 1.0
            rotated = AB.T @ E @ AB
            rotated[:n, :n] -= E
            basis.append(rotated.ravel())
    basis += [np.outer(a, b).ravel() + np.outer(b, a).ravel() for a in t.C for b in t.C]
    target = (t.M - t.H).ravel()
    columns = np.array(basis).T
    off = columns @ np.linalg.lstsq(columns, target, rcond=None)[0] - target
    return float(np.linalg.norm(off) / np.linalg.norm(target))


def rotation_errors(rotated: bool, steps: int = 12) -> list[float]:
    """Return |w - w*| for l_rot = 10 |x - x_s|^2 + 0.1 |u - u_s|^2, or for l_rot - Lambda(x) + Lambda(Phi)."""
    t, problem = tuning(), replace(shooting(N), rows=(), bounds=np.zeros(0))

    def storage(x: Any) -> Any:
        return 100 * ca.sumsqr(x - ca.DM(t.x_s))

    def tracking(w: Any) -> Any:
        return 10 * ca.sumsqr(w[:2] - ca.DM(t.x_s)) + 0.1 * ca.sumsqr(w[2:] - ca.DM(t.u_s))

    node = problem.functions(None if rotated else lambda x, x_next: storage(x_next) - storage(x), tracking)
    plan = replace(steady_plan(t, N), lam=np.zeros((N + 1, 2)), mu=np.zeros((N, 0)))
    plans = [plan]
    for _ in range(steps):
        end = (np.zeros(2), np.zeros((2, 2))) if rotated else (-200 * (plan.x[-1] - t.x_s), -200 * np.eye(2))
        plan = stepped(plan, kkt_step(quadratic_program(problem, node, plan, None, end), START - plan.x[0]))
        plans.append(plan)
    return [float(np.hypot(np.linalg.norm(p.x - plan.x), np.linalg.norm(p.u - plan.u))) for p in plans]


def ipopt_iterations(horizon: int, M: Array | None) -> int:
    """Count IPOPT's iterations from the steady state, x_0 = (35, 49.743), with default options."""
    t, stage = tuning(), shooting().stage
    W, end = ca.SX.sym("W", 4, horizon), ca.SX.sym("end", 2)
    x: list[Any] = [START, *ca.horzsplit(W[:2, 1:]), end]
    V, f, g, lbg, ubg = ca.vertcat(ca.vec(W), end), ca.SX(0), [W[:2, 0] - START], [np.zeros(2)], [np.zeros(2)]
    for k in range(horizon):
        Phi, cost, h = stage.values(W[:, k])
        f += cost
        g += [Phi - x[k + 1], h] if k else [Phi - x[k + 1], h[2:]]
        lbg += [np.zeros(2), stage.rows.lower[0 if k else 2 :]]
        ubg += [np.zeros(2), stage.rows.upper[0 if k else 2 :]]
    g, lbg, ubg = [*g, end - ca.DM(t.x_s)], [*lbg, np.zeros(2)], [*ubg, np.zeros(2)]
    options: dict[str, Any] = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    program: dict[str, Any] = {"x": V, "f": f, "g": ca.vertcat(*g)}
    if M is not None:
        p, lam_f, lam_g = ca.SX(0, 1), ca.SX.sym("lam_f"), ca.SX.sym("lam_g", program["g"].numel())
        H = ca.triu(ca.diagcat(*[ca.DM(M)] * horizon, ca.DM(2, 2))) * lam_f
        names = (["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])
        options["hess_lag"] = ca.Function("nlp_hess_l", [V, p, lam_f, lam_g], [ca.sparsify(H)], *names)
    solver = ca.nlpsol("solver", "ipopt", program, options)
    start = np.concatenate([np.tile([*t.x_s, *t.u_s], horizon), t.x_s])
    solver(x0=start, lbg=np.concatenate(lbg), ubg=np.concatenate(ubg))
    if not solver.stats()["success"]:
        raise RuntimeError(f"IPOPT: {solver.stats()['return_status']}")
    return int(solver.stats()["iter_count"])
