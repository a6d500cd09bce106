"""The package of an estimator has data on measurements, besides the data of every package."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nmpc_codegen.package.kinds import CONTROLLER, ESTIMATORS, EstimatorKind, Kind
from nmpc_codegen.package.signals import Signal


@dataclass(frozen=True)
class Estimation:
    """An estimator finds x from y_k = h(x_k, u_{k-1}, p_k) + noise, x_{k+1} = Phi(x_k, u_k, p_k, w_k).

    measured: the measurements y; inputs: the controls u of the plant; noise_std (ny,), process_std (nw,), initial_std
    (nx,): standard deviations of the noise, of w, and of x_0; thresholds (ny,): of Huber's loss in standard deviations,
    0 for least squares; states (ny,): the state that a measurement is, "" for another expression; unknown: parameters
    of the OCP that are states here, after its own.

    After the user's parameters, of which there are ``own``, a node stores the controls u_k, u_{k-1} if ``before``, y_k,
    and the inverse standard deviations of y_k, 0 for missing ones.
    """

    kind: EstimatorKind
    measured: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    noise_std: tuple[float, ...]
    process_std: tuple[float, ...]
    initial_std: tuple[float, ...]
    thresholds: tuple[float, ...]
    states: tuple[str, ...]
    unknown: tuple[str, ...]
    own: int
    before: bool

    @property
    def measurements(self) -> tuple[str, ...]:
        """Return the names of the elements of y."""
        return _elements(self.measured)

    @property
    def controls(self) -> tuple[str, ...]:
        """Return the names of the elements of u."""
        return _elements(self.inputs)

    @property
    def ny(self) -> int:
        return len(self.measurements)

    @property
    def nu(self) -> int:
        return len(self.controls)

    @property
    def signals(self) -> int:
        """Return the number of signals after the user's parameters."""
        return len(self.inputs) * (1 + self.before) + 2 * len(self.measured)

    @property
    def data(self) -> int:
        """Return the number of values that a node stores for the estimator."""
        return self.nu * (1 + self.before) + 2 * self.ny

    @property
    def places(self) -> tuple[int, int, int, int]:
        """Return the indices of u_k, u_{k-1}, y_k and inverse standard deviations among the parameters of a node."""
        before = self.own + self.nu
        first = before + self.nu * self.before
        return self.own, before, first, first + self.ny


def kind_of(estimation: Estimation | None) -> Kind:
    """Return the kind of a package with this estimation; None: a controller."""
    return CONTROLLER if estimation is None else ESTIMATORS[estimation.kind]


def _elements(signals: Sequence[Signal]) -> tuple[str, ...]:
    return tuple(e for s in signals for e in s.elements)
