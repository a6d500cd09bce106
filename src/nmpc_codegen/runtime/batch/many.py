"""A batch keeps many controllers of one package in one block of memory, and several threads call them.

    many = batch(ocp, 4096)
    u, status = many.step(X)       # X (M, nx) -> u (M, nu), status (M,)

Each controller computes the same bits as a single one, whatever the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.access.telling import Named
from nmpc_codegen.runtime.batch.driver import Driver
from nmpc_codegen.runtime.batch.struct_block import Statuses, Structs, reserve, single, stride_of
from nmpc_codegen.runtime.batch.told import Told, numbers
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.loops.flights import Flights
from nmpc_codegen.runtime.loops.flying import fly
from nmpc_codegen.runtime.loops.forecasts import Bounds, Tables
from nmpc_codegen.runtime.loops.loop_data import Drawn, state_loop
from nmpc_codegen.runtime.solving import limits

Array = NDArray[Any]


class Batch(Structs):
    """A batch has M independent controllers of one package, which begin as copies of one controller.

    x, u, lam, mu_u are views whose first axis has length M, before the axes of a Controller: x (M, N+1, nx). mu_x, mu,
    mu_N, eta are read-only copies of the same form. many[i] is a Controller on the same memory. ``threads`` threads
    share every call; the results do not depend on their number.

    batch() creates a Batch; so does Batch(controller, number) if only the runtime is installed.

    Args:
        controller: from build() or open_package(); its present state is copied.
        number: M >= 1.
        threads: 1 or more; None: one for each core that this process may use.

    Raises:
        ControllerError: a number is wrong, or ``controller`` is no Controller.
        BuildError: there is no compiler.

    Attributes:
        description: the content of <name>.json.
        dims: sizes, as in a Controller.
        names: names of the elements of every vector.
    """

    def __init__(self, controller: Controller, number: int, threads: int | None = None) -> None:
        check(controller, number)
        package = controller._package
        stride = stride_of(package.dtype.itemsize)
        super().__init__(Driver(package, threads), reserve(int(number) * stride), int(number), stride)
        first = np.zeros((1, stride), np.uint8)
        first[0, : package.dtype.itemsize] = controller._memory
        self.call("COPY", None, first=first)

    # -- calls --------------------------------------------------------------------------------------------------------

    def step(self, X: ArrayLike) -> tuple[Array, Statuses]:
        """Take one sample with every controller, as Controller.step() does.

        Args:
            X: measured states (M, nx). NaN gives the status NOT_FINITE and a safe control.

        Returns:
            Controls to apply (M, nu), finite and inside their bounds whatever the status; statuses (M,).
        """
        return self._sample("step", X)

    def prepare(self) -> Statuses:
        """Run the preparation phase of every controller and return the statuses (M,)."""
        return self.call("PLAIN", "prepare")

    def feedback(self, X: ArrayLike) -> tuple[Array, Statuses]:
        """Run the feedback phase of every controller.

        Args:
            X: measured states (M, nx).

        Returns:
            Controls and statuses, as step() returns them.
        """
        return self._sample("feedback", X)

    def solve(self, X: ArrayLike, tol: float | None = None, max_iterations: int = 100) -> Statuses:
        """Iterate every controller from its plan to convergence for the states (M, nx); x, u, ... are the solutions.

        Args:
            X: initial states (M, nx).
            tol: tolerance of the KKT residual, relative to its terms; None: 1e-8, in single precision 1e-4.
            max_iterations: maximum number of SQP iterations of each controller.

        Returns:
            Statuses (M,).
        """
        tol, max_iterations = limits(self.description.precision, tol, max_iterations)
        return self.call("SOLVE", "solve", first=self._states(X, "X"), number=tol, places=[max_iterations])

    def shift(self) -> None:
        """Shift every plan by one interval."""
        self._expect(self.call("PLAIN", "shift"), "shift")

    def reset(self, index: ArrayLike | None = None) -> None:
        """Return to the initial plan; references, weights, parameters and bounds are kept.

        Args:
            index: a mask (M,), or numbers of the controllers that are meant; None: all.
        """
        chosen = None if index is None else numbers(index, self._count)
        self._expect(self.call("PLAIN", "reset", index=chosen), "reset")

    def integrate(self, X: ArrayLike, U: ArrayLike, dt: float) -> Array:
        """Return the states (M, nx) that follow X (M, nx) after the time ``dt`` under constant controls U (M, nu)."""
        states, controls = self._states(X, "X"), self._controls(U)
        out = self._zeros(max(1, self.dims.nx))
        given.require_time(dt)
        self.call("INTEGRATE", "integrate", first=states, second=controls, out=out, number=float(dt))
        return out[:, : self.dims.nx]

    # -- closed loops -------------------------------------------------------------------------------------------------

    def simulate(
        self,
        X0: ArrayLike,
        steps: int,
        dt: float | None = None,
        *,
        parameters: Tables | None = None,
        bounds: Bounds | None = None,
        references: ArrayLike | Tables | None = None,
        disturbance: Drawn | None = None,
        noise: Drawn | None = None,
        added: ArrayLike | None = None,
        plant: Controller | Batch | None = None,
        plant_parameters: Tables | None = None,
        seed: int = 0,
        first: int = 0,
        record: bool = False,
    ) -> Flights:
        """Simulate F closed loops in C: u_k = step(x_k + noise_k), x_{k+1} = plant(x_k, u_k) + disturbance_k.

        Each closed loop is a flight. If F = M, controller i flies flight i and is left in its last state. A batch of
        one controller flies any number of flights: each begins with a copy, and no more than summaries are kept.

        Args:
            X0: initial states of the plant (F, nx).
            steps: number of samples, >= 0.
            dt: sampling time, as in simulate().
            parameters: {name: table over the samples}, for the controllers and their own plant. A table is a number,
                (n,) or (F, n); for a vector it is (n, size) or (F, n, size). A first axis of 1 holds the same values
                for all flights; (F, 1) is one constant for each flight. A node reads the row of the sample at its time;
                the last row holds for all later samples.
            bounds: {name of a row or of a vector of rows: (lower, upper)}, each a table as for parameters.
            references: {name of a residual: table}, or (n, ny), (F, n, ny) for the path residual.
            disturbance: Normal(std) or Uniform(half_width), added to the state after every sample; numbers mean Normal.
            noise: random numbers added to the state that the controller receives.
            added: (steps, nx) or (F, steps, nx), added to the state after every sample, besides ``disturbance``.
            plant: a controller, of the same or another package, whose integrator and parameters advance the state; or a
                batch of F of them. They are copied. None: each controller is its own plant.
            plant_parameters: tables of the plant only. Without ``plant``, the plant is another copy of the controller,
                with ``parameters`` as well; its parameters are used to evaluate rows and costs.
            seed: seed of the random numbers, 0 .. 2^64 - 1. A random number is a function of (seed, first + i, sample,
                state) only.
            first: number of flight 0 in the random generator.
            record: keep x, u and status of every sample.

        Raises:
            ControllerError: shapes or numbers are wrong, or the plant has other states or controls.

        Examples:
            >>> from nmpc_codegen import Normal, batch
            >>> flights = batch(ocp, 1).simulate(np.full((1000, 1), 0.3), 50, noise=Normal(0.01))
            >>> len(flights), flights.last.shape
            (1000, (1000, 1))
        """
        own = None if plant is None else self.structs_of(plant)
        drawn = disturbance, noise
        loop = state_loop(
            self, X0, own, steps, dt, parameters, bounds, references, drawn, added, plant_parameters, seed, first
        )
        return fly(loop, record)

    # -- data ---------------------------------------------------------------------------------------------------------

    def set_reference(self, y: ArrayLike | Named, node: int | None = None, index: ArrayLike | None = None) -> None:
        """Set the references of residuals.

        Args:
            y: (ny,) for all controllers; (M, ny), one row for each; (M, N, ny), one for each node; a first axis of 1
                holds the same values for all. Or {name of a residual or of a vector of them: values of the same forms}.
            node: as in Controller.set_reference().
            index: a mask (M,), or numbers of the controllers that are meant; M is then their number.
        """
        self._tell(index, lambda told: told._tell_residuals("reference", y, node))

    def set_terminal_reference(self, y: ArrayLike | Named, index: ArrayLike | None = None) -> None:
        """Set the reference of the terminal residual.

        Args:
            y: (ny_N,), (M, ny_N), or {name: value}.
            index: as in set_reference().
        """
        self._tell(index, lambda told: told._tell_residuals("reference", y, self.dims.N))

    def set_weight(self, W: ArrayLike, node: int | None = None, index: ArrayLike | None = None) -> None:
        """Set the weights of residuals.

        Args:
            W: the diagonal (ny,), or (M, ny), one for each; matrices (M, ny, ny), (1, ny, ny).
            node: as in Controller.set_weight().
            index: as in set_reference().
        """
        self._tell(index, lambda told: told._tell_residuals("weight", W, node))

    def set_terminal_weight(self, W: ArrayLike, index: ArrayLike | None = None) -> None:
        """Set the weight of the terminal residual.

        Args:
            W: in the forms of set_weight().
            index: as in set_reference().
        """
        self._tell(index, lambda told: told._tell_residuals("weight", W, self.dims.N))

    def set_parameter(
        self, name: str, value: ArrayLike, node: int | None = None, index: ArrayLike | None = None
    ) -> None:
        """Set a parameter.

        Args:
            name: name of a parameter, or of an element of a vector.
            value: a number or (size,) for all controllers; (M,) or (M, size), one value for each; (M, N+1) or (M, N+1,
                size), one for each node; a first axis of 1 holds the same values for all.
            node: as in Controller.set_parameter().
            index: a mask (M,), or numbers of the controllers that are meant; M is then their number.
        """
        self._tell(index, lambda told: told._tell_parameters({name: value}, node))

    def set_parameters(self, values: Named, node: int | None = None, index: ArrayLike | None = None) -> None:
        """Set several parameters: all of them, or none if one is wrong.

        Args:
            values: {name: value}, in the forms of set_parameter().
            node: as in set_parameter().
            index: as in set_reference().
        """
        if not isinstance(values, Mapping):
            raise ControllerError(f"set_parameters: {values!r} is no {{name: value}}")
        self._tell(index, lambda told: told._tell_parameters(values, node))

    def set_bounds(
        self,
        name: str,
        lower: ArrayLike,
        upper: ArrayLike,
        node: int | None = None,
        index: ArrayLike | None = None,
    ) -> None:
        """Set the bounds of a row, or of all rows of a vector.

        Args:
            name: of the row, or of the vector.
            lower: a number or (rows,); (M,) or (M, rows); (M, N+1) or (M, N+1, rows), one value for each node; -inf: no
                bound.
            upper: the same; inf: no bound.
            node: as in Controller.set_bounds().
            index: as in set_reference().
        """
        self._tell(index, lambda told: told._tell_bounds([(name, lower, upper)], node))

    def copy(self) -> Batch:
        """Return an independent batch in the same state."""
        return _restore(self[0], len(self), self.threads, self.memory)

    __copy__ = copy

    def __deepcopy__(self, memo: object) -> Batch:
        return self.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (self[0], len(self), self.threads, self.memory.tobytes())

    # -- what is known of them ----------------------------------------------------------------------------------------

    def __getitem__(self, i: int) -> Controller:
        """Return controller number ``i``, which works on the memory of the batch."""
        begin = self._number(i) * self.stride
        return Controller(self._package, self.memory[begin : begin + self._package.dtype.itemsize])

    def __iter__(self) -> Iterator[Controller]:
        return (self[i] for i in range(self._count))

    @property
    def threads(self) -> int:
        """Return the number of threads that share a call."""
        return self.driver.threads

    @property
    def status(self) -> Statuses:
        """Return a view on the statuses of the last call, (M,)."""
        return self._view("status")

    @property
    def stats(self) -> NDArray[np.void]:
        """Return a view on the counters of the last call: stats["qp_iterations"] (M,) and others of the package."""
        return self._view("stats")

    @property
    def cost(self) -> Array:
        """Return the costs of the plans with their present data, (M,)."""
        out = self._zeros(1)
        self.call("COST", "cost", out=out)
        return out[:, 0]

    @property
    def nbytes(self) -> int:
        """Return the number of bytes of all structs."""
        return self.memory.nbytes

    def __repr__(self) -> str:
        sizes = f"{self._count} of {self.description.name}, {self.nbytes / 2**20:.3g} MiB, {self.threads} threads"
        return f"<Batch {sizes}>"

    # -- inner --------------------------------------------------------------------------------------------------------

    def _number(self, i: int) -> int:
        """Return the number of a controller; negative numbers count from the end."""
        if not given.is_integer(i):
            raise TypeError(f"a batch has controllers with numbers, not {i!r}")
        if not -self._count <= i < self._count:
            raise IndexError(f"controller {i} of {self._count}")
        return int(i) % self._count

    def structs_of(self, plant: Controller | Batch) -> Structs:
        """Return the structs of a plant (internal)."""
        if not isinstance(plant, Controller | Batch):
            raise ControllerError(f"plant is {plant!r:.60}; expected a Controller or a Batch")
        return single(plant) if isinstance(plant, Controller) else plant

    def _tell(self, index: ArrayLike | None, tell: Callable[[Told], None]) -> None:
        """Call ``tell`` with the setters of the controllers in ``index``."""
        tell(Told(self, index))

    def _zeros(self, width: int) -> Array:
        """Return an array of zeros (M, width) for results."""
        return np.zeros((self._count, width), self._real)

    def _sample(self, function: str, X: ArrayLike) -> tuple[Array, Statuses]:
        out = self._zeros(max(1, self.dims.nu))
        status = self.call("SAMPLE", function, first=self._states(X, "X"), out=out)
        return out[:, : self.dims.nu], status

    def _states(self, X: ArrayLike, what: str) -> Array:
        """Return states (M, nx) in the type that C reads; NaN is passed on, because the C code handles it."""
        return np.ascontiguousarray(self._array(what, X, (self._count, self.dims.nx), finite=False))

    def _controls(self, U: ArrayLike) -> Array:
        found = self._array("U", U, (self._count, self.dims.nu), finite=False)
        return np.ascontiguousarray(found) if self.dims.nu else np.zeros((self._count, 1), self._real)

    def _expect(self, status: Statuses, call: str) -> None:
        """Raise ControllerError if a call that only writes data has failed."""
        if status.any():
            raise ControllerError(f"{self._package.name}.{call} of controller {int((status != 0).argmax())} failed")


def check(controller: Controller, number: int) -> None:
    """Raise ControllerError unless ``number`` copies of ``controller`` can be made."""
    if not isinstance(controller, Controller):
        raise ControllerError(f"batch() was given {controller!r:.80}; expected an OCP or a Controller")
    check_number(number)


def check_number(number: int) -> None:
    """Raise ControllerError unless ``number`` is an integer >= 1."""
    if not given.is_integer(number) or number < 1:
        raise ControllerError(f"number is {number!r}; expected an integer >= 1")


def _restore(controller: Controller, number: int, threads: int, state: bytes | NDArray[np.uint8]) -> Batch:
    """Create a batch whose memory has these bytes."""
    found = Batch(controller, number, threads)
    found.memory[:] = np.frombuffer(state, np.uint8)
    return found
