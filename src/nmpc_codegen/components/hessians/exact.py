"""The exact Hessian of the Lagrangian is computed stage by stage, with the multipliers of the last QP.

    Q_k = d2 (l_k + lam_{k+1}' Phi_k + mu_k' h_k) / d(x_k, u_k)^2,   Q_N = d2 (l_N + mu_N' h_N + eta' r) / dx_N^2

Q_0 includes d2 (eta' r) / dx_0^2; mixed derivatives of r in x_0 and x_N are left out. l_k is the sum of least squares,
general costs and the integral of cost rates. x_next, [A_k B_k], the gradient and Q_k come from one sweep (Quirynen et
al., CDC 2014, section IV). Before the first QP an adjoint pass computes lam.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from nmpc_codegen.components.allowed import Named, check_options, option
from nmpc_codegen.components.base import EVERY_USE, Counts, Dims, Hessian, Integrator, Seam
from nmpc_codegen.components.hessians.regularization import EigenvalueFloor, Mirror, Project
from nmpc_codegen.components.stage_cost import StageCost, StageCosts, slices
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.model import Block, HessianModel, ModelFunctions, operations
from nmpc_codegen.ir.stage_products import Pattern, irreducible_blocks, pattern
from nmpc_codegen.ir.sweep import Call, Routine, Slice
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Size, Struct

#: Switch of the parts, and the level of a regularisation that sets it.
LEVELS = (("STAGES", "stage"), ("REDUCED", "reduced"))

# Limits on sweeps of Jacobi rotations and on QL iterations per eigenvalue; the decomposition is then used as it is.
MAX_SWEEPS = 12
MAX_QL = 30

# (largest size, number) of blocks that are decomposed at once, so that small blocks fill vector registers.
LANES = ((8, 8), (16, 4))


@dataclass(frozen=True)
class Symmetric:
    """Three sweeps: forward, adjoint, and forward with a symmetric recursion of the Hessian.

    Source: Quirynen et al., CDC 2014, algorithm 2.
    """

    scheme: ClassVar[str] = "symmetric"


@dataclass(frozen=True)
class ForwardOverAdjoint:
    """Forward mode over the adjoint, which stores the sensitivities of all stages.

    Source: Quirynen et al., CDC 2014, algorithm 1.
    """

    scheme: ClassVar[str] = "forward_over_adjoint"


_REGULARIZATIONS: dict[str, EigenvalueFloor | None] = {"project": Project(), "mirror": Mirror(), "none": None}
_SWEEPS: dict[str, Symmetric | ForwardOverAdjoint] = {cls.scheme: cls() for cls in (Symmetric, ForwardOverAdjoint)}


@dataclass(frozen=True)
class ExactHessian(Hessian):
    """The Hessian consists of exact second derivatives of the Lagrangian, for any cost.

    Args:
        regularization: change of the Hessian where the QP would not be convex; None: no change.
        sweep: method that propagates second derivatives of the dynamics.

    Examples:
        >>> from nmpc_codegen import ExactHessian, Mirror, Options
        >>> options = Options(hessian=ExactHessian(Mirror(level="stage")))
    """

    regularization: EigenvalueFloor | None = option(Mirror(), Named(_REGULARIZATIONS, (Project, Mirror)))
    sweep: Symmetric | ForwardOverAdjoint = option(Symmetric(), Named(_SWEEPS, (Symmetric, ForwardOverAdjoint)))

    name: ClassVar[str] = "exact"
    template: ClassVar[str] = "hessians/exact.c"
    needs: ClassVar[tuple[Seam, ...]] = ("integrator",)
    supports: ClassVar[frozenset[str]] = EVERY_USE

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    @property
    def level(self) -> str:
        """Return the level of the regularisation: "stage", "reduced" or "nowhere"."""
        return "nowhere" if self.regularization is None else self.regularization.level

    def blocks(self, problem: Problem, costs: StageCosts, integrator: Integrator) -> HessianModel:
        """Return the terminal block, the part of start cost and coupled rows in the first block, and the path blocks.

        path_exact(x, u, p, dt, yref, W, mu, lam -> x_next, S, g, Q) computes the path blocks.
        """
        cost = costs.path
        more = (*cost.data_ports, cost.mu_port)
        last, first = self._ends(problem, costs.terminal)
        start = self._start_block(costs.start)
        added = pattern(first, "Q") | pattern(start, "Q") | {(i, i) for i, _ in enumerate(problem.proximal)}
        curved = integrator.lift_hessian(problem, self.sweep.scheme, "path_exact", self._start(cost), more)
        curved = self._store_zeros(curved, added)
        Q = self._block(_lower(curved) | added, cost.nz)
        Q_N = self._block(_lower(last), problem.nx)
        return HessianModel(start, Block(Q), Block(Q_N, last), first, curved)

    def _start_block(self, cost: StageCost) -> Kernel:
        """Return the kernel of the second derivatives of the start cost."""
        doc = "Q = d2 l_0 / dx_0^2, lower triangle"
        return cost.kernel("hessian", doc, cost.hessian, Port("Q", cost.nz, cost.nz))

    def _ends(self, problem: Problem, cost: StageCost) -> tuple[Routine, Routine]:
        """Return the terminal block, and the part of the coupled rows in the first block."""
        nx, nz, ne = problem.nx, problem.nx + problem.nu, problem.coupled_rows
        x_0, eta, Q_0 = ca.SX.sym("x_0", nx), ca.SX.sym("eta", ne), ca.SX.sym("Q_0", nz * nz)
        x_N = cost.inputs[0]
        r = ca.SX(0) if problem.coupled is None else ca.dot(eta, problem.coupled(x_0, x_N))
        first, last = (ca.sparsify(ca.tril(ca.hessian(r, x)[0])) for x in (x_0, x_N))
        Q = ca.sparsify(cost.hessian + last)
        ports = [Port("first", nx, doc="x_0"), Port("eta", ne, doc="multipliers of the coupled rows")]
        terminal = lift(
            ca.Function("hessian", [*cost.inputs, cost.yref, cost.W, cost.mu, x_0, eta], [Q]),
            "terminal_hessian",
            "Q = d2 (l + mu' h + eta' r) / dx_N^2, lower triangle",
            [*cost.ports, *cost.data_ports, cost.mu_port, *ports],
            [Port("Q", nx, nx)],
        )
        total = ca.SX(nz, nz)
        for i, j in zip(*first.sparsity().get_triplet(), strict=True):
            total[i, j] = Q_0[i * nz + j] + first[i, j]
        initial = lift(
            ca.Function("initial", [x_0, x_N, eta, Q_0], [total]),
            "initial_hessian",
            "Q = Q_0 + d2 (eta' r) / dx_0^2, entries that change",
            [ports[0], Port("last", nx, doc="x_N"), ports[1], Port("block", nz * nz, doc="Q_0", flat=True)],
            [Port("Q", nz, nz)],
        )
        return self._store_zeros(terminal), initial

    def _start(self, cost: StageCost) -> Call:
        """Return the call for g and Q of the node's own cost and rows."""
        Q = ca.densify(cost.hessian)
        symbols = [*cost.inputs, cost.yref, cost.W, cost.mu]
        leaf = ca.Function("node", symbols, [ca.densify(cost.gradient), ca.vec(Q.T)])
        outs = (Slice("g", cost.nz), Slice("Q", cost.nz**2))
        return Call(leaf, slices(*cost.ports, *cost.data_ports, cost.mu_port), outs)

    def _store_zeros(self, routine: Routine, more: Pattern = frozenset()) -> Routine:
        """Return the routine with zeros in the entries ``more`` and in those that a regularisation may fill."""
        if not isinstance(routine, Kernel):
            return routine
        return routine.with_zeros("Q", sorted(self._block(pattern(routine, "Q") | more, routine.outputs[-1].rows)))

    def _block(self, lower: Pattern, n: int) -> Pattern:
        """Return the nonzeros of a block after its regularisation."""
        return fill_blocks(lower, n) if self.level == "stage" else lower

    def adds(self, features: Features) -> Features:
        """Return the features with a Hessian that depends on multipliers, and with the level of its regularisation."""
        return replace(
            features,
            lagrangian=True,
            node_kernels=True,
            regularize_stages=self.level == "stage",
            regularize_reduced=self.level == "reduced",
        )

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        if self.regularization is None:
            return ()
        mirror = (
            "MIRROR",
            int(self.regularization.mirrors),
            "1: negative eigenvalues change sign, 0: they are raised to the floor",
        )
        if self.level == "stage":
            return (
                mirror,
                ("LANES", _lanes(dims.nz), "blocks that are decomposed at once"),
                ("MAX_SWEEPS", MAX_SWEEPS, "sweeps of Jacobi rotations"),
            )
        return (
            mirror,
            ("MAX_QL", MAX_QL, "QL iterations per eigenvalue"),
        )

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs of the Hessian blocks (lower triangles, z = (x, u)) and of their decomposition."""
        blocks = (
            Field("Q", (dims.nq, dims.nz, dims.nz), "path blocks", "data"),
            Field("Q_N", (dims.nx, dims.nx), "terminal block", "data"),
        )
        scratch: tuple[Field, ...] = (
            Field("adjoint", (), "1: lam comes from an adjoint pass", "scratch", "int32"),
            Field("changed", (), "1: entries of Q outside its pattern are nonzero", "scratch", "int32"),
        )
        if self.level == "stage":
            nodes, lanes = dims.nodes, Size("LANES", _lanes(dims.nz))
            square = Size("NZ * NZ", dims.nz**2)
            scratch += (
                Field("scale", (nodes,), "largest absolute entry of the block", "scratch"),
                Field("A", (square, lanes), "blocks of one size, one in each lane; diagonalised in place", "scratch"),
                Field("V", (square, lanes), "eigenvectors of the blocks", "scratch"),
            )
        return (Struct("hessian", "Hessian blocks, lower triangles, z = (x, u)", (*blocks, *scratch)),)

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        """Count the terminal block; the work of a regularisation depends on the data."""
        return {} if self.level == "stage" else {"hessian": operations(model.terminal.hessian)}


def _lower(routine: Routine) -> Pattern:
    """Return the nonzeros of the routine's output Q in the lower triangle."""
    return frozenset((r, c) for r, c in pattern(routine, "Q") if r >= c)


def _lanes(nz: int) -> int:
    return next((lanes for size, lanes in LANES if nz <= size), 1)


def fill_blocks(lower: Pattern, n: int) -> Pattern:
    """Return the full lower triangles of all irreducible blocks, with the whole diagonal."""
    return frozenset((r, c) for block in irreducible_blocks(lower, n) for r in block for c in block if r >= c)
