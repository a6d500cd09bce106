"""An Observer is a compiled estimator: NumPy views on its C struct, and the calls of its C package.

xhat = step(y, u)
"""

from __future__ import annotations

from collections.abc import Mapping
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.estimation import Estimation
from nmpc_codegen.package.signals import members
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.compiled import CompiledPackage
from nmpc_codegen.runtime.estimation.doubts import describe_doubts
from nmpc_codegen.runtime.memory import OnFailure
from nmpc_codegen.runtime.setters import EVERY_NODE, Setters

Array = NDArray[Any]
#: Numbers in the order of the elements, or {name of an element or of a vector: numbers}.
Named = ArrayLike | Mapping[str, ArrayLike]


class Observer(Setters):
    """An observer is an estimator with its memory; build() or open_estimator() creates it ready to step.

    Attributes:
        description: the content of <name>.json.
        dims: sizes; nx includes the unknown parameters, which follow the states.
        names: names of the elements; ``states`` holds those of the estimate.
        estimation: measurements with their noise, and the unknown parameters.

    Examples:
        >>> from nmpc_codegen import OCP, build
        >>> ocp = OCP("ball", T=1.0, N=10)
        >>> h, v = ocp.state("h"), ocp.state("v")
        >>> ocp.dynamics({h: v, v: -9.81})
        >>> observer = build(ocp.estimator(N=10, measure={"h": h}, noise_std={"h": 0.01}))
        >>> h0, v0 = observer.step([1.0])
    """

    def __init__(self, package: CompiledPackage) -> None:
        super().__init__(package)
        assert package.description.estimation is not None
        self.estimation: Estimation = package.description.estimation
        self._y, self._y_c = self._buffer(self.estimation.ny)
        self._u, self._u_c = self._buffer(self.estimation.nu)
        self._estimate = package.function("estimate")

    def step(self, y: Named, u: Named | None = None, on_failure: OnFailure = "status") -> Array:
        """Take a sample: move to the present measurements and estimate the state there.

        Args:
            y: measurements (ny,), where NaN is a missing one, or {name: value}, where names left out are missing.
            u: controls (nu,) that have acted since the last sample, or {name: value} for all of them. In the first
                sample they matter only if measurements depend on controls. A plant without controls takes None.
            on_failure: "status" stores the outcome in ``status``; "raise" raises ControllerError after a failure.

        Returns:
            Estimate (nx,): the states, then the unknown parameters; a new array, finite whatever the status.
        """
        self._take(y)
        first = int(self._struct["samples"]) == 0
        if self.estimation.nu and u is None and not first:
            listed = ", ".join(self.estimation.controls)
            raise ControllerError(f"{self._package.name}.step: expected u, the controls since the last one: {listed}")
        self._u[:] = 0.0
        if u is not None:
            names = self.estimation.controls
            self._u[:] = self._stack("u", u, names)
            there = {i for name in u for i in members(name, names)} if isinstance(u, Mapping) else range(len(names))
            if missing := [name for i, name in enumerate(names) if i not in there]:
                raise ControllerError(f"{self._package.name}.step: u has no {missing[0]!r}")
        controls = (self._u_c,) if self.estimation.nu else ()
        start = perf_counter_ns()
        status = self._estimate(self._s, self._y_c, *controls, self._xhat_c)
        self._feedback_ns = perf_counter_ns() - start
        self._judge(status, "step", on_failure)
        return self._xhat.copy()

    def correct(self, y: Named, node: int = 0, on_failure: OnFailure = "status") -> Array:
        """Replace measurements of an earlier sample by late ones, and estimate the present state again.

        Args:
            y: as in step(); entries that are not missing replace the measurements of that sample.
            node: sample of the measurements, counted from the present one: 0, -1 for the last one, ...; it must be
                inside the window.
            on_failure: as in step().

        Returns:
            Estimate (nx,) of the present state.
        """
        if isinstance(node, bool) or not isinstance(node, int | np.integer):
            raise ControllerError(f"{self._package.name}.correct: node is {node!r}; expected an integer <= 0")
        if self.estimation.kind == "ekf":
            raise ControllerError(f"{self._package.name}.correct: a filter keeps no sample; expected kind='mhe'")
        back = self.nodes - 1
        if back < 0:
            raise ControllerError(f"{self._package.name}.correct: there is no sample yet; expected a step() before")
        if not -back <= node <= 0:
            raise ControllerError(f"{self._package.name}.correct: node is {node}; expected -{back} .. 0, its window")
        self._take(y)
        start = perf_counter_ns()
        status = self._call("correct", self._s, self._y_c, -int(node), self._xhat_c)
        self._feedback_ns = perf_counter_ns() - start
        self._judge(status, "correct", on_failure)
        return self._xhat.copy()

    def measure(self, x: ArrayLike, u: ArrayLike | None = None) -> Array:
        """Return what sensors without noise measure: h(x, u, p), shape (ny,).

        Args:
            x: state (nx,).
            u: controls (nu,) that act there; None: 0. Parameters are those of the present sample.
        """
        state = self._array("x", x, (self.dims.nx,), finite=False)
        control = (
            np.zeros(self.estimation.nu) if u is None else self._array("u", u, (self.estimation.nu,), finite=False)
        )
        y, y_c = self._buffer(self.estimation.ny)
        arguments = (self._pointer(control),) if self.estimation.nu else ()
        self._call("measure", self._s, self._pointer(state), *arguments, y_c)
        return y

    def reset(self, x0: ArrayLike | None = None, P0: ArrayLike | None = None) -> None:
        """Forget all measurements.

        Args:
            x0: (nx,) expected state at the next sample; None: the declared initial state.
            P0: (nx, nx) covariance of its error; None: that of the declared standard deviations.
        """
        nx = self.dims.nx
        start = self.description.x_initial if x0 is None else self._array("x0", x0, (nx,))
        P = np.diag(np.square(self.estimation.initial_std)) if P0 is None else self._array("P0", P0, (nx, nx))
        status = self._call("restart", self._s, self._pointer(np.asarray(start)), self._pointer(np.asarray(P)))
        if status == Status.BAD_ARGUMENT:
            raise ControllerError("reset: P0 is not symmetric and positive semidefinite")
        self._expect(status, "reset")

    def set_parameter(self, name: str, value: ArrayLike, node: int | None = None) -> None:
        """Set a parameter from the next sample on; the window keeps the values of earlier samples.

        Args:
            name: the declared name of a number or vector, or of an element of a vector, r[1].
            value: a number, or (size,).
            node: None, the only allowed value.
        """
        self.set_parameters({name: value}, node=node)

    def set_parameters(self, values: Any = None, /, *, node: int | None = None, **more: ArrayLike) -> None:
        """Set several parameters from the next sample on: all of them, or none if one is wrong.

        Args:
            values: {name: value}, for names that are no keywords.
            node: None, the only allowed value: parameters hold from the next sample on.
            more: name=value.
        """
        if node is not None:
            raise ControllerError(f"{self._package.name}: node is {node!r}; parameters hold from the next sample on")
        if values is not None and not isinstance(values, Mapping):
            raise ControllerError(f"set_parameters: {values!r} is no {{name: value}}")
        named = {**(values or {}), **more}
        signals, stored = self.description.parameters, np.array(self._view("next")) if named else np.zeros(0)
        checked = [self._checked_parameter(n, v, self.dims.N) for n, v in named.items()]
        for number, column, rows in checked:
            first = signals[number].offset + (column or 0)
            stored[first : first + rows.shape[-1]] = rows[0, 0]
        for number in dict.fromkeys(one.number for one in checked):
            own = stored[signals[number].offset :][: signals[number].size]
            self._expect(self._call("set_parameter", self._s, number, EVERY_NODE, self._pointer(own)), "set_parameter")

    # -- what is known about it ---------------------------------------------------------------------------------------

    @property
    def covariance(self) -> Array:
        """Return the covariance (nx, nx) of the error of the last estimate, if model and noise are as declared."""
        P, P_c = self._buffer(self.dims.nx**2)
        self._call("covariance", self._s, P_c)
        return P.reshape(self.dims.nx, self.dims.nx)

    @property
    def std(self) -> Array:
        """Return the standard deviations (nx,) of the last estimate: the roots of the diagonal of its covariance."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def nodes(self) -> int:
        """Return the number of nodes of the window with measurements, 0 before the first sample."""
        if int(self._struct["samples"]) == 0:
            return 0
        return int(self._struct["window"]) + 1 if self.estimation.kind == "mhe" else 1

    @property
    def window(self) -> Array:
        """Return the estimates (nodes, nx) at the samples of the window, the present one last."""
        return self.x[: self.nodes].copy()

    def diagnose(self) -> str:
        """Explain in one line why the last call was not OK."""
        found = self.status
        if found == Status.OK:
            return str(found)
        if found == Status.NOT_FINITE:
            return f"{found.name}: a control is not finite; the estimate takes the one before"
        gaps = self.stats.residual > self.description.options.get("algorithm.tolerance", np.inf)
        if found == Status.NOT_CONVERGED and not gaps:
            return f"{found.name}: {describe_doubts(self.estimation, self.stats, self._struct['watch'])}"
        if found == Status.NOT_CONVERGED:
            return f"{found.name}: the window leaves gaps of {self.stats.residual:.2g}; the estimate is the filter's"
        return f"{found.name}: {found.text}; the estimate is the filter's"

    def integrate(self, x: ArrayLike, u: ArrayLike, dt: float) -> Array:
        """Raise ControllerError: an estimator has no integrator; call integrate(x, u, dt) of its controller.

        Raises:
            ControllerError: always.
        """
        raise ControllerError(f"{self._package.name}: an estimator has no integrate(); expected that of the controller")

    def __repr__(self) -> str:
        e = self.estimation
        sizes = f"{e.kind}, N={self.dims.N}, nx={self.dims.nx}, ny={e.ny}, nu={e.nu}"
        code = f"{self.description.precision}, {self.nbytes} bytes; {self.status.name}"
        return f"<Observer {self._package.name}: {sizes}; {code}>"

    # -- inner --------------------------------------------------------------------------------------------------------

    def _take(self, y: Named) -> None:
        self._y[:] = self._stack("y", y, self.estimation.measurements)

    def _stack(self, what: str, given: Named, names: tuple[str, ...]) -> Array:
        """Return the numbers of a vector, with NaN for the names that a mapping leaves out."""
        if not isinstance(given, Mapping):
            return self._array(what, given, (len(names),), finite=False)
        found = np.full(len(names), np.nan, dtype=self._real)
        for name, value in given.items():
            places = members(name, names)
            if not places:
                raise ControllerError(f"{what}: no {name!r}; those that exist: {', '.join(map(repr, names))}")
            found[places] = self._array(
                f"{what}: {name!r}", np.atleast_1d(np.asarray(value)), (len(places),), finite=False
            )
        return found
