"""The identity as Hessian: steepest descent on the condensed problem, for comparisons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from nmpc_codegen.components.base import Counts, Defaults, Dims
from nmpc_codegen.components.hessians.stage_cost import integrated_kernels, stage_cost
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Field, Struct, Table
from nmpc_codegen.ir.kernel import OpCount, Port, lift
from nmpc_codegen.ir.stage_products import Pattern, pattern
from nmpc_codegen.ir.sweep import Routine


@dataclass(frozen=True)
class IdentityHessian(Defaults):
    """Q_k = I, Q_N = I: no curvature at all. For any cost; convergence is that of steepest descent, if any."""

    seam: ClassVar[str] = "hessian"
    name: ClassVar[str] = "identity"
    template: ClassVar[str] = "hessians/identity.c"
    needs: ClassVar[tuple[str, ...]] = ("integrator",)
    supports: ClassVar[frozenset[str]] = frozenset(
        {"soft rows", "coupled rows", "free initial state", "general cost", "integrated cost", "accumulators"}
    )

    def routines(self, problem: Problem) -> tuple[Routine, ...]:
        """Cost and gradient of both stages, and the constant blocks."""
        found: list[Routine] = []
        for stage, name in ((problem.path, "path"), (problem.terminal, "terminal")):
            cost = stage_cost(stage, name)
            if name == "terminal" or problem.path.cost_rate is None:
                found += [cost.cost_kernel(), cost.gradient_kernel()]
            identity = ca.Function("identity", [], [ca.SX.eye(cost.nz)])
            found.append(lift(identity, f"{name}_hessian", "Q = I", (), (Port("Q", cost.nz, cost.nz),)))
        return tuple(found)

    def joint_routines(self, problem: Problem, integrator: Any) -> tuple[Routine, ...]:
        """path_cost and path_gradient of costs that are integrated."""
        return integrated_kernels(problem, integrator)

    def patterns(self, routines: Mapping[str, Routine]) -> tuple[Pattern, Pattern]:
        """The diagonals."""
        return pattern(routines["path_hessian"], "Q"), pattern(routines["terminal_hessian"], "Q")

    @property
    def switches(self) -> Mapping[str, int]:
        """The Hessian is never indefinite."""
        return {"REGULARIZE_REDUCED": 0, "REGULARIZE_STAGES": 0}

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        return ()

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return ()

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Hessian blocks, lower triangles in the order z = (x, u)."""
        fields = (
            Field("Q", (dims.nq, dims.nz, dims.nz), "path block, the same for all nodes", "data"),
            Field("Q_N", (dims.nx, dims.nx), "terminal block", "data"),
        )
        return (Struct("hessian", "Hessian blocks, lower triangles, z = (x, u)", fields),)

    def cost(self, dims: Dims, known: Counts) -> dict[str, OpCount]:
        """Nothing is computed."""
        return {"hessian": known["path_hessian"] * dims.nq.value + known["terminal_hessian"]}
