"""Without condensing, the QP keeps the stages of the problem, for solvers that exploit them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nmpc_codegen.components.base import USES_OF_STAGES, Condensing, Counts, Dims, QpShape, Seam, StageMatrices
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.package.opcount import OpCount


@dataclass(frozen=True)
class NoCondensing(Condensing):
    """Every shooting interval is a stage of the QP; nothing is eliminated, and memory and time are linear in N."""

    name: ClassVar[str] = "none"
    template: ClassVar[str] = "condensing/none.c"
    needs: ClassVar[tuple[Seam, ...]] = ("hessian", "qp")
    gives: ClassVar[str] = "stages"
    supports: ClassVar[frozenset[str]] = USES_OF_STAGES

    def qp_shape(self, problem: Problem) -> QpShape:
        """Return the shape of the QP, with the controls of all intervals as variables."""
        return QpShape(problem.N * problem.nu, problem.N * problem.nu)

    def cost(self, dims: Dims, model: StageMatrices) -> Counts:
        """Count two bounds per control and row relative to the iterate, and J_0 dx_0 of the coupled rows."""
        rows, coupled = dims.N * dims.nu + dims.ng, dims.ne * dims.nx
        return {"condense_embed": OpCount(add=2 * rows + coupled, mul=coupled)}
