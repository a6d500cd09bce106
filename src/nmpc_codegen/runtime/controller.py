"""A compiled controller: NumPy views on the C struct, and the calls of the C package.

    u0 = step(xhat) = prepare(); feedback(xhat)

The whole state of a controller is in the struct, a 64-byte aligned byte array that the Controller owns: copying,
pickling and saving copy these bytes. Use one controller per thread; C calls release the GIL.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from time import perf_counter_ns
from typing import IO, TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import Kind
from nmpc_codegen.package.status import Kkt, Stats, Status
from nmpc_codegen.runtime import compiled, given
from nmpc_codegen.runtime.compiled import CompiledPackage
from nmpc_codegen.runtime.diagnosis.diagnose import diagnosis
from nmpc_codegen.runtime.diagnosis.foreign_names import OF_CONTROLLER, missing
from nmpc_codegen.runtime.memory import Memory
from nmpc_codegen.runtime.records.show import in_html, in_one_line
from nmpc_codegen.runtime.solving import Globalization, Solution, solve

__all__ = ["CompiledPackage", "Controller", "Kkt", "Solution", "Stats", "Status"]

EVERY_NODE = -1  # <NAME>_ALL of the C package

Array = NDArray[Any]
OnFailure = Literal["status", "raise"]


class Controller(Memory):
    """A controller with its memory, which build() or open_package() creates initialised and ready to step.

    The arrays x, u, lam, mu_u are views on the current iterate; write an initial guess to them. The multipliers of
    rows, mu_x, mu, mu_N and eta, are read-only copies; assign to them.
    """

    # -- the real-time iteration ------------------------------------------------------------------------------------

    def step(self, xhat: ArrayLike, on_failure: OnFailure = "status") -> Array:
        """Call prepare() and feedback(xhat); an algorithm without these phases computes the sample in one call.

        Args:
            xhat: measured state, shape (nx,). NaN is not an error here: the status is NOT_FINITE, the control is safe.
            on_failure: "status" stores the outcome in ``status``; "raise" raises ControllerError after a failure.

        Returns:
            Control to apply, shape (nu,): a new array, finite and inside its bounds whatever the status.
        """
        self._measure(xhat)
        start = perf_counter_ns()
        if self._phases is None or (self._starts_at_measured and self._struct["samples"] == 0):
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

    def prepare(self, on_failure: OnFailure = "status", level: str = "A") -> Status:
        """Perform all operations that do not depend on the measured state: linearise, condense, factorise.

        Args:
            on_failure: as in step().
            level: "A", all of them; "B", "C" and "D" need RealTimeIteration(levels=True) and keep the derivatives and
                factors of the last level A. "B": dynamics, rows and the gradient of the cost are evaluated; "C": also
                the gradient of the Lagrangian; "D": nothing. After a failure and after solve() the level is A.
        """
        start = perf_counter_ns()
        number = given.level_number(level)
        status = self._call("prepare_level", self._s, number) if number else self._call("prepare", self._s)
        self._prepare_ns = perf_counter_ns() - start
        return self._judge(status, "prepare", on_failure)

    def iterate(self, level: str = "A", on_failure: OnFailure = "status") -> Status:
        """One iteration at the state x_0 of the plan: a preparation at that level, the QP and its full step.

        It needs RealTimeIteration(levels=True). The plan changes only if the status is OK or RELAXED.
        """
        return self._judge(self._call("iterate", self._s, given.level_number(level)), "iterate", on_failure)

    def feedback(self, xhat: ArrayLike, on_failure: OnFailure = "status") -> Array:
        """Solve the prepared problem for the measured state (nx,); return the control (nu,) as step() does."""
        self._measure(xhat)
        start = perf_counter_ns()
        status = self._call("feedback", self._s, self._xhat_c, self._u0_c)
        self._feedback_ns = perf_counter_ns() - start
        self._judge(status, "feedback", on_failure)
        return self._u0.copy()

    def feedback_first(self, xhat: ArrayLike, on_failure: OnFailure = "status") -> Array:
        """Return the control (nu,) for the measured state (nx,) on the predicted working set, before the QP is solved.

        It needs RealTimeIteration(levels=True), an active-set method and a measured x_0. Apply the control, then call
        feedback_finish().
        """
        self._measure(xhat)
        self._judge(self._call("feedback_first", self._s, self._xhat_c, self._u0_c), "feedback_first", on_failure)
        return self._u0.copy()

    def feedback_finish(self, on_failure: OnFailure = "status") -> Status:
        """Solve the QP for the state of feedback_first() and update the plan; see stats.first_deviation."""
        start = perf_counter_ns()
        status = self._call("feedback_finish", self._s)
        self._feedback_ns = perf_counter_ns() - start
        return self._judge(status, "feedback_finish", on_failure)

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
            tol: KKT residual, relative to the terms that it sums, up to which the problem counts as solved, > 0;
                None: 1e-8, in single precision 1e-4.
            max_iterations: maximum number of SQP iterations, >= 1.
            globalization: "filter", a line search that accepts what reduces cost or violation, with restoration of
                feasibility; or "full_step", the real-time iteration repeated.
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

    # -- what is solved ---------------------------------------------------------------------------------------------

    def set_reference(self, y: ArrayLike | Mapping[str, float], node: int | None = None) -> None:
        """Set the reference of the path residual.

        Args:
            y: (ny,); or (N, ny), one row per node, (N,) if ny = 1; or {name of a residual: value}, the others stay.
            node: 0..N-1, or None for every node. Online(reference="shared") allows only None, and no (N, ny).
        """
        each = self._each_node("reference", "the reference", node)
        self._expect_some(self.dims.ny, "path residual")
        if isinstance(y, Mapping):
            columns = self._columns(y, self.names.y)
            current = self._view("yref")
            for k in range(self.dims.N) if node is None and each else [node]:
                row = current[self._node(k)] if each else current[0]
                self._send("set_reference", self._replace(row, columns), k)
        else:
            self._send_data("set_reference", "reference", y, self.dims.ny, self.dims.N if each else 0, node)

    def set_terminal_reference(self, y: ArrayLike | Mapping[str, float]) -> None:
        """Set the reference of the terminal residual: (ny_N,), or {name: value}."""
        self._each_node("reference", "the terminal reference")
        self._expect_some(self.dims.ny_N, "terminal residual")
        if isinstance(y, Mapping):
            value = self._replace(self._view("yref_N"), self._columns(y, self.names.y_N))
        else:
            value = self._array("terminal reference", y, (self.dims.ny_N,))
        self._expect(self._call("set_terminal_reference", self._s, self._pointer(value)), "set_terminal_reference")

    def set_weight(self, W: ArrayLike, node: int | None = None) -> None:
        """Set the weight of the path residual, symmetric positive semidefinite up to rounding; (W + W') / 2 is stored.

        Rows and columns of residuals that were stated with scale_with_dt are multiplied by dt_k wherever W is used, so
        give them as in least_squares().

        Args:
            W: its diagonal (ny,) or the matrix (ny, ny); or (N, ny, ny), one matrix per node. Off-diagonal entries
                require a weight that was declared with some, or Online(dense_weight=True).
            node: 0..N-1, or None for every node. Online(weight="shared") allows only None, and no (N, ny, ny).
        """
        each, ny = self._each_node("weight", "the weight", node), self.dims.ny
        self._expect_some(ny, "path residual")
        dense = self._view("W").ndim == 3
        if node is None and each and given.ndim(W) == 3:
            matrices = self._array("weight", W, (self.dims.N, ny, ny))
            checked = [
                given.stored_weight(w, f"weight of node {k}", self._real, ny, dense) for k, w in enumerate(matrices)
            ]
            for k, one in enumerate(checked):
                self._send("set_weight", one, k)
        else:
            self._send("set_weight", given.stored_weight(W, "weight", self._real, ny, dense), node)

    def set_terminal_weight(self, W: ArrayLike) -> None:
        """Set the weight of the terminal residual: (ny_N,) or (ny_N, ny_N)."""
        self._each_node("weight", "the terminal weight")
        self._expect_some(self.dims.ny_N, "terminal residual")
        value = given.stored_weight(W, "terminal weight", self._real, self.dims.ny_N, self._view("W_N").ndim == 2)
        self._expect(self._call("set_terminal_weight", self._s, self._pointer(value)), "set_terminal_weight")

    def set_parameter(self, name: str, value: ArrayLike, node: int | None = None) -> None:
        """Set the value of an online parameter.

        Args:
            name: the declared name; a vector parameter is set as a whole.
            value: a number, or (size,); or one row per node, (N+1, size), with node=None; (N+1,) if size = 1.
            node: 0..N, or None for every node. Online(parameter="shared") allows None and N, and no (N+1, size).
        """
        signals = self.description.parameters
        index = self._lookup(name, [p.name for p in signals], "parameter")
        size = signals[index].size
        what = f"parameter {name!r}"
        each = self._each_node("parameter", what, node, terminal=True)
        self._send_data("set_parameter", what, value, size, self.dims.N + 1 if each else 0, node, index)

    def set_bounds(self, name: str, lower: ArrayLike, upper: ArrayLike, node: int | None = None) -> None:
        """Set the bounds of a row, or of all rows of a vector by its base name.

        Args:
            name: name of the row, e.g. "swing" or "r[1]"; or "r" for r[0], r[1], ...
            lower: a number or one per row; -inf: no bound.
            upper: a number or one per row; +inf: no bound.
            node: a node of the row, or None for all of them. Online(bounds="shared") allows None and N.
        """
        rows = self._row_numbers(name)
        self._each_node("bounds", f"the bounds of {name!r}", node, terminal=True)
        low, high = (
            given.checked_bound(value, f"{which} bound of {name!r}", self._real, len(rows))
            for which, value in (("lower", lower), ("upper", upper))
        )
        if np.any(low > high):
            raise ControllerError(f"bounds of {name!r}: lower {low.tolist()} above upper {high.tolist()}")
        k = self._node(node)
        for row, one_low, one_high in zip(rows, low.tolist(), high.tolist(), strict=True):
            status = self._call("set_bounds", self._s, row, k, one_low, one_high)
            self._expect(status, "set_bounds", f"row {self.names.rows[row]!r}, node {node}")

    def set_previous(self, u: ArrayLike) -> None:
        """Set the control that was applied last, (nu,): what the actuator did, where it is not what step() returned.

        Call it after step() or feedback(), which set it to the control that they return.
        """
        self._needs_inner(bool(self.description.inner.previous), "previous control", "ocp.previous(u) or ocp.rate(u)")
        value = self._array("previous control", u, (self.dims.nu,))
        self._expect(self._call("set_previous", self._s, self._pointer(value)), "set_previous")

    def set_time(self, time: float) -> None:
        """Set the time of the next sample, in the unit of the problem; step() and feedback() move it on by the sampling
        time. A sample that has been prepared sees the change to first order."""
        self._needs_inner(self.description.inner.time, "time", "ocp.time")
        value = float(self._array("time", time, ()))
        self._expect(self._call("set_time", self._s, value), "set_time")

    # -- what is known about it ----------------------------------------------------------------------------------------

    def diagnose(self) -> str:
        """Why the last call was not OK, in the user's names, and what to try; a few lines.

        It names what is not finite with its node and operation, violated rows, the largest gap of the plan, repeats the
        warnings of the compiler and gives advice for the options in force.
        """
        return diagnosis(self, self._xhat, self._solved)

    def __repr__(self) -> str:
        return in_one_line(self)

    def _repr_html_(self) -> str:
        return in_html(self)

    if not TYPE_CHECKING:  # a type checker must find names that do not exist

        def __getattr__(self, attribute: str) -> Any:
            """Explain attributes that do not exist, those of other tools too; of a property, repeat its own error."""
            of_class = getattr(type(self), attribute, None)
            if isinstance(of_class, property):
                return of_class.__get__(self)
            raise missing("Controller", attribute, OF_CONTROLLER, dir(type(self)))

    # -- copies -----------------------------------------------------------------------------------------------------

    def copy(self) -> Self:
        """An independent controller in the same state."""
        twin = type(self)(self._package)
        twin._memory[:] = self._memory
        return twin

    __copy__ = copy

    def __deepcopy__(self, memo: object) -> Self:
        return self.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        package = self._package
        state = self._memory.tobytes()
        return compiled.restore, (package.reload, dict(package.files), package.name, package.profile, state)

    def save(self, file: str | os.PathLike[str] | IO[bytes]) -> None:
        """Write the state, the bytes of the struct and the fingerprint of its package, as an .npz archive."""
        compiled.write_state(file, self._package.fingerprint, self._memory)

    def load(self, file: str | os.PathLike[str] | IO[bytes]) -> None:
        """Load a state that save() wrote; it must come from the same C package, but the profile may differ."""
        self._memory[:] = compiled.read_state(file, self._package, self._memory.shape)

    # -- inner ------------------------------------------------------------------------------------------------------

    def _judge(self, status: int, call: str, on_failure: OnFailure) -> Status:
        judged = Status(status)
        if on_failure == "raise" and judged.is_failure:
            why = self.diagnose() if self.status == judged else str(judged)
            raise ControllerError(f"{self._package.name}.{call}: {why}")
        if on_failure not in ("raise", "status"):
            raise ControllerError(f"on_failure is {on_failure!r}; allowed: 'status', 'raise'")
        return judged

    def _measure(self, xhat: ArrayLike) -> None:
        """Copy the measured state to the buffer that C reads. NaN is passed on, as the C code handles it."""
        self._solved = False
        if type(xhat) is np.ndarray and xhat.dtype == self._real and xhat.shape == self._xhat.shape:
            self._xhat[:] = xhat
        else:
            self._xhat[:] = self._array("xhat", xhat, (self.dims.nx,), finite=False)

    def _each_node(self, option: Kind, what: str, node: int | None = None, terminal: bool = False) -> bool:
        """True if this kind of data is stored for every node; ControllerError if ``node`` cannot be set.

        Args:
            option: the kind of data, a field of Online.
            what: name of the data, for the message.
            node: the node that the user gave.
            terminal: True if shared data of this kind have a copy for node N.
        """
        layout, k = self.description.online[option], self._node(node)
        if layout == "fixed":
            raise ControllerError(
                f'{self._package.name}: {what} cannot be set: it was generated with Online({option}="fixed"); '
                f'generate it with "shared" or "node"'
            )
        if layout == "shared" and k != EVERY_NODE and not (terminal and k == self.dims.N):
            allowed = f"None or {self.dims.N}" if terminal else "None"
            raise ControllerError(
                f"{self._package.name}: {what} cannot be set at node {node}; expected node {allowed}: "
                f'it was generated with Online({option}="shared")'
            )
        return layout == "node"

    def _expect_some(self, size: int, what: str) -> None:
        if not size:
            raise ControllerError(f"{self._package.name} has no {what}")

    def _node(self, node: int | None) -> int:
        """Node number for C; None: every node. The C code checks whether data of this node can be set."""
        if node is None:
            return EVERY_NODE
        if not given.is_integer(node) or not 0 <= node <= self.dims.N:
            raise ControllerError(f"node is {node!r}; expected None or an integer in 0..{self.dims.N}")
        return int(node)

    def _send(self, call: str, value: Array, node: int | None, *leading: int) -> None:
        status = self._call(call, self._s, *leading, self._node(node), self._pointer(value))
        self._expect(status, call, "every node" if node is None else f"node {node}")

    def _send_data(
        self, call: str, what: str, value: ArrayLike, size: int, nodes: int, node: int | None, *leading: int
    ) -> None:
        """Send ``size`` numbers for a node or for all, or one row per node if ``nodes`` are stored."""
        for k, row in given.by_node(value, what, self._real, size, 0 if node is not None else nodes):
            self._send(call, row, node if k is None else k, *leading)

    def _lookup(self, name: str, known: Sequence[str], kind: str) -> int:
        if name not in known:
            there = ", ".join(map(repr, known)) or "none"
            raise ControllerError(f"{self._package.name} has no {kind} {name!r}; those that exist: {there}")
        return known.index(name)

    def _row_numbers(self, name: str) -> list[int]:
        """The row of that name, or all rows name[i]."""
        known = self.names.rows
        members = [i for i, row in enumerate(known) if row.rpartition("[")[0] == name]
        return members or [self._lookup(name, known, "row")]

    def _columns(self, values: Mapping[str, float], known: tuple[str, ...]) -> dict[int, float]:
        found = {self._lookup(name, known, "residual"): (name, value) for name, value in values.items()}
        return {i: float(self._array(f"reference of {n!r}", v, ())) for i, (n, v) in found.items()}

    def _replace(self, row: Array, columns: Mapping[int, float]) -> Array:
        new = row.copy()
        for index, value in columns.items():
            new[index] = value
        return new
