"""The generated functions are called through a Python object that takes and returns NumPy arrays."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.derivative_model import DerivativeModel
from nmpc_codegen.derivatives.layout import settings, structs
from nmpc_codegen.errors import DerivativeError
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.status import Status
from nmpc_codegen.package.struct_layout import EPS

Array = NDArray[Any]

Method = Literal["finite_differences", "forward", "adjoint", "adjoint_matrices", "alternative"]

#: Methods of gradient() and of impulse_response().
GRADIENTS: tuple[Method, ...] = get_args(Method)
IMPULSE_RESPONSES: tuple[Method, ...] = GRADIENTS

Sweep = Literal["symmetric", "forward_over_adjoint"]
SWEEPS: tuple[Sweep, ...] = get_args(Sweep)

#: Methods that compute only the requested rows.
BY_ROWS = ("adjoint", "adjoint_matrices")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A trajectory is the result of a simulation.

    Attributes:
        x: (N + 1, nx), states.
        z: (N, nout), outputs.
        cost: J.
    """

    x: Array
    z: Array
    cost: float


class Derivatives:
    """The object computes derivatives of J and z with respect to the controls u_0, ..., u_{N-1}.

    The arrays are views that may be changed; arrays that the problem lacks do not exist. Only one thread at a time may
    use an object.

    Attributes:
        p: parameters (N + 1, np).
        yref: references (N, ny).
        yref_N: reference of the end (ny_N,).
        W: weight of the path: its diagonal, or all entries row by row.
        W_N: weight of the end, in the same form.
        operations: exact operations per C function.
        name: prefix of the C names.
        N: number of intervals.
        nx: number of states.
        nu: number of controls.
        nout: number of outputs.
        output_names: names of the outputs.
        precision: "double" or "single".
    """

    p: Array
    yref: Array
    yref_N: Array
    W: Array
    W_N: Array
    name: str
    N: int
    nx: int
    nu: int
    nout: int

    def __init__(self, model: DerivativeModel, name: str, ffi: Any, lib: Any) -> None:
        problem = model.problem
        self.name = name
        self.N, self.nx, self.nu, self.nout = problem.N, problem.nx, problem.nu, model.outputs
        self.output_names = model.output_names
        self.precision = model.precision
        self.operations: Mapping[str, OpCount] = Counts(model).all
        self._ffi, self._lib = ffi, lib
        self._scalar = np.float64 if model.precision == "double" else np.float32
        self._structs = {s.name: ffi.new(f"{name}_{s.name}_t *") for s in structs(model)}
        self._data = self._structs["data"]
        self._function("init")(self._data)
        for setting in settings(model):
            if setting.field.name != "x0":
                setattr(self, setting.field.name, self._view("data", setting.field.name))

    # Evaluation ------------------------------------------------------------------------------------------------------

    def simulate(self, x0: ArrayLike, u: ArrayLike) -> Trajectory:
        """Compute x_{k+1} = Phi(x_k, u_k, p_k), z_k = g(x_k, u_k, p_k) and J from x0 (nx,) and u (N, nu).

        Raises:
            DerivativeError: an argument has a wrong shape, or an argument or a result is not finite.
        """
        self._set(x0, u)
        self._call("simulate", self._structs["trajectory"])
        z = self._view("trajectory", "z").copy() if self.nout else np.zeros((self.N, 0), self._scalar)
        return Trajectory(self._view("trajectory", "x").copy(), z, float(self._structs["trajectory"].J))

    def gradient(self, x0: ArrayLike, u: ArrayLike, method: Method = "adjoint", *, step: float | None = None) -> Array:
        """Return dJ/du, (N, nu).

        Args:
            x0: initial state, (nx,).
            u: controls, (N, nu).
            method: "adjoint" (Algorithm 6.3 with products, O(N)), "adjoint_matrices" (6.7 and 6.3), "forward" (6.7 and
                6.2), "alternative" (6.8 and 6.9), "finite_differences" (6.1).
            step: step of finite differences, relative to max(1, |u|); default: the square root of the machine epsilon.

        Raises:
            DerivativeError: an argument is wrong, or a result is not finite.
        """
        self._check(method, step)
        self._set(x0, u)
        g = np.zeros((self.N, self.nu), self._scalar)
        self._call(f"gradient_{method}", *self._step(method, step), self._work(method), self._pointer(g))
        return g

    def impulse_response(
        self,
        x0: ArrayLike,
        u: ArrayLike,
        method: Method = "forward",
        *,
        rows: Iterable[tuple[int, int | str]] | None = None,
        step: float | None = None,
    ) -> Array:
        """Return Xi = dz/du, (N nout, N nu): element (n nout + i, k nu + j) is dz_n[i] / du_k[j].

        Args:
            x0: initial state, (nx,).
            u: controls, (N, nu).
            method: "forward" (Algorithms 6.7 and 6.5), "adjoint" (6.6 with products), "adjoint_matrices" (6.7 and 6.6),
                "alternative" (6.8 and 6.10), "finite_differences" (6.4).
            rows: (node, output) of the rows to compute by the adjoint methods, where an output is an index or a name;
                the result has only these rows, in this order. None: all rows.
            step: see gradient().

        Raises:
            DerivativeError: there are no outputs, an argument is wrong, or a result is not finite.
        """
        self._check(method, step)
        if not self.nout:
            raise DerivativeError(f"{self.name} has no outputs; give them to build(ocp, outputs=...)")
        if rows is not None and method not in BY_ROWS:
            raise DerivativeError(f"rows: method {method!r} computes whole columns; expected {' or '.join(BY_ROWS)}")
        wanted = np.arange(self.N * self.nout) if rows is None else np.array([self._row(row) for row in rows], int)
        self._set(x0, u)
        Xi = np.zeros((len(wanted), self.N * self.nu), self._scalar)
        chosen: tuple[Any, ...] = ()
        if method in BY_ROWS:
            chosen = (self._ffi.new("int[]", wanted.tolist()), len(wanted))
        arguments = (*self._step(method, step), *chosen, self._work(method), self._pointer(Xi))
        self._call(f"impulse_response_{method}", *arguments)
        return Xi

    def sensitivities(self, x0: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
        """Return A (N, nx, nx) and B (N, nx, nu) of every interval, by Algorithm 6.7.

        Args:
            x0: (nx,), initial state.
            u: (N, nu), controls.

        Raises:
            DerivativeError: an argument has a wrong shape, or an argument or a result is not finite.
        """
        self._set(x0, u)
        self._call("sensitivities", self._structs["linearization"])
        S = self._view("linearization", "S")
        return S[:, :, : self.nx].copy(), S[:, :, self.nx :].copy()

    def responses(self, x0: ArrayLike, u: ArrayLike, k: int | None = None) -> Array:
        """Return dx_n / du_k for n = 0, ..., N, by Algorithm 6.8.

        Args:
            x0: (nx,), initial state.
            u: (N, nu), controls.
            k: interval; None: all intervals.

        Returns:
            (N + 1, nx, nu) for one k, or (N, N + 1, nx, nu) for all.

        Raises:
            DerivativeError: an argument is wrong, or an argument or a result is not finite.
        """
        controls = range(self.N) if k is None else [self._index(k, self.N, "k: control")]
        self._set(x0, u)
        found = []
        for each in controls:
            self._call("sensitivities_alternative", each, self._structs["response"])
            found.append(self._view("response", "S").copy())
        return np.array(found) if k is None else found[0]

    def hessians(self, x0: ArrayLike, u: ArrayLike, lam: ArrayLike, sweep: Sweep = "symmetric") -> Array:
        """Return H_k = d2 (lam_k' Phi(x_k, u_k, p_k)) / d(x, u)^2 of every interval, (N, nx + nu, nx + nu).

        The Hessians are taken along the simulation. Source: Quirynen et al., CDC 2014, algorithms 2 and 1.

        Args:
            x0: initial state, (nx,).
            u: controls, (N, nu).
            lam: multipliers of the intervals, (N, nx).
            sweep: "symmetric" (three sweeps), or "forward_over_adjoint".

        Raises:
            DerivativeError: the package was made without second_order=True, an argument is wrong, or an argument or a
                result is not finite.
        """
        if sweep not in SWEEPS:
            raise DerivativeError(f"sweep: {sweep!r}; expected one of {', '.join(SWEEPS)}")
        if "hessians" not in self._structs:
            raise DerivativeError(f"{self.name} has no second derivatives; give second_order=True to build()")
        self._set(x0, u)
        multipliers = self._numbers("lam", lam, (self.N, self.nx))
        self._call(f"hessians_{sweep}", self._pointer(multipliers), self._structs["hessians"])
        return self._view("hessians", "H").copy()

    # Arguments -------------------------------------------------------------------------------------------------------

    def _check(self, method: str, step: float | None) -> None:
        if method not in GRADIENTS:
            raise DerivativeError(f"method: {method!r}; expected one of {', '.join(GRADIENTS)}")
        if step is not None:
            if method != "finite_differences":
                raise DerivativeError(f"step: method {method!r} has none; it belongs to finite_differences")
            least = EPS[self.precision]
            if isinstance(step, bool) or not isinstance(step, int | float) or not least <= step < np.inf:
                raise DerivativeError(f"step: {step!r}; expected a finite number of at least {least:.3g}")

    def _set(self, x0: ArrayLike, u: ArrayLike) -> None:
        for name, value in (("x0", x0), ("u", u)):
            view = self._view("data", name)
            view[...] = self._numbers(name, value, view.shape)

    def _numbers(self, name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
        try:
            array = np.ascontiguousarray(value, self._scalar)
        except (TypeError, ValueError) as error:
            raise DerivativeError(f"{name}: {error}; expected numbers of shape {shape}") from error
        if array.shape != shape:
            raise DerivativeError(f"{name} has shape {array.shape}; expected {shape}")
        if not np.isfinite(array).all():
            raise DerivativeError(f"{name} is not finite")
        return array

    def _row(self, row: Any) -> int:
        try:
            node, output = row
        except (TypeError, ValueError):
            raise DerivativeError(f"rows: {row!r}; expected pairs (node, output)") from None
        if isinstance(output, str):
            if output not in self.output_names:
                raise DerivativeError(f"rows: no output {output!r}; there are {', '.join(self.output_names)}")
            output = self.output_names.index(output)
        return self._index(node, self.N, "rows: node") * self.nout + self._index(output, self.nout, "rows: output")

    @staticmethod
    def _index(value: Any, size: int, what: str) -> int:
        try:
            index = operator.index(value)
        except TypeError:
            raise DerivativeError(f"{what} {value!r}; expected an integer") from None
        if not 0 <= index < size:
            raise DerivativeError(f"{what} {index}; expected 0 to {size - 1}")
        return index

    def _step(self, method: Method, step: float | None) -> tuple[float, ...]:
        if method != "finite_differences":
            return ()
        return (float(np.sqrt(EPS[self.precision])) if step is None else float(step),)

    def _work(self, method: Method) -> Any:
        """Return the struct that a method uses; its matrices are computed first if the method needs them."""
        struct = {"finite_differences": "trajectory", "adjoint": "nodes", "alternative": "response"}
        work = self._structs[struct.get(method, "linearization")]
        if method in ("forward", "adjoint_matrices"):
            self._call("sensitivities", work)
        return work

    # Calls -----------------------------------------------------------------------------------------------------------

    def _function(self, function: str) -> Any:
        return getattr(self._lib, f"{self.name}_{function}")

    def _call(self, function: str, *arguments: Any) -> None:
        status = Status(self._function(function)(self._data, *arguments))
        if status is not Status.OK:
            data = [n for n in ("p", "yref", "yref_N", "W", "W_N") if not np.isfinite(getattr(self, n, 0.0)).all()]
            where = f"{', '.join(data)} of the data" if data else "a state or a result"
            what = f"{where} is not finite" if status is Status.NOT_FINITE else status.text
            raise DerivativeError(f"{self.name}_{function}: {what}")

    def _view(self, struct: str, member: str) -> Array:
        """Return a NumPy view on an array of a struct."""
        array = getattr(self._structs[struct], member)
        flat = np.frombuffer(self._ffi.buffer(array), self._scalar)
        shape, kind = [], self._ffi.typeof(array)
        while kind.kind == "array":
            shape.append(kind.length)
            kind = kind.item
        return flat.reshape(shape)

    def _pointer(self, array: Array) -> Any:
        return self._ffi.cast("void *", array.ctypes.data)
