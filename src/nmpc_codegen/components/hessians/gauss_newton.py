"""The Gauss-Newton Hessian approximates that of least-squares costs.

    l = 1/2 (y - yref)' W (y - yref),   gradient J' W (y - yref),   Hessian J' W J,   J = dy / d(x, u)

(Houska, Ferreau and Diehl, Automatica 47, 2011, section 2.2). Only the lower triangle of the Hessian is formed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from nmpc_codegen.components.base import EVERY_USE, Counts, Dims, Hessian, Integrator
from nmpc_codegen.components.hessians.exact import MAX_SWEEPS
from nmpc_codegen.components.stage_cost import StageCost, StageCosts
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Kernel, Port
from nmpc_codegen.ir.model import Block, HessianModel, ModelFunctions, operations
from nmpc_codegen.ir.stage_products import pattern
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Struct


@dataclass(frozen=True)
class GaussNewton(Hessian):
    """The Gauss-Newton Hessian of a least-squares cost is H = sum_k J_k' W_k J_k, J_k the Jacobian of the residual.

    For every general row, mu_i d2 h_i is added if it is positive semidefinite, with the multipliers of the last QP;
    without this term, steps do not converge with discs and other convex rows. If the user states this Hessian, solve()
    uses it, too; if the compiler chooses it, solve() may have the exact one.
    """

    name: ClassVar[str] = "gauss_newton"
    template: ClassVar[str] = "hessians/gauss_newton.c"
    supports: ClassVar[frozenset[str]] = EVERY_USE - {"general cost", "integrated cost"}

    def blocks(self, problem: Problem, costs: StageCosts, integrator: Integrator) -> HessianModel:
        """Return J' W J of every stage and, as a separate routine, second derivatives of rows times multipliers."""
        start = self._block(costs.start)
        path = self._block(costs.path, bool(problem.proximal))
        return HessianModel(start.hessian, path, self._block(costs.terminal))

    def _block(self, cost: StageCost, diagonal: bool = False) -> Block:
        Q = ca.sparsify(cost.gauss_newton)
        if diagonal:  # stored as zeros, to which samples add proximal terms
            Q = ca.project(Q, Q.sparsity().unite(ca.Sparsity.diag(cost.nz)))
        # nonzeros of the rows only are stored as zeros, to which add_rows() adds
        Q = ca.project(Q, Q.sparsity().unite(cost.curvature.sparsity()))
        kernel = cost.kernel("hessian", "Q = J' W J, lower triangle", Q, Port("Q", cost.nz, cost.nz))
        curvature = self._curvature(cost) if cost.curvature.nnz() else None
        return Block(pattern(kernel, "Q"), kernel, curvature)

    def _curvature(self, cost: StageCost) -> Kernel:
        doc = "M = sum_i mu_i d2 h_i, lower triangle"
        return cost.kernel("curvature", doc, cost.curvature, Port("M", cost.nz, cost.nz), mu=True)

    def adds(self, features: Features) -> Features:
        """Return the features of a Hessian that is never indefinite, so that nothing is regularised."""
        return replace(features, node_kernels=True)

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """Return the sizes of the decomposition of blocks, used if samples add the curvature of active rows."""
        return (
            ("LANES", 1, "blocks that are decomposed at once"),
            ("MAX_SWEEPS", MAX_SWEEPS, "sweeps of Jacobi rotations"),
        )

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the struct of the Hessian blocks, lower triangles in the order z = (x, u)."""
        return (
            Struct(
                "hessian",
                "Hessian blocks, lower triangles, z = (x, u)",
                (
                    Field("Q", (dims.nq, dims.nz, dims.nz), "path blocks; one for all nodes if it is constant", "data"),
                    Field("Q_N", (dims.nx, dims.nx), "terminal block", "data", only=_has_terminal_block),
                ),
            ),
        )

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        """Count all blocks that hessian() forms; with the curvature of rows, the count depends on the data."""
        if model.path.curvature or model.terminal.curvature:
            return {}
        return {"hessian": operations(model.path.hessian) * dims.nq + operations(model.terminal.hessian)}


def _has_terminal_block(features: Features) -> bool:
    """Return False if the terminal block is zero and the fully condensed QP does not copy it."""
    return features.terminal_block or features.stage_multipliers or features.has("terminal_exact")
