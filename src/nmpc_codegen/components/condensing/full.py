"""Full condensing in O(N^2) eliminates dx_1 .. dx_N and keeps the dependence on dx_0 separate.

    dx_k = G_k (dx_0, du_0, ..., du_{N-1}) + c_k

The columns of G_k are propagated forward panel by panel, and a backward sweep forms the lower triangle of the condensed
Hessian.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nmpc_codegen.components.base import EVERY_USE, Condensing, Counts, Dims, QpShape, Seam, StageMatrices
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.tuning import COLUMNS
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.struct_layout import Field, Size, Struct


def _panels(width: int) -> int:
    return -(-width // COLUMNS) * COLUMNS


def _slacks(problem: Problem) -> tuple[int, ...]:
    """Return for every QP row the variable that is its slack, or -1; rows with a quadratic penalty have one."""
    first = len(_variables(problem)) + len(problem.free_initial)
    soft = [problem.rows[row].soft for _, _, _, row in problem.qp_rows]
    needs = [penalty is not None and penalty[1] > 0 for penalty in soft]
    return tuple(first + sum(needs[:m]) if need else -1 for m, need in enumerate(needs))


def _variables(problem: Problem) -> list[tuple[int, int]]:
    """Return (node, control) of every control that is a variable of the QP, which begins a block."""
    starts, held = problem.node_data, problem.augmentation.held
    return [(k, j) for k in range(problem.N) for j in range(problem.nu) if j not in held or starts[k, held.index(j)]]


def _columns(dims: Dims) -> int:
    """Return the number of columns of G_k: dx_0 and all controls."""
    return dims.nx - dims.banded + dims.qp.nvu


@dataclass(frozen=True)
class FullCondensing(Condensing):
    """All states except the first are eliminated; the QP has N nu variables and the free components of x_0."""

    name: ClassVar[str] = "full"
    template: ClassVar[str] = "condensing/full.c"
    needs: ClassVar[tuple[Seam, ...]] = ("hessian", "qp")
    gives: ClassVar[str] = "condensed"
    supports: ClassVar[frozenset[str]] = EVERY_USE

    def qp_shape(self, problem: Problem) -> QpShape:
        """Return the shape of the QP, with the controls, the free components of x_0 and the slacks as variables."""
        controls, slacks = len(_variables(problem)), sum(s >= 0 for s in _slacks(problem))
        return QpShape(controls, controls + len(problem.free_initial) + slacks, slacks)

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Return the slack variable of every row."""
        slacks, variables = _slacks(problem), _variables(problem)
        controls = [(k, j) for k in range(problem.N) for j in range(problem.nu)]
        places = tuple(variables.index(at) if at in variables else -1 for at in controls)
        return (
            Table("row_slack", "int", slacks, "slack variable of QP row m, or -1"),
            Table("control_variable", "int", places, "QP variable of control j of node k, or -1"),
            Table("variable_node", "int", tuple(k for k, _ in variables), "node of a control in the QP"),
        )

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        zero = ": all but those of the last states, which are 0"
        return (
            ("COLUMNS", COLUMNS, "columns of G_k that are processed together"),
            ("NXC", dims.nx - dims.banded, f"columns of dx_0{zero if dims.banded else ''}"),
            ("LDG", _panels(_columns(dims)), "columns of G_k: NXC + NVU, rounded up to COLUMNS"),
        )

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs for sensitivities of the condensed states, and for data of the feedback phase."""
        panel, nodes = Size("COLUMNS", COLUMNS), dims.nodes
        return (
            Struct(
                "columns",
                "a panel of columns of dx_k = G_k (dx_0, du) + c_k, while the QP is formed",
                (
                    Field("G", (nodes, dims.nx, panel), "columns of G_0 .. G_N", "scratch"),
                    Field("W", (dims.nx, panel), "W_k of the backward sweep", "scratch"),
                    Field("T", (dims.nu, panel), "one block row of the condensed Hessian", "scratch"),
                ),
            ),
            Struct(
                "work",
                "memory of phases that never overlap",
                (Field("columns", (), "while the QP is formed", "scratch", "columns"),),
                union=True,
            ),
            Struct(
                "condensed",
                "the condensed QP's dependence on dx_0",
                (
                    Field("c", (nodes, dims.nx), "free response of the gaps b_k", "data"),
                    Field("g", (dims.qp.nv,), "condensed gradient at dx_0 = 0", "data"),
                    Field("Hx", (dims.qp.nv, dims.nx), "coupling of the controls to dx_0", "data"),
                    Field("Ax", (dims.ng, dims.nx), "coupling of the rows to dx_0", "data"),
                    Field("v", (dims.ng,), "values of the rows at du = 0, dx_0 = 0", "data"),
                    Field("terms", (dims.ng,), "magnitude of the terms of v", "data"),
                    Field(
                        "held",
                        (dims.ng,),
                        "weights of a a' in the Hessian",
                        "data",
                        only=lambda f: f.regularize_reduced,
                    ),
                    Field(
                        "regularized",
                        (),
                        "1: the Hessian has been regularised",
                        "data",
                        "int32",
                        only=lambda f: f.regularize_reduced,
                    ),
                ),
            ),
        )

    def cost(self, dims: Dims, model: StageMatrices) -> Counts:
        """Count all functions except condense_rows, which skips zeros of row gradients.

        Columns are padded to COLUMNS.
        """
        N, nx, nu, nf, ng = dims.N, dims.nx, dims.nu, dims.nf, dims.ng
        nus, nxc = dims.qp.nvu, nx - model.products.banded

        def panels(first: int, step: int, nodes: int) -> int:
            return sum(_panels(first + k * step) // COLUMNS for k in range(nodes))

        hessian = model.products.forward_panel * panels(nxc, nu, N)
        hessian += model.products.terminal_panel * panels(nxc + nus, 0, 1)
        hessian += model.products.backward_panel * panels(nxc + nu, nu, N)
        gradient = (model.products.state_step + model.products.adjoint_step) * N + model.products.terminal_adjoint
        return {
            "condense_hessian": hessian,
            "condense_add_curvature": OpCount(add=nu * (nu + 1) // 2) * N,
            "condense_gradient": gradient,
            "condense_embed": OpCount(add=nx + 2, mul=nx) * nus
            + OpCount(add=2 * nx + 2, mul=2 * nx) * ng
            + OpCount(add=nx, mul=nx) * nf,
            "condense_expand": model.products.state_step * N,
        }
