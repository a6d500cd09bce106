"""Stages of implicit schemes evaluate kernels lifted from CasADi: f, its derivatives, and those of a cost rate.

stage_slope(x, u, p -> f);   stage_slopes(x, u, p -> f, J = [f_x f_u]);   stage_equation(x, u, p -> g, J = g_z)
stage_rate(x, u, p -> l);    stage_rate_gradient(x, u, p -> rho = dl / d(x, u))
stage_rate_product(x, u, p, dx, du -> w = d2 l (dx; du))
stage_curvature(x, u, p, mu, weight -> H = d2 (mu' f + weight l) / d(x, u)^2, lower triangle)
"""

from __future__ import annotations

from functools import cached_property
from weakref import WeakKeyDictionary

import casadi as ca

from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.kernel import Kernel, Port, lift

#: Pairs (row, column).
Pattern = frozenset[tuple[int, int]]


class StageKernels:
    """Stages of one problem have these kernels, with the sparsity patterns of their results.

    If Newton's method solves for algebraic variables z, the point of a stage is (x, z), and their equations follow f.
    """

    def __init__(self, problem: Problem) -> None:
        stage, algebra = problem.path, problem.algebra
        self.nx, self.nu = problem.nx, problem.nu
        self.na = algebra.size if algebra else 0
        self.p, self.u = ca.SX.sym("p", problem.np), stage.u
        z = ca.SX.sym("z", self.na)
        self.x = ca.vertcat(stage.x, z)
        data = ca.vertcat(self.p, z, ca.SX.zeros(self.na**2))
        self.equations = ca.SX(0, 1)
        if algebra and self.na:
            self.equations = algebra.equations(stage.x, self.u, self.p, z)
        self.f = ca.densify(ca.vertcat(problem.dynamics(stage.x, self.u, data), self.equations))
        self.rated = stage.cost_rate is not None
        self.l = ca.SX(0)
        if stage.cost_rate is not None:
            self.l = ca.substitute(stage.cost_rate, stage.p, data)
        self.z = ca.vertcat(self.x, self.u)
        self._ports = (Port("x", self.nv), Port("u", self.nu), Port("p", problem.np))

    @property
    def nv(self) -> int:
        """Return the number of variables of a stage, (x, z)."""
        return self.nx + self.na

    @property
    def all(self) -> tuple[Kernel, ...]:
        """Return the kernels that compute something, whether or not functions of the package call them."""
        found = (
            *(self.slope, self.slopes, self.equation),
            *(self.rate, self.rate_gradient, self.rate_product, self.curvature),
        )
        return tuple(kernel for kernel in found if kernel is not None and kernel.writes)

    def of(self, function: str) -> tuple[Kernel, ...]:
        """Return the kernels that a function of an interval evaluates."""
        more: dict[str, tuple[Kernel | None, ...]] = {
            "integral": (self.rate,),
            "integral_gradient": (self.rate_gradient,),
            "integral_product": (self.rate_product,),
            **dict.fromkeys(("symmetric", "forward_over_adjoint"), (self.rate_gradient, self.curvature)),
        }
        found = (self.slope, self.slopes, self.equation, *more.get(function, ()))
        return tuple(kernel for kernel in found if kernel is not None and kernel.writes)

    def _kernel(
        self, name: str, doc: str, results: list[Expression], outputs: list[Port], **more: Expression
    ) -> Kernel:
        ports = [*self._ports, *(Port(other, int(symbol.numel())) for other, symbol in more.items())]
        function = ca.Function(name, [self.x, self.u, self.p, *more.values()], results)
        return lift(function, f"stage_{name}", doc, ports, outputs)

    @cached_property
    def slope(self) -> Kernel:
        return self._kernel("slope", "f = dx / dt", [self.f], [Port("f", self.nv)])

    @cached_property
    def slopes(self) -> Kernel:
        outputs = [Port("f", self.nv), Port("J", self.nv, self.nv + self.nu)]
        doc = "f = dx / dt, J = df / d(x, u)"
        return self._kernel("slopes", doc, [self.f, ca.sparsify(ca.jacobian(self.f, self.z))], outputs)

    @cached_property
    def rate(self) -> Kernel | None:
        return (
            self._kernel("rate", "l = cost per unit of time", [ca.densify(self.l)], [Port("l", 1)])
            if self.rated
            else None
        )

    @cached_property
    def rate_gradient(self) -> Kernel | None:
        if not self.rated:
            return None
        gradient = ca.sparsify(ca.gradient(self.l, self.z))
        return self._kernel("rate_gradient", "rho = dl / d(x, u)", [gradient], [Port("rho", self.nv + self.nu)])

    @cached_property
    def rate_product(self) -> Kernel | None:
        if not self.rated:
            return None
        dx, du = ca.SX.sym("dx", self.nv), ca.SX.sym("du", self.nu)
        slope = ca.jtimes(self.l, self.z, ca.vertcat(dx, du))
        product = ca.sparsify(ca.gradient(slope, self.z))
        doc = "w = d2 l / d(x, u)^2 (dx; du)"
        return self._kernel("rate_product", doc, [product], [Port("w", self.nv + self.nu)], dx=dx, du=du)

    @cached_property
    def curvature(self) -> Kernel:
        mu, weight = ca.SX.sym("mu", self.nv), ca.SX.sym("weight", 1)
        H = ca.tril(ca.hessian(ca.dot(mu, self.f) + weight * self.l, self.z)[0])
        nz = self.nv + self.nu
        doc = "H = d2 (mu' f + weight l) / d(x, u)^2, lower triangle"
        return self._kernel("curvature", doc, [ca.sparsify(H)], [Port("H", nz, nz)], mu=mu, weight=weight)

    # Patterns --------------------------------------------------------------------------------------------------------

    @cached_property
    def curved(self) -> tuple[int, ...]:
        """Return the variables (x, z, u) in which f or l is nonlinear."""
        nz = self.nv + self.nu
        return tuple(sorted({i for _, e, _ in self.curvature.stores for i in divmod(e, nz)}))

    @cached_property
    def equation(self) -> Kernel | None:
        """Return the algebraic equations of a node; None if Newton's method solves none."""
        if not self.na:
            return None
        outputs = [Port("f", self.na), Port("J", self.na, self.na)]
        results = [ca.densify(self.equations), ca.sparsify(ca.jacobian(self.equations, self.x[self.nx :]))]
        return self._kernel("equation", "f = g, J = dg / dz", results, outputs)

    @cached_property
    def _along(self) -> dict[int, set[int]]:
        """Return {variable of a stage or control: variables (x, u) of the start on which it depends}."""
        nz = self.nv + self.nu
        output = next(i for i, port in enumerate(self.slopes.outputs) if port.name == "J")
        slopes = {divmod(e, nz) for o, e, _ in self.slopes.stores if o == output}
        found = {i: {i} if i < self.nx else set[int]() for i in range(self.nv)}
        found |= {self.nv + j: {self.nx + j} for j in range(self.nu)}
        together = [range(self.nx, self.nv)] if self.na else []  # an equation may determine any of its variables
        growing = True
        while growing:
            before = {i: len(of) for i, of in found.items()}
            for i, m in slopes:
                found[i] |= found[m]
            for group in together:
                union: set[int] = set().union(*(found[i] for i in group))
                found |= {i: set(union) for i in group}
            growing = any(len(of) > before[i] for i, of in found.items())
        return found

    @cached_property
    def reached(self) -> Pattern:
        """Return (state, variable) if the end of an interval depends on this variable at its start."""
        return frozenset((i, j) for i in range(self.nx) for j in self._along[i])

    @cached_property
    def bent(self) -> Pattern:
        """Return (row, column), row >= column, of second derivatives of the end and of the integral of an interval."""
        pairs = {divmod(e, self.nv + self.nu) for _, e, _ in self.curvature.stores}
        both = {(i, j) for r, c in pairs for i in self._along[r] for j in self._along[c]}
        return frozenset((max(pair), min(pair)) for pair in both)


_KERNELS: WeakKeyDictionary[Problem, StageKernels] = WeakKeyDictionary()


def stage_kernels(problem: Problem) -> StageKernels:
    """Return the kernels of a problem, which are made once for its trials and its functions."""
    if problem not in _KERNELS:
        _KERNELS[problem] = StageKernels(problem)
    return _KERNELS[problem]
