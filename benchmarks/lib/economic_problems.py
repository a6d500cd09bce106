"""Two economic problems at their optimal steady states: the evaporation process and energy-optimal driving.

Both are those of Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC", IEEE TAC 66, 2021, section V.
tuned() yields a Hessian M with the properties of its section IV by Riccati equations alone: with P of H - eps I,

    M = H + Hcal(P) + F C'C >= eps I on the null space of the active rows C, and for F large enough everywhere,
    Hcal(P) = [A'PA - P, A'PB; B'PA, B'PB].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space, solve_discrete_are
from scipy.optimize import minimize

from nmpc_codegen import OCP

Array = NDArray[np.float64]

#: Integration steps of an interval of 0.1 s of the driving problem.
DRIVING_STEPS = 5


@dataclass(frozen=True, eq=False)
class Stage:
    """A discrete problem: step(x, u) -> (x_next, l), rows c(x, u) >= 0, a guess of its steady state, cyclic states."""

    nx: int
    nu: int
    step: Callable[[Any, Any], tuple[Any, Any]]
    rows: Callable[[Any, Any], Any]
    guess: Array
    cyclic: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Steady:
    """Optimal steady state w = (x, u): multipliers lam of L = l + lam' (x_next - x) - mu' c, Hessian H of L, x_next =
    A x + B u, and the Jacobian C of the strictly active rows."""

    w: Array
    lam: Array
    H: Array
    A: Array
    B: Array
    C: Array


def rk4(f: Callable[[Any, Any], Any], x: Any, u: Any, dt: float, steps: int) -> Any:
    """x after ``dt`` by the classical scheme."""
    h = dt / steps
    for _ in range(steps):
        k1 = f(x, u)
        k2 = f(x + h / 2 * k1, u)
        k3 = f(x + h / 2 * k2, u)
        k4 = f(x + h * k3, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


# Evaporation process ----------------------------------------------------------------------------------------------


def evaporation_rates(x: Any, u: Any) -> tuple[Any, Any]:
    """(dx / dt, cost) of x = (X2, P2), u = (P100, F200); time in minutes."""
    X2, P2, P100, F200 = x[0], x[1], u[0], u[1]
    F1, F3, X1, Cp, lam, U2 = 10.0, 50.0, 5.0, 0.07, 38.5, 6.84
    T2, T3 = 0.5616 * P2 + 0.3126 * X2 + 48.43, 0.507 * P2 + 55
    Q100 = 0.16 * (F1 + F3) * (0.1538 * P100 + 90 - T2)
    F4 = (Q100 - F1 * Cp * (T2 - 40)) / lam
    Q200 = U2 * (T3 - 25) * 2 * Cp * F200 / (2 * Cp * F200 + U2)  # finite at F200 = 0
    F2 = F1 - F4
    rates = ca.vertcat((F1 * X1 - F2 * X2) / 20, (F4 - Q200 / lam) / 4)
    return rates, 10.09 * (F2 + F3) + 600 * Q100 / 36.6 + 0.6 * F200


def _evaporation_step(x: Any, u: Any) -> tuple[Any, Any]:
    f = lambda x, u: evaporation_rates(x, u)[0]  # noqa: E731
    return rk4(f, x, u, 1.0, 1), evaporation_rates(x, u)[1]


EVAPORATION = Stage(
    2,
    2,
    _evaporation_step,
    lambda x, u: ca.vertcat(x[0] - 25, x[1] - 40, 80 - x[1], 400 - u[0], 400 - u[1]),
    np.array([25, 49.743, 191.713, 215.888]),
)


def evaporation(N: int = 200, fixed_end: bool = True) -> OCP:
    """The OCP with x_N = x_s, or with the cost-to-go of the LQR as terminal cost."""
    at = steady(EVAPORATION)
    x_s = at.w[:2]
    ocp = OCP("evaporation", T=float(N), N=N)
    X2, P2 = ocp.state("X2", initial=float(x_s[0])), ocp.state("P2", initial=float(x_s[1]))
    P100, F200 = ocp.control("P100"), ocp.control("F200")
    rates, cost = evaporation_rates(ocp.x, ocp.u)
    ocp.dynamics(rates)
    ocp.stage_cost(cost)
    ocp.subject_to(25, X2, np.inf)
    ocp.subject_to(40, P2, 80)
    ocp.subject_to(-np.inf, P100, 400)
    ocp.subject_to(-np.inf, F200, 400)
    if fixed_end:
        ocp.subject_to(x_s, ocp.x, x_s, at="end", name="steady")
    else:
        dx = ocp.x - x_s
        ocp.terminal_cost(ca.dot(at.lam, dx) + ca.bilin(cost_to_go(EVAPORATION), dx, dx) / 2)
    return ocp


# Energy-optimal driving -------------------------------------------------------------------------------------------

GEAR, WHEEL, MASS, LENGTH = 7.94, 0.35, 1700.0, 4.8
WATTS, ALPHA = 14341.0, -788.743


def driving_rates(x: Any, u: Any, py_ref: Any = 0.0) -> tuple[Any, Any]:
    """(dx / dt, cost rate) of x = (px, py, v, theta, delta), u = (T, Fb, udelta)."""
    v, theta, delta = x[2], x[3], x[4]
    T, Fb, turn = u[0], u[1], u[2]
    drag = 0.45 * v**2 + MASS * 9.81 * 0.015
    rates = ca.vertcat(
        v * ca.cos(theta),
        v * ca.sin(theta),
        (GEAR * T / WHEEL - Fb - drag) / MASS,
        v * ca.tan(delta) / LENGTH,
        turn,
    )
    w = GEAR * v / WHEEL
    power = w * T + 0.0323 * w * T + 0.0183 * w**2 + 0.0043 * T**2
    return rates, (power + ALPHA * v) / WATTS + (x[1] - py_ref) ** 2 + theta**2 + delta**2 + turn**2


def _driving_step(x: Any, u: Any) -> tuple[Any, Any]:
    f = lambda z, u: ca.vertcat(*driving_rates(z, u))  # noqa: E731
    z = rk4(f, ca.vertcat(x, 0), u, 0.1, DRIVING_STEPS)
    return z[:5], z[5]


DRIVING = Stage(
    5,
    3,
    _driving_step,
    lambda x, u: ca.vertcat(
        u[0], 280 - u[0], 80e3 - u[0] * GEAR / WHEEL * x[2], x[2], 1047.2 * WHEEL / GEAR - x[2], u[1], 10e3 - u[1]
    ),
    np.array([0, 0, 50 / 3.6, 0, 0, 15.0, 0.0, 0.0]),
    cyclic=(0,),
)


def driving(N: int = 100) -> OCP:
    """The OCP with the cost-to-go of the LQR as terminal cost; the reference of py is a parameter."""
    at, V = steady(DRIVING), cost_to_go(DRIVING)
    ocp = OCP("driving", T=0.1 * N, N=N)
    for name, value in zip(("px", "py", "v", "theta", "delta"), at.w[:5], strict=True):
        ocp.state(name, initial=float(value))
    T, Fb, _ = (ocp.control(name) for name in ("torque", "brake", "turn"))
    ocp.cyclic(ocp.x[0])
    py_ref = ocp.parameter("py_ref")
    rates, cost = driving_rates(ocp.x, ocp.u, py_ref)
    ocp.dynamics(rates)
    ocp.stage_cost(cost, integrate=True)
    dx = ocp.x - at.w[:5] - ca.vertcat(0, py_ref, 0, 0, 0)
    ocp.terminal_cost(ca.dot(at.lam, dx) + ca.bilin(V, dx, dx) / 2)
    v = ocp.x[2]
    ocp.subject_to(0, T, 280)
    ocp.subject_to(0, Fb, 10e3)
    ocp.subject_to(0, v, 1047.2 * WHEEL / GEAR)
    ocp.subject_to(-np.inf, T * GEAR / WHEEL * v / 1e3, 80, name="power")
    return ocp


# Steady states and Hessians ------------------------------------------------------------------------------------------


@cache
def steady(stage: Stage) -> Steady:
    """By IPOPT, then Newton's method on the active rows."""
    nx, nu = stage.nx, stage.nu
    w = ca.SX.sym("w", nx + nu)
    x, u = w[:nx], w[nx:]
    step, cost = stage.step(x, u)
    kept = [i for i in range(nx) if i not in stage.cyclic]
    gap, rows = (step - x)[kept], stage.rows(x, u)
    fixed = w[list(stage.cyclic)]
    scale = ca.DM(np.maximum(1.0, np.abs(stage.guess)))
    nlp = {"x": w, "f": cost, "g": ca.vertcat(gap, fixed, rows)}
    options = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
    bounds = {"lbg": 0, "ubg": [0] * nx + [np.inf] * rows.numel()}
    found = ca.nlpsol("steady", "ipopt", nlp, options)(x0=stage.guess, **bounds)
    mu = -np.asarray(found["lam_g"]).ravel()[nx:]
    active = [i for i in range(rows.numel()) if mu[i] > 1e-7]
    c = ca.vertcat(gap, fixed, rows[active])
    y = ca.SX.sym("y", c.numel())
    L = cost + ca.dot(y, c)
    F = ca.vertcat(ca.gradient(L, w), c)
    newton = ca.Function("newton", [w, y], [F, ca.jacobian(F, ca.vertcat(w, y))])
    z = np.concatenate([np.asarray(found["x"]).ravel(), np.zeros(c.numel())])
    n = nx + nu
    unit = np.concatenate([np.asarray(scale).ravel(), np.ones(c.numel())])
    for _ in range(10):
        value, K = (np.asarray(part) for part in newton(z[:n], z[n:]))
        z = z - unit * np.linalg.lstsq(K * unit, value.ravel(), rcond=1e-14)[0]
    lam = np.zeros(nx)
    lam[kept] = z[n : n + len(kept)]
    evaluate = ca.Function("data", [w, y], [ca.hessian(L, w)[0], ca.jacobian(step, w), ca.jacobian(rows[active], w)])
    H, S, C = (np.asarray(part) for part in evaluate(z[:n], z[n:]))
    return Steady(z[:n], lam, H, S[:, :nx], S[:, nx:], C.reshape(-1, n))


