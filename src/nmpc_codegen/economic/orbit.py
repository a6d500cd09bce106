"""The best periodic operation and its multipliers are found by IPOPT and Newton's method.

    min sum_k l(x_k, u_k, p_k)  s.t.  x_{k+1} = Phi(x_k, u_k, p_k),  x_P = x_0,  lower <= h(x_k, u_k, p_k) <= upper

As at a steady state, IPOPT finds the active rows, and Newton's method with these rows as equations removes the error of
the barrier; a point that is no minimum is left along the direction of negative curvature. All computations use units of
the typical sizes of w = (x, u), of the cost and of the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg

from nmpc_codegen.economic.stage import SteadyStage, in_units, magnitudes, units
from nmpc_codegen.economic.stationary import (
    ATTEMPTS,
    CURVED,
    IPOPT_TOLERANCE,
    LEAVE,
    NEWTON_STEPS,
    RESIDUAL,
    STRICT,
    active_bounds,
    refuse_violated,
)
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.problem import Array

#: Largest violation and gap of an admissible point; size of w that shows divergence; both in units.
ADMISSIBLE, INFINITE = 1e-8, 1e8


@dataclass(frozen=True, eq=False)
class Orbit:
    """An orbit has w (P, nx + nu), lam (P, nx) at the start of each interval, mu of its rows, and active rows.

    ``size`` (nx + nu,) holds typical magnitudes of w.
    """

    w: Array
    lam: Array
    mu: tuple[Array, ...]
    active: tuple[tuple[int, ...], ...]
    size: Array


def solve_orbit(stages: Sequence[SteadyStage], guess: Array) -> Orbit:
    """Return the orbit near the guess (P, nx + nu).

    Raises:
        ProblemError: there is no orbit, its cost has no lower bound, it is no minimum, or a soft row is violated on it.
    """
    name, n = stages[0].problem.name, stages[0].nx
    size = magnitudes(stages[0], *guess)
    each = [units(stage, point, size) for stage, point in zip(stages, guess, strict=True)]
    money, norms = max(m for m, _ in each), [r for _, r in each]
    if not np.isfinite(money):
        raise ProblemError(f"tune_periodic: cost or rows of '{name}' are not finite at the guess; give another one")
    money = money or 1.0
    found = _least(
        _Program([in_units(s, size, money, r) for s, r in zip(stages, norms, strict=True)], name), guess / size
    )
    mu = tuple(m * money / r for m, r in zip(found.mu, norms, strict=True))
    for stage, active, of_rows in zip(stages, found.active, mu, strict=True):
        refuse_violated(stage.rows, active, of_rows, "best orbit")
    w = found.w * size
    return Orbit(w, found.lam * money / size[:n], mu, found.active, magnitudes(stages[0], *w, size))


def _least(program: _Program, w: Array) -> Orbit:
    """Find a minimum from the start w."""
    for _ in range(ATTEMPTS):
        found = program.polish(*program.optimum(w))
        direction = program.downhill(found)
        if not direction.any():
            return found
        w = found.w + LEAVE * max(1.0, float(np.abs(found.w).max())) * direction
    raise ProblemError(
        f"tune_periodic: every orbit of '{program.name}' that was found is a maximum or a saddle of the cost; give a "
        "guess=(x, u) near the minimum"
    )


class _Program:
    """The nonlinear program of the orbit has the variables w_0, ..., w_{P-1}, in units."""

    def __init__(self, stages: Sequence[SteadyStage], name: str) -> None:
        self.stages, self.name, self.n, self.nz = stages, name, stages[0].nx, int(stages[0].w.numel())

    def optimum(self, start: Array) -> tuple[Array, Array, list[Array]]:
        """Return IPOPT's point: w, lam, mu."""
        P, n = len(self.stages), self.n
        V = ca.SX.sym("V", self.nz, P)
        outs = [stage.values(V[:, k]) for k, stage in enumerate(self.stages)]
        gaps = [out[0] - V[:n, (k + 1) % P] for k, out in enumerate(outs)]
        quiet: dict[str, Any] = {"print_level": 0, "sb": "yes", "bound_relax_factor": 0.0, "max_iter": 3000}
        quiet |= dict.fromkeys(("tol", "constr_viol_tol", "compl_inf_tol"), IPOPT_TOLERANCE) | {"acceptable_iter": 0}
        settings: Any = {"print_time": False, "show_eval_warnings": False, "ipopt": quiet}
        program = {"x": ca.vec(V), "f": sum(o[1] for o in outs), "g": ca.vertcat(*gaps, *(o[2] for o in outs))}
        solver = ca.nlpsol("orbit", "ipopt", program, settings)
        rows = [stage.rows for stage in self.stages]
        low = np.concatenate([np.zeros(P * n), *(r.lower for r in rows)])
        high = np.concatenate([np.zeros(P * n), *(r.upper for r in rows)])
        found = solver(x0=start.ravel(), lbg=low, ubg=high)
        w, g, multipliers = (np.asarray(found[key], dtype=float).ravel() for key in ("x", "g", "lam_g"))
        self._refuse(str(solver.stats()["return_status"]), w, np.max(np.concatenate([low - g, g - high]), initial=0.0))
        after = multipliers[: P * n].reshape(P, n)
        mu = np.split(multipliers[P * n :], np.cumsum([len(r.names) for r in rows])[:-1])
        return w.reshape(P, self.nz), np.roll(after, 1, axis=0), list(mu)

    def _refuse(self, status: str, w: Array, off: float) -> None:
        """Raise ProblemError if the point is no orbit."""
        if status == "Diverging_Iterates" or not np.abs(w).max() < INFINITE:
            raise ProblemError(
                f"tune_periodic: the cost of '{self.name}' has no lower bound on its orbits; bound the states and "
                "controls by subject_to(), or check the sign of the cost"
            )
        if not off <= ADMISSIBLE:
            raise ProblemError(
                f"tune_periodic: '{self.name}' has no periodic operation of {len(self.stages)} intervals near the "
                f"guess (IPOPT: {status}, rows and gaps off by {off:.2g}); check the rows, or give a guess=(x, u)"
            )

    def polish(self, w: Array, lam: Array, mu: list[Array]) -> Orbit:
        """Apply Newton's method to the optimality conditions with the active rows as equations."""
        triples = zip(self.stages, w, mu, strict=True)
        held = [active_bounds(s.rows, np.asarray(s.values(p)[2], dtype=float).ravel(), m) for s, p, m in triples]
        mu = [np.where(np.isin(np.arange(len(m)), rows), m, 0.0) for m, (rows, _) in zip(mu, held, strict=True)]
        best, last, largest = (w, lam, mu), np.inf, 1.0
        for _ in range(NEWTON_STEPS):
            K, r, forces = self._system(w, lam, mu, held)
            size = float(np.abs(r).max()) / max(1.0, forces, float(np.abs(w).max()))
            if not size < last:
                break
            best, last, largest = (w, lam, [m.copy() for m in mu]), size, forces
            step = np.linalg.lstsq(K, -r, rcond=None)[0]
            w = w + step[: w.size].reshape(w.shape)
            lam = lam + step[w.size : w.size + lam.size].reshape(lam.shape)
            at = w.size + lam.size
            for m, (rows, _) in zip(mu, held, strict=True):
                m[list(rows)] += step[at : at + len(rows)]
                at += len(rows)
        over = max(self._excess(point, k) for k, point in enumerate(best[0]))
        if last > RESIDUAL or over > ADMISSIBLE:
            raise ProblemError(
                f"tune_periodic: the optimality conditions of the orbit of '{self.name}' are solved only to "
                f"{last:.2g}, its rows to {over:.2g}; are they singular, as where orbits may be shifted in time, or "
                "does the guess mislead?"
            )
        strict = []
        for stage, m in zip(self.stages, best[2], strict=True):
            equations = stage.rows.lower == stage.rows.upper
            strict.append(tuple(np.flatnonzero((np.abs(m) > STRICT * largest) | equations).tolist()))
        return Orbit(best[0], best[1], tuple(best[2]), tuple(strict), np.ones(self.nz))

    def _excess(self, point: Array, k: int) -> float:
        """Return the largest violation of the rows of an interval."""
        h, rows = np.asarray(self.stages[k].values(point)[2], dtype=float).ravel(), self.stages[k].rows
        return float(np.max(np.concatenate([h - rows.upper, rows.lower - h]), initial=0.0))

    def downhill(self, found: Orbit) -> Array:
        """Return a direction (P, nx + nu) of norm 1 with negative curvature of the Lagrangian on the orbits, else zero.

        Rows at their bounds are held, also those without a multiplier.
        """
        held = []
        for stage, point in zip(self.stages, found.w, strict=True):
            h = np.asarray(stage.values(point)[2], dtype=float).ravel()
            near = 1e-8 * np.maximum(1.0, np.abs(h))
            at = (np.abs(h - stage.rows.lower) <= near) | (np.abs(h - stage.rows.upper) <= near)
            held.append((tuple(np.flatnonzero(at).tolist()), h))
        K, _, _ = self._system(found.w, found.lam, [m.copy() for m in found.mu], held)
        size = found.w.size
        basis = scipy.linalg.null_space(K[size:, :size])
        if not basis.shape[1]:
            return np.zeros(found.w.shape)
        values, vectors = np.linalg.eigh(basis.T @ K[:size, :size] @ basis)
        if values[0] >= CURVED * np.abs(np.linalg.eigvalsh(K[:size, :size])).max():
            return np.zeros(found.w.shape)
        return np.asarray((basis @ vectors[:, 0]).reshape(found.w.shape))

    def _system(self, w: Array, lam: Array, mu: list[Array], held: list[Any]) -> tuple[Array, Array, float]:
        """Return matrix and right-hand side of the conditions, and the largest of the forces in their sums."""
        P, n, nz = len(self.stages), self.n, self.nz
        G, H, C, forces = np.zeros((P * n, P * nz)), [], [], 1.0
        slopes, gaps, excess = np.zeros((P, nz)), np.zeros((P, n)), []
        for k, (stage, point) in enumerate(zip(self.stages, w, strict=True)):
            Phi, _, h = (np.asarray(v, dtype=float).ravel() for v in stage.values(point))
            AB, gradient, J = (np.asarray(v, dtype=float) for v in stage.jacobians(point))
            following, (rows, bound) = (k + 1) % P, held[k]
            H.append(np.asarray(stage.hessian(point, lam[following], mu[k]), dtype=float))
            slopes[k] += gradient.ravel() + AB.T @ lam[following] + J.T @ mu[k]
            slopes[k, :n] -= lam[k]
            gaps[following] = Phi - w[following, :n]
            place = slice(following * n, following * n + n)
            G[place, k * nz : (k + 1) * nz] += AB
            G[place, following * nz : following * nz + n] -= np.eye(n)
            C.append(J[list(rows)].reshape(-1, nz))
            excess.append((h - bound)[list(rows)])
            forces = max(forces, float(np.abs(gradient).max()), float(np.abs(lam).max()))
        rows_of_all = np.vstack([G, scipy.linalg.block_diag(*C)])
        K = np.block([[scipy.linalg.block_diag(*H), rows_of_all.T], [rows_of_all, np.zeros((len(rows_of_all),) * 2)]])
        return K, np.concatenate([slopes.ravel(), gaps.ravel(), *excess]), forces
