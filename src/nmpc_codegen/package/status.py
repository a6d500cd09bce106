"""Calls of a controller return status, residuals and counters."""

from __future__ import annotations

import math
from collections.abc import Callable, Container
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]


class Status(IntEnum):
    """The status that a call of the C package returns; the values are those of <name>_status_t.

    A status prints as ``OK: solved``; it compares, converts and formats with ``d`` as an integer.

    Attributes:
        text: the result of <name>_status_string() in C.
        meaning: an explanation in one line.
    """

    text: str
    meaning: str

    def __new__(cls, value: int, text: str = "", meaning: str = "") -> Status:
        status = int.__new__(cls, value)
        status._value_, status.text, status.meaning = value, text, meaning
        return status

    OK = 0, "ok", "solved"
    ITERATION_LIMIT = (
        1,
        "iteration limit reached",
        "stopped at the iteration limit before the tolerance was reached",
    )
    INFEASIBLE = (
        2,
        "the constraints cannot be met",
        "no plan was found that satisfies the constraints; the control is safe but not optimal",
    )
    RELAXED = (
        3,
        "soft solution: rows were relaxed",
        "no plan meets all hard rows; the control is that of the plan that violates them least",
    )
    NUMERICAL_FAILURE = (
        4,
        "numerical failure: a factorisation broke down or a number is not finite",
        "a factorisation broke down, or a number is not finite; the control is safe but not optimal",
    )
    NOT_FINITE = (
        5,
        "the measured state is not finite",
        "the measured state contains a NaN or an infinity; the control is a safe one",
    )
    NOT_PREPARED = (
        6,
        "feedback without prepare",
        "feedback() was called without prepare(); the control is a safe one",
    )
    NOT_INITIALIZED = 7, "init was not called", "the struct was never initialised"
    BAD_INDEX = 8, "no such node, row or parameter", "the node does not exist, or its data cannot be set separately"
    BAD_BOUNDS = 9, "lower bound above upper bound", "lower bound above upper bound"
    BAD_ARGUMENT = 10, "argument out of range or not finite", "an argument is out of range"
    STALLED = 11, "no further progress", "no further progress was possible before the tolerance was reached"
    SUBPROBLEM_FAILED = (
        12,
        "a subproblem was given up",
        "an iteration of solve() was given up by its QP solver, and so was its relaxation",
    )
    NOT_CONVERGED = (
        13,
        "the plan does not satisfy the model to the tolerance",
        "the control is safe, but the plan is far from the model or its rows, or on its way",
    )

    @property
    def is_failure(self) -> bool:
        """Return True unless the status is OK or NOT_CONVERGED; then the control is that of a QP with all its rows."""
        return self not in (Status.OK, Status.NOT_CONVERGED)

    def __str__(self) -> str:
        return f"{self.name}: {self.meaning}"

    def __format__(self, spec: str) -> str:
        if spec[-1:] in _INTEGER_TYPES:
            return int.__format__(self, spec)
        return format(str(self), spec)


#: Last letters of format specifications for numbers.
_INTEGER_TYPES = tuple("bcdeEfFgGnoxX%")


#: The residuals that every algorithm has.
KKT_PARTS = ("stationarity", "equality", "inequality", "complementarity")


@dataclass(frozen=True)
class Kkt:
    """KKT residuals are the largest violation of each part of the optimality conditions.

    Attributes:
        stationarity: largest component of the gradient of the Lagrangian.
        equality: largest gap of the dynamics, or of x_0 - xhat.
        inequality: largest violation of bounds and rows.
        complementarity: largest product of a multiplier and the distance to its bound.
        relative: the largest of all residuals, each divided by its scale plus the magnitudes of its terms; solve()
            stops when it is at most ``tol``, which therefore does not depend on units. NaN for an algorithm without it.
    """

    stationarity: float
    equality: float
    inequality: float
    complementarity: float
    relative: float = math.nan  # NaN for an algorithm without it

    def __str__(self) -> str:
        return ", ".join(f"{part} {value:.1e}" for part, value in self.parts.items())

    @classmethod
    def read(cls, value: Callable[[str], Any], members: Container[str] = KKT_PARTS) -> Kkt:
        """Return the KKT residuals from ``value(name)``; those that are not in ``members`` keep their defaults."""
        return cls(**{part: float(value(part)) for part in cls.__dataclass_fields__ if part in members})

    @property
    def parts(self) -> dict[str, float]:
        """Return the absolute residuals by name."""
        return {part: getattr(self, part) for part in KKT_PARTS}


