"""What a call of a controller reports: status, residuals, counts, solution."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]


class Status(IntEnum):
    """What a call of the C package returns; the values are those of <name>_status_t.

    Printed it is ``OK: solved``; it compares, converts and formats with ``d`` as the integer it is.
    """

    OK = 0
    ITERATION_LIMIT = 1
    INFEASIBLE = 2
    RELAXED = 3
    NUMERICAL_FAILURE = 4
    NOT_FINITE = 5
    NOT_PREPARED = 6
    NOT_INITIALIZED = 7
    BAD_INDEX = 8
    BAD_BOUNDS = 9
    BAD_ARGUMENT = 10
    STALLED = 11

    @property
    def meaning(self) -> str:
        """One line for a person."""
        return _MEANINGS[self]

    def __str__(self) -> str:
        return f"{self.name}: {self.meaning}"

    def __format__(self, spec: str) -> str:
        if spec[-1:] in _INTEGER_TYPES:
            return int.__format__(self, spec)
        return format(str(self), spec)


#: Last letters of a format specification that ask for a number.
_INTEGER_TYPES = tuple("bcdeEfFgGnoxX%")


_MEANINGS = {
    Status.OK: "solved",
    Status.ITERATION_LIMIT: "stopped at the iteration limit before the tolerance was reached",
    Status.INFEASIBLE: "no plan satisfies the constraints; the control is safe but not optimal",
    Status.RELAXED: "constraints had to be relaxed",
    Status.NUMERICAL_FAILURE: "a factorisation broke down; the control is safe but not optimal",
    Status.NOT_FINITE: "the state, the data or the iterate holds a NaN or an infinity; the control is a safe one",
    Status.NOT_PREPARED: "feedback() was called without prepare(); the control is a safe one",
    Status.NOT_INITIALIZED: "the struct was never initialised",
    Status.BAD_INDEX: "the node does not exist, or may not be set by itself",
    Status.BAD_BOUNDS: "lower bound above upper bound",
    Status.BAD_ARGUMENT: "an argument is out of range",
    Status.STALLED: "no further progress was possible before the tolerance was reached",
}


@dataclass(frozen=True)
class Kkt:
    """Largest violation of each part of the optimality conditions."""

    stationarity: float
    equality: float
    inequality: float
    complementarity: float

    def __str__(self) -> str:
        return ", ".join(f"{part} {value:.1e}" for part, value in vars(self).items())


@dataclass(frozen=True)
class Stats:
    """What the last call did. Times (ns) are those of the C calls alone.

    ``violated_row``, ``violated_node``, ``violation``: after INFEASIBLE or RELAXED the hard row (the user's name) that
    the last step of the QP violates most, its node, and by how much; else None, None and 0.
    """

    qp_iterations: int
    active_set_changes: int
    dropped_rows: int
    relaxed_rows: int
    sqp_iterations: int
    violated_row: str | None
    violated_node: int | None
    violation: float
    kkt: Kkt
    prepare_ns: int
    feedback_ns: int

    def __str__(self) -> str:
        lines = [
            f"QP: {self.qp_iterations} iterations, {self.active_set_changes} changes of the active set",
            f"SQP: {self.sqp_iterations} iterations",
            f"rows: {self.dropped_rows} redundant, {self.relaxed_rows} soft or relaxed and violated",
            f"KKT: {self.kkt}",
            f"time: prepare {self.prepare_ns / 1e3:.1f} us, feedback {self.feedback_ns / 1e3:.1f} us",
        ]
        if self.violated_row is not None:
            lines.insert(3, f"violated: {self.violated_row} at node {self.violated_node} by {self.violation:.3g}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """Result of solve(); arrays are copies. Multipliers are positive at upper and negative at lower bounds.

    Printed it is a few lines: status, cost, iterations, time, KKT residuals, first control, shapes.
    """

    status: Status
    x: Array  # (N+1, nx)
    u: Array  # (N, nu)
    lam: Array  # (N+1, nx): lam[0] of x_0 = xhat, lam[k+1] of x_{k+1} = Phi_k
    mu_x: Array  # (N+1, nx)
    mu_u: Array  # (N, nu)
    mu: Array  # (N, nh)
    mu_N: Array  # (nh_N,)
    eta: Array  # (number of coupled rows,)
    cost: float
    kkt: Kkt
    iterations: int
    time_ns: int
    controls: tuple[str, ...] = ()  # names of the controls

    def __str__(self) -> str:
        names = self.controls or tuple(f"u[{j}]" for j in range(self.u.shape[1]))
        first = ", ".join(f"{name} = {value:.6g}" for name, value in zip(names, self.u[0], strict=True))
        return "\n".join(
            (
                str(self.status),
                f"cost {self.cost:.8g} after {self.iterations} iterations, {self.time_ns / 1e3:.1f} us",
                f"KKT: {self.kkt}",
                f"first control: {first}",
                f"x {self.x.shape}, u {self.u.shape}",
            )
        )

    def __repr__(self) -> str:
        sizes = f"x {self.x.shape}, u {self.u.shape}"
        return f"<Solution {self.status.name}: cost {self.cost:.8g}, {self.iterations} iterations, {sizes}>"
