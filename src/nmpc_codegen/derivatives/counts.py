"""Exact operation counts of the C functions, from those of the lifted functions and the loops of the parts."""

from __future__ import annotations

from collections.abc import Iterable

from nmpc_codegen.derivatives.model import DerivativeModel
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.package.opcount import OpCount


def _add(n: int) -> OpCount:
    return OpCount(add=n)


def _products(n: int) -> OpCount:
    """n terms y += a b."""
    return OpCount(add=n, mul=n)


class Counts:
    """Operations of every function of the package of one model; P = N (N - 1) / 2 pairs n > k, T = P + N."""

    def __init__(self, model: DerivativeModel) -> None:
        self.model = model
        problem = model.problem
        self.N, self.nx, self.nu, self.nout = problem.N, problem.nx, problem.nu, model.outputs
        self.P = self.N * (self.N - 1) // 2
        self.T = self.P + self.N

    @property
    def all(self) -> dict[str, OpCount]:
        """Function -> operations of one run; of all rows where rows are chosen, of k = 0 where k is chosen."""
        found = {
            "simulate": self.simulate,
            "sensitivities": self.sensitivities,
            "sensitivities_alternative": self.sensitivities_alternative(0),
            "gradient_finite_differences": self.gradient_finite_differences,
            "gradient_forward": self.gradient_forward,
            "gradient_adjoint": self.gradient_adjoint,
            "gradient_adjoint_matrices": self.gradient_adjoint_matrices,
            "gradient_alternative": self.gradient_alternative,
        }
        if self.nout:
            rows = range(self.N * self.nout)
            found |= {
                "impulse_response_finite_differences": self.impulse_response_finite_differences,
                "impulse_response_forward": self.impulse_response_forward,
                "impulse_response_adjoint": self.impulse_response_adjoint(rows),
                "impulse_response_adjoint_matrices": self.impulse_response_adjoint_matrices(rows),
                "impulse_response_alternative": self.impulse_response_alternative,
            }
        return found

    # Parts -----------------------------------------------------------------------------------------------------------

    @property
    def _value(self) -> OpCount:
        return self.model.products.value.count

    @property
    def _forced(self) -> OpCount:
        return self.model.products.forced.count

    @property
    def _free(self) -> OpCount:
        return self.model.products.free.count

    @property
    def _cost_gradients(self) -> OpCount:
        return self.model.path.gradient.count * self.N + self.model.terminal.gradient.count

    @property
    def _add_columns(self) -> OpCount:
        return _products(self.nx * self.nu)

    @property
    def _advance_columns(self) -> OpCount:
        return _products(self.nx * self.nx * self.nu)

    @property
    def _adjoint_product(self) -> OpCount:
        return _products(self.nx * (self.nx + self.nu))

    @property
    def _perturbed(self) -> OpCount:
        return OpCount(add=2, mul=1)

    @property
    def _quotient(self) -> OpCount:
        return OpCount(add=1, div=1)

    # Functions -------------------------------------------------------------------------------------------------------

    @property
    def simulate(self) -> OpCount:
        """x, z, J."""
        node = self._value + self.model.path.cost.count + _add(1) + count_of(self.model.output)
        return node * self.N + self.model.terminal.cost.count + _add(1)

    @property
    def sensitivities(self) -> OpCount:
        """Algorithm 6.7."""
        return self.model.linearize.count * self.N

    def sensitivities_alternative(self, k: int) -> OpCount:
        """Algorithm 6.8 for one k."""
        return self._value * k + self._forced + self._free * (self.N - 1 - k)

    @property
    def responses(self) -> OpCount:
        """Algorithm 6.8 for all k, without the repeated simulations up to node k."""
        return self._forced * self.N + self._free * self.P

    @property
    def gradient_finite_differences(self) -> OpCount:
        """Algorithm 6.1."""
        node = self._value + self.model.path.cost.count + _add(1)
        end = self.model.terminal.cost.count + _add(1) + self._perturbed + self._quotient
        return self.simulate + (node * self.T + end * self.N) * self.nu

    @property
    def gradient_forward(self) -> OpCount:
        """Algorithm 6.2 without 6.7."""
        pairs = (self._add_columns + self._advance_columns) * self.P
        return self._cost_gradients + pairs + self._add_columns * self.N

    @property
    def gradient_adjoint_matrices(self) -> OpCount:
        """Algorithm 6.3 without 6.7."""
        return self._cost_gradients + (self._adjoint_product + _add(self.nx + self.nu)) * self.N

    @property
    def gradient_adjoint(self) -> OpCount:
        """Algorithm 6.3 with products."""
        node = self._value + self.model.products.adjoint.count + _add(self.nx + self.nu)
        return node * self.N + self._cost_gradients

    @property
    def gradient_alternative(self) -> OpCount:
        """Algorithms 6.8 and 6.9."""
        return self.responses + self._cost_gradients + self._add_columns * self.T

    @property
    def impulse_response_finite_differences(self) -> OpCount:
        """Algorithm 6.4."""
        output = count_of(self.model.output) + self._quotient * self.nout
        return self.simulate + (self._perturbed * self.N + output * self.T + self._value * self.P) * self.nu

    @property
    def _output_jacobians(self) -> OpCount:
        return count_of(self.model.output_jacobian) * self.N

    @property
    def insertion(self) -> OpCount:
        """Algorithm 6.10 without 6.8."""
        return self._output_jacobians + self._add_columns * (self.P * self.nout)

    @property
    def impulse_response_forward(self) -> OpCount:
        """Algorithm 6.5 without 6.7."""
        return self.insertion + self._advance_columns * ((self.N - 1) * (self.N - 2) // 2)

    def impulse_response_adjoint_matrices(self, rows: Iterable[int]) -> OpCount:
        """Algorithm 6.6 for the rows, without 6.7."""
        return self._output_jacobians + self._adjoint_product * self._steps_back(rows)

    def impulse_response_adjoint(self, rows: Iterable[int]) -> OpCount:
        """Algorithm 6.6 for the rows with products."""
        back = self.model.products.adjoint.count * self._steps_back(rows)
        return self._value * (self.N - 1) + self._output_jacobians + back

    @property
    def impulse_response_alternative(self) -> OpCount:
        """Algorithms 6.8, up to node N - 1, and 6.10."""
        pairs = (self.N - 1) * (self.N - 2) // 2
        return self._forced * (self.N - 1) + self._free * pairs + self.insertion

    def _steps_back(self, rows: Iterable[int]) -> int:
        """Row n * nout + i goes back over n intervals."""
        return sum(row // self.nout for row in rows)


def count_of(routine: Routine | None) -> OpCount:
    """Operations of one run; none without the routine."""
    return OpCount() if routine is None else routine.count