def cost_to_go(stage: Stage, less: float = 0.0) -> Array:
    """P of the LQR with the Hessian H - less D at the steady state, with the active rows held; 0 for cyclic states.

    D is diagonal, of the size of H on every variable.
    """
    at, nx = steady(stage), stage.nx
    H = at.H - less * np.diag(units(stage))
    on_states = np.array([not np.any(row[nx:]) for row in at.C], dtype=bool)
    states = np.vstack([at.C[on_states, :nx], np.eye(nx)[list(stage.cyclic)]])
    Z = null_space(states) if len(states) else np.eye(nx)
    after = [at.C[on_states, :nx] @ at.A @ Z, at.C[on_states, :nx] @ at.B]
    C = np.vstack([np.hstack(after), np.hstack([at.C[~on_states, :nx] @ Z, at.C[~on_states, nx:]])])
    held, n = C[:, Z.shape[1] :], Z.shape[1]
    K = -np.linalg.pinv(held) @ C[:, :n] if len(C) else np.zeros((stage.nu, n))
    free = null_space(held) if len(C) else np.eye(stage.nu)
    T = np.block([[Z, np.zeros((nx, free.shape[1]))], [K, free]])
    G = T.T @ H @ T
    A, B = Z.T @ (at.A @ Z + at.B @ K), Z.T @ at.B @ free
    P = solve_discrete_are(A, B, G[:n, :n], G[n:, n:], s=G[:n, n:])
    return np.asarray(Z @ P @ Z.T)


