"""Operation counts of the C functions follow exactly from those of the lifted functions and the loops of the parts."""

from __future__ import annotations

from collections.abc import Iterable

from nmpc_codegen.derivatives.derivative_model import DerivativeModel
from nmpc_codegen.ir.model import operations
from nmpc_codegen.package.opcount import OpCount

_ADD, _PERTURBED, _QUOTIENT = OpCount(add=1), OpCount(add=2, mul=1), OpCount(add=1, div=1)
_PRODUCT = OpCount(add=1, mul=1)  # y += a b


class Counts:
    """The operation counts of the functions of one model, with the numbers of algorithms of [T09].

    P = N (N - 1) / 2 is the number of pairs n > k, and T = P + N.
    """

    def __init__(self, model: DerivativeModel) -> None:
        problem, products = model.problem, model.products
        self.model = model
        self.N, self.nx, self.nu, self.nout = problem.N, problem.nx, problem.nu, model.outputs
        self.P = self.N * (self.N - 1) // 2
        self.T = self.P + self.N
        self.value, self.forced, self.free = (r.count for r in (products.value, products.forced, products.free))
        self.adjoint = products.adjoint.count
        self.output, self.jacobians = operations(model.output), operations(model.output_jacobian) * self.N
        self.node = self.value + model.path.cost.count + _ADD
        self.end = model.terminal.cost.count + _ADD
        self.gradients = model.path.gradient.count * self.N + model.terminal.gradient.count
        self.add_columns = _PRODUCT * (self.nx * self.nu)
        self.advance_columns = _PRODUCT * (self.nx * self.nx * self.nu)
        self.adjoint_product = _PRODUCT * (self.nx * (self.nx + self.nu))

    @property
    def all(self) -> dict[str, OpCount]:
        """Return {function: operations of one run}.

        Functions in which rows are chosen count all rows; those in which k is chosen count k = 0. Methods with matrices
        exclude algorithm 6.7, which computes the matrices.
        """
        N, nu, P, T = self.N, self.nu, self.P, self.T
        perturbed = self.node * T + (self.end + _PERTURBED + _QUOTIENT) * N
        found = {
            "simulate": self.simulate,
            "sensitivities": self.sensitivities,
            "sensitivities_alternative": self.sensitivities_alternative(0),
            "gradient_finite_differences": self.simulate + perturbed * nu,
            "gradient_forward": self.gradients + (self.add_columns + self.advance_columns) * P + self.add_columns * N,
            "gradient_adjoint": (self.value + self.adjoint + _ADD * (self.nx + nu)) * N + self.gradients,
            "gradient_adjoint_matrices": self.gradients + (self.adjoint_product + _ADD * (self.nx + nu)) * N,
            "gradient_alternative": self.responses + self.gradients + self.add_columns * T,
        }
        if self.nout:
            rows, pairs = range(N * self.nout), (N - 1) * (N - 2) // 2
            changed = _PERTURBED * N + (self.output + _QUOTIENT * self.nout) * T + self.value * P
            found |= {
                "impulse_response_finite_differences": self.simulate + changed * nu,
                "impulse_response_forward": self.insertion + self.advance_columns * pairs,
                "impulse_response_adjoint": self.impulse_response_adjoint(rows),
                "impulse_response_adjoint_matrices": self.impulse_response_adjoint_matrices(rows),
                "impulse_response_alternative": self.forced * (N - 1) + self.free * pairs + self.insertion,
            }
        return found | {f"hessians_{scheme}": r.count * N for scheme, r in self.model.hessians.items()}

    @property
    def simulate(self) -> OpCount:
        """Count the computation of x, z and J."""
        return (self.node + self.output) * self.N + self.end

    @property
    def sensitivities(self) -> OpCount:
        """Count algorithm 6.7."""
        return self.model.linearize.count * self.N

    def sensitivities_alternative(self, k: int) -> OpCount:
        """Count algorithm 6.8 for one k."""
        return self.value * k + self.forced + self.free * (self.N - 1 - k)

    @property
    def responses(self) -> OpCount:
        """Count algorithm 6.8 for all k, without the repeated simulations up to node k."""
        return self.forced * self.N + self.free * self.P

    @property
    def insertion(self) -> OpCount:
        """Count algorithm 6.10 without algorithm 6.8, whose results it inserts."""
        return self.jacobians + self.add_columns * (self.P * self.nout)

    def impulse_response_adjoint_matrices(self, rows: Iterable[int]) -> OpCount:
        """Count algorithm 6.6 for the rows, without algorithm 6.7."""
        return self.jacobians + self.adjoint_product * self._steps_back(rows)

    def impulse_response_adjoint(self, rows: Iterable[int]) -> OpCount:
        """Count algorithm 6.6 for the rows, with products instead of matrices."""
        return self.value * (self.N - 1) + self.jacobians + self.adjoint * self._steps_back(rows)

    def _steps_back(self, rows: Iterable[int]) -> int:
        """Return the number of intervals of all backward sweeps: row n * nout + i goes back over n intervals."""
        return sum(row // self.nout for row in rows)