#: Words on a constant Hessian that is not valid for the present data.
STALE = (
    "the constant Hessian M belongs to other parameters, weights or bounds than the present ones: convergence may be "
    "slow or fail; compute M again for these, or return to the declared ones"
)


@dataclass(frozen=True)
class Stats:
    """Statistics describe the last call.

    Times (ns) are those of the C calls only; counters that an algorithm lacks are 0.

    Attributes:
        qp_iterations: iterations of the last QP.
        active_set_changes: changes of the working set of the last QP.
        dropped_rows: number of redundant rows that were left out.
        relaxed_rows: number of soft or relaxed rows that are violated.
        sqp_iterations: iterations of the last solve().
        violated_row: after INFEASIBLE or RELAXED the hard row (by the user's name) that the last step of the QP
            violates most; else None.
        violated_node: node of that row; else None.
        violation: violation of that row, else 0; for the augmented Lagrangian and for single shooting the largest gap
            or violation of a hard row in its scale.
        kkt: residuals of the present plan.
        prepare_ns: time of the preparation phase.
        feedback_ns: time of the feedback phase.
        stale_hessian: True if parameters, weights or bounds differ from those for which a constant Hessian was
            computed.
        newton_iterations: steps of the augmented Lagrangian or of single shooting.
        accepted: number of these steps that were accepted.
        cg_iterations: iterations of conjugate gradients.
        faces: number of sets of active bounds on which conjugate gradients ran.
        shifts: shifts of a preconditioner.
        negative_curvature: number of directions of negative curvature that were found.
        simulations: number of simulations of the plan, by single shooting.
        residual: residual of the plan at which the QP of the last sample was linearised: its largest gap in the scale
            of the state, and the largest difference of a hard row from its prediction in the last step, in the scale
            of the row; above ``RealTimeIteration(tolerance=...)`` the status is NOT_CONVERGED. For the augmented
            Lagrangian and for single shooting it is that of the plan itself.
        iterations: number of QPs of the last sample, or of rounds of the augmented Lagrangian.
        innovation: for an estimator, the largest |y - expected y| of the last sample, in standard deviations of that
            difference, at most 1e9; 0 without measurements.
        error: this difference, y - expected y, in the unit of the measurement.
        measurement: the measurement with this difference; None: nothing was measured.
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
    stale_hessian: bool = False
    newton_iterations: int = 0
    accepted: int = 0
    cg_iterations: int = 0
    faces: int = 0
    shifts: int = 0
    negative_curvature: int = 0
    simulations: int = 0
    residual: float = 0.0
    iterations: int = 1
    innovation: float = 0.0
    error: float = 0.0
    measurement: str | None = None

    def __str__(self) -> str:
        lines = [*(self._newton() if self.newton_iterations else self._qp())]
        lines += [
            f"plan: residual {self.residual:.1e} after {self.iterations} iterations",
            f"KKT: {self.kkt}",
            f"time: prepare {self.prepare_ns / 1e3:.1f} us, feedback {self.feedback_ns / 1e3:.1f} us",
        ]
        if self.measurement is not None:
            lines.append(f"innovation: {self.innovation:.2g} standard deviations, of {self.measurement}")
        if self.violated_row is not None:
            lines.insert(3, f"violated: {self.violated_row} at node {self.violated_node} by {self.violation:.3g}")
        return "\n".join([*lines, STALE] if self.stale_hessian else lines)

    def _qp(self) -> tuple[str, ...]:
        return (
            f"QP: {self.qp_iterations} iterations, {self.active_set_changes} changes of the active set",
            f"SQP: {self.sqp_iterations} iterations",
            f"rows: {self.dropped_rows} redundant, {self.relaxed_rows} soft or relaxed and violated",
        )

    def _newton(self) -> tuple[str, ...]:
        if self.simulations:
            return (
                f"steps: {self.newton_iterations}, {self.accepted} accepted, {self.simulations} simulations",
                f"conjugate gradients: {self.cg_iterations} products on {self.faces} faces",
                f"largest violation {self.violation:.3g}",
            )
        return (
            f"Newton: {self.newton_iterations} iterations, {self.accepted} accepted, on {self.faces} faces",
            f"conjugate gradients: {self.cg_iterations} iterations, {self.negative_curvature} negative curvatures",
            f"preconditioner: {self.shifts} shifts; largest gap or violation {self.violation:.3g}",
        )
