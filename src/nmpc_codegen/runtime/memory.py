"""The memory of a controller or estimator is its C struct, which is viewed, copied, saved and passed to C functions."""

from __future__ import annotations

import math
import os
from typing import IO, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Kkt, Stats, Status
from nmpc_codegen.runtime import compiled, given
from nmpc_codegen.runtime.access.iterate import Iterate
from nmpc_codegen.runtime.compiled import CompiledPackage

Array = NDArray[Any]
OnFailure = Literal["status", "raise"]

#: The counters of an algorithm that has none.
_NO_COUNTS = {**dict.fromkeys((*compiled.COUNTERS, *compiled.NEWTON), 0), "violation": 0.0}


#: Part of the augmented state -> the expression that brings it.
_ADDED = {
    "previous": "previous control: its problem does not contain ocp.previous(u) or ocp.rate(u)",
    "time": "time: its problem does not contain ocp.time",
}


class Memory(Iterate):
    """The memory is an initialised struct of a package, with views on its iterate and on the results of the last call.

    ``memory`` holds the bytes of an initialised struct that another object also owns.
    """

    def __init__(self, package: CompiledPackage, memory: NDArray[np.uint8] | None = None) -> None:
        self._memory = compiled.allocate(package.dtype.itemsize) if memory is None else memory
        super().__init__(package, self._memory.view(package.dtype).reshape(()))
        self._s = package.ffi.from_buffer(f"{package.name}_solver_t *", self._memory)
        self._xhat, self._xhat_c = self._buffer(self.dims.nx)
        self._u0, self._u0_c = self._buffer(self.dims.nu)
        self._phases = self._functions("prepare", "feedback")
        self._starts_at_measured = "REPAIRS" in self.description.sizes or "most_iterations" in self.description.members(
            "solver"
        )
        self._may_be_solved = "solved" in self.description.members("solver")
        self._prepare_ns = 0
        self._feedback_ns = 0
        self._solved = False  # True if the last call was solve()
        if memory is None:
            self._expect(self._call("init", self._s), "init")

    # -- what is known about it ----------------------------------------------------------------------------------------

    @property
    def z(self) -> Array:
        """Return the algebraic variables of the plan, (N+1, number), a copy; NaN where the equations have no solution.

        They belong to x and u of each node, and at node N to u_{N-1}.
        """
        if not self.names.algebraic:
            return np.zeros((self.dims.N + 1, 0))
        last = np.append(self.u, self.u[-1:], axis=0)
        return np.array([self.algebraic(x, u, k) for k, (x, u) in enumerate(zip(self.x, last, strict=True))])

    def algebraic(self, x: ArrayLike, u: ArrayLike, node: int = 0) -> Array:
        """Return the algebraic variables (number,) at a state and control; NaN if the equations have no solution.

        Newton's method starts from its last result at this node. Previous controls, time and controls held by hold=
        have their values in the plan at the node.

        Args:
            x: state (nx,).
            u: control (nu,).
            node: node whose parameters are used.
        """
        names, N = self.names.algebraic, self.dims.N
        if not names:
            return np.zeros(0)
        if not given.is_integer(node) or not 0 <= node <= N:
            raise ControllerError(f"algebraic: node is {node!r}; expected an integer between 0 and {N}")
        state = self._array("x", x, (self.dims.nx,), finite=False)
        control = self._array("u", u, (self.dims.nu,), finite=False)
        out, out_c = self._buffer(len(names))
        self._call("algebraic", self._s, int(node), self._pointer(state), self._pointer(control), out_c)
        return out

    @property
    def previous(self) -> Array:
        """Return a copy of the control applied last, (nu,), by the last sample or set_previous()."""
        self._needs("previous")
        return np.array(self._view("previous"))

    @property
    def time(self) -> float:
        """Return the time of the next sample."""
        self._needs("time")
        return float(self._view("time"))

    def _needs(self, name: Literal["previous", "time"]) -> None:
        """Raise ControllerError unless the augmented state has this part."""
        if not getattr(self.description.augmentation, name):
            raise ControllerError(f"{self._package.name} has no {_ADDED[name]}")

    @property
    def status(self) -> Status:
        """Return the status of the last prepare(), feedback(), step() or solve().

        For an estimator, step() or correct().
        """
        return Status(int(self._struct["status"]))

    @property
    def stats(self) -> Stats:
        """Return counters, residuals and times of the last call; counters that the algorithm lacks are 0."""
        found: Any = self._struct["stats"] if "stats" in self.description.members("solver") else {}
        counts = _NO_COUNTS | {name: found[name] for name in self.description.members("stats")}
        return Stats(
            **{name: int(counts[name]) for name in (*compiled.COUNTERS[:5], *compiled.NEWTON)},
            violated_row=self._violated_row(),
            violated_node=int(counts["violated_node"]) if self._violated_row() else None,
            violation=float(counts["violation"]),
            kkt=self.kkt() if self.description.members("kkt") else Kkt.read(lambda _: math.nan),
            prepare_ns=self._prepare_ns,
            feedback_ns=self._feedback_ns,
            stale_hessian=bool(counts.get("stale_hessian", 0)),
            residual=float(counts["residual"] if "residual" in counts else counts["violation"]),
            iterations=int(counts.get("iterations", 1 + counts.get("repairs", 0))),
            innovation=float(counts.get("innovation", 0)),
            error=float(counts.get("error", 0)),
            measurement=self._farthest(int(counts.get("measurement", -1))),
        )

    def _farthest(self, index: int) -> str | None:
        """Return the name of measurement number ``index``, None for -1."""
        found = self.description.estimation
        return None if found is None or index < 0 else found.measurements[index]

    @property
    def time_ns(self) -> int:
        """Return the time (ns) of the last step(), or of the last prepare() and feedback() together."""
        return self._prepare_ns + self._feedback_ns

    @property
    def cost(self) -> float:
        """Return the cost of the current plan, with the present references and weights."""
        return float(self._call("cost", self._s))

    def kkt(self) -> Kkt:
        """Return the KKT residuals of the current iterate."""
        evaluate = self._package.function("kkt")
        out = self._package.ffi.new(f"{self._package.name}_kkt_t *")
        evaluate(self._s, out)
        return Kkt.read(lambda part: getattr(out, part), self.description.members("kkt"))

    def integrate(self, x: ArrayLike, u: ArrayLike, dt: float) -> Array:
        """Return the state (nx,) after a time under a constant control, by the integrator of the package.

        Previous controls and time in the dynamics have their values in the last sample. Discrete states beside
        continuous ones take their next value, for any dt.

        Args:
            x: state (nx,).
            u: control (nu,).
            dt: the time >= 0, in the unit of the problem.
        """
        given.require_time(dt)
        start = self._array("x", x, (self.dims.nx,), finite=False)
        control = self._array("u", u, (self.dims.nu,), finite=False)
        out, out_c = self._buffer(self.dims.nx)
        self._call("integrate", self._s, self._pointer(start), self._pointer(control), float(dt), out_c)
        return out[: self.dims.nx]

    @property
    def profile(self) -> str:
        """Return the name of the compiler profile."""
        return str(self._package.profile.name)

    def _depends_on_measured(self) -> bool:
        """Return True if the preparation of the next sample depends on the measured state.

        That is so in the first sample, and in one that may begin at the state of solve().
        """
        first = self._starts_at_measured and self._struct["samples"] == 0
        return bool(first or (self._may_be_solved and self._struct["solved"]))

    @property
    def nbytes(self) -> int:
        """Return the size of the solver struct in bytes: all memory that the C package uses except the stack."""
        return self._package.dtype.itemsize

    def call_solve(self, tol: float, last: int) -> Status:
        """Call C's solve() for the state last measured, up to iteration ``last`` (internal)."""
        return Status(self._call("solve", self._s, self._xhat_c, tol, last))

    def call_iteration(self) -> Status:
        """Call C's prepare() and feedback(), or step(), for the state last measured (internal)."""
        if self._phases is None:
            return Status(self._call("step", self._s, self._xhat_c, self._u0_c))
        return Status(self._call("prepare", self._s) or self._call("feedback", self._s, self._xhat_c, self._u0_c))

    # -- copies -----------------------------------------------------------------------------------------------------

    def copy(self) -> Self:
        """Return an independent copy in the same state."""
        twin = type(self)(self._package)
        twin._memory[:] = self._memory
        return twin

    __copy__ = copy

    def __bytes__(self) -> bytes:
        """Return the bytes of the solver struct, as memcpy() copies them on a target; replay() reads them."""
        return self._memory.tobytes()

    def __deepcopy__(self, memo: object) -> Self:
        return self.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        package = self._package
        state = bytes(self)
        return compiled.restore, (package.reload, dict(package.files), package.name, package.profile, state)

    def save(self, file: str | os.PathLike[str] | IO[bytes]) -> None:
        """Write the bytes of the struct and the fingerprint of its package as an .npz archive.

        Args:
            file: path, or a file that is open for writing bytes.
        """
        compiled.write_state(file, self._package.fingerprint, self._memory)

    def load(self, file: str | os.PathLike[str] | IO[bytes]) -> None:
        """Load a state that save() wrote; it must come from the same C package, but the profile may differ.

        Args:
            file: path, or a file that is open for reading bytes.

        Raises:
            ControllerError: the file was not written by save(), or it belongs to another package.
            OSError: the file cannot be read.
        """
        self._memory[:] = compiled.read_state(file, self._package, self._memory.shape)

    # -- calls and their arguments -------------------------------------------------------------------------------------

    def diagnose(self) -> str:
        """Explain why the last call was not OK."""
        raise NotImplementedError

    def _judge(self, status: int, call: str, on_failure: OnFailure) -> Status:
        judged = Status(status)
        if on_failure == "raise" and judged.is_failure:
            why = self.diagnose() if self.status == judged else str(judged)
            raise ControllerError(f"{self._package.name}.{call}: {why}")
        if on_failure not in ("raise", "status"):
            raise ControllerError(f"on_failure is {on_failure!r}; allowed: 'status', 'raise'")
        return judged

    def _functions(self, *names: str) -> tuple[Any, ...] | None:
        """Return the C functions with these names, looked up once; None if one of them does not exist."""
        if not all(map(self.description.offers, names)):
            return None
        return tuple(map(self._package.function, names))

    def _call(self, name: str, *arguments: Any) -> Any:
        return self._package.function(name)(*arguments)

    def _expect(self, status: int, call: str, what: str = "") -> None:
        """Raise ControllerError if a call that only writes data has failed."""
        if Status(status).is_failure:
            subject = f" ({what})" if what else ""
            raise ControllerError(f"{self._package.name}.{call}{subject}: {Status(status)}")

    def _violated_row(self) -> str | None:
        if "violated_row" not in self.description.members("stats"):
            return None
        index = int(self._struct["stats"]["violated_row"])
        return self.description.rows[index].name if index >= 0 else None

    def _buffer(self, size: int) -> tuple[Array, Any]:
        """Return an array of ``size`` numbers, backed by at least one number for C, and its pointer."""
        whole = np.zeros(max(1, size), dtype=self._real)
        return whole[:size], self._pointer(whole)

    def _pointer(self, array: Array) -> Any:
        contiguous = np.ascontiguousarray(array, dtype=self._real).reshape(-1)
        if contiguous.size == 0:
            contiguous = np.zeros(1, dtype=self._real)
        return self._package.ffi.from_buffer(f"{self._package.name}_real[]", contiguous)
