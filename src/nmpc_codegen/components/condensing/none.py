"""No condensing: the QP keeps the stages of the problem, for solvers that exploit them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nmpc_codegen.components.base import EVERY_USE, Condensing, Counts, Dims, QpShape, Seam, StageMatrices
from nmpc_codegen.components.condensing.partial import PartialCondensing
from nmpc_codegen.components.condensing.stage_rows import copied_states, embed_cost, stage_tables
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table


@dataclass(frozen=True)
class NoCondensing(Condensing):
    """Every shooting interval is a stage of the QP; nothing is eliminated, memory and time are linear in N."""

    name: ClassVar[str] = "none"
    template: ClassVar[str] = "condensing/none.c"
    needs: ClassVar[tuple[Seam, ...]] = ("hessian", "qp")
    gives: ClassVar[str] = "stages"
    columns: ClassVar[bool] = False
    eliminates: ClassVar[bool] = False
    supports: ClassVar[frozenset[str]] = EVERY_USE

    @property
    def label(self) -> str:
        return self.name

    def qp_shape(self, problem: Problem) -> QpShape:
        """N stages, each with the controls of one interval."""
        return QpShape(problem.N, problem.nu, problem.N * problem.nu)

    def adapt(self, problem: Problem) -> NoCondensing | PartialCondensing:
        """Itself, or PartialCondensing(1) if the stages need copies of components of x_0, which it can hold."""
        return PartialCondensing(1) if copied_states(problem) else self

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Positions of the rows in the stages."""
        return stage_tables(problem, 1)

    def cost(self, dims: Dims, model: StageMatrices) -> Counts:
        """Computing bounds relative to the iterate; all other data are copied."""
        return {"condense_embed": embed_cost(dims)}
