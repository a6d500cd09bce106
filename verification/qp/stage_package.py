"""A package can hold any stage QP: every matrix is a parameter of a real controller, with one value per node.

    x_{k+1} = S_k z_k + b_k,   cost sum_k 1/2 z_k'Q_k z_k + g_k'z_k,   rows lower <= c_k + C_k z_k <= upper,  z = (x, u)

At the plan x = 0, u = 0 the linearisation of that problem is the problem itself, to the last bit. So the QP of a sample
is known exactly, and its answer is the plan that an application gets: control, states, multipliers.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import (
    OCP,
    Controller,
    ExactHessian,
    Online,
    Options,
    Status,
)
from nmpc_codegen.package.struct_layout import Precision
from verification.oracles.stage_qp import Array, Point, Shape, StageQP, rows_of
from verification.routes import PURE, ROUTES

#: Condensing and QP solver with their default options, by name.
SOLVERS = {name: ROUTES[name] for name in ("dense", "riccati", "interior")}

SCALARS: dict[Precision, type[np.floating[Any]]] = {"double": np.float64, "single": np.float32}


def options(solver: str, precision: Precision) -> Options:
    """Return options with which the solver receives the QP unchanged: no regularisation, own bounds at every node."""
    condensing, qp = SOLVERS[solver]
    return Options(
        hessian=ExactHessian(regularization=None), condensing=condensing, qp=qp, online=Online(bounds="node"),
        precision=precision, algorithm=PURE,
    )  # fmt: skip


def parameter_sizes(shape: Shape) -> dict[str, int]:
    """Return the sizes of the parameters of a node, in their order."""
    nx, nz = shape.nx, shape.nx + shape.nu
    return {
        "dynamics": nx * nz, "offset": nx, "hessian": nz * (nz + 1) // 2, "gradient": nz,
        "rows": shape.path * nz, "values": shape.path, "end_rows": shape.end * nx, "end_values": shape.end,
    }  # fmt: skip


#: Scales, and declared values of cost data. They are small, so that no drawn number counts as 0.
SMALL = {"gradient": 1e-10, "hessian": 1e-10, "rows": 1.0, "end_rows": 1.0}
SCALE = 1e-8


def stage_ocp(shape: Shape) -> OCP:
    """Return the problem of a shape; all controls are bounded, and the first ``states`` states at the nodes 1 .. N."""
    nx, nz = shape.nx, shape.nx + shape.nu
    ocp = OCP("stages", N=shape.N)
    x, u = ocp.state("x", size=nx, scale=SCALE), ocp.control("u", size=shape.nu, scale=SCALE)
    z = ca.vertcat(x, u)
    sizes = {name: size for name, size in parameter_sizes(shape).items() if size}
    p = {name: ocp.parameter(name, size=size, value=SMALL.get(name, 0.0)) for name, size in sizes.items()}
    ocp.dynamics(ca.reshape(p["dynamics"], nz, nx).T @ z + p["offset"], discrete=True)
    lower = ca.SX(ca.Sparsity.lower(nz), p["hessian"])
    Q, g = lower + lower.T - ca.diag(ca.diag(lower)), p["gradient"]
    ocp.stage_cost(ca.bilin(Q, z, z) / 2 + ca.dot(g, z))
    ocp.terminal_cost(ca.bilin(Q[:nx, :nx], x, x) / 2 + ca.dot(g[:nx], x))
    ocp.subject_to(-1, u, 1, name="control")
    if shape.states:
        ocp.subject_to(-1, x[: shape.states], 1, name="state")
    if shape.path:
        ocp.subject_to(-1, ca.reshape(p["rows"], nz, shape.path).T @ z + p["values"], 1, name="path")
    if shape.end:
        ocp.subject_to(-1, ca.reshape(p["end_rows"], nx, shape.end).T @ x + p["end_values"], 1, at="end", name="end")
    return ocp


def rounded(qp: StageQP, precision: Precision) -> StageQP:
    """Return the QP in the numbers that a solver of this precision gets, as doubles."""
    kind = SCALARS[precision]
    data = ("S", "b", "Q", "Q_N", "g", "g_N", "C", "c", "lower", "upper", "lower_u", "upper_u", "dx0")
    with np.errstate(over="ignore"):
        return dataclasses.replace(qp, **{name: getattr(qp, name).astype(kind).astype(float) for name in data})


def parameters(qp: StageQP) -> Array:
    """Return the values of all parameters, (N + 1, np)."""
    shape, rows = qp.shape, qp.rows
    N, nx = shape.N, shape.nx
    nz = nx + shape.nu
    sizes = parameter_sizes(shape)
    starts = dict(zip(sizes, np.cumsum([0, *sizes.values()]), strict=False))
    p = np.zeros((N + 1, sum(sizes.values())))

    def part(name: str, nodes: slice, value: Array) -> None:
        p[nodes, starts[name] : starts[name] + value.shape[-1]] = value

    path, end = slice(0, N), slice(N, N + 1)
    columns, lines = np.triu_indices(nz)  # of the lower triangle, column by column
    part("dynamics", path, qp.S.reshape(N, -1))
    part("offset", path, qp.b)
    part("hessian", path, qp.Q[:, lines, columns])
    last = np.zeros((nz, nz))
    last[:nx, :nx] = qp.Q_N
    part("hessian", end, last[lines, columns])
    part("gradient", path, qp.g)
    part("gradient", end, qp.g_N)
    general = rows.kind == 1
    on_path, at_end = general & (rows.node < N), general & (rows.node == N)
    if shape.path:
        part("rows", path, qp.C[on_path].reshape(N, -1))  # rows are sorted by node, then by index
        part("values", path, qp.c[on_path].reshape(N, -1))
    if shape.end:
        part("end_rows", end, qp.C[at_end, :nx].reshape(1, -1))
        part("end_values", end, qp.c[at_end].reshape(1, -1))
    return p


@dataclasses.dataclass(frozen=True, eq=False)
class Answer:
    """An answer is the result of a sample: its status, the plan, the multipliers of the dynamics, QP iterations."""

    status: Status
    point: Point
    lam: Array
    iterations: int


def write(controller: Controller, qp: StageQP) -> None:
    """Write the QP and a zero plan into a controller, so that the QP of the next sample is ``qp``."""
    shape, rows = qp.shape, rows_of(qp.shape)
    controller.view("p")[...] = parameters(qp)
    lower, upper = controller.view("lower"), controller.view("upper")
    for bounds, of_u, of_rows in ((lower, qp.lower_u, qp.lower), (upper, qp.upper_u, qp.upper)):
        bounds[:-1, : shape.nu] = of_u
        bounds[rows.node, shape.nu + rows.user] = of_rows
    controller.x[:] = 0.0
    controller.u[:] = 0.0


def answer(controller: Controller, qp: StageQP) -> Answer:
    """Run one sample with this QP, from the working set of the previous sample."""
    write(controller, qp)
    controller.step(qp.dx0)
    c = controller
    mult = c.member("mult").astype(float)
    point = Point(c.x.astype(float), c.u.astype(float), c.mu_u.astype(float), mult)
    return Answer(c.status, point, c.lam.astype(float), c.stats.qp_iterations)
