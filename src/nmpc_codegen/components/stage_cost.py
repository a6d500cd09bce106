"""The cost of a stage is written as expressions; every algorithm uses the kernels of its value and gradient.

    l = 1/2 (y - yref)' W (y - yref) + general cost,   dl / dz = J' W (y - yref) + gradient of the general cost,

J = dy / dz, z = (x, u). Weights and references are inputs, as they can change at run time. Hessian components derive
their blocks from the same expressions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from nmpc_codegen.frontend.problem import Problem, Reduce, Stage
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.sweep import Slice


@dataclass(frozen=True, eq=False)
class StageCost:
    """The cost of one stage has symbols and expressions; z = (x, u).

    ``inputs`` and ``ports`` are x, u, p, dt, and only x, p at the start and terminal stages; ``data_ports`` are yref,
    W. ``weight`` is the matrix with the entries W; rows and columns of residuals with scale_with_dt are scaled by dt.
    """

    name: str
    inputs: tuple[Expression, ...]
    ports: tuple[Port, ...]
    yref: Expression
    W: Expression
    data_ports: tuple[Port, Port]
    mu: Expression
    z: Expression
    residual: Expression  # y - yref
    weight: Expression
    general: Expression | None  # the general cost
    rows: Expression  # mu' h
    ties: Expression  # further residuals of weight 1
    reduce: Reduce  # (expression, order) -> equal expression with derivatives up to this order, by fewer operations

    @property
    def nz(self) -> int:
        return int(self.z.numel())

    @property
    def ny(self) -> int:
        return int(self.residual.numel())

    def _cost_of_order(self, order: int) -> tuple[Expression, Expression, Expression]:
        """Return residual, ties and general cost with derivatives up to this order."""
        parts = self.residual, self.ties, ca.SX(0) if self.general is None else self.general
        residual, ties, general = (self.reduce(part, order) for part in parts)
        return residual, ties, general

    def _value(self, order: int) -> Expression:
        residual, ties, general = self._cost_of_order(order)
        least_squares = ca.dot(residual, self.weight @ residual) / 2 if self.ny else ca.SX(1, 1)
        if ties.numel():
            least_squares += ca.sumsqr(ties) / 2
        return least_squares if self.general is None else ca.SX(least_squares + general)

    @property
    def value(self) -> Expression:
        """Return the cost l."""
        return self._value(0)

    @property
    def jacobian(self) -> Expression:
        """Return J = dy / dz."""
        return ca.jacobian(self._cost_of_order(1)[0], self.z) if self.ny else ca.SX(0, self.nz)

    @property
    def gradient(self) -> Expression:
        """Return d l / dz."""
        residual, ties, general = self._cost_of_order(1)
        least_squares = self.jacobian.T @ (self.weight @ residual) if self.ny else ca.SX(self.nz, 1)
        least_squares += ca.jacobian(ties, self.z).T @ ties
        if self.general is None:
            return ca.sparsify(least_squares)
        return ca.sparsify(least_squares + ca.gradient(general, self.z))

    @property
    def gauss_newton(self) -> Expression:
        """Return the lower triangle of J' W J."""
        of_ties = ca.jacobian(self._cost_of_order(1)[1], self.z)
        return ca.sparsify(ca.tril(self.jacobian.T @ self.weight @ self.jacobian + of_ties.T @ of_ties))

    @property
    def curvature(self) -> Expression:
        """Return the lower triangle of d2 (mu' h) / dz^2."""
        if not self.mu.numel():
            return ca.SX(self.nz, self.nz)
        return ca.sparsify(ca.tril(ca.hessian(self.rows, self.z)[0]))

    @property
    def hessian(self) -> Expression:
        """Return the lower triangle of d2 (l + mu' h) / dz^2."""
        return ca.sparsify(ca.tril(ca.hessian(self._value(2) + self.rows, self.z)[0]))

    @property
    def mu_port(self) -> Port:
        return Port("mu", int(self.mu.numel()), doc="multipliers of the general rows")

    def kernel(self, suffix: str, doc: str, value: Expression, out: Port, *, mu: bool = False) -> Kernel:
        """Return value(inputs, yref, W[, mu]) as the routine <stage>_<suffix>."""
        symbols = [*self.inputs, self.yref, self.W, *([self.mu] if mu else [])]
        ports = [*self.ports, *self.data_ports, *([self.mu_port] if mu else [])]
        return lift(ca.Function(suffix, symbols, [value]), f"{self.name}_{suffix}", doc, ports, [out])

    def cost_kernel(self) -> Kernel:
        """Return <stage>_cost -> l, which is not stored if the stage has no cost."""
        doc = "l = 1/2 (y - yref)' W (y - yref)" + ("" if self.general is None else " + general cost")
        return self.kernel("cost", doc, ca.sparsify(self.value), Port("l", 1))

    def gradient_kernel(self) -> Kernel:
        """Return <stage>_gradient -> g."""
        doc = "g = J' W (y - yref)" + ("" if self.general is None else " + gradient of the general cost")
        return self.kernel("gradient", doc, self.gradient, Port("g", self.nz))

    @cached_property
    def direction(self) -> Expression:
        """Return the vector d that ``product`` multiplies."""
        return ca.SX.sym("d", self.nz)

    @property
    def product(self) -> Expression:
        """Return J' W J d plus the Hessian of the general cost times d."""
        d = self.direction
        residual, ties, _ = self._cost_of_order(1)
        moved = ca.jtimes(residual, self.z, d) if self.ny else ca.SX(0, 1)
        least_squares = ca.jtimes(residual, self.z, self.weight @ moved, True) if self.ny else ca.SX(self.nz, 1)
        of_ties = ca.jacobian(ties, self.z)
        least_squares += of_ties.T @ (of_ties @ d)
        if self.general is None:
            return ca.sparsify(least_squares)
        return ca.sparsify(least_squares + ca.jtimes(ca.gradient(self.general, self.z), self.z, d))

    def product_kernel(self) -> Kernel:
        """Return <stage>_product: (inputs, yref, W, d) -> w."""
        doc = "w = J' W J d" + ("" if self.general is None else " + Hessian of the general cost times d")
        symbols = [*self.inputs, self.yref, self.W, self.direction]
        ports = [*self.ports, *self.data_ports, Port("d", self.nz)]
        name = f"{self.name}_product"
        return lift(ca.Function("product", symbols, [self.product]), name, doc, ports, [Port("w", self.nz)])


