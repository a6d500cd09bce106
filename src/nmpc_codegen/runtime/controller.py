"""A Controller is a compiled controller: NumPy views on its C struct, and the calls of its C package.

    u0 = step(xhat) = prepare(); feedback(xhat)

The struct holds the whole state of a controller. It is a 64-byte aligned byte array that the Controller owns: copying,
pickling and saving copy these bytes. Use one controller per thread; C calls release the GIL.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Kkt, Stats, Status
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.compiled import CompiledPackage
from nmpc_codegen.runtime.diagnosis.diagnose import diagnosis
from nmpc_codegen.runtime.diagnosis.foreign_names import OF_CONTROLLER, missing
from nmpc_codegen.runtime.memory import OnFailure
from nmpc_codegen.runtime.setters import Setters
from nmpc_codegen.runtime.solving import Globalization, Solution, solve

__all__ = ["CompiledPackage", "Controller", "Kkt", "Solution", "Stats", "Status"]

Array = NDArray[Any]


class Controller(Setters):
    """A controller is compiled C with its memory.

    Build() or open_package() creates it initialised and ready to step.

    One struct holds the whole state: copies, pickles and saved files contain its bytes. Only one thread at a time may
    use a controller.

    Attributes:
        description: the content of <name>.json: sizes, signals, rows, options, the report of the compiler.
        dims: sizes N, nx, nu, np, ny, ny_N, nh, nh_N (general rows of the path and of the end), nr (scalar rows).
        names: names of the elements of every vector: states, controls, parameters, rows, residuals.

    Examples:
        >>> from nmpc_codegen import OCP, build
        >>> ocp = OCP("tank", T=10.0, N=10)
        >>> h, q = ocp.state("h", unit="m"), ocp.control("q", unit="m/s")
        >>> ocp.dynamics({h: q - 0.1 * h})
        >>> ocp.least_squares(h, weight=1, reference=0.5)
        >>> ocp.subject_to(0, q, 0.2)
        >>> controller = build(ocp)
        >>> q0 = controller.step([0.3])
        >>> controller.status.name
        'OK'
    """

    # -- the real-time iteration ------------------------------------------------------------------------------------

    def step(self, xhat: ArrayLike, on_failure: OnFailure = "status", iterations: int | None = None) -> Array:
        """Call prepare() and feedback(xhat); an algorithm without these phases computes the sample in one call.

        Args:
            xhat: measured state, shape (nx,). NaN raises no error: the status is NOT_FINITE and the control is safe.
            on_failure: "status" stores the outcome in ``status``; "raise" raises ControllerError after a failure.
            iterations: largest number of QPs in this sample, for a caller with a deadline; None: the number in the
                options. The control is that of the best plan so far, and the status tells whether this plan is near a
                solution.

        Returns:
            Control to apply, shape (nu,): a new array, finite and inside its bounds whatever the status.

        Raises:
            ControllerError: xhat has another shape or is no array of numbers; iterations is no integer >= 1; or the
                sample failed and on_failure is "raise".
        """
        if iterations is not None:
            with self._limit(iterations):
                return self.step(xhat, on_failure)
        self._measure(xhat)
        start = perf_counter_ns()
        if self._phases is None or self._depends_on_measured():
            status = self._call("step", self._s, self._xhat_c, self._u0_c)
            self._feedback_ns, self._prepare_ns = perf_counter_ns() - start, 0
        else:
            prepare, feedback = self._phases
            prepared = prepare(self._s)
            middle = perf_counter_ns()
            status = feedback(self._s, self._xhat_c, self._u0_c)
            self._feedback_ns = perf_counter_ns() - middle
            self._prepare_ns = middle - start
            if prepared:
                status = self._struct["status"] = prepared
        if on_failure != "status":
            self._judge(status, "step", on_failure)
        return self._u0.copy()

    def prepare(self, on_failure: OnFailure = "status") -> Status:
        """Perform all operations that do not depend on the measured state: linearise, condense, factorise.

        Args:
            on_failure: as in step().
        """
        start = perf_counter_ns()
        status = self._call("prepare", self._s)
        self._prepare_ns = perf_counter_ns() - start
        return self._judge(status, "prepare", on_failure)

    def feedback(self, xhat: ArrayLike, on_failure: OnFailure = "status", iterations: int | None = None) -> Array:
        """Run the feedback phase: solve the prepared problem for the measured state.

        Args:
            xhat: measured state (nx,), as in step().
            on_failure: as in step().
            iterations: as in step().

        Returns:
            Control to apply (nu,), as step() returns it.
        """
        if iterations is not None:
            with self._limit(iterations):
                return self.feedback(xhat, on_failure)
        self._measure(xhat)
        start = perf_counter_ns()
        status = self._call("feedback", self._s, self._xhat_c, self._u0_c)
        self._feedback_ns = perf_counter_ns() - start
        self._judge(status, "feedback", on_failure)
        return self._u0.copy()

    def solve(
        self,
        xhat: ArrayLike,
        tol: float | None = None,
        max_iterations: int = 100,
        globalization: Globalization = "filter",
    ) -> Solution:
        """Iterate to convergence from the current iterate.

        Call it before the first step() of a loop that starts cold, or pass warm_start=True to simulate().

        Args:
            xhat: initial state, shape (nx,).
            tol: tolerance of the KKT residual, relative to its terms, > 0; None: 1e-8, in single precision 1e-4.
            max_iterations: maximum number of SQP iterations, >= 1.
            globalization: "filter", a line search that accepts a step if it reduces cost or violation, with restoration
                of feasibility; or "full_step", repeated real-time iterations.

        Examples:
            >>> from nmpc_codegen import build
            >>> solution = build(ocp).solve([0.3], tol=1e-9)
            >>> solution.status.name, solution.x.shape, solution.u.shape
            ('OK', (11, 1), (10, 1))
        """
        self._measure(xhat)
        self._solved = True
        return solve(self, tol, max_iterations, globalization)

    def reset(self) -> None:
        """Return to the initial plan; references, weights, parameters and bounds are kept."""
        self._expect(self._call("reset", self._s), "reset")

    def shift(self) -> None:
        """Shift the plan by one interval."""
        self._expect(self._call("shift", self._s), "shift")

    # -- what is known about it ----------------------------------------------------------------------------------------

    def diagnose(self) -> str:
        """Explain why the last call was not OK, in the user's names, and advise what to try, in a few lines.

        The text names numbers that are not finite with their node and operation, violated rows and the largest gap of
        the plan. It repeats the warnings of the compiler and gives advice for the options in force.
        """
        return diagnosis(self, self._xhat, self._solved)

    def __repr__(self) -> str:
        d, described = self.dims, self.description
        sizes = f"N={d.N}, nx={d.nx}, nu={d.nu}, np={d.np}, {d.nr} rows"
        code = f"{described.precision}, {described.target}, profile {self.profile}, {self.nbytes} bytes"
        return f"<Controller {described.name}: {sizes}; {code}; {self.status.name}>"

    def _repr_html_(self) -> str:
        from nmpc_codegen.pictures.notebook import of_controller

        return of_controller(self)

    if not TYPE_CHECKING:  # a type checker must find names that do not exist

        def __getattr__(self, attribute: str) -> Any:
            """Raise an error for an attribute that does not exist.

            For attributes of other tools it names the right one.

            An error inside a property is passed on unchanged.
            """
            of_class = getattr(type(self), attribute, None)
            if isinstance(of_class, property):
                return of_class.__get__(self)
            raise missing("Controller", attribute, OF_CONTROLLER, dir(type(self)))

    # -- inner ------------------------------------------------------------------------------------------------------

    def note_sample(self, u: Array, time_ns: int) -> None:
        """Record that compiled code has taken a sample of this struct (internal)."""
        self._solved, self._prepare_ns, self._feedback_ns = False, 0, time_ns
        self._u0[:] = u

    @contextmanager
    def _limit(self, iterations: int) -> Iterator[None]:
        """Limit the QPs of the calls in this context; a package without this member takes one QP in a sample."""
        if not given.is_integer(iterations) or iterations < 1:
            raise ControllerError(f"iterations is {iterations!r}; expected an integer from 1 on")
        if self.description.options["algorithm"] != "RealTimeIteration":
            raise ControllerError("iterations: only samples of RealTimeIteration can be limited at run time")
        member = self.member("most_iterations")
        usual = member.copy()
        if member.size:
            member[...] = min(int(iterations), int(usual))
        try:
            yield
        finally:
            if member.size:
                member[...] = usual

    def _measure(self, xhat: ArrayLike) -> None:
        """Copy the measured state to the buffer that C reads; NaN is passed on, because the C code handles it."""
        self._solved = False
        if type(xhat) is np.ndarray and xhat.dtype == self._real and xhat.shape == self._xhat.shape:
            self._xhat[:] = xhat
        else:
            self._xhat[:] = self._array("xhat", xhat, (self.dims.nx,), finite=False)
