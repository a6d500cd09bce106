"""IPOPT and Newton's method find the optimal steady state and its multipliers.

    min l(x, u)  s.t.  x = Phi(x, u),  lower <= h(x, u) <= upper
    L_s = l + lam_s' (Phi - x) + mu_s' h,    mu_s > 0 at the upper bound and < 0 at the lower one

IPOPT finds the active rows; Newton's method on the optimality conditions with these rows as equations then removes the
error of the barrier. The sign of lam_s is that of the multipliers of the controller: with the opposite one, which [Z20]
prints in its equation (3), the Hessian of L_s has another spectrum.

Source: Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020), section III, called [Z20] here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg

from nmpc_codegen.economic.stage import Rows, SteadyStage, in_units, magnitudes, units
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import vector
from nmpc_codegen.frontend.problem import Array

#: Tolerance of IPOPT; residual of the polished point, relative to the largest multiplier or variable.
IPOPT_TOLERANCE, RESIDUAL = 1e-12, 1e-10
#: A multiplier below this fraction of the largest one does not make its row strictly active.
STRICT = 1e-9
NEWTON_STEPS = 20
#: Curvature below CURVED, relative to the largest one, counts as negative. A point that is no minimum is left at most
#: ATTEMPTS times, by the fraction LEAVE of its size.
CURVED, ATTEMPTS, LEAVE = -1e-9, 3, 0.1
#: Largest distance, relative to the size of a state, by which the model may move at a steady state of an implicit
# scheme.
MOVING = 1e-4


@dataclass(frozen=True, eq=False)
class SteadyState:
    """A steady state without the cyclic states; n states are kept.

    Attributes:
        x: (n,), states.
        u: (nu,), controls.
        lam: (n,), multipliers of the dynamics.
        mu: one multiplier per row.
        cost: cost of one interval.
        active: indices of the rows that are strictly active.
        residual: residual of the optimality conditions.
        size: (n + nu,), typical magnitudes of w.
    """

    x: Array
    u: Array
    lam: Array
    mu: Array
    cost: float
    active: tuple[int, ...]
    residual: float
    size: Array

    @property
    def w(self) -> Array:
        """Return (x, u)."""
        return np.concatenate([self.x, self.u])


def solve_steady_state(stage: SteadyStage, guess: tuple[Array, Array] | None = None) -> SteadyState:
    """Solve for the steady state from a guess (x, u) of all states and controls.

    Without a guess, x is the initial state and u the reference of the controls or the middle of their bounds.

    A point of the optimality conditions that is no minimum, such as the start at a maximum, is left along the direction
    of negative curvature.

    Raises:
        ProblemError: IPOPT finds no steady state, the cost has no lower bound on the steady states, or the optimality
            conditions are singular.
    """
    w = start_point(stage, guess)
    _refuse_infinite(stage, w)
    size = magnitudes(stage, w)
    money, norms = units(stage, w, size)
    money = money if 0 < money < np.inf else 1.0
    found = _least(in_units(stage, size, money, norms), w / size)
    lam, mu = found.lam * money / size[: stage.nx], found.mu * money / norms
    w = found.w * size
    _refuse_moving(stage, w, magnitudes(stage, w, size))
    refuse_violated(stage.rows, found.active, mu, "steady state")
    n, cost = stage.nx, found.cost * money
    return SteadyState(w[:n], w[n:], lam, mu, cost, found.active, found.residual, magnitudes(stage, w, size))


def _least(stage: SteadyStage, w: Array) -> SteadyState:
    """Find a minimum from the start w, in the units of the stage."""
    direction = np.zeros(0)
    for _ in range(ATTEMPTS):
        found = _optimum(stage, w)
        direction = _downhill(stage, found)
        if not direction.any():
            return found
        w = found.w + LEAVE * max(1.0, float(np.abs(found.w).max())) * direction
    names = ", ".join(stage.names[i] for i in np.flatnonzero(np.abs(direction) > 0.1 * np.abs(direction).max()))
    raise ProblemError(
        f"OCP '{stage.problem.name}': every steady state found is a maximum or a saddle of the cost in the direction "
        f"of {names}; give a guess=(x, u) near the minimum, or bound these variables"
    )


def _downhill(stage: SteadyStage, found: SteadyState) -> Array:
    """Return a direction (n + nu,) of norm 1 at constant state with negative curvature of the Lagrangian, else zero.

    Rows at their bounds are held, also those without a multiplier.
    """
    w, rows = found.w, stage.rows
    h = stage.values(w)[2].full().ravel()
    size = 1e-8 * np.maximum(1.0, np.abs(h))
    held = (np.abs(h - rows.lower) <= size) | (np.abs(h - rows.upper) <= size)
    H = np.asarray(stage.hessian(w, found.lam, found.mu))
    diagonal = np.abs(np.diag(H))
    unit = 1 / np.sqrt(np.where(diagonal > 1e-12 * max(diagonal.max(), np.finfo(float).tiny), diagonal, 1.0))
    AB, _, J = (np.asarray(v, dtype=float) for v in stage.jacobians(w))
    basis = scipy.linalg.null_space(np.vstack([AB - np.eye(stage.nx, len(w)), J[held]]) * unit)
    if not basis.shape[1]:
        return np.zeros(len(w))
    scaled = H * np.outer(unit, unit)
    values, vectors = np.linalg.eigh(basis.T @ scaled @ basis)
    if values[0] >= CURVED * np.abs(np.linalg.eigvalsh(scaled)).max():
        return np.zeros(len(w))
    direction: Array = unit * (basis @ vectors[:, 0])
    return direction / np.linalg.norm(direction)


def _optimum(stage: SteadyStage, start: Array) -> SteadyState:
    """Return a point that satisfies the optimality conditions."""
    rows, w, n = stage.rows, stage.w, stage.nx
    g = ca.vertcat(stage.Phi - stage.x, rows.h)
    quiet: dict[str, Any] = {
        "print_level": 0,
        "sb": "yes",
        "tol": IPOPT_TOLERANCE,
        "bound_relax_factor": 0.0,
        "max_iter": 1000,
    }
    quiet |= {"acceptable_iter": 0, "constr_viol_tol": IPOPT_TOLERANCE, "compl_inf_tol": IPOPT_TOLERANCE}
    settings: Any = {"print_time": False, "show_eval_warnings": False, "ipopt": quiet}
    solver = ca.nlpsol("steady", "ipopt", {"x": w, "f": stage.cost, "g": g}, settings)
    low, high = np.concatenate([np.zeros(n), rows.lower]), np.concatenate([np.zeros(n), rows.upper])
    found = solver(x0=start, lbg=low, ubg=high)
    g_found = found["g"].full().ravel()
    point, multipliers = (np.asarray(found[key], dtype=float).ravel() for key in ("x", "lam_g"))
    _refuse_failure(stage, solver.stats()["return_status"], point, np.maximum(low - g_found, g_found - high))
    return _polish(stage, point, multipliers[:n], multipliers[n:])


def _refuse_infinite(stage: SteadyStage, w: Array) -> None:
    if all(np.all(np.isfinite(v.full())) for v in (*stage.values(w), *stage.jacobians(w))):
        return
    at = ", ".join(f"{name} = {value:.6g}" for name, value in zip(stage.names, w, strict=True))
    raise ProblemError(
        f"OCP '{stage.problem.name}': cost, dynamics or rows are not finite at {at}, where the search for a steady "
        "state starts; declare other initial= values of the states, or give a guess=(x, u)"
    )


def _refuse_moving(stage: SteadyStage, w: Array, size: Array) -> None:
    """Raise ProblemError if the point is a fixed point of an implicit scheme at which the model is not at rest.

    There (I - dt f_x)^{-1} dt f is not 0.
    """
    if stage.move is None:
        return
    evaluate = ca.Function("move", [stage.w], [stage.move, ca.densify(ca.jacobian(stage.move, stage.x))])
    move, slopes = (np.asarray(value, dtype=float) for value in evaluate(w))
    moved = np.abs(np.linalg.lstsq(np.eye(stage.nx) - slopes, move[:, 0])[0]) / size[: stage.nx]
    worst = int(np.argmax(moved))
    if moved[worst] > MOVING:
        raise ProblemError(
            f"OCP '{stage.problem.name}': the state '{stage.names[worst]}' is not at rest at the steady state that was "
            f"found, x = {np.round(w[: stage.nx], 6).tolist()}; give a guess=(x, u) near it"
        )


def _refuse_failure(stage: SteadyStage, status: str, w: Array, over: Array) -> None:
    """Raise ProblemError if IPOPT found no steady state that satisfies the rows.

    ``over``: violations of the equilibrium and of the rows, (n + rows,).
    """
    if status == "Diverging_Iterates":
        raise ProblemError(
            f"OCP '{stage.problem.name}': the cost has no lower bound on the steady states; bound the states and "
            "controls by subject_to(), or check the sign of the cost"
        )
    worst, n = int(np.argmax(over)), stage.nx
    if over[worst] <= 1e-6 * max(1.0, float(np.abs(w).max())):
        return
    what = f"the state '{stage.names[worst]}' is not at rest" if worst < n else f"row '{stage.rows.names[worst - n]}'"
    raise ProblemError(
        f"OCP '{stage.problem.name}': no steady state was found (IPOPT: {status}; {what}, by {over[worst]:.2g}); check "
        "rows and parameters, give a guess=(x, u), or name states that grow for ever by ocp.cyclic(...)"
    )


def start_point(stage: SteadyStage, guess: tuple[Array, Array] | None = None) -> Array:
    """Return the start w of the search: the guess, else the initial state with references or mid-ranges of controls."""
    problem = stage.problem
    if guess is not None:
        if not isinstance(guess, (tuple, list)) or len(guess) != 2:
            raise ProblemError(f"guess={guess!r}; expected (x, u) with {problem.nx} and {problem.nu} values")
        x, u = vector(guess[0], problem.nx, "guess: x"), vector(guess[1], problem.nu, "guess: u")
        return np.concatenate([x[list(stage.kept)], u])
    u = np.zeros(problem.nu)
    for row in problem.rows:
        if row.kind == "control":
            both = np.isfinite(row.lower) and np.isfinite(row.upper)
            u[row.index] = (row.lower + row.upper) / 2 if both else np.clip(u[row.index], row.lower, row.upper)
    for j, value in enumerate(problem.reference_controls):
        u[j] = value if problem.path.target_of(problem.nx + j) else u[j]
    return np.concatenate([problem.x_initial[list(stage.kept)], u])


def active_bounds(rows: Rows, h: Array, mu: Array) -> tuple[tuple[int, ...], Array]:
    """Return the rows whose multiplier exceeds their distance to the bound of its sign, and those bounds."""
    bound = np.where(mu > 0, rows.upper, rows.lower)
    near = [i for i in range(len(mu)) if rows.lower[i] == rows.upper[i] or abs(mu[i]) > abs(h[i] - bound[i])]
    return tuple(near), bound


def _polish(stage: SteadyStage, w: Array, lam: Array, mu: Array) -> SteadyState:
    """Apply Newton's method to L_w = 0, Phi = x, h = bound for the active rows."""
    n, rows = stage.nx, stage.rows
    active, bound = active_bounds(rows, stage.values(w)[2].full().ravel(), mu)
    E = np.eye(n, len(w))
    mu = np.where([i in active for i in range(len(mu))], mu, 0.0)
    best: tuple[float, Array, Array, Array] | None = None
    for _ in range(NEWTON_STEPS):
        Phi, _, h = (np.asarray(v, dtype=float).ravel() for v in stage.values(w))
        AB, gradient, J = (np.asarray(v, dtype=float) for v in stage.jacobians(w))
        C = J[list(active)]
        r = np.concatenate(
            [gradient.ravel() + (AB - E).T @ lam + J.T @ mu, Phi - w[:n], (h - bound)[list(active)]], dtype=float
        )
        H = np.asarray(stage.hessian(w, lam, mu))
        size = _relative(r, w, np.concatenate([gradient.ravel(), lam, mu, H.ravel() * max(1.0, np.abs(w).max())]))
        if not np.isfinite(size) or (best is not None and size >= best[0]):
            break
        best = (size, w, lam, mu)
        G = np.vstack([AB - E, C])
        K = np.block([[H, G.T], [G, np.zeros((len(G), len(G)))]])
        step = np.linalg.lstsq(K, -r, rcond=None)[0]
        w, lam = w + step[: len(w)], lam + step[len(w) : len(w) + n]
        mu = mu.copy()
        mu[list(active)] += step[len(w) + n :]
    if best is None or best[0] > RESIDUAL:
        raise ProblemError(
            f"OCP '{stage.problem.name}': the optimality conditions of the steady state are solved only to "
            f"{np.inf if best is None else best[0]:.2g}; are they singular, or does the guess lead to another point?"
        )
    return _check(stage, *best)