def stage_cost(stage: Stage, name: str, reduce: Reduce = lambda expression, order: expression) -> StageCost:
    """Return the cost of a stage of the problem; ``name`` is "start", "path" or "terminal"."""
    yref, (W, weight, nw) = ca.SX.sym("yref", stage.ny), weight_matrix(stage)
    mu = ca.SX.sym("mu", stage.nh)
    terminal = not stage.nu
    x, p = Port("x", stage.nx), Port("p", int(stage.p.numel()))
    return StageCost(
        name=name,
        inputs=(stage.x, stage.p) if terminal else (stage.x, stage.u, stage.p, stage.dt),
        ports=(x, p) if terminal else (x, Port("u", stage.nu), p, Port("dt", 1)),
        yref=yref,
        W=W,
        data_ports=(
            Port("yref", stage.ny),
            Port("W", nw, doc="diagonal of the weight")
            if stage.diagonal_weight
            else Port("W", nw, doc=f"weight, {stage.ny} rows of {stage.ny}", flat=True),
        ),
        mu=mu,
        z=ca.vertcat(stage.x, stage.u),
        residual=stage.y - yref,
        weight=weight,
        general=stage.cost,
        rows=ca.dot(mu, stage.h) if stage.nh else ca.SX(0),
        ties=ca.SX(0, 1) if stage.ties is None else stage.ties,
        reduce=reduce,
    )


@dataclass(frozen=True, eq=False)
class StageCosts:
    """The costs of all stages of a problem are collected."""

    start: StageCost
    path: StageCost
    terminal: StageCost


def stage_costs(problem: Problem) -> StageCosts:
    """Return the expressions that algorithms and Hessians share."""
    stages = {name: getattr(problem, name) for name in ("start", "path", "terminal")}
    return StageCosts(*(stage_cost(stage, name, problem.reduction(stage)) for name, stage in stages.items()))


def slices(*ports: Port) -> tuple[Slice, ...]:
    """Return one slice per port, which covers the whole port."""
    return tuple(Slice(p.name, p.size) for p in ports)


def weight_matrix(stage: Stage) -> tuple[Expression, Expression, int]:
    """Return (symbol, matrix, length) of the weight.

    The symbol holds the diagonal of a diagonal weight, else all entries row by row; the matrix includes the scaling
    with dt.
    """
    ny = stage.ny
    if stage.diagonal_weight:
        symbol = ca.SX.sym("W", ny)
        matrix = ca.diag(symbol) if ny else ca.SX(0, 0)
    else:
        symbol = ca.SX.sym("W", ny * ny)
        matrix = ca.reshape(symbol, ny, ny)
        matrix = ca.tril(matrix.T) + ca.tril(matrix.T, False).T
    scales = [stage.dt if scaled else ca.SX(1) for scaled in stage.scale_with_dt]
    for i, a in enumerate(scales):
        for j, b in enumerate(scales):
            matrix[i, j] = matrix[i, j] * (a if a is b else ca.sqrt(a * b))
    return symbol, matrix, int(symbol.numel())
