"""Full condensing in O(N^2): eliminates dx_1 .. dx_N, keeps dx_0 apart.

    dx_k = G_k (dx_0, du_0, ..., du_{N-1}) + c_k

Columns are propagated forward, one backward sweep per column forms the lower triangle of the condensed Hessian
(algorithms.md 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nmpc_codegen.cmodule import Field, Size, Struct
from nmpc_codegen.component import PANEL, Dims
from nmpc_codegen.kernel import OpCount
from nmpc_codegen.problem import Problem
from nmpc_codegen.sweep import Routine


def _panels(width: int) -> int:
    return -(-width // PANEL) * PANEL


@dataclass(frozen=True)
class FullCondensing:
    """Eliminate all states but the first; the QP has N nu variables."""

    seam: ClassVar[str] = "condensing"
    name: ClassVar[str] = "full"
    template: ClassVar[str] = "condensing/full.c.jinja"
    needs: ClassVar[tuple[str, ...]] = ("hessian", "qp")
    supports: ClassVar[frozenset[str]] = frozenset({"general cost"})

    def routines(self, problem: Problem) -> tuple[Routine, ...]:
        return ()

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("LDG", _panels(dims.nx.value + dims.nv.value), "columns of G_k: NX + NV, rounded up to PANEL"),)

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Sensitivities of the condensed states and what the feedback phase needs."""
        ldg = Size("LDG", _panels(dims.nx.value + dims.nv.value))
        nodes = Size("N + 1", dims.N.value + 1)
        return (
            Struct(
                "condensed",
                "dx_k = G_k (dx_0, du) + c_k and the condensed QP's dependence on dx_0",
                (
                    Field("G", (nodes, dims.nx, ldg), "columns: dx_0, then du_0 .. du_{N-1}", "data"),
                    Field("c", (nodes, dims.nx), "free response of the gaps b_k", "data"),
                    Field("W", (Size("2", 2), dims.nx, ldg), "W_k of the backward sweep", "scratch"),
                    Field("T", (dims.nu, ldg), "one block row of the condensed Hessian", "scratch"),
                    Field("g", (dims.nv,), "condensed gradient at dx_0 = 0", "data"),
                    Field("Hx", (dims.nv, dims.nx), "coupling of the controls to dx_0", "data"),
                    Field("Ax", (dims.ng, dims.nx), "coupling of the rows to dx_0", "data"),
                    Field("v", (dims.ng,), "values of the rows at du = 0, dx_0 = 0", "data"),
                    Field("dx", (nodes, dims.nx), "step of the states", "result"),
                ),
            ),
        )

    def cost(self, dims: Dims) -> dict[str, OpCount]:
        """Multiplications and additions of condense_hessian and condense_gradient, padding to PANEL included."""
        N, nx, nu = dims.N.value, dims.nx.value, dims.nu.value
        hessian = OpCount()
        for k in range(N):
            forward, backward = _panels(nx + k * nu), _panels(nx + (k + 1) * nu)
            hessian += OpCount(add=1, mul=1) * (nx * nx * forward)
            hessian += OpCount(add=1, mul=1) * (2 * nx * nu * backward)
            if k > 0:
                hessian += OpCount(add=1, mul=1) * (2 * nx * nx * _panels(nx + k * nu))
            hessian += OpCount(add=nu * (nu + 1) // 2)
        hessian += OpCount(add=1, mul=1) * (nx * nx * _panels(nx + N * nu))
        per_node = nx * nx + 2 * nx * nu
        gradient = OpCount(add=1, mul=1) * (N * (per_node + 2 * nx * nx) + nx * nx - (2 * nx * nx))
        return {"condense_hessian": hessian, "condense_gradient": gradient}
