"""tune_periodic(): positive definite Hessians along the best periodic operation, computed once and off line.

    min sum_k l(x_k, u_k, p_k)  s.t.  x_{k+1} = Phi(x_k, u_k, p_k),  x_P = x_0,  lower <= h(x_k, u_k, p_k) <= upper
    M_k = H_k + (Hcal(dP_k, dP_k+1) + eta C_k'F_k C_k) / alpha,   dP_P = dP_0

H_k are Hessians of the Lagrangian at this orbit, for example that of a tariff, a day, or a batch. As at a steady state,
rotation by a quadratic storage function, here one per interval, and squares of strictly active rows change neither the
solution nor the Hessian on the null space of the dynamics and of those rows.

Source: Zanon, Gros and Diehl, "A periodic tracking MPC that is locally equivalent to periodic economic MPC", IFAC World
Congress 2017.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg

from nmpc_codegen.economic.linear_quadratic import LinearQuadratic
from nmpc_codegen.economic.semidefinite import Weights, convexify_period
from nmpc_codegen.economic.stage import SteadyStage, magnitudes, steady_stage
from nmpc_codegen.economic.steady_state import IPOPT_TOLERANCE, NEWTON_STEPS, RESIDUAL, STRICT, active_bounds
from nmpc_codegen.errors import OptionError, ProblemError
from nmpc_codegen.frontend.checks import integer
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.options import Options


@dataclass(frozen=True, eq=False)
class PeriodicTuning:
    """The orbit and its Hessians, in the units of the problem, P intervals.

    x (P, nx), u (P, nu), lam (P, nx), mu (P arrays of the strictly active rows, whose names are ``active``);
    M (P, nx+nu, nx+nu); H, A, B, C, dP: the expansion and the storage at every interval; ``cost``: mean of an interval.
    """

    problem: Problem
    x: Array
    u: Array
    lam: Array
    mu: tuple[Array, ...]
    active: tuple[tuple[str, ...], ...]
    M: Array
    H: Array
    A: Array
    B: Array
    C: tuple[Array, ...]
    dP: Array
    alpha: float
    beta: float
    cost: float

    @property
    def period(self) -> int:
        """P, intervals."""
        return len(self.M)

    def cost_to_go(self, periods: int = 50) -> Array:
        """S (P, nx, nx): the Riccati recursion of A, B, M around the orbit, without rows, after so many periods."""
        n, S = self.x.shape[1], self.M[0, : self.x.shape[1], : self.x.shape[1]]
        found = np.zeros((self.period, n, n))
        for k in reversed(range(self.period * periods)):
            i = k % self.period
            AB = np.hstack([self.A[i], self.B[i]])
            Z = self.M[i] + AB.T @ S @ AB
            S = Z[:n, :n] - Z[:n, n:] @ np.linalg.solve(Z[n:, n:], Z[n:, :n])
            S = found[i] = (S + S.T) / 2
        return found


def tune_periodic(
    ocp: OCP,
    options: Options | None = None,
    *,
    parameters: Any = None,
    period: int | None = None,
    rho1: float = 1e-3,
    eta: int = 1,
    guess: tuple[Any, Any] | None = None,
) -> PeriodicTuning:
    """Find the best periodic operation of a problem, and Hessians M_k of LETEMPC along it.

    Args:
        ocp: the problem, on a uniform grid; its cost, dynamics and rows of inner nodes count, whatever its horizon.
        options: its integrator defines the discrete map.
        parameters: values of the online parameters in every interval of a period, (P, np), or (P,) if np = 1.
        period: P, if the parameters do not change.
        rho1: penalty of |F_k|, the multiples of strictly active rows.
        eta: 1: strictly active rows may be used; 0: the cost must be dissipative without them.
        guess: (x (P, nx), u (P, nu)) near the orbit; by default the initial state, and the middle of the bounds.

    Raises:
        ProblemError: there are cyclic states or unequal intervals, no orbit is found, or there are no such M_k.
        OptionError: an argument has a value that is not allowed, or CVXPY or Clarabel is missing.
    """
    weights = Weights(rho1, eta=eta)
    if not isinstance(ocp, OCP):
        raise ProblemError(f"ocp: {type(ocp).__name__}; expected an OCP")
    problem = classify(ocp)
    if not problem.uniform or problem.cyclic:
        what = "has cyclic states" if problem.cyclic else "has intervals of different length"
        raise ProblemError(
            f"tune_periodic: '{problem.name}' {what}; expected a uniform grid and an orbit of all states"
        )
    values = _parameters(problem, parameters, period)
    orbit = _Orbit(problem, [steady_stage(problem, options, p) for p in values])
    return _tuned(orbit, weights, *orbit.solve(_guess(problem, len(values), guess)))


def _tuned(orbit: _Orbit, weights: Weights, w: Array, lam: Array, mu: list[Array]) -> PeriodicTuning:
    """The Hessians along an orbit."""
    active, stages, problem = orbit.active(w, lam, mu), orbit.stages, orbit.problem
    period = [orbit.expansion(k, w[k], lam, mu[k], active[k]) for k in range(len(stages))]
    found = convexify_period(period, weights, magnitudes(stages[0], *w))
    if isinstance(found, str):
        rows = "" if weights.eta else "; eta=1 uses the strictly active rows"
        raise ProblemError(
            f"tune_periodic: no positive definite M_k were found along the orbit of '{problem.name}' (solver: "
            f"{found}): "
            f"it is not strictly dissipative there; add curvature to the cost, or integrate it with the dynamics{rows}"
        )
    n = problem.nx
    return PeriodicTuning(
        problem=problem,
        x=w[:, :n],
        u=w[:, n:],
        lam=lam,
        mu=tuple(m[list(rows)] for m, rows in zip(mu, active, strict=True)),
        active=tuple(lq.active for lq in period),
        M=np.array([c.M for c in found]),
        H=np.array([lq.H for lq in period]),
        A=np.array([lq.A for lq in period]),
        B=np.array([lq.B for lq in period]),
        C=tuple(lq.C for lq in period),
        dP=np.array([c.dP for c in found]),
        alpha=found[0].alpha,
        beta=found[0].beta,
        cost=float(np.mean([float(s.values(point)[1]) for s, point in zip(stages, w, strict=True)])),
    )


def _parameters(problem: Problem, given: Any, period: int | None) -> Array:
    """Values (P, np)."""
    count = len(problem.p_value)
    if (given is None) == (period is None):
        raise OptionError("tune_periodic: expected either parameters=, one row per interval, or period=, a number")
    if period is not None:
        return np.tile(problem.p_value, (integer(period, "tune_periodic: period", 1), 1))
    try:
        found = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        found = np.zeros(0)
    found = found[:, None] if found.ndim == 1 else found
    if found.ndim != 2 or found.shape[1] != count or not len(found) or not np.all(np.isfinite(found)):
        raise OptionError(f"tune_periodic: parameters of shape {np.shape(given)}; expected (P, {count}) finite numbers")
    return found


def _guess(problem: Problem, period: int, guess: tuple[Any, Any] | None) -> Array:
    """w (P, nx + nu)."""
    if guess is None:
        u = np.zeros(problem.nu)
        for row in problem.rows:
            if row.kind == "control":
                ends = [bound for bound in (row.lower, row.upper) if np.isfinite(bound)]
                u[row.index] = np.mean(ends) if ends else 0.0
        return np.tile(np.concatenate([problem.x_initial, u]), (period, 1))
    try:
        return np.hstack(
            [
                np.asarray(v, dtype=float).reshape(period, n)
                for v, n in zip(guess, (problem.nx, problem.nu), strict=True)
            ]
        )
    except (TypeError, ValueError) as error:
        shapes = f"({period}, {problem.nx}) and ({period}, {problem.nu})"
        raise OptionError(f"tune_periodic: guess={guess!r}; expected (x, u) of shapes {shapes}") from error


class _Orbit:
    """The program of the orbit in the variables w_0, ..., w_{P-1}, scaled by their magnitudes."""

    def __init__(self, problem: Problem, stages: Sequence[SteadyStage]) -> None:
        self.problem, self.stages, self.nz = problem, stages, problem.nx + problem.nu

    def solve(self, guess: Array) -> tuple[Array, Array, list[Array]]:
        """w (P, nz), lam (P, nx) of the state at the start of every interval, mu of its rows."""
        size, P, n = magnitudes(self.stages[0], *guess), len(self.stages), self.problem.nx
        V = ca.SX.sym("V", self.nz, P)
        outs = [stage.values(V[:, k] * size) for k, stage in enumerate(self.stages)]
        gaps = [out[0] / size[:n] - V[:n, (k + 1) % P] for k, out in enumerate(outs)]
        cost = sum(out[1] for out in outs)
        quiet: dict[str, Any] = {
            "print_level": 0,
            "sb": "yes",
            "tol": IPOPT_TOLERANCE,
            "bound_relax_factor": 0.0,
            "max_iter": 3000,
        }
        quiet |= {"constr_viol_tol": IPOPT_TOLERANCE, "compl_inf_tol": IPOPT_TOLERANCE, "acceptable_iter": 0}
        program = {"x": ca.vec(V), "f": cost, "g": ca.vertcat(*gaps, *(out[2] for out in outs))}
        settings: Any = {"print_time": False, "show_eval_warnings": False, "ipopt": quiet}
        solver = ca.nlpsol("orbit", "ipopt", program, settings)
        rows = [stage.rows for stage in self.stages]
        low = np.concatenate([np.zeros(P * n), *(r.lower for r in rows)])
        high = np.concatenate([np.zeros(P * n), *(r.upper for r in rows)])
        found = solver(x0=(guess / size).ravel(), lbg=low, ubg=high)
        g = np.asarray(found["g"], dtype=float).ravel()
        off = float(np.max(np.concatenate([low - g, g - high]), initial=0.0))
        if not off <= 1e-8:
            status = solver.stats()["return_status"]
            raise ProblemError(
                f"tune_periodic: '{self.problem.name}' has no periodic operation of {P} intervals near the guess "
                "(IPOPT: "
                f"{status}, rows and gaps off by {off:.2g}); check the rows, or give a guess=(x, u)"
            )
        w = np.asarray(found["x"], dtype=float).reshape(P, self.nz) * size
        multipliers = np.asarray(found["lam_g"], dtype=float).ravel()
        after = multipliers[: P * n].reshape(P, n) / size[:n]
        mu = np.split(multipliers[P * n :], np.cumsum([len(r.names) for r in rows])[:-1])
        return self._polished(w, np.roll(after, 1, axis=0), list(mu))

    def _polished(self, w: Array, lam: Array, mu: list[Array]) -> tuple[Array, Array, list[Array]]:
        """Newton's method on the optimality conditions with the active rows as equations."""
        held = [
            active_bounds(s.rows, np.asarray(s.values(p)[2]).ravel(), m)
            for s, p, m in zip(self.stages, w, mu, strict=True)
        ]
        mu = [np.where(np.isin(np.arange(len(m)), rows), m, 0.0) for m, (rows, _) in zip(mu, held, strict=True)]
        best, last = (w, lam, mu), np.inf
        for _ in range(NEWTON_STEPS):
            K, r, forces = self._system(w, lam, mu, held)
            size = float(np.abs(r).max()) / max(1.0, forces, float(np.abs(w).max()))
            if not size < last:
                break
            best, last = (w, lam, [m.copy() for m in mu]), size
            step = np.linalg.lstsq(K, -r, rcond=None)[0]
            w = w + step[: w.size].reshape(w.shape)
            lam = lam + step[w.size : w.size + lam.size].reshape(lam.shape)
            at = w.size + lam.size
            for m, (rows, _) in zip(mu, held, strict=True):
                m[list(rows)] += step[at : at + len(rows)]
                at += len(rows)
        if last > RESIDUAL:
            raise ProblemError(
                f"tune_periodic: the optimality conditions of the orbit of '{self.problem.name}' are solved only to "
                f"{last:.2g}; are they singular, as where orbits may be shifted in time, or does the guess mislead?"
            )
        return best

    def _system(self, w: Array, lam: Array, mu: list[Array], held: list[Any]) -> tuple[Array, Array, float]:
        """Matrix and right-hand side of the conditions, and the largest of the forces that they add up."""
        P, n, nz = len(self.stages), self.problem.nx, self.nz
        H, slopes, gaps, G, C, excess, forces = [], np.zeros((P, nz)), [], np.zeros((P * n, P * nz)), [], [], 1.0
        for k, (stage, point) in enumerate(zip(self.stages, w, strict=True)):
            Phi, _, h = (np.asarray(v, dtype=float).ravel() for v in stage.values(point))
            AB, gradient, J = (np.asarray(v, dtype=float) for v in stage.jacobians(point))
            nxt, (rows, bound) = (k + 1) % P, held[k]
            H.append(np.asarray(stage.hessian(point, lam[nxt], mu[k])))
            slopes[k] += gradient.ravel() + AB.T @ lam[nxt] + J.T @ mu[k]
            slopes[k, :n] -= lam[k]
            gaps.append(Phi - w[nxt, :n])
            G[nxt * n : nxt * n + n, k * nz : (k + 1) * nz] += AB
            G[nxt * n : nxt * n + n, nxt * nz : nxt * nz + n] -= np.eye(n)
            C.append(J[list(rows)].reshape(-1, nz))
            excess.append((h - bound)[list(rows)])
            forces = max(forces, float(np.abs(gradient).max()), float(np.abs(lam).max()))
        held_rows = np.vstack([G, scipy.linalg.block_diag(*C)])
        K = np.block([[scipy.linalg.block_diag(*H), held_rows.T], [held_rows, np.zeros((len(held_rows),) * 2)]])
        gaps_at_end = np.roll(np.array(gaps), 1, axis=0)
        return K, np.concatenate([slopes.ravel(), gaps_at_end.ravel(), *excess]), forces

    def active(self, w: Array, lam: Array, mu: Sequence[Array]) -> list[tuple[int, ...]]:
        """Strictly active rows of every interval: their multipliers are no rounding errors, or they are equations."""
        gradients = [np.abs(np.asarray(s.jacobians(p)[1])).max() for s, p in zip(self.stages, w, strict=True)]
        largest = max(*gradients, float(np.abs(lam).max()), *(float(np.abs(m).max(initial=0.0)) for m in mu))
        found = []
        for stage, m in zip(self.stages, mu, strict=True):
            equations = stage.rows.lower == stage.rows.upper
            found.append(tuple(np.flatnonzero((np.abs(m) > STRICT * largest) | equations).tolist()))
        return found

    def expansion(self, k: int, w: Array, lam: Array, mu: Array, active: tuple[int, ...]) -> LinearQuadratic:
        """A, B, H and C of an interval."""
        stage, n = self.stages[k], self.problem.nx
        AB, _, J = (np.asarray(v, dtype=float) for v in stage.jacobians(w))
        H = np.asarray(stage.hessian(w, lam[(k + 1) % len(self.stages)], mu), dtype=float)
        names = tuple(stage.rows.names[i] for i in active)
        return LinearQuadratic(AB[:, :n], AB[:, n:], (H + H.T) / 2, J[list(active)].reshape(-1, self.nz), active=names)
