"""IPOPT solves the optimal control problem as a nonlinear program: the oracle of --check, tests and benchmarks.

The method is direct multiple shooting in CasADi, implemented independently of the code generator. trajectory.py defines
the signs of multipliers and the data of the nodes, and computes the KKT residuals of a solution without IPOPT.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.ir.casadi_types import part
from nmpc_codegen.oracle.trajectory import (
    CLASSICAL,
    Data,
    Point,
    Residuals,
    Tableau,
    evaluate_cost,
    interval_map,
    kkt_residuals,
    multiplier_of,
    node_cost,
    node_data,
    node_rows,
    node_values,
    row_nodes,
    scaled_weight,
    shape_of,
    stage_equations,
    stage_start,
    start_cost,
    with_maps,
)

__all__ = [
    "CLASSICAL",
    "Data",
    "Point",
    "Reference",
    "ReferenceSolution",
    "Residuals",
    "Tableau",
    "control_start",
    "evaluate_cost",
    "interval_map",
    "kkt_residuals",
    "node_data",
    "solve_reference",
]


@dataclass(frozen=True, eq=False)
class ReferenceSolution(Point):
    """A reference solution comes from IPOPT."""

    cost: float
    success: bool
    status: str
    iterations: int
    residuals: Residuals = field(repr=False)


# The nonlinear program ------------------------------------------------------------------------------------------------

#: Statuses of IPOPT at a solution if round-off prevents it from reaching its tolerance.
_AT_ROUND_OFF = frozenset({"Search_Direction_Becomes_Too_Small", "Solved_To_Acceptable_Level", "Restoration_Failed"})


class Reference:
    """A reference is the nonlinear program of a problem, built once and solved for any data.

    Args:
        problem: the problem.
        integrator: Runge-Kutta tableau as plain arrays; discrete maps ignore it. The stages of an implicit scheme are
            variables, and their equations are rows of the program.
        tol: tolerance of IPOPT.
    """

    def __init__(self, problem: Problem, integrator: Tableau = CLASSICAL, *, tol: float = 1e-12) -> None:
        self.problem, self.integrator = problem, integrator
        nx, nu, N = problem.nx, problem.nu, problem.N
        self._x = [ca.MX.sym(f"x_{k}", nx) for k in range(N + 1)]
        self._u = [ca.MX.sym(f"u_{k}", nu) for k in range(N)]
        self._slack: list[Any] = []
        self._g: list[Any] = []
        self._general: list[tuple[int, int, int]] = []  # (row, node, slack side: 0 none, -1 lower, 1 upper) of g
        self._data = _symbolic_data(problem)
        self._increments: list[Any] = []
        self._rest: list[Any] = []
        self._starts: list[Array] = []
        self._p = [self._values(k) for k in range(N + 1)]
        implicit = integrator.implicit and not problem.discrete
        Phi = self._implicit_interval() if implicit else interval_map(problem, integrator)
        cost = self._cost_and_dynamics(Phi)
        cost += self._add_rows()
        z = ca.vertcat(*self._x, *self._u, *self._slack, *self._increments)
        self._g += self._rest
        small = implicit or N * Phi.n_instructions() < 50_000
        options: dict[str, Any] = {
            "print_time": False,
            "expand": small,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "tol": tol,
                "constr_viol_tol": tol,
                "compl_inf_tol": tol,
                "bound_relax_factor": 0.0,
                "acceptable_iter": 0,
                "max_iter": 1000,
                "fixed_variable_treatment": "make_constraint",
            },
        }
        nlp = {"x": z, "p": self._data.stacked, "f": cost, "g": ca.vertcat(*self._g)}
        self._solver = ca.nlpsol("reference", "ipopt", nlp, options)

    def _values(self, k: int) -> Any:
        """Return the values that expressions of node k use for p.

        Algebraic variables on which the expressions depend become variables of the NLP.
        """
        problem, algebra, p = self.problem, self.problem.algebra, self._data.p[k]
        stage = problem.path if k < problem.N else problem.terminal
        if algebra is None or not problem.solved:
            return p
        z = ca.MX.sym(f"z_{k}", algebra.size)
        terms = ca.veccat(ca.SX(0, 1), stage.y, stage.h, *(c for c in (stage.cost, stage.ties) if c is not None))
        if not ca.depends_on(terms, part(stage.p, problem.np)):
            return node_values(p, ca.MX.zeros(algebra.size))
        x = self._x[k]
        u = self._u[k] if k < problem.N else ca.vertcat(*problem.controls_before(ca.vertsplit(x)))
        self._add(z, algebra.equations(x, u, p, z), algebra.first)
        return node_values(p, z)

    def _add(self, variables: Any, rest: Any, start: Array) -> None:
        """Add variables with their equations and initial values."""
        self._increments.append(variables)
        self._rest.append(rest)
        self._starts.append(start)

    def _implicit_interval(self) -> Any:
        """Return (x, u, p, dt) -> (x_next, q) in the increments of the stages, which become variables."""
        problem, steps = self.problem, self.integrator.steps
        equations = stage_equations(problem, self.integrator)

        def interval(x: Any, u: Any, p: Any, dt: Any) -> tuple[Any, Any]:
            end, q = x, ca.MX(0)
            for _ in range(steps):
                v = ca.MX.sym("D", equations.size1_in(0))
                rest, end, more = equations(v, end, u, p, dt / steps)
                self._add(v, rest, stage_start(problem, self.integrator))
                q = q + more
            return with_maps(problem, end, x, u, p, dt), q

        return interval

    def _cost_and_dynamics(self, Phi: Any) -> Any:
        problem, d = self.problem, self._data
        node, node_N = node_cost(problem.path), node_cost(problem.terminal)
        given = [i for i in range(problem.nx) if i not in problem.free_initial]
        self._g.append(ca.vertcat(ca.MX(0, 1), *(d.x0[i] - self._x[0][i] for i in given)))
        cost = node_N(self._x[-1], ca.MX(0, 1), self._p[-1], 0, d.yref_N, d.W_N)
        cost += start_cost(problem)(self._x[0], d.p[0])
        for k in range(problem.N):
            x_next, q = Phi(self._x[k], self._u[k], d.p[k], problem.dt[k])
            self._g.append(x_next - self._x[k + 1])
            cost += q + node(self._x[k], self._u[k], self._p[k], problem.dt[k], d.yref[k], d.W[k])
        return cost

    def _add_rows(self) -> Any:
        """Append general and soft rows to g and return the penalty of the slacks."""
        problem = self.problem
        h, h_N, N = node_rows(problem.path), node_rows(problem.terminal), problem.N
        path = [h(self._x[k], self._u[k], self._p[k]) for k in range(N)]
        end = h_N(self._x[N], ca.MX(0, 1), self._p[N])
        coupled: Any = None if problem.coupled is None else problem.coupled(self._x[0], self._x[N])
        penalty: Any = 0
        for i, row in enumerate(problem.rows):
            if row.soft is None and row.variable(problem.nx) is not None:
                continue
            for k in row_nodes(row):
                value = row.value(self._x[k], None, end if k == N else path[k], coupled, k == N)
                soft = row.penalty(k, problem.dt)
                if soft is None:
                    self._g.append(value)
                    self._general.append((i, k, 0))
                    continue
                s = ca.MX.sym("s", 2)
                self._slack.append(s)
                self._g.extend((value + s[0], value - s[1]))
                self._general.extend(((i, k, -1), (i, k, 1)))
                penalty += ca.sum1(soft[0] * s + soft[1] / 2 * s * s)
        return penalty

    def solve(self, data: Data, *, x: Any = None, u: Any = None) -> ReferenceSolution:
        """Solve for the given data.

        Args:
            data: see node_data().
            x: initial guess (N+1, nx) or (nx,); by default x_k = x0.
            u: initial guess (N, nu) or (nu,); by default the control reference, or 0 without one.
        """
        problem = self.problem
        lbx, ubx, lbg, ubg = self._bounds(data)
        x_guess = shape_of("x", data.x0 if x is None else x, (problem.N + 1, problem.nx))
        u_guess = shape_of("u", control_start(problem, data) if u is None else u, (problem.N, problem.nu))
        more = np.concatenate([np.zeros(2 * len(self._slack)), *self._starts])
        found = self._solver(
            x0=np.concatenate([x_guess.ravel(), u_guess.ravel(), more]),
            p=self._data.values(problem, data),
            lbx=lbx,
            ubx=ubx,
            lbg=lbg,
            ubg=ubg,
        )
        return self._solution(found, data)

    def _bounds(self, data: Data) -> tuple[Array, Array, Array, Array]:
        problem = self.problem
        N, nx, nu = problem.N, problem.nx, problem.nu
        count = (N + 1) * nx + N * nu
        lbx = np.concatenate([np.full(count, -np.inf), np.zeros(2 * len(self._slack))])
        lbx = np.concatenate([lbx, np.full(sum(D.numel() for D in self._increments), -np.inf)])
        ubx = np.full(lbx.size, np.inf)
        for i, row in enumerate(problem.rows):
            place = row.variable(nx)
            if row.soft is None and place is not None:
                for k in row.nodes:
                    at = k * nx + place if place < nx else (N + 1) * nx + k * nu + place - nx
                    lbx[at], ubx[at] = data.lower[k, i], data.upper[k, i]
        gaps = N * nx + nx - len(problem.free_initial)
        low, high = [0.0] * gaps, [0.0] * gaps
        for i, k, side in self._general:
            low.append(-np.inf if side > 0 else data.lower[k, i])
            high.append(np.inf if side < 0 else data.upper[k, i])
        stages = np.zeros(sum(rest.numel() for rest in self._rest))
        return lbx, ubx, np.concatenate([low, stages]), np.concatenate([high, stages])

    def _solution(self, found: Mapping[str, Any], data: Data) -> ReferenceSolution:
        problem = self.problem
        N, nx, nu = problem.N, problem.nx, problem.nu
        split = (N + 1) * nx, (N + 1) * nx + N * nu
        z, lam_z, lam_g = (found[key].full().ravel() for key in ("x", "lam_x", "lam_g"))
        free = len(problem.free_initial)
        lam = np.zeros((N + 1, nx))
        lam[0, [i for i in range(nx) if i not in problem.free_initial]] = lam_g[: nx - free]
        lam[1:] = lam_g[nx - free : nx - free + N * nx].reshape(N, nx)
        point = Point(
            x=z[: split[0]].reshape(N + 1, nx),
            u=z[split[0] : split[1]].reshape(N, nu),
            lam=lam,
            mu_x=lam_z[: split[0]].reshape(N + 1, nx).copy(),
            mu_u=lam_z[split[0] : split[1]].reshape(N, nu).copy(),
            mu=np.zeros((N, problem.path.nh)),
            mu_N=np.zeros(problem.terminal.nh),
            eta=np.zeros(problem.coupled_rows),
        )
        first = nx - free + N * nx
        of_rows = lam_g[first : first + len(self._general)]
        for (i, k, _), multiplier in zip(self._general, of_rows, strict=True):
            where, index = multiplier_of(problem, point, problem.rows[i], k)
            where[index] += multiplier
        residuals = kkt_residuals(problem, point, data, self.integrator)
        stats = self._solver.stats()
        status = str(stats["return_status"])
        scale = max(1.0, float(np.abs(point.lam).max(initial=0.0)))
        success = bool(stats["success"]) or (status in _AT_ROUND_OFF and residuals.worst <= 1e-9 * scale)
        return ReferenceSolution(
            **vars(point),
            cost=float(found["f"]),
            success=success,
            status=status,
            iterations=int(stats["iter_count"]),
            residuals=residuals,
        )


@dataclass(frozen=True, eq=False)
class _Symbols:
    """The data are symbols of the nonlinear program."""

    x0: Any
    p: list[Any]
    yref: list[Any]
    yref_N: Any
    W: list[Any]
    W_N: Any

    @property
    def stacked(self) -> Any:
        parts = [self.x0, *self.p, *self.yref, self.yref_N, *self.W, self.W_N]
        return ca.vertcat(*(ca.vec(part) for part in parts))

    @staticmethod
    def values(problem: Problem, data: Data) -> Array:
        """Return the numbers in the order of ``stacked``.

        As W is symmetric, row-major and column-major order are equal.
        """
        W = [scaled_weight(problem, data.W[k], k).ravel() for k in range(problem.N)]
        return np.concatenate(
            [data.x0, data.p.ravel(), data.yref.ravel(), data.yref_N, *W, data.W_N.ravel()], dtype=float
        )


def _symbolic_data(problem: Problem) -> _Symbols:
    N, ny, ny_N = problem.N, problem.path.ny, problem.terminal.ny
    sym = ca.MX.sym
    return _Symbols(
        x0=sym("x0", problem.nx),
        p=[sym(f"p_{k}", problem.np) for k in range(N + 1)],
        yref=[sym(f"yref_{k}", ny) for k in range(N)],
        yref_N=sym("yref_N", ny_N),
        W=[sym(f"W_{k}", ny, ny) for k in range(N)],
        W_N=sym("W_N", ny_N, ny_N),
    )


def control_start(problem: Problem, data: Data) -> Array:
    """Return the controls of the initial plan, (N, nu): where their residuals have their references, or 0."""
    hidden = np.full(problem.solved, np.nan)
    nodes = zip(data.p, data.yref, strict=False)
    u = np.array([np.asarray(problem.control_start(np.concatenate([p, hidden]), y)).ravel() for p, y in nodes])
    return np.where(np.isfinite(u), u, 0.0)


def solve_reference(
    problem: Problem,
    integrator: Tableau = CLASSICAL,
    *,
    tol: float = 1e-12,
    x_guess: Any = None,
    u_guess: Any = None,
    **data: Any,
) -> ReferenceSolution:
    """Build the nonlinear program and solve it once; ``data`` as in node_data() (x0, p, yref, ..., bounds)."""
    return Reference(problem, integrator, tol=tol).solve(node_data(problem, **data), x=x_guess, u=u_guess)
