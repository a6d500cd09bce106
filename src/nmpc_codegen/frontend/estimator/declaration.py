"""An estimator is stated beside an OCP, whose model, parameters and rows it shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import identifier, integer, list_names, quote, vector
from nmpc_codegen.frontend.expressions import NODE
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.frontend.statement import Declared
from nmpc_codegen.frontend.symbol import Symbol
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.package.kinds import EstimatorKind
from nmpc_codegen.package.signals import Signal
from nmpc_codegen.runtime.given import is_positive

__all__ = ["Estimator"]

#: Threshold of loss="huber" in standard deviations: 95 % of the efficiency of least squares if the noise is normal.
HUBER = 1.345

#: Largest standard deviation; its inverse is the least one.
LARGEST = 1e30

LOSSES = ("squares", "huber")
KINDS: tuple[EstimatorKind, ...] = get_args(EstimatorKind)


@dataclass(frozen=True, eq=False)
class Measurement:
    """A measurement has the measured elements of one name."""

    signal: Signal
    expression: Any
    std: Array
    threshold: float  # 0: least squares


class Estimator:
    """An estimator finds the states of a model from measurements, at every sample.

        y_k = h(x_k, u_{k-1}, p_k) + v_k,   x_{k+1} = Phi(x_k, u_k, p_k) + w_k,   v and w independent, normal

    kind="mhe" is moving horizon estimation. It finds the states of the last N intervals that minimise

        |x_0 - xbar|^2_P^-1 + sum_k |v_k|^2 + |w_k|^2,   in standard deviations, and the rows of the OCP as soft rows,

    where (xbar, P) is the estimate of a Kalman filter before the window. kind="ekf" is only the extended Kalman filter.
    ocp.estimator(...) is the usual way to create an Estimator.

    Args:
        ocp: the model; its controls are known; its costs and its rows on controls are ignored. An OCP without controls
            and costs states an uncontrolled plant.
        N: number of intervals of the window, >= 1; unused for kind="ekf".
        measure: {name: h}, expressions of states, controls, parameters; a control is that of the previous interval.
        noise_std: {name: standard deviation > 0} of every measurement, a number or one per element.
        process_std: {state: standard deviation of the noise added from sample to sample}; {parameter: the same for an
            unknown parameter}, which is then estimated, as a state after those of the OCP. 0: a constant.
        input_std: {control or parameter: standard deviation of the noise added to it, independent in every interval}.
        initial_std: {state or unknown parameter: standard deviation of its initial value}; default: its size, which is
            the declared scale, half the width of its bounds, or its initial value.
        loss: "squares", "huber", or {measurement: one of both}; with "huber" the cost of errors beyond 1.345 standard
            deviations grows linearly, so that outliers have little influence.
        rows: True: the hard rows of the OCP that contain states and hold along its path; False: none; or their names.
        dt: time between samples; default: the first interval of the OCP.
        kind: "mhe" or "ekf".
        name: prefix of the C package, by default the name of the OCP and "_estimator".

    Raises:
        ProblemError: a name, an expression or a number is wrong; the message names it.

    Attributes:
        measurements: measured expressions with their noise.
        unknown: declarations of the unknown parameters.
    """

    def __init__(
        self,
        ocp: OCP,
        *,
        N: int = 1,
        measure: Mapping[str, Any],
        noise_std: Mapping[str, Any],
        process_std: Mapping[Any, Any] | None = None,
        input_std: Mapping[Any, Any] | None = None,
        initial_std: Mapping[Any, Any] | None = None,
        loss: str | Mapping[str, str] = "squares",
        rows: bool | list[str] | tuple[str, ...] = True,
        dt: float | None = None,
        kind: EstimatorKind = "mhe",
        name: str | None = None,
    ) -> None:
        if not isinstance(ocp, OCP):
            raise ProblemError(f"Estimator: {quote(ocp)} is no OCP; expected the one that states the model")
        if kind not in KINDS:
            raise ProblemError(f"estimator: kind is {quote(kind)}; expected one of {', '.join(map(repr, KINDS))}")
        self.ocp, self.kind = ocp, kind
        self.N = 1 if kind == "ekf" else integer(N, "estimator: N", 1)
        self.name = f"{ocp.name}_estimator" if name is None else name
        check_package_name(self.name, "estimator: name")
        if self.name == ocp.name:
            raise ProblemError(f"estimator: name {quote(name)} is that of the OCP; expected another one")
        self.dt = self._interval(dt)
        self.measurements = self._measurements(measure, noise_std, loss)
        process = self._deviations("process_std", process_std, ocp.states, ocp.parameters)
        inputs = self._deviations("input_std", input_std, ocp.controls, ocp.parameters)
        states = {s.signal.name for s in ocp.states}
        self.unknown = tuple(d for d in ocp.parameters if d.signal.name in process)
        if both := sorted(process.keys() & inputs.keys()):
            raise ProblemError(f"estimator: '{both[0]}' has a process_std and an input_std; expected one of them")
        self.process_std = {n: std for n, std in process.items() if n in states or np.any(std)}
        self.input_std = {n: std for n, std in inputs.items() if np.any(std)}
        self.initial_std = self._deviations("initial_std", initial_std, ocp.states, list(self.unknown))
        self.rows = self._rows(rows)

    if not TYPE_CHECKING:

        def __getattr__(self, attribute: str) -> Any:
            """Raise AttributeError; for methods of a running estimator, the message names build()."""
            hint = f"; build(estimator).{attribute} runs it" if attribute in ("step", "correct", "covariance") else ""
            raise AttributeError(f"Estimator has no attribute {attribute!r}{hint}")

    def __repr__(self) -> str:
        names = ", ".join(m.signal.name for m in self.measurements)
        return f"<Estimator {self.name}: {self.kind}, N = {self.N}, measured: {names}>"

    def _interval(self, dt: Any) -> float | None:
        if self.ocp.dt is None:
            if dt is not None:
                raise ProblemError(f"estimator: dt is given, but the dynamics of '{self.ocp.name}' are a discrete map")
            return None
        if dt is not None and not is_positive(dt):
            raise ProblemError(f"estimator: dt is {quote(dt)}; expected a positive number")
        return float(self.ocp.dt[0] if dt is None else dt)

    def _measurements(self, measure: Any, noise_std: Any, loss: Any) -> tuple[Measurement, ...]:
        for word, given in (("measure", measure), ("noise_std", noise_std)):
            if not isinstance(given, Mapping) or not given:
                raise ProblemError(f"estimator: {word} is {quote(given)}; expected {{name: ...}} with one measurement")
        for word, given in (("noise_std", noise_std), ("loss", loss if isinstance(loss, Mapping) else {})):
            if unknown := [n for n in given if n not in measure]:
                known = ", ".join(map(str, measure))
                raise ProblemError(
                    f"estimator: {word} of {quote(unknown[0])}, which is not measured; measured: {known}"
                )
        found: list[Measurement] = []
        for name, value in measure.items():
            what = f"estimator: measurement {quote(name)}"
            identifier(name, what)
            h = self.ocp._expression(value, what, tuple(kind for kind in NODE if kind not in ("interval", "time")))
            if name not in noise_std:
                raise ProblemError(f"{what} has no standard deviation; expected one in noise_std")
            std = vector(noise_std[name], h.numel(), f"{what}: noise_std")
            if not h.numel() or np.any(std <= 0.0):
                raise ProblemError(f"{what}: noise_std is {quote(noise_std[name])}; expected numbers > 0")
            _require_moderate(std, f"{what}: noise_std")
            if any(not self._varies(h[i]) for i in range(h.numel())):
                raise ProblemError(f"{what} depends on no state; expected one, or a parameter that is not known")
            word = loss.get(name, "squares") if isinstance(loss, Mapping) else loss
            if word not in LOSSES:
                raise ProblemError(f"{what}: loss is {quote(word)}; expected 'squares' or 'huber'")
            offset = sum(m.signal.size for m in found)
            signal = Signal(name, h.numel(), self._unit(h), (0.0,) * h.numel(), offset, h.numel() == 1)
            found.append(Measurement(signal, h, std, HUBER if word == "huber" else 0.0))
        return tuple(found)

    def _varies(self, h: Any) -> bool:
        """Return True if a measurement depends on anything that is estimated; an algebraic variable counts."""
        symbols = ca.vertcat(self.ocp.x, self.ocp.p, self.ocp.z)
        return bool(ca.depends_on(h, symbols))

    def _unit(self, h: Any) -> str:
        """Return the unit of a measured symbol."""
        element = self.ocp.element(h[0])
        every = (*self.ocp.states, *self.ocp.controls, *self.ocp.parameters, *self.ocp.algebraics)
        names = {e: d.signal.unit for d in every for e in d.signal.elements}
        return "" if element is None else names.get(element.name, "")

    def _deviations(self, what: str, given: Any, *kinds: list[Declared]) -> dict[str, Array]:
        """Return {name of a signal: standard deviations of its elements}."""
        if given is None:
            return {}
        if not isinstance(given, Mapping):
            raise ProblemError(f"estimator: {what} is {quote(given)}; expected {{symbol or name: standard deviation}}")
        known = {d.signal.name: d for of in kinds for d in of}
        found: dict[str, Array] = {}
        for key, value in given.items():
            declared = self._signal(key, known)
            if declared is None:
                raise ProblemError(f"estimator: {what} of {quote(key)}, which it cannot have{list_names(known)}")
            signal = declared.signal
            std = vector(value, signal.size, f"estimator: {what} of '{signal.name}'")
            if np.any(std < 0.0) or (what == "initial_std" and not np.all(std > 0.0)):
                least = "> 0" if what == "initial_std" else ">= 0"
                raise ProblemError(f"estimator: {what} of '{signal.name}' is {quote(value)}; expected numbers {least}")
            _require_moderate(std, f"estimator: {what} of '{signal.name}'")
            if signal.name in found:
                raise ProblemError(f"estimator: {what} of '{signal.name}' is given twice")
            found[signal.name] = std
        return found

    def _signal(self, key: Any, known: Mapping[str, Declared]) -> Declared | None:
        """Return the declared signal for a name or for its symbol."""
        if isinstance(key, str):
            return known.get(key)
        for declared in known.values():
            same = isinstance(key, Symbol) and key is declared.symbol
            if same or (
                isinstance(key, ca.SX) and key.shape == declared.symbol.shape and ca.is_equal(key, declared.symbol)
            ):
                return declared
        return None

    def _rows(self, rows: Any) -> tuple[str, ...] | bool:
        if isinstance(rows, bool):
            return rows
        known = {name for s in self.ocp.statements for name in s.names}
        if not isinstance(rows, (list, tuple)) or (unknown := [n for n in rows if n not in known]):
            wrong = quote(rows) if not isinstance(rows, (list, tuple)) else quote(unknown[0])
            raise ProblemError(f"estimator: rows: {wrong} is no row{list_names(sorted(known))}")
        return tuple(rows)


def _require_moderate(std: Array, what: str) -> None:
    """Raise ProblemError for a standard deviation whose square, or its inverse, overflows."""
    if np.any((std != 0.0) & ((std < 1 / LARGEST) | (std > LARGEST))):
        raise ProblemError(f"{what} is {quote(std.tolist())}; expected numbers between {1 / LARGEST:g} and {LARGEST:g}")
