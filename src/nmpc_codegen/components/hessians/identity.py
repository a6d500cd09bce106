"""The identity as Hessian: steepest descent on the condensed problem, for comparisons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from nmpc_codegen.components.base import Counts, Defaults, Dims, Integrator, Seam
from nmpc_codegen.components.stage_cost import StageCosts
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Field, Struct
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.model import Block, HessianModel, ModelFunctions, operations
from nmpc_codegen.ir.stage_products import pattern


@dataclass(frozen=True)
class IdentityHessian(Defaults):
    """Q_k = I, Q_N = I, for any cost; if the iterations converge, they converge like steepest descent."""

    seam: ClassVar[Seam] = "hessian"
    name: ClassVar[str] = "identity"
    template: ClassVar[str] = "hessians/identity.c"
    needs: ClassVar[tuple[Seam, ...]] = ("integrator",)
    supports: ClassVar[frozenset[str]] = frozenset(
        {"soft rows", "coupled rows", "free initial state", "general cost", "integrated cost", "accumulators"}
    )

    def blocks(self, problem: Problem, costs: StageCosts, integrator: Integrator) -> HessianModel:
        """The constant blocks; the start cost does not contribute."""
        path, terminal = _identity("path", problem.nx + problem.nu), _identity("terminal", problem.nx)
        return HessianModel(None, Block(pattern(path, "Q"), path), Block(pattern(terminal, "Q"), terminal))

    @property
    def switches(self) -> Mapping[str, int]:
        """The Hessian is never indefinite, so nothing is regularised."""
        return {"REGULARIZE_REDUCED": 0, "REGULARIZE_STAGES": 0, "NODE_KERNELS": 1}

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Hessian blocks, lower triangles in the order z = (x, u)."""
        fields = (
            Field("Q", (dims.nq, dims.nz, dims.nz), "path block, the same for all nodes", "data"),
            Field("Q_N", (dims.nx, dims.nx), "terminal block", "data"),
        )
        return (Struct("hessian", "Hessian blocks, lower triangles, z = (x, u)", fields),)

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        """No operations, since the blocks are constant."""
        return {"hessian": operations(model.path.hessian) * dims.nq.value + operations(model.terminal.hessian)}


def _identity(stage: str, n: int) -> Kernel:
    return lift(ca.Function("identity", [], [ca.SX.eye(n)]), f"{stage}_hessian", "Q = I", (), (Port("Q", n, n),))
