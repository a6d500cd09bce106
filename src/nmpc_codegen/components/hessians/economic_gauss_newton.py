"""A constant Hessian for economic costs is computed off line; the gradient is that of the cost.

    Q_k = M,   k = 0 .. N - 1,   Q_N = M_f

M is positive semidefinite, although the Hessian of an economic cost need not be, and equals the Hessian of the
Lagrangian at the optimal steady state on the null space of the dynamics and of the strictly active rows (Zanon,
"A Gauss-Newton-like Hessian approximation for economic NMPC", IEEE TAC 66, 2021, Theorem 8). Near the steady state the
iteration therefore converges like Gauss-Newton on a tracking problem, without second derivatives in the generated code.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from nmpc_codegen.components.allowed import AllowedPoint, Matrix, check_options, option
from nmpc_codegen.components.base import COUPLED_START, Counts, Dims, Hessian, Integrator
from nmpc_codegen.components.hessians.given_matrices import refuse_indefinite, refuse_shape
from nmpc_codegen.components.hessians.steady_rows import limits, terminal_state_is_fixed, tied_parameters
from nmpc_codegen.components.stage_cost import StageCost, StageCosts
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.model import Block, HessianModel, ModelFunctions, operations
from nmpc_codegen.ir.stage_products import pattern
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Struct


@dataclass(frozen=True)
class EconomicGaussNewton(Hessian):
    """The Hessian is a constant M at every stage and M_f at the terminal node, for any cost.

    Args:
        M: (nx + nu, nx + nu), order z = (x, u), symmetric positive semidefinite, with a positive definite block of the
            controls; the rows of cyclic states may be zero. M approximates the second derivatives of the cost of one
            interval, so it contains the factor of the interval length if the cost has it.
        M_f: (nx, nx), symmetric positive semidefinite; None if the terminal state is fixed by equations.
        steady_state: (x_s, u_s), the point at which M was computed. Bounds that are inactive there may then be changed
            at run time as long as they admit it; without it, M belongs to all declared bounds.

    M is valid for the declared parameters and weights, and for the bounds of rows that are active at the steady state.
    If one of them is changed at run time, the iteration continues with M, and ``stats.stale_hessian`` is set.
    References may be changed, and so may parameters on which only the gradient of the cost depends. The block of a
    least-squares cost of x_0 is added to the first one; other costs of x_0 have no block.
    """

    M: ArrayLike | None = option(None, Matrix())
    M_f: ArrayLike | None = option(None, Matrix())
    steady_state: tuple[ArrayLike, ArrayLike] | None = option(None, AllowedPoint())

    name: ClassVar[str] = "economic_gauss_newton"
    template: ClassVar[str] = "hessians/economic_gauss_newton.c"
    supports: ClassVar[frozenset[str]] = frozenset(
        {
            *("soft rows", "coupled rows", "free initial state", COUPLED_START),
            *("general cost", "integrated cost", "accumulators"),
        }
    )

    def __post_init__(self) -> None:
        check_options(self, self.seam)
        for name in ("M", "M_f"):
            refuse_indefinite(getattr(self, name), f"EconomicGaussNewton.{name}")

    def check(self, problem: Problem) -> None:
        """Raise OptionError if the shapes do not fit the problem, a matrix is missing, or intervals differ."""
        nx, nu, where = problem.nx, problem.nu, f"of {problem.name}"
        if self.M is None:
            raise OptionError(
                f"EconomicGaussNewton.M: None; expected the Hessian {where}, shape {(nx + nu, nx + nu)}; tune() of "
                "nmpc_codegen.economic computes it: state options = Options(hessian=tune(ocp).hessian()) in the "
                "problem file and leave out the word (--set hessian.M=[[...], ...] takes numbers)"
            )
        refuse_shape(self.M, (nx + nu, nx + nu), "EconomicGaussNewton.M", f"order (x, u) {where}")
        refuse_indefinite(self._path[nx:, nx:], "EconomicGaussNewton.M, block of the controls", strictly=True)
        if self.M_f is not None:
            refuse_shape(self.M_f, (nx, nx), "EconomicGaussNewton.M_f", f"states {where}")
        elif not terminal_state_is_fixed(problem):
            raise OptionError(
                f"EconomicGaussNewton.M_f: None, but no equations fix the terminal state {where}; expected a matrix of "
                f"shape {(nx, nx)}, zero if there is no terminal cost (--set hessian.M_f=[[...], ...])"
            )
        if self.steady_state is not None:
            for name, value, n in zip(("x_s", "u_s"), self.steady_state, (nx, nu), strict=True):
                refuse_shape(value, (n,), f"EconomicGaussNewton.steady_state, {name}", where)
        if not problem.uniform:
            raise OptionError(
                "EconomicGaussNewton: M belongs to one interval length and clashes with the non-uniform grid "
                f"{where}; expected equal intervals (--set hessian=economic_gauss_newton)"
            )
        limits(problem, self.steady_state)

    @property
    def _path(self) -> Array:
        return np.asarray(self.M, dtype=float)

    def blocks(self, problem: Problem, costs: StageCosts, integrator: Integrator) -> HessianModel:
        """Return the constant blocks M and M_f, and the block of a least-squares cost of x_0."""
        self.check(problem)
        M_f = np.zeros((problem.nx, problem.nx)) if self.M_f is None else np.asarray(self.M_f, dtype=float)
        path, terminal = _constant("path", "M", self._path), _constant("terminal", "M_f", M_f)
        start = _start(costs.start)
        return HessianModel(start, Block(pattern(path, "Q"), path), Block(pattern(terminal, "Q"), terminal))

    def notes(self, problem: Problem) -> tuple[str, ...]:
        """Describe the data for which M is valid."""
        active = sorted({problem.rows[i].name for i in self._decisive_rows(problem)})
        rows = f"bounds of {', '.join(active)}" if self.steady_state is not None else "bounds of all rows"
        tied = [name for name, on in zip(problem.parameter_names, tied_parameters(problem), strict=True) if on]
        data = [f"parameters {', '.join(tied)}"] * bool(tied)
        data += ["weights"] * bool(problem.path.ny + problem.terminal.ny) + [rows] * bool(active)
        if not data:
            return ()
        return (
            f"hessian: {self.name}; M belongs to the declared {', '.join(data)}: after a change of them at run time "
            "stats.stale_hessian is 1",
        )

    def _decisive_rows(self, problem: Problem) -> list[int]:
        """Return the rows whose declared bounds determine M."""
        return [i for i, row in enumerate(limits(problem, self.steady_state).T) if row[0] == row[1] or row[2] == row[3]]

    def adds(self, features: Features) -> Features:
        """Return the features of a constant Hessian, which is never indefinite and depends on data that may change."""
        return replace(features, tuned=True, node_kernels=True)

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Return the range of the bounds of every row for which M is valid."""
        values = limits(problem, self.steady_state)
        names = ("least_lower", "most_lower", "least_upper", "most_upper")
        tied = tuple(map(int, tied_parameters(problem)))
        return (
            Table("tuned_parameter", "int", tied, "1: M belongs to the declared value of the parameter"),
            *(
                Table(
                    f"tuned_{name}",
                    "real",
                    tuple(map(float, row)),
                    f"{name.replace('_', ' ')} bound of every row with which M holds",
                )
                for name, row in zip(names, values, strict=True)
            ),
        )

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the struct of the Hessian blocks, lower triangles in the order z = (x, u)."""
        fields = (
            Field("Q", (dims.nq, dims.nz, dims.nz), "path block, the same for all nodes but the first", "data"),
            Field("Q_N", (dims.nx, dims.nx), "terminal block", "data"),
            Field(
                "new_data",
                (),
                "1: data have been set since the last comparison",
                "keep",
                "int32",
                only=lambda f: f.tuned,
            ),
        )
        return (Struct("hessian", "Hessian blocks, lower triangles, z = (x, u)", fields),)

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        """Count no operations for constant blocks, except for the block of a start cost."""
        if model.start.hessian is not None and model.start.hessian.writes:
            return {}
        return {"hessian": operations(model.path.hessian) * dims.nq + operations(model.terminal.hessian)}


def _constant(stage: str, symbol: str, value: Array) -> Kernel:
    Q = ca.sparsify(ca.SX(ca.DM(np.tril(value))))
    n = len(value)
    return lift(ca.Function("constant", [], [Q]), f"{stage}_hessian", f"Q = {symbol}", (), (Port("Q", n, n),))


def _start(cost: StageCost) -> Kernel | None:
    """Return the kernel of J' W J of the cost of x_0."""
    if not cost.ny:
        return None
    return cost.kernel("hessian", "Q = J' W J, lower triangle", cost.gauss_newton, Port("Q", cost.nz, cost.nz))
