"""Gauss-Newton Hessian of least-squares costs.

    l = 1/2 (y - yref)' W (y - yref),   gradient J' W (y - yref),   Hessian J' W J,   J = dy / d(x, u)

([H11] section 2.2, algorithms.md 3). Only the lower triangle of the Hessian is formed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from nmpc_codegen.components.allowed import Flag, Number, check_options, option
from nmpc_codegen.components.base import Counts, Defaults, Dims, Integrator, Seam
from nmpc_codegen.components.hessians.stage_cost import weight_matrix
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.cmodule import Field, Struct
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.model import ModelFunctions, QuadraticModel, StageModel, operations
from nmpc_codegen.ir.stage_products import pattern


@dataclass(frozen=True)
class GaussNewton(Defaults):
    """Gauss-Newton Hessian; ``levenberg_marquardt`` >= 0 is added to its diagonal.

    ``convex_rows`` adds sum_i mu_i d2 h_i of the general rows at every node where it is positive semidefinite, with the
    multipliers of the last QP: discs and other convex rows need it to converge.
    """

    convex_rows: bool = option(False, Flag())
    levenberg_marquardt: float = option(0.0, Number(closed=True))

    seam: ClassVar[Seam] = "hessian"
    name: ClassVar[str] = "gauss_newton"
    template: ClassVar[str] = "hessians/gauss_newton.c"
    needs: ClassVar[tuple[Seam, ...]] = ()
    supports: ClassVar[frozenset[str]] = frozenset({"soft rows", "coupled rows", "free initial state", "accumulators"})

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    def quadratic_model(self, problem: Problem, integrator: Integrator) -> QuadraticModel:
        """cost, gradient and hessian of the path and of the terminal stage; least squares live at the nodes."""
        return QuadraticModel(self._stage(problem.path, "path"), self._stage(problem.terminal, "terminal"))

    def _stage(self, stage: Stage, name: str) -> StageModel:
        z = ca.vertcat(stage.x, stage.u)
        nz, ny = int(z.numel()), stage.ny
        yref, W, weight, nw = ca.SX.sym("yref", ny), *weight_matrix(stage)
        residual = stage.y - yref
        J = ca.jacobian(stage.y, z) if ny else ca.SX(0, nz)
        weighted = weight @ residual
        hessian = ca.sparsify(ca.tril(J.T @ weight @ J + self.levenberg_marquardt * ca.DM.eye(nz)))
        mu = ca.SX.sym("mu", stage.nh)
        curvature = ca.sparsify(ca.tril(ca.hessian(ca.dot(mu, stage.h), z)[0])) if stage.nh else ca.SX(nz, nz)
        if self.convex_rows:  # entries that only the rows have are stored as zeros, for add_rows() to add to
            hessian = ca.project(hessian, hessian.sparsity().unite(curvature.sparsity()))
        terminal = not stage.nu
        args = [stage.x, stage.p] if terminal else [stage.x, stage.u, stage.p, stage.dt]
        ports = [Port("x", stage.nx), Port("p", int(stage.p.numel()))]
        if not terminal:
            ports = [ports[0], Port("u", stage.nu), ports[1], Port("dt", 1)]
        Wp = Port("W", nw, doc="diagonal of the weight" if stage.diagonal_weight else "weight, row-major")
        yp = Port("yref", ny)

        def kernel(
            suffix: str, doc: str, more: list[Expression], more_ports: list[Port], value: Expression, out: Port
        ) -> Kernel:
            return lift(ca.Function(suffix, args + more, [value]), f"{name}_{suffix}", doc, ports + more_ports, [out])

        gradient = ca.sparsify(J.T @ weighted) if ny else ca.SX(nz, 1)
        cost = ca.dot(residual, weighted) / 2 if ny else ca.SX(1, 1)
        value, slope, block = (
            kernel("cost", "l = 1/2 (y - yref)' W (y - yref)", [yref, W], [yp, Wp], cost, Port("l", 1)),
            kernel("gradient", "g = J' W (y - yref)", [yref, W], [yp, Wp], gradient, Port("g", nz)),
            kernel("hessian", "Q = J' W J, lower triangle", [W], [Wp], hessian, Port("Q", nz, nz)),
        )
        model = StageModel(value, slope, pattern(block, "Q"), block)
        if not self.convex_rows:
            return model
        function = ca.Function("curvature", [*args[: 2 if terminal else 3], mu], [curvature])
        doc = "M = sum_i mu_i d2 h_i, lower triangle"
        curved = [*ports[: 2 if terminal else 3], Port("mu", stage.nh)]
        return replace(model, curvature=lift(function, f"{name}_curvature", doc, curved, [Port("M", nz, nz)]))

    @property
    def switches(self) -> Mapping[str, int]:
        """Whether the curvature of rows is added; the Hessian is never indefinite."""
        return {"CONVEX_ROWS": int(self.convex_rows), "REGULARIZE_REDUCED": 0, "REGULARIZE_STAGES": 0}

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Hessian blocks, lower triangles in the order z = (x, u)."""
        return (
            Struct(
                "hessian",
                "Hessian blocks, lower triangles, z = (x, u)",
                (
                    Field(
                        "Q", (dims.nq, dims.nz, dims.nz), "path blocks; one for all nodes where it is constant", "data"
                    ),
                    Field("Q_N", (dims.nx, dims.nx), "terminal block", "data"),
                ),
            ),
        )

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        """All blocks that hessian() forms; with convex rows the count depends on the data."""
        if self.convex_rows:
            return {}
        return {"hessian": operations(model.path.hessian) * dims.nq.value + operations(model.terminal.hessian)}
