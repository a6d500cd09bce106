"""tune() computes a constant positive definite Hessian for economic NMPC, once and off line.

    M = H + (Hcal(dP) + eta C'F C) / alpha,   M_f = H_f - (dP + eta D'G D) / alpha

H is the Hessian of the Lagrangian of the optimal steady state. Rotating the cost by a quadratic storage function (Hcal)
and adding squares of strictly active rows (C'F C) change neither the solution nor, at the steady state, the Hessian on
the null space of the dynamics and of those rows; so M keeps the fast convergence near the steady state.

Source: Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020), section IV, called [Z20] here.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from nmpc_codegen.economic.linear_quadratic import Frequency, LinearQuadratic, frequency_function, linear_quadratic
from nmpc_codegen.economic.semidefinite import ConvexityProof, Weights, convexify, scalings
from nmpc_codegen.economic.stage import SteadyStage, steady_stage
from nmpc_codegen.economic.stationary import SteadyState, solve_steady_state
from nmpc_codegen.economic.terminal import with_terminal_cost
from nmpc_codegen.errors import OptionError, ProblemError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.options import Options

if TYPE_CHECKING:
    from nmpc_codegen.components.base import Hessian


@dataclass(frozen=True, eq=False)
class Tuning:
    """A tuning is the result of tune(), in the units and order of the problem.

    Cyclic states have zero rows and columns.

    Attributes:
        problem: the problem.
        M: (nx+nu, nx+nu), the Hessian of a stage.
        M_f: (nx, nx), Hessian of the end; None if x_N is fixed.
        dP: (nx, nx), of the solution of the program; -dP / alpha is the storage.
        F: multiples of strictly active rows.
        G: multiples of strictly active rows at node N.
        alpha: factor of H in the program, by which its other terms are divided.
        beta: bound of the condition number of M in the scaling of the program.
        eta: 1 if strictly active rows could be used.
        H: (nx+nu, nx+nu), Hessian of the Lagrangian at the steady state.
        H_f: (nx, nx), Hessian of the Lagrangian of the end; None if x_N is fixed.
        A: (nx, nx), of the discrete map.
        B: (nx, nu), of the discrete map.
        C: (rows, nx+nu), slopes of the strictly active rows.
        D: (rows, nx), slopes of the rows that are strictly active at node N.
        x_s: (nx,), steady state.
        u_s: (nu,), control at the steady state.
        lam_s: (nx,), multipliers of the dynamics.
        mu_s: (rows,), multipliers of the strictly active rows, > 0 at the upper bound.
        nu_s: (rows,), multipliers of the rows of D.
        cost: cost of an interval at the steady state.
        active: names of the rows of C.
        active_terminal: names of the rows of D.
        names: names of states and controls.
        kept: states that are not cyclic.
        scaling: name of the scaling of the variables that succeeded.
        conditioning: condition number of M.
        dissipativity: the least value of the frequency function without rows, positive if a quadratic storage function
            exists without them.
        with_rows: the same for the frequency function on the strictly active rows.
    """

    problem: Problem
    M: Array
    M_f: Array | None
    dP: Array
    F: Array
    G: Array
    alpha: float
    beta: float
    eta: int
    H: Array
    H_f: Array | None
    A: Array
    B: Array
    C: Array
    D: Array
    x_s: Array
    u_s: Array
    lam_s: Array
    mu_s: Array
    nu_s: Array
    cost: float
    active: tuple[str, ...]
    active_terminal: tuple[str, ...]
    names: tuple[str, ...]
    kept: tuple[int, ...]
    scaling: str
    conditioning: float
    dissipativity: Frequency
    with_rows: Frequency

    @property
    def dissipative(self) -> bool:
        """Return True if the cost is strictly dissipative at the steady state even without strictly active rows."""
        return self.dissipativity.positive

    @property
    def storage(self) -> Array:
        """Return S = -dP / alpha of the storage function Lambda(x) = -lam_s'(x - x_s) + 1/2 (x - x_s)' S (x - x_s).

        The rotated cost l + Lambda(x) - Lambda(Phi) has the Hessian M on the null space of the strictly active rows.
        """
        return -self.dP / self.alpha

    def hessian(self) -> Hessian:
        """Return the component EconomicGaussNewton with this M, M_f and steady state."""
        module = import_module("nmpc_codegen.components.hessians.economic_gauss_newton")
        found: Hessian = module.EconomicGaussNewton(M=self.M, M_f=self.M_f, steady_state=(self.x_s, self.u_s))
        return found

    def __str__(self) -> str:
        """Return a table for readers."""
        w = np.concatenate([self.x_s, self.u_s])
        w[np.abs(w) < 1e-15 * np.abs(w).max()] = 0.0
        states = [f"  {name} = {value:.6g}" for name, value in zip(self.names, w, strict=True)]
        kept = np.flatnonzero(np.diag(self.M))
        values = np.linalg.eigvalsh(self.M[np.ix_(kept, kept)])
        end = "x_N is fixed, so there is no M_f"
        if self.M_f is not None:
            ends = np.linalg.eigvalsh(self.M_f[np.ix_(self.kept, self.kept)])
            end = f"M_f: eigenvalues {ends[0]:.3g} .. {ends[-1]:.3g}"
        rows = [f"  {name}: multiplier {mu:.4g}" for name, mu in zip(self.active, self.mu_s, strict=True)]
        return "\n".join(
            [
                f"economic tuning of {self.problem.name} (eta = {self.eta})",
                f"steady state, cost {self.cost:.8g} per interval:",
                *states,
                *(["strictly active rows:", *rows] if rows else ["no row is strictly active"]),
                f"H: eigenvalues {np.linalg.eigvalsh(self.H)[0]:.3g} .. {np.linalg.eigvalsh(self.H)[-1]:.3g}",
                f"M: eigenvalues {values[0]:.3g} .. {values[-1]:.3g}, condition number {self.conditioning:.4g}",
                end,
                f"alpha {self.alpha:.6g}, beta {self.beta:.4g}, w scaled by: {self.scaling}",
                f"dissipativity: {self.verdict}",
            ]
        )

    @property
    def verdict(self) -> str:
        """Return a sentence on dissipativity."""
        if self.dissipative:
            return f"strictly dissipative at the steady state (frequency function >= {self.dissipativity.least:.3g})"
        return (
            f"not strictly dissipative by itself (frequency function {self.dissipativity.least:.3g} at "
            f"{self.dissipativity.theta:.3g} rad), but on the strictly active rows ({self.with_rows.least:.3g})"
        )


def tune(
    ocp: OCP,
    options: Options | None = None,
    *,
    rho1: float = 1e-3,
    rho2: float = 1e-3,
    eta: int = 1,
    scaling: Any = "auto",
    guess: Any = None,
) -> Tuning:
    """Compute M and M_f of EconomicGaussNewton for a problem.

    Args:
        ocp: the problem, on a uniform grid; states that grow for ever are named by ocp.cyclic().
        options: its integrator defines the discrete map.
        rho1: penalty of |F|, the multiples of strictly active rows.
        rho2: penalty of |G|, the multiples of strictly active rows at node N.
        eta: 1: strictly active rows may be used; 0: the cost must be dissipative without them.
        scaling: "none", "curvature", "magnitude", or d (nx+nu,) for w / d; "auto": the first of them that succeeds.
        guess: (x, u) near the steady state; by default the initial state, and references or mid-ranges of controls.

    Raises:
        ProblemError: there is no steady state or no solution; the message says which condition fails.
        OptionError: an argument has a value that is not allowed.
        ExtraError: CVXPY or Clarabel is missing.
    """
    weights = Weights(rho1, rho2, eta)
    problem = with_terminal_cost(_classify(ocp, options), options)
    if not problem.uniform:
        raise ProblemError(f"tune: '{problem.name}' has intervals of different length, so no M is constant on its grid")
    stage = steady_stage(problem, options)
    steady = solve_steady_state(stage, guess)
    lq = linear_quadratic(stage, steady)
    without, with_rows = frequency_function(lq.without_rows()), frequency_function(lq)
    candidates = _candidates(stage, lq, steady, scaling)
    certificate, name = _solve(lq, weights, candidates, (without, with_rows))
    return _tuning(stage, steady, lq, certificate, name, weights.eta, (without, with_rows))


def steady_state(ocp: OCP, options: Options | None = None, guess: Any = None) -> SteadyState:
    """Return the optimal steady state and its multipliers: min l  s.t.  x = Phi(x, u) and the rows of the path.

    Cyclic states are left out; M is not computed.

    Args:
        ocp: the problem.
        options: their integrator defines the discrete map.
        guess: (x, u) near the steady state, as in tune().

    Raises:
        ProblemError: there is no steady state; the message says which condition fails.

    Examples:
        >>> from nmpc_codegen.economic import steady_state
        >>> [float(round(value, 6)) for value in steady_state(ocp).u]
        [0.05]
    """
    return solve_steady_state(steady_stage(_classify(ocp, options), options), guess)


def _classify(ocp: OCP, options: Options | None) -> Problem:
    if not isinstance(ocp, OCP):
        raise ProblemError(f"ocp: {type(ocp).__name__}; expected an OCP")
    if options is not None and not isinstance(options, Options):
        raise OptionError(f"options: {options!r}; expected Options(...) or None")
    return classify(ocp)


def _candidates(stage: SteadyStage, lq: LinearQuadratic, steady: SteadyState, scaling: Any) -> dict[str, Array]:
    known = scalings(lq, steady.w)
    if isinstance(scaling, str):
        if scaling not in (*known, "auto"):
            raise OptionError(f"tune: scaling={scaling!r}; expected one of auto, {', '.join(known)}, or an array")
        return known if scaling == "auto" else {scaling: known[scaling]}
    problem = stage.problem
    try:
        d = np.asarray(scaling, dtype=float)
    except (TypeError, ValueError):
        d = np.zeros(0)
    if d.shape != (problem.nx + problem.nu,) or not np.all(np.isfinite(d) & (d > 0)):
        raise OptionError(f"tune: scaling must be {problem.nx + problem.nu} positive numbers")
    return {"the given numbers": d[[*stage.kept, *range(problem.nx, len(d))]]}


def _solve(
    lq: LinearQuadratic, weights: Weights, candidates: dict[str, Array], frequency: tuple[Frequency, Frequency]
) -> tuple[ConvexityProof, str]:
    """Return the certificate of the first scaling for which the program is solved, and the name of that scaling."""
    decisive = frequency[weights.eta]
    statuses = {}
    for name, d in candidates.items():
        found = convexify(lq, weights, d)
        if isinstance(found, ConvexityProof):
            return found, name
        statuses[name] = found
        if not decisive.positive:
            break  # the frequency function confirms that no scaling helps
    if not decisive.positive:
        where = "on the strictly active rows " if weights.eta else ""
        hint = "add curvature to the cost, or integrate it with the dynamics"
        if not weights.eta and frequency[1].positive:
            hint = f"eta=1 uses the strictly active rows ({', '.join(lq.active)}), with which a solution exists"
        raise ProblemError(
            f"tune: no M exists for eta = {weights.eta}: the frequency function {where}is {decisive.least:.3g} at "
            f"{decisive.theta:.3g} rad per interval, but must be positive; {hint}"
        )
    failed = "; ".join(f"{name}: {status}" for name, status in statuses.items())
    alone = LinearQuadratic(lq.A, lq.B, lq.H, lq.C, size=lq.size)
    if lq.H_f is not None and any(
        isinstance(convexify(alone, weights, d), ConvexityProof) for d in candidates.values()
    ):
        raise ProblemError(
            "tune: M exists, but no positive definite M_f with it was found: the terminal cost bends too little or is "
            f"missing; state ocp.lqr_terminal_cost(economic=True) or fix x_N (solver: {failed})"
        )
    raise ProblemError(
        f"tune: the frequency function ({decisive.least:.3g} > 0) says that M exists, but the solver fails ({failed}); "
        "choose other units, or scaling= with the typical size of every state and control"
    )


def _tuning(
    stage: SteadyStage,
    steady: SteadyState,
    lq: LinearQuadratic,
    found: ConvexityProof,
    scaling: str,
    eta: int,
    frequency: tuple[Frequency, Frequency],
) -> Tuning:
    problem, kept = stage.problem, list(stage.kept)
    nx, nu = problem.nx, problem.nu
    both = [*kept, *range(nx, nx + nu)]

    def spread(matrix: Array, rows: list[int] | None, columns: list[int], shape: tuple[int, int]) -> Array:
        out = np.zeros(shape)
        out[np.ix_(range(shape[0]) if rows is None else rows, columns)] = matrix
        out.flags.writeable = False
        return out

    lam = np.zeros(nx)
    lam[kept] = steady.lam
    D = np.zeros((0, lq.n)) if lq.D is None else lq.D
    slope = ca.Function("V", [stage.x], [ca.gradient(stage.terminal_cost, stage.x)])(steady.x).full().ravel()
    values = np.linalg.eigvalsh(found.M)
    return Tuning(
        problem=problem,
        M=spread(found.M, both, both, (nx + nu, nx + nu)),
        M_f=None if found.M_f is None else spread(found.M_f, kept, kept, (nx, nx)),
        dP=spread(found.dP, kept, kept, (nx, nx)),
        F=found.F,
        G=found.G,
        alpha=found.alpha,
        beta=found.beta,
        eta=eta,
        H=spread(lq.H, both, both, (nx + nu, nx + nu)),
        H_f=None if lq.H_f is None else spread(lq.H_f, kept, kept, (nx, nx)),
        A=spread(lq.A, kept, kept, (nx, nx)),
        B=spread(lq.B, kept, list(range(nu)), (nx, nu)),
        C=spread(lq.C, None, both, (len(lq.C), nx + nu)),
        D=spread(D, None, kept, (len(D), nx)),
        x_s=stage.full(steady.x),
        u_s=steady.u,
        lam_s=lam,
        mu_s=steady.mu[list(steady.active)],
        nu_s=np.linalg.lstsq(D.T, steady.lam - slope, rcond=None)[0],
        cost=steady.cost,
        active=lq.active,
        active_terminal=lq.active_terminal,
        names=(*problem.state_names, *problem.control_names),
        kept=stage.kept,
        scaling=scaling,
        conditioning=float(values[-1] / values[0]),
        dissipativity=frequency[0],
        with_rows=frequency[1],
    )
