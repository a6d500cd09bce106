"""The QPs of closed loops, read from the solver struct of a prepared controller as data of the independent oracle."""

from __future__ import annotations

from typing import Any

import numpy as np

from nmpc_codegen.frontend.problem import Problem
from verification.oracles.stage_qp import Array, Rows, Shape, StageQP


def rows_of_problem(problem: Problem) -> Rows:
    """QP rows besides the control bounds, from the statement of the problem."""
    node, kind, index, user = (np.array([r[i] for r in problem.qp_rows], dtype=int) for i in range(4))
    soft = [problem.rows[i].soft for i in user]
    l1 = np.array([np.inf if p is None else p[0] for p in soft])
    l2 = np.array([0.0 if p is None else p[1] for p in soft])
    return Rows(node, kind, index, user, l1, l2)


def read_qp(problem: Problem, struct: Any, xhat: Array, plan: tuple[Array, Array] | None = None) -> StageQP:
    """The QP of the next feedback(xhat), from the struct of a controller after prepare(), in double precision.

    Bounds have to be stored "shared" (one pair for the path, one for node N) or "node". ``plan``: the prepared
    (x, u), if the struct now holds another plan.
    """
    N, nx, nu = problem.N, problem.nx, problem.nu
    node, terminal, hessian = struct["node"], struct["terminal"], struct["hessian"]
    rows = rows_of_problem(problem)
    x, u = plan or (struct["x"].copy(), struct["u"].copy())
    lower, upper = (_at_nodes(struct[name], N) for name in ("lower", "upper"))
    C, c = np.zeros((len(rows), nx + nu)), np.zeros(len(rows))
    C0 = np.zeros((len(rows), nx))
    for m, (k, kind, i) in enumerate(zip(rows.node, rows.kind, rows.index, strict=True)):
        if kind == 0:
            C[m, i], c[m] = 1.0, x[k, i]
        elif kind == 2:
            C0[m], C[m, :nx], c[m] = struct["coupled"]["J_0"][i], struct["coupled"]["J_N"][i], struct["coupled"]["r"][i]
        elif k == N:
            C[m, :nx], c[m] = terminal["J"][i], terminal["h"][i]
        else:
            C[m], c[m] = node["J"][k, i], node["h"][k, i]
    Q = hessian["Q"] + np.tril(hessian["Q"], -1).transpose(0, 2, 1) - np.triu(hessian["Q"], 1)
    Q_N = np.tril(hessian["Q_N"]) + np.tril(hessian["Q_N"], -1).T
    lower_u, upper_u = np.full((N, nu), -np.inf), np.full((N, nu), np.inf)
    for i, row in enumerate(problem.rows):
        if row.kind == "control":
            lower_u[:, row.index], upper_u[:, row.index] = lower[:N, i], upper[:N, i]
    return StageQP(
        shape=Shape(nx, nu, N), rows=rows, S=node["S"].copy(), b=node["b"].copy(),
        Q=np.broadcast_to(Q, (N, nx + nu, nx + nu)).copy(), Q_N=Q_N, g=node["g"].copy(), g_N=terminal["g"].copy(),
        C=C, C0=C0, c=c, lower=lower[rows.node, rows.user], upper=upper[rows.node, rows.user],
        lower_u=lower_u, upper_u=upper_u, x=x, u=u, dx0=np.asarray(xhat, dtype=float) - x[0], optimum=None, proof=None,
        unit_x=np.ones(nx), unit_u=np.ones(nu), kind=problem.name,
    )  # fmt: skip


def _at_nodes(values: Array, N: int) -> Array:
    """(N+1, rows) of bounds that are stored for the path and for the end, or for every node."""
    return values.copy() if len(values) == N + 1 else np.vstack([np.repeat(values[:1], N, axis=0), values[1:]])
