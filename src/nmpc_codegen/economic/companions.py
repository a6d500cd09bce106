"""Companions of an economic cost are locally equivalent tracking, plain tracking, and rotation by a storage function.

    LETEMPC   1/2 (w - w_s)' M (w - w_s) - mu_s' C (w - w_s)
    tracking  1/2 (w - w_s)' W (w - w_s)
    rotation  l + Lambda(x) - Lambda(Phi(x, u)),   V_f + Lambda   ("map")
              J + Lambda(x_0)                                     ("nodes": l_k + Lambda(x_k) - Lambda(x_{k+1}))

The two rotations have the same solutions. They differ on gaps, where Phi(x_k, u_k) is not x_{k+1}: SQP iterates with a
Hessian that does not depend on multipliers are those of the original problem for "nodes" with any storage function, and
for "map" only if Lambda is linear. On the nodes the sum collapses to Lambda(x_0).

Sources: Zanon, Gros and Diehl, "A tracking MPC formulation that is locally equivalent to economic MPC", Journal of
Process Control 45 (2016), and its periodic variant, IFAC World Congress 2017; Zanon, "A Gauss-Newton-like Hessian
approximation for economic NMPC" (2020), section III.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.economic.convex_hessian import Tuning
from nmpc_codegen.economic.periodic import PeriodicTuning
from nmpc_codegen.economic.stage import tableau
from nmpc_codegen.errors import OptionError, ProblemError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.options import Options
from nmpc_codegen.oracle.trajectory import interval_map


def letempc_cost(tuning: Tuning, x: Any, u: Any) -> Expression:
    """Return the stage cost of LETEMPC, for ocp.stage_cost(..., scale_with_dt=False).

    Its linear term balances the economic cost against the strictly active rows; without it the cost is not equivalent.

    Args:
        tuning: M and what belongs to it.
        x: symbols (nx,).
        u: symbols (nu,).

    Returns:
        An expression, a scalar.
    """
    dw = ca.vertcat(x, u) - np.concatenate([tuning.x_s, tuning.u_s])
    quadratic = ca.dot(dw, ca.DM(tuning.M) @ dw) / 2
    return ca.SX(quadratic - ca.dot(tuning.C.T @ tuning.mu_s, dw))


def letempc_terminal_cost(tuning: Tuning, x: Any) -> Expression:
    """Return 1/2 (x - x_s)' M_f (x - x_s) - nu_s' D (x - x_s), for ocp.terminal_cost().

    Args:
        tuning: M and what belongs to it.
        x: symbols (nx,).

    Raises:
        ProblemError: the tuning has no M_f, because x_N is fixed.
    """
    if tuning.M_f is None:
        raise ProblemError("letempc_terminal_cost: x_N is fixed, so there is no terminal cost")
    dx = x - tuning.x_s
    return ca.SX(ca.dot(dx, ca.DM(tuning.M_f) @ dx) / 2 - ca.dot(tuning.D.T @ tuning.nu_s, dx))


def periodic_letempc(tuning: PeriodicTuning, ocp: OCP) -> Callable[[int], dict[str, Array]]:
    """Give an OCP without a cost the least-squares cost of LETEMPC along an orbit.

        1/2 |R_k (w - c_k)|^2,   R_k'R_k = M_k,   c_k = w_k + M_k^-1 C_k' mu_k,   1/2 |R_N (x_N - c_N)|^2

    R_k and c_k become the online parameters letempc_factor and letempc_centre; R_N and c_N, of the cost-to-go, the
    parameters letempc_end_factor and letempc_end_centre of node N. c_k makes a square of the quadratic term of LETEMPC
    and of its linear one, the pull against the strictly active rows.

    Args:
        tuning: the orbit.
        ocp: the problem, with dynamics and rows.

    Returns:
        A function that gives the values of the four parameters, one row per node, for the plan of sample n:
            ``for name, values in at(n).items(): controller.set_parameter(name, values)``.
    """
    if not isinstance(tuning, PeriodicTuning):
        raise ProblemError(f"periodic_letempc: {type(tuning).__name__}; expected the result of tune_periodic()")
    sizes = (int(ocp.x.numel()), int(ocp.u.numel()))
    if sizes != (tuning.x.shape[1], tuning.u.shape[1]):
        raise ProblemError(
            f"periodic_letempc: '{ocp.name}' has {sizes[0]} states and {sizes[1]} controls; the tuning is that of "
            f"'{tuning.problem.name}' with {tuning.x.shape[1]} and {tuning.u.shape[1]}"
        )
    nz, nx = tuning.M.shape[1], tuning.x.shape[1]
    w = np.hstack([tuning.x, tuning.u])
    pull = [C.T @ mu for C, mu in zip(tuning.C, tuning.mu, strict=True)]
    centres = w + np.array([np.linalg.solve(M, g) for M, g in zip(tuning.M, pull, strict=True)])
    tables = {
        "letempc_factor": _columns(np.linalg.cholesky(tuning.M).transpose(0, 2, 1)),
        "letempc_centre": centres,
        "letempc_end_factor": _columns(np.linalg.cholesky(tuning.cost_to_go()).transpose(0, 2, 1)),
        "letempc_end_centre": tuning.x,
    }
    factor, centre, end, goal = (
        ocp.parameter(name, size=table.shape[1], value=table[0].tolist()) for name, table in tables.items()
    )
    ocp.least_squares(ca.reshape(factor, nz, nz) @ (ca.vertcat(ocp.x, ocp.u) - centre), weight=np.ones(nz))
    ocp.terminal_least_squares(ca.reshape(end, nx, nx) @ (ocp.x - goal), weight=np.ones(nx))
    _check_fit(tuning, classify(ocp))
    N = ocp.N

    def at(sample: int) -> dict[str, Array]:
        nodes = (sample + np.arange(N + 1)) % tuning.period
        return {name: table[nodes] for name, table in tables.items()}

    return at


def _check_fit(tuning: PeriodicTuning, here: Problem) -> None:
    """Raise ProblemError if the problem differs from that of the orbit, or already has a cost."""
    there = tuning.problem
    signals = [(*p.state_names, *p.control_names) for p in (here, there)]
    if signals[0] != signals[1]:
        raise ProblemError(f"periodic_letempc: '{here.name}' has {signals[0]}; expected {signals[1]}, as tuned")
    if not here.uniform or not np.isclose(here.dt[0], there.dt[0]):
        raise ProblemError(f"periodic_letempc: '{here.name}' has intervals of {here.dt[0]:g}; expected {there.dt[0]:g}")
    general = {"general cost", "integrated cost"} & here.uses
    if general or (here.path.ny, here.terminal.ny) != (len(signals[0]), here.nx):
        raise ProblemError(f"periodic_letempc: '{here.name}' has a cost already; state it without one")


def _columns(matrices: NDArray[Any]) -> Array:
    """Return matrices (P, n, n) as rows (P, n n), column by column, as CasADi reads them."""
    return np.asarray(matrices.transpose(0, 2, 1).reshape(len(matrices), -1))


def tracking_cost(tuning: Tuning, x: Any, u: Any, weight: Any) -> Expression:
    """Return 1/2 (w - w_s)' W (w - w_s) at the economic steady state.

    Args:
        tuning: the result of tune().
        x: symbols (nx,).
        u: symbols (nu,).
        weight: W (nx+nu, nx+nu) or its diagonal.
    """
    dw = ca.vertcat(x, u) - np.concatenate([tuning.x_s, tuning.u_s])
    W = np.asarray(weight, dtype=float)
    W = np.diag(W) if W.ndim == 1 else W
    if W.shape != (len(tuning.names), len(tuning.names)):
        raise ProblemError(f"tracking_cost: weight has shape {W.shape}, expected ({len(tuning.names)},) or its square")
    return ca.SX(ca.dot(dw, ca.DM(W) @ dw) / 2)


def rotate(
    ocp: OCP, storage: Callable[[Any], Any], options: Options | None = None, *, on: str = "map", sign: float = 1.0
) -> None:
    """Add the terms of a rotation to the cost of an OCP.

    Args:
        ocp: the problem, with its dynamics, on a uniform grid.
        storage: Lambda, from an SX column (nx,) to an SX scalar.
        options: its integrator defines Phi.
        on: "map" or "nodes".
        sign: -1 undoes a rotation: a tracking cost becomes an economic one with the same solutions.

    Raises:
        OptionError: ``on`` is another word.
        ProblemError: the grid is not uniform, or the storage function is no scalar.
    """
    if on not in ("map", "nodes"):
        raise OptionError(f"rotate: on={on!r}; expected 'map' or 'nodes'")
    if on == "nodes":
        ocp.start_cost(sign * storage(ocp.x))
        return
    problem = classify(ocp)
    problem.refuse_augmented("rotate")
    if not problem.uniform:
        raise ProblemError(f"rotate: '{problem.name}' has intervals of different length; use on='nodes'")
    scheme = tableau(problem, options)
    if scheme.implicit:
        raise ProblemError(f"rotate: the map of '{problem.name}' is that of an implicit scheme; use on='nodes'")
    Phi, _ = interval_map(problem, scheme)(ocp.x, ocp.u, ocp.p, problem.dt[0])
    ocp.stage_cost(sign * (storage(ocp.x) - storage(Phi)), scale_with_dt=False)
    ocp.terminal_cost(sign * storage(ocp.x))
