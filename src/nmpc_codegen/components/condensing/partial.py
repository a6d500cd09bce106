"""Partial condensing: every block of intervals becomes one stage of the QP.

dx_{kB+j} = G_j (dx_kB, du_kB, ..., du_{kB+B-1}) + c_j,   j = 0 .. B
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from nmpc_codegen.components.allowed import Whole, check_options, option
from nmpc_codegen.components.base import EVERY_USE, Condensing, Counts, Dims, QpShape, Seam, StageMatrices
from nmpc_codegen.components.condensing.stage_rows import copied_states, embed_cost, stage_tables
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.struct_layout import Field, Struct


@dataclass(frozen=True)
class PartialCondensing(Condensing):
    """Eliminate all states but every block-th: ceil(N / block) stages with block nu controls each.

    Args:
        block: intervals of a stage, at most as many as the horizon has; a shorter last block is padded with controls
            that stay 0.
    """

    block: int = option(2, Whole())

    name: ClassVar[str] = "partial"
    template: ClassVar[str] = "condensing/partial.c"
    needs: ClassVar[tuple[Seam, ...]] = ("hessian", "qp")
    gives: ClassVar[str] = "stages"
    columns: ClassVar[bool] = False
    eliminates: ClassVar[bool] = True
    supports: ClassVar[frozenset[str]] = EVERY_USE

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    def _block(self, N: int) -> int:
        return min(self.block, N)

    @property
    def label(self) -> str:
        return f"{self.name}({self.block})"

    def qp_shape(self, problem: Problem) -> QpShape:
        """ceil(N / block) stages, each with the controls of a block."""
        block = self._block(problem.N)
        stages = -(-problem.N // block)
        return QpShape(stages, block * problem.nu, stages * block * problem.nu, copies=len(copied_states(problem)))

    def adds(self, features: Features) -> Features:
        """Whether a state bound may be a general row of a stage."""
        return replace(features, block_rows=True)

    def adapt(self, problem: Problem) -> PartialCondensing:
        """Itself: it handles every problem with features that it supports."""
        return self

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Positions of the rows in the stages."""
        return stage_tables(problem, self._block(problem.N))

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """The length of a block."""
        return (("BLOCK", self._block(dims.N.value), "intervals of a stage of the QP"),)

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """The stages of the QP, and the states inside a block as functions of its variables."""
        nx, nxs, nzs = dims.nx, dims.qp.nxs, dims.qp.nzs
        return (
            Struct(
                "block",
                "stage of the QP",
                (
                    Field("S", (nxs, nzs), "[A B] of the block", "data"),
                    Field("b", (nxs,), "gap", "data"),
                    Field("g", (nzs,), "gradient", "data"),
                    Field("Q", (nzs, nzs), "Hessian, lower triangle", "data"),
                ),
                shape=(dims.qp.ns,),
            ),
            Struct(
                "blocks",
                "states inside a block, and the rows",
                (
                    Field("G", (dims.N, nx, nzs), "dx_{kB+j} = G_j (dx_kB, du) + c_j of every node", "scratch"),
                    Field("c", (dims.N, nx), "c_j of every node", "scratch"),
                    Field("Z", (dims.nz, nzs), "[G_j; selection of du]", "scratch"),
                    Field("J", (dims.ng, nzs), "gradients of the rows", "data"),
                    Field("Q_N", (nxs, nxs), "Hessian of the last stage, lower triangle", "data"),
                    Field("g_N", (nxs,), "gradient of the last stage", "data"),
                    Field("v", (dims.ng,), "values of the rows at dx_kB = 0, du = 0", "data"),
                ),
            ),
        )

    def cost(self, dims: Dims, model: StageMatrices) -> Counts:
        """All operations except those on gradients and values of the rows."""
        N, nx, nxs, nu, nz = (size.value for size in (dims.N, dims.nx, dims.qp.nxs, dims.nu, dims.nz))
        block = self._block(N)
        forward, hessian = OpCount(), OpCount()
        for k in range(N):
            width = nxs + (k % block) * nu
            products = nx * nx * width
            forward += OpCount(add=products, mul=products)
            width += nu
            products = nz * nz * width + nz * width * (width + 1) // 2
            hessian += OpCount(add=products, mul=products)
        return {
            "condense_matrices": forward + hessian,
            "condense_embed": embed_cost(dims),
            "condense_expand": model.products.state_step * N,
        }
