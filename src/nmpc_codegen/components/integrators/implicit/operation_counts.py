"""The operations of the functions of templates/integrators/implicit are counted in the order of their text.

The counts are for a given number of Newton steps per stage, as in a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

from nmpc_codegen.components.integrators.implicit.stage_kernels import StageKernels
from nmpc_codegen.components.integrators.tableau import ButcherTableau
from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.package.opcount import OpCount

NONE = OpCount()


def _sums(n: int) -> OpCount:
    """Count n products that are added up."""
    return OpCount(add=n, mul=n)


@dataclass(frozen=True, eq=False)
class ImplicitCounts:
    """The counts belong to one problem, scheme, number of steps per interval and of Newton steps per stage."""

    kernels: StageKernels
    tableau: ButcherTableau
    steps: int
    newton: int

    @property
    def n(self) -> int:
        return self.kernels.nx

    @property
    def nv(self) -> int:
        """Return the number of variables of a stage."""
        return self.kernels.nv

    @property
    def nz(self) -> int:
        return self.kernels.nx + self.kernels.nu

    @property
    def together(self) -> int:
        """Return the number of stages of a block."""
        return self.tableau.block

    @property
    def size(self) -> int:
        """Return the number of variables of a block."""
        return self.together * self.nv

    @property
    def blocks(self) -> range:
        return range(self.tableau.stages // self.together)

    def _is_explicit(self, block: int) -> bool:
        return self.together == 1 and not self.tableau.a[block][block]

    @property
    def _lengths(self) -> OpCount:
        return OpCount(mul=self.together**2)

    # newton.c --------------------------------------------------------------------------------------------------------

    @property
    def factorize(self) -> OpCount:
        """Count the factors of M at the points of a block, with the kernel of f and its derivatives."""
        n, s = self.size, self.together
        form = _sums(s * s * self.n * self.nv) + OpCount(other=s * (self.nv - self.n) * self.nv)
        return count_of(self.kernels.slopes) * s + form + factors_of(n)

    def solve(self, columns: int) -> OpCount:
        """Count the product of M^-1 or M'^-1 with this number of columns."""
        return solution_of(self.size, columns)

    @property
    def correct(self) -> OpCount:
        """Count one correction of the points of a block with given slopes."""
        s, n = self.together, self.n
        rest = OpCount(add=s * n, other=s * (self.nv - n)) + _sums(s * s * n)
        return self.solve(1) + rest + OpCount(add=self.size)

    @property
    def newton_steps(self) -> OpCount:
        """Count the Newton steps of a block after the computation of its bases."""
        left = self.together * self.n
        evaluated = count_of(self.kernels.slope) * self.together + self.correct + OpCount(add=left, other=left)
        return (self.factorize + self.correct) * self.newton + evaluated

    # forward.c -------------------------------------------------------------------------------------------------------

    def _bases(self, block: int, columns: int) -> OpCount:
        return _sums(self.together * block * self.together * self.n * columns)

    def stage(self, block: int) -> OpCount:
        """Count the points and the increments of a block."""
        if self._is_explicit(block):
            return self._bases(block, 1) + count_of(self.kernels.slopes) + OpCount(mul=self.n)
        return self._bases(block, 1) + self._lengths + self.newton_steps + OpCount(add=self.together * self.n)

    def end(self, columns: int) -> OpCount:
        """Count the end of a step along this number of columns."""
        return _sums(self.tableau.stages * self.n * columns)

    @property
    def step(self) -> OpCount:
        return sum(map(self.stage, self.blocks), self.end(1))

    @property
    def value(self) -> OpCount:
        return (OpCount(div=1) + self.step) * self.steps

    def _forcing(self, columns: int, rows: int) -> OpCount:
        entries = rows * self.kernels.nu
        return OpCount(mul=entries) + _sums(entries * columns)

    def stage_columns(self, block: int, columns: int) -> OpCount:
        """Count the derivatives of a block along this number of columns."""
        n, s = self.n, self.together
        if self._is_explicit(block):
            own = OpCount(mul=n * n) + _sums(n * n * columns)
            return self._bases(block, columns) + self._forcing(columns, n) + own
        forcing = self._forcing(columns, n) * s**2 + self._forcing(columns, self.nv - n) * s
        found = self._bases(block, columns) + self._lengths + forcing
        return found + self.solve(columns) + OpCount(add=s * n * columns)

    def all_columns(self, columns: int) -> OpCount:
        """Count the derivatives of all stages of a step, and of the end of the step."""
        return sum((self.stage_columns(b, columns) for b in self.blocks), self.end(columns))

    def columns(self, columns: int) -> OpCount:
        """Count an interval along this number of columns."""
        return OpCount(div=1) + (self.step + self.all_columns(columns)) * self.steps

    # adjoint.c -------------------------------------------------------------------------------------------------------

    @property
    def record(self) -> OpCount:
        return self.step * self.steps

    def pull_stage(self, block: int, columns: int) -> OpCount:
        """Count the adjoint of a block and of its controls."""
        n, s = self.n, self.together
        later = self.tableau.stages - (block + 1) * s
        found = OpCount(mul=s * n * columns) + _sums(s * later * n * columns)
        if self._is_explicit(block):
            found += OpCount(mul=n * columns) + _sums(n * n * columns)
        else:
            weighed = OpCount(mul=s * n * columns) + _sums(s * (s - 1) * n * columns)
            found += self._lengths + OpCount(add=2 * s * n * columns) + self.solve(columns) + weighed
        controls = OpCount(add=self.kernels.nu * columns) + _sums(self.nv * self.kernels.nu * columns)
        return found + controls * s

    def pull(self, columns: int) -> OpCount:
        """Count a step backward."""
        end = OpCount(add=self.tableau.stages * self.n * columns)
        return sum((self.pull_stage(b, columns) for b in self.blocks), end)

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
        """Count the gradients of the rate at the stages of a step."""
        return (count_of(self.kernels.rate_gradient) + OpCount(mul=1 + self.nv + self.kernels.nu)) * self.tableau.stages

    @property
    def integral_gradient(self) -> OpCount:
        backward = (self.rate_gradients + self.pull(1)) * self.steps
        return OpCount(div=1, add=self.n) + self.record + backward

    @property
    def integral_product(self) -> OpCount:
        rate = (count_of(self.kernels.rate_product) + OpCount(mul=1 + self.nv + self.kernels.nu)) * self.tableau.stages
        forward = self.step + self.all_columns(1) + rate
        return OpCount(div=1, add=self.n) + (forward + self.pull(1)) * self.steps

    # curvature.c -----------------------------------------------------------------------------------------------------

    @property
    def _products(self) -> OpCount:
        """Count H, and H Z, of a stage."""
        weight = OpCount(mul=any(port.name == "weight" for port in self.kernels.curvature.reads))
        return count_of(self.kernels.curvature) + weight + _sums(len(self.kernels.curved) ** 2 * self.nz)

    @property
    def _rates(self) -> tuple[OpCount, OpCount]:
        """Count the gradients of the rate in a step, and their addition to g."""
        if self.kernels.rate_gradient is None:
            return NONE, NONE
        return self.rate_gradients, _sums((self.nv + self.kernels.nu) * self.nz) * self.tableau.stages

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


def factors_of(n: int) -> OpCount:
    """Count the factorisation of a matrix of n rows."""
    pairs, inner = n * (n - 1) // 2, (n - 1) * n * (2 * n - 1) // 6
    return OpCount(div=n, mul=2 * pairs + 2 * n, other=2 * pairs + 3 * n) + _sums(inner)


def solution_of(n: int, columns: int) -> OpCount:
    """Count the solution of n equations with given factors and this number of right-hand sides."""
    return _sums(columns * n * (n - 1)) + OpCount(mul=columns * n)


def count_of(kernel: Kernel | None) -> OpCount:
    """Return the count of a kernel that may be missing."""
    return NONE if kernel is None else kernel.count