def units(stage: Stage) -> Array:
    """Positive numbers of the size of the diagonal of H, (nx + nu,)."""
    size = np.abs(np.diag(steady(stage).H))
    return np.maximum(size, 1e-6 * size.max()) * (1.0 - np.isin(np.arange(len(size)), stage.cyclic))


@cache
def tuned(stage: Stage, less: float = 1e-2) -> tuple[Array, Array]:
    """(M, M_f): with dP = P + C_x'q + q'C_x for active rows C_x of states, the free q and F are those with the smallest
    condition number of M in units of H. M_f belongs to the terminal cost of cost_to_go(stage)."""
    at, nx = steady(stage), stage.nx
    others = [i for i in range(len(at.H)) if i not in stage.cyclic]
    P, S = cost_to_go(stage, less), np.hstack([at.A, at.B])
    states = at.C[[not np.any(row[nx:]) for row in at.C], :nx]
    d, size = np.sqrt(units(stage)[others]), float(np.abs(at.H).max())

    def hessian(free: Array) -> Array:
        q = size * free[1:].reshape(len(states), nx)
        dP = P + states.T @ q + q.T @ states
        M = at.H + S.T @ dP @ S + size * np.exp(free[0]) * at.C.T @ at.C
        M[:nx, :nx] -= dP
        return np.asarray((M + M.T) / 2)

    def condition(free: Array) -> float:
        values = np.linalg.eigvalsh(hessian(free)[np.ix_(others, others)] / d / d[:, None])
        return float(np.log(values.max() / values.min()) if values.min() > 0 else 100 - values.min() / values.max())

    free = np.concatenate([[5.0], 5 * states.ravel()])
    for _ in range(5):
        free = minimize(condition, free, method="Nelder-Mead", options={"maxiter": 2000, "xatol": 1e-9}).x
    if condition(free) >= 100:
        raise ValueError("no positive definite Hessian was found")
    M = hessian(free)
    M[list(stage.cyclic)] = M[:, list(stage.cyclic)] = 0
    return cleared(M), cleared(cost_to_go(stage) - P)


def cleared(M: Array) -> Array:
    """M without entries that are rounding errors in units of its diagonal, so that the generated code skips them."""
    size = np.sqrt(np.abs(np.diag(M)))
    return np.where(np.abs(M) > 1e-12 * np.outer(size, size), M, 0.0)
