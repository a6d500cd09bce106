"""tune_periodic() computes positive definite Hessians along the best periodic operation, once and off line.

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
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmpc_codegen.components.integrators import ImplicitRungeKutta
from nmpc_codegen.decisions.integrator import integrator_of
from nmpc_codegen.economic.linear_quadratic import LinearQuadratic
from nmpc_codegen.economic.orbit import Orbit, solve_orbit
from nmpc_codegen.economic.semidefinite import Weights, convexify_period
from nmpc_codegen.economic.stage import SteadyStage, steady_stage
from nmpc_codegen.economic.stationary import start_point
from nmpc_codegen.errors import OptionError, ProblemError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.options import Options


@dataclass(frozen=True, eq=False, repr=False)
class PeriodicTuning:
    """A periodic tuning has an orbit of P intervals and its Hessians, in the units of the problem.

    Attributes:
        problem: the problem.
        x: (P, nx), states.
        u: (P, nu), controls.
        lam: (P, nx), multipliers of the dynamics.
        mu: P arrays, multipliers of the strictly active rows.
        active: names of the strictly active rows.
        M: (P, nx+nu, nx+nu), Hessians of LETEMPC.
        H: (P, nx+nu, nx+nu), Hessians of the Lagrangian.
        A: (P, nx, nx), of the discrete map.
        B: (P, nx, nu), of the discrete map.
        C: P arrays, slopes of the strictly active rows.
        dP: (P, nx, nx), solution of the program, which defines the storage function.
        alpha: factor of H in the program, by which its other terms are divided.
        beta: bound of the condition number of M in the scaling of the program.
        cost: mean cost of an interval.
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
        """Return the number of intervals P."""
        return len(self.M)

    def __str__(self) -> str:
        """Return a table for readers."""
        names = (*self.problem.state_names, *self.problem.control_names)
        w = np.hstack([self.x, self.u])
        spans = [f"  {name}: {v.min():.6g} .. {v.max():.6g}" for name, v in zip(names, w.T, strict=True)]
        every = sorted({row for rows in self.active for row in rows})
        held = [f"  {row}: in {sum(row in rows for rows in self.active)} intervals" for row in every]
        H, M = np.linalg.eigvalsh(self.H), np.linalg.eigvalsh(self.M)
        return "\n".join(
            [
                f"periodic tuning of {self.problem.name}, {self.period} intervals",
                f"orbit, mean cost {self.cost:.8g} per interval:",
                *spans,
                *(["strictly active rows:", *held] if held else ["no row is strictly active"]),
                f"H_k: eigenvalues {H.min():.3g} .. {H.max():.3g}",
                f"M_k: eigenvalues {M.min():.3g} .. {M.max():.3g}",
                f"alpha {self.alpha:.6g}, beta {self.beta:.4g}",
            ]
        )

    def cost_to_go(self, periods: int = 50) -> Array:
        """Return S (P, nx, nx): the Riccati recursion of A, B, M around the orbit, without rows.

        It runs over the given number of periods.
        """
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
        guess: (x (P, nx), u (P, nu)) near the orbit; by default the initial state, and references or mid-ranges of
            controls.

    Raises:
        ProblemError: there are cyclic states or unequal intervals, no orbit is found, or there are no such M_k.
        OptionError: an argument has a value that is not allowed.
        ExtraError: CVXPY or Clarabel is missing.
    """
    weights = Weights(rho1, eta=eta)
    if not isinstance(ocp, OCP):
        raise ProblemError(f"ocp: {type(ocp).__name__}; expected an OCP")
    if options is not None and not isinstance(options, Options):
        raise OptionError(f"options: {options!r}; expected Options(...) or None")
    problem = classify(ocp)
    if not problem.uniform or problem.cyclic:
        what = "has cyclic states" if problem.cyclic else "has intervals of different length"
        raise ProblemError(
            f"tune_periodic: '{problem.name}' {what}; expected a uniform grid and an orbit of all states"
        )
    chosen = integrator_of(problem, options or Options())
    if isinstance(chosen, ImplicitRungeKutta):
        raise ProblemError(
            f"tune_periodic: the map of '{problem.name}' is that of an implicit scheme; expected an explicit one "
            "that is stable: Options(integrator=ExplicitRungeKutta(steps=...))"
        )
    values = _parameters(problem, parameters, period)
    fixed = replace(options or Options(), integrator=chosen)
    stages = [steady_stage(problem, fixed, p) for p in values]
    return _tune(problem, stages, solve_orbit(stages, _guess(stages, guess)), weights)


def _tune(problem: Problem, stages: Sequence[SteadyStage], orbit: Orbit, weights: Weights) -> PeriodicTuning:
    """Return the Hessians along an orbit."""
    w, n = orbit.w, problem.nx
    period = [_expansion(stage, orbit, k) for k, stage in enumerate(stages)]
    found = convexify_period(period, weights, orbit.size)
    if isinstance(found, str):
        rows = "" if weights.eta else "; eta=1 uses the strictly active rows"
        raise ProblemError(
            f"tune_periodic: no positive definite M_k were found along the orbit of '{problem.name}' (solver: "
            f"{found}): it is not strictly dissipative there; add curvature to the cost, or integrate it with the "
            f"dynamics{rows}"
        )
    return PeriodicTuning(
        problem=problem,
        x=w[:, :n],
        u=w[:, n:],
        lam=orbit.lam,
        mu=tuple(m[list(rows)] for m, rows in zip(orbit.mu, orbit.active, strict=True)),
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


def _expansion(stage: SteadyStage, orbit: Orbit, k: int) -> LinearQuadratic:
    """Return A, B, H and C of an interval."""
    n, point, active = stage.nx, orbit.w[k], list(orbit.active[k])
    AB, _, J = (np.asarray(v, dtype=float) for v in stage.jacobians(point))
    H = np.asarray(stage.hessian(point, orbit.lam[(k + 1) % len(orbit.w)], orbit.mu[k]), dtype=float)
    names = tuple(stage.rows.names[i] for i in active)
    return LinearQuadratic(AB[:, :n], AB[:, n:], (H + H.T) / 2, J[active].reshape(-1, len(point)), active=names)


def _parameters(problem: Problem, given: Any, period: int | None) -> Array:
    """Return the values (P, np)."""
    count = len(problem.p_value)
    if (given is None) == (period is None):
        raise OptionError("tune_periodic: expected either parameters=, one row per interval, or period=, a number")
    if period is not None:
        if isinstance(period, bool) or not isinstance(period, (int, np.integer)) or period < 1:
            raise OptionError(f"tune_periodic: period={period!r}; expected an integer >= 1")
        return np.tile(problem.p_value, (int(period), 1))
    if not count:
        raise OptionError(f"tune_periodic: '{problem.name}' has no parameters; give period= instead of parameters=")
    try:
        found = np.array(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise OptionError(f"tune_periodic: parameters={given!r}; expected numbers of shape (P, {count})") from error
    found = found[:, None] if found.ndim == 1 and count == 1 else found
    if found.ndim != 2 or found.shape[1] != count or not len(found):
        raise OptionError(f"tune_periodic: parameters of shape {found.shape}; expected (P, {count})")
    if not np.all(np.isfinite(found)):
        row, column = np.argwhere(~np.isfinite(found))[0]
        raise OptionError(
            f"tune_periodic: parameters[{row}, {column}] is {found[row, column]}; expected finite numbers"
        )
    return found


def _guess(stages: Sequence[SteadyStage], guess: tuple[Any, Any] | None) -> Array:
    """Return w (P, nx + nu)."""
    problem, period, sizes = stages[0].problem, len(stages), (stages[0].nx, stages[0].problem.nu)
    if guess is None:
        return np.tile(start_point(stages[0]), (period, 1))
    try:
        parts = [np.asarray(v, dtype=float).reshape(period, n) for v, n in zip(guess, sizes, strict=True)]
    except (TypeError, ValueError) as error:
        shapes = f"({period}, {problem.nx}) and ({period}, {problem.nu})"
        raise OptionError(f"tune_periodic: guess={guess!r}; expected (x, u) of shapes {shapes}") from error
    if not all(np.all(np.isfinite(part)) for part in parts):
        raise OptionError("tune_periodic: guess= has NaN or Inf; expected finite numbers")
    return np.hstack(parts)