def _relative(r: Array, w: Array, forces: Array) -> float:
    """Return the residual: its slopes relative to the terms of the Lagrangian, its gaps relative to w."""
    slopes, gaps = np.abs(r[: len(w)]), np.abs(r[len(w) :])
    largest = max(float(np.abs(forces).max()), np.finfo(float).tiny)
    return max(float(slopes.max()) / largest, float(gaps.max()) / max(1.0, float(np.abs(w).max())))


def _check(stage: SteadyStage, residual: float, w: Array, lam: Array, mu: Array) -> SteadyState:
    rows, n = stage.rows, stage.nx
    _, cost, h = (np.asarray(v, dtype=float).ravel() for v in stage.values(w))
    largest = max(np.abs(np.concatenate([mu, lam, stage.jacobians(w)[1].full().ravel()])))
    strict = tuple(i for i in range(len(mu)) if abs(mu[i]) > STRICT * largest or rows.lower[i] == rows.upper[i])
    excess = float(np.max(np.concatenate([h - rows.upper, rows.lower - h, [0.0]])))
    if excess > 1e-8 * max(1.0, float(np.abs(w).max())):
        raise ProblemError(f"OCP '{stage.problem.name}': the steady state violates a row by {excess:.2g}; give guess=")
    return SteadyState(w[:n], w[n:], lam, mu, float(cost[0]), strict, residual, np.ones(len(w)))


def refuse_violated(rows: Rows, active: tuple[int, ...], mu: Array, where: str) -> None:
    """Raise ProblemError if the penalty of a soft row is too small to keep it."""
    for i in active:
        if abs(mu[i]) > rows.penalty[i]:
            raise ProblemError(
                f"the soft row '{rows.names[i]}' is violated at the {where} (multiplier {mu[i]:.3g}, l1 = "
                f"{rows.penalty[i]:.3g}); it must hold there: raise its l1, or move its bound"
            )
