"""IPOPT minimises objective (7.16) with exact l1 penalties: one slack per row and point of the integrator."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from examples import vandevusse

#: Nodes and weights of classical Runge-Kutta steps, written independently of the package.
STEPS = 4
STAGE_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
QUIET = {"print_time": 0, "ipopt.print_level": 0, "ipopt.sb": "yes"}
EXACT = {"ipopt.tol": 1e-12, "ipopt.bound_relax_factor": 0.0, "ipopt.max_iter": 1000}


def interval() -> ca.Function:
    """Return (x, u) -> (x_next, stage points side by side); STAGE_WEIGHTS are their weights in the integral."""
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    rates, h = ca.Function("f", [x, u], [vandevusse.rates(x, u)]), vandevusse.SAMPLING / STEPS
    state, points = x, []
    for _ in range(STEPS):
        slopes: list[Any] = []
        for part in (0.0, 0.5, 0.5, 1.0):
            points.append(state + (h * part * slopes[-1] if slopes else 0))
            slopes.append(rates(points[-1], u))
        state = state + h * sum(w * k for w, k in zip(STAGE_WEIGHTS, slopes, strict=True))
    return ca.Function("interval", [x, u], [state, ca.horzcat(*points)])


def tracking(points: Any, u: Any, reference: np.ndarray) -> Any:
    """Return the integral of the cost without penalties over an interval."""
    h, cost = vandevusse.SAMPLING / STEPS, 0
    for i in range(points.shape[1]):
        off = ca.vertcat(points[1, i], points[2, i], u) - reference
        cost = cost + h * STAGE_WEIGHTS[i % 4] * ca.dot(vandevusse.WEIGHT * off, off) / 2
    return cost


def price(penalty: float) -> np.ndarray:
    """Return the price of one unit of each row at each point of an interval, (2, points)."""
    h = vandevusse.SAMPLING / STEPS
    return penalty * h * np.outer(list(vandevusse.WEIGHTS.values()), np.tile(STAGE_WEIGHTS, STEPS))


def cost_of(u: np.ndarray, reference: np.ndarray, penalty: float) -> float:
    """Return (7.16) of the controls u (N, 2), with the exact max."""
    step, x, total = interval(), vandevusse.steady_state(vandevusse.ENDS[0]), 0.0
    bounds = np.array(list(vandevusse.HIGHEST.values()))[:, None]
    for k, control in enumerate(u):
        following, points = step(x, control)
        over = np.maximum(np.asarray(points)[1:3] - bounds, 0.0)
        total += float(tracking(points, ca.DM(control), reference[k])) + float(np.sum(price(penalty) * over))
        x = np.asarray(following).ravel()
    return total


def optimum(reference: np.ndarray, penalty: float, u: np.ndarray) -> float:
    """Return IPOPT's value of (7.16) by multiple shooting, from the plan to which the controls u lead."""
    step, N = interval(), len(u)
    X, U, S = ca.MX.sym("X", 4, N + 1), ca.MX.sym("U", 2, N), ca.MX.sym("S", 2 * 4 * STEPS, N)
    highest, cost = np.array(list(vandevusse.HIGHEST.values())), ca.MX(0)
    gaps, rows = [X[:, 0] - vandevusse.steady_state(vandevusse.ENDS[0])], []
    states, slacks = [vandevusse.steady_state(vandevusse.ENDS[0])], []
    for k in range(N):
        following, points = step(X[:, k], U[:, k])
        gaps.append(following - X[:, k + 1])
        rows.append(ca.vec(points[1:3, :] - ca.repmat(ca.DM(highest), 1, 4 * STEPS)) - S[:, k])
        cost += tracking(points, U[:, k], reference[k]) + ca.dot(price(penalty).T.ravel(), S[:, k])
        x, at = step(states[-1], u[k])
        states.append(np.asarray(x).ravel())
        slacks.append(np.maximum(np.asarray(at)[1:3].T.ravel() - np.tile(highest, 4 * STEPS), 0.0))
    variables = ca.vertcat(ca.vec(X), ca.vec(U), ca.vec(S))
    start = np.concatenate([np.ravel(states), np.ravel(u), np.ravel(slacks) + 1e-3])
    n, m, free = 4 * (N + 1), 2 * 4 * STEPS * N, 4 * (N + 1) + 2 * N
    program: Any = {"x": variables, "f": cost, "g": ca.vertcat(*gaps, *rows)}
    options: Any = QUIET | EXACT
    nlp = ca.nlpsol("nlp", "ipopt", program, options)
    lowest = np.concatenate([np.full(free, -np.inf), np.zeros(m)])
    found = nlp(x0=start, lbx=lowest, lbg=np.r_[np.zeros(n), np.full(m, -np.inf)], ubg=0)
    if not nlp.stats()["success"]:
        raise RuntimeError(f"IPOPT: {nlp.stats()['return_status']}")
    return float(found["f"])
