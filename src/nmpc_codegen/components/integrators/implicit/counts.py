"""Operations of the functions of templates/integrators/implicit, in the order of their text.

A sample takes so many steps of Newton's method per stage; with more of them the counts grow.
"""

from __future__ import annotations

from dataclasses import dataclass

from nmpc_codegen.components.integrators.implicit.stage_kernels import StageKernels
from nmpc_codegen.components.integrators.tableau import ButcherTableau
from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.package.opcount import OpCount

NONE = OpCount()


def _sums(n: int) -> OpCount:
    """Return the count of n products that are added up."""
    return OpCount(add=n, mul=n)


@dataclass(frozen=True, eq=False)
class Counts:
    """The counts for one problem, scheme, number of steps per interval and of Newton's method per stage."""

    kernels: StageKernels
    tableau: ButcherTableau
    steps: int
    newton: int

    @property
    def n(self) -> int:
        return self.kernels.nx

    @property
    def nz(self) -> int:
        return self.kernels.nx + self.kernels.nu

    @property
    def stages(self) -> range:
        return range(self.tableau.stages)

    def _is_explicit(self, stage: int) -> bool:
        return not self.tableau.a[stage][stage]

    # newton.c --------------------------------------------------------------------------------------------------------

    @property
    def factorize(self) -> OpCount:
        """Return the count of the factors of M at a point, with the kernel of f and its derivatives."""
        n = self.n
        pairs, inner = n * (n - 1) // 2, (n - 1) * n * (2 * n - 1) // 6
        form, pivots = _sums(n * n), OpCount(mul=pairs + 2 * n, other=2 * pairs + 3 * n)
        return count_of(self.kernels.slopes) + form + pivots + OpCount(div=n, mul=pairs) + _sums(inner)

    def solve(self, columns: int) -> OpCount:
        """Return the count of M^-1 or M'^-1 times so many columns."""
        n = self.n
        return _sums(columns * n * (n - 1)) + OpCount(mul=columns * n)

    @property
    def correct(self) -> OpCount:
        """Return the count of one correction of a point with given slopes."""
        n = self.n
        return self.solve(1) + OpCount(add=3 * n, mul=n)

    @property
    def newton_steps(self) -> OpCount:
        """Return the count of an implicit stage behind its base."""
        evaluated = count_of(self.kernels.slope) + self.correct + OpCount(add=self.n, other=self.n)
        return (self.factorize + self.correct) * self.newton + evaluated

    # forward.c -------------------------------------------------------------------------------------------------------

    def stage(self, i: int) -> OpCount:
        """Return the count of the point and the increment of a stage."""
        n = self.n
        base = _sums(i * n)
        if self._is_explicit(i):
            return base + count_of(self.kernels.slopes) + OpCount(mul=n)
        return base + OpCount(mul=1) + self.newton_steps + OpCount(add=n)

    def end(self, columns: int) -> OpCount:
        """Return the count of the end of a step along so many columns."""
        return _sums(self.tableau.stages * self.n * columns)

    @property
    def step(self) -> OpCount:
        return sum(map(self.stage, self.stages), self.end(1))

    @property
    def value(self) -> OpCount:
        return (OpCount(div=1) + self.step) * self.steps

    def _forcing(self, columns: int) -> OpCount:
        entries = self.n * self.kernels.nu
        return OpCount(mul=entries) + _sums(entries * columns)

    def stage_columns(self, i: int, columns: int) -> OpCount:
        """Return the count of the derivatives of a stage along so many columns."""
        n = self.n
        found = _sums(i * n * columns) + self._forcing(columns)
        if self._is_explicit(i):
            return found + OpCount(mul=n * n) + _sums(n * n * columns)
        return found + OpCount(mul=1) + self.solve(columns) + OpCount(add=n * columns)

    def all_columns(self, columns: int) -> OpCount:
        """Return the count of the derivatives of all stages of a step and of its end."""
        return sum((self.stage_columns(i, columns) for i in self.stages), self.end(columns))

    def columns(self, columns: int) -> OpCount:
        """Return the count of an interval along so many columns."""
        return OpCount(div=1) + (self.step + self.all_columns(columns)) * self.steps

    # adjoint.c -------------------------------------------------------------------------------------------------------

    @property
    def record(self) -> OpCount:
        return self.step * self.steps

    def pull_stage(self, i: int, columns: int) -> OpCount:
        """Return the count of the adjoint of a stage and of its controls."""
        n, later = self.n, self.tableau.stages - 1 - i
        found = OpCount(mul=n * columns) + _sums(later * n * columns)
        if self._is_explicit(i):
            found += OpCount(mul=n * columns) + _sums(n * n * columns)
        else:
            found += OpCount(mul=1 + n * columns, add=2 * n * columns) + self.solve(columns)
        return found + OpCount(add=self.kernels.nu * columns) + _sums(n * self.kernels.nu * columns)

    def pull(self, columns: int) -> OpCount:
        """Return the count of a step backward."""
        end = OpCount(add=self.tableau.stages * self.n * columns)
        return sum((self.pull_stage(i, columns) for i in self.stages), end)

    @property
    def adjoint(self) -> OpCount:
        return OpCount(div=1) + self.record + self.pull(1) * self.steps

    # quadrature.c ----------------------------------------------------------------------------------------------------

    @property
    def integral(self) -> OpCount:
        rate = count_of(self.kernels.rate) + OpCount(mul=2, add=1)
        return OpCount(div=1) + (self.step + rate * self.tableau.stages) * self.steps

    @property
    def rate_gradients(self) -> OpCount:
        """Return the count of the gradients of the rate at the stages of a step."""
        return (count_of(self.kernels.rate_gradient) + OpCount(mul=1 + self.nz)) * self.tableau.stages

    @property
    def integral_gradient(self) -> OpCount:
        backward = (self.rate_gradients + self.pull(1)) * self.steps
        return OpCount(div=1, add=self.n) + self.record + backward

    @property
    def integral_product(self) -> OpCount:
        rate = (count_of(self.kernels.rate_product) + OpCount(mul=1 + self.nz)) * self.tableau.stages
        forward = self.step + self.all_columns(1) + rate
        return OpCount(div=1, add=self.n) + (forward + self.pull(1)) * self.steps

    # curvature.c -----------------------------------------------------------------------------------------------------

    @property
    def _products(self) -> OpCount:
        """Return the count of H, and H Z, of a stage."""
        weight = OpCount(mul=any(port.name == "weight" for port in self.kernels.curvature.reads))
        return count_of(self.kernels.curvature) + weight + _sums(len(self.kernels.curved) ** 2 * self.nz)

    @property
    def _rates(self) -> tuple[OpCount, OpCount]:
        """Return the counts of the gradients of the rate in a step, and of what they add to g."""
        if self.kernels.rate_gradient is None:
            return NONE, NONE
        return self.rate_gradients, _sums(self.nz**2) * self.tableau.stages

    @property
    def symmetric(self) -> OpCount:
        gradients, added = self._rates
        triangle = _sums(len(self.kernels.curved) * self.nz * (self.nz + 1) // 2)
        third = self.all_columns(self.nz) + (self._products + triangle) * self.tableau.stages + added
        return OpCount(div=1) + self.record + (gradients + self.pull(1) + third) * self.steps

    @property
    def forward_over_adjoint(self) -> OpCount:
        gradients, added = self._rates
        first = self.step + self.all_columns(self.nz) + gradients
        second = self.pull(1) + self._products * self.tableau.stages + self.pull(self.nz) + added
        return OpCount(div=1, add=self.nz * (self.nz + 1) // 2) + (first + second) * self.steps


def count_of(kernel: Kernel | None) -> OpCount:
    """Return the count of a kernel that may be missing."""
    return NONE if kernel is None else kernel.count
