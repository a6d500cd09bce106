"""Results of the calls of a controller: status, residuals, counters, solution, diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class Status(IntEnum):
    """The status that a call of the C package returns; the values are those of <name>_status_t.

    ``text`` is the result of <name>_status_string() in C, ``meaning`` an explanation in one line. It prints as
    ``OK: solved``, and it compares, converts and formats with ``d`` as an integer.
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
        "no plan satisfies the constraints; the control is safe but not optimal",
    )
    RELAXED = 3, "soft solution: rows were relaxed", "constraints had to be relaxed"
    NUMERICAL_FAILURE = (
        4,
        "numerical failure: a factorisation broke down or a number is not finite",
        "a factorisation broke down; the control is safe but not optimal",
    )
    NOT_FINITE = (
        5,
        "the measured state is not finite",
        "the state, the data or the iterate contains a NaN or an infinity; the control is a safe one",
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

    def __str__(self) -> str:
        return f"{self.name}: {self.meaning}"

    def __format__(self, spec: str) -> str:
        if spec[-1:] in _INTEGER_TYPES:
            return int.__format__(self, spec)
        return format(str(self), spec)


#: Last letters of a format specification that ask for a number.
_INTEGER_TYPES = tuple("bcdeEfFgGnoxX%")


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
    """Statistics of the last call. Times (ns) are those of the C calls alone.

    ``violated_row``, ``violated_node``, ``violation``: after INFEASIBLE or RELAXED the hard row (by the user's name)
    that the last step of the QP violates most, its node, and the violation; else None, None and 0.
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

    It prints in a few lines: status, cost, iterations, time, KKT residuals, first control, shapes.
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


# Diagnosis ------------------------------------------------------------------------------------------------------------


def diagnosis(ctrl: Any, measured: Array) -> str:
    """Why the last call of a Controller was not OK: node, state or row by its name, and what to try.

    ``measured``: the state (nx,) that it was given.
    """
    status = ctrl.status
    if status == Status.OK:
        return str(status)
    broken = _broken_plan(ctrl, measured) or _broken_model(ctrl)
    lines = [str(status), *broken, *_worst_row(ctrl), *_advice(ctrl)]
    return "\n".join(dict.fromkeys(lines))


def _broken_plan(ctrl: Any, measured: Array) -> list[str]:
    """The first number of the measured state or of the plan that is not finite."""
    names = ctrl.names
    unknown = [n for n, v in zip(names.states, measured, strict=True) if not np.isfinite(v)]
    if unknown and ctrl.status == Status.NOT_FINITE:
        return [f"measured {', '.join(unknown)} is not finite"]
    for what, array, columns in (("state", ctrl.x, names.states), ("control", ctrl.u, names.controls)):
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            node, i = bad[0]
            return [f"{what} {columns[i]} at node {node} of the plan is not finite: call reset(), or write the plan"]
    return []


def _broken_model(ctrl: Any) -> list[str]:
    """The first interval over which the model yields no finite state."""
    for k, dt in enumerate(ctrl.description.dt):
        end = np.asarray(ctrl.integrate(ctrl.x[k], ctrl.u[k], dt))
        bad = [name for name, value in zip(ctrl.names.states, end, strict=True) if not np.isfinite(value)]
        if bad:
            pairs = zip(ctrl.names.states, ctrl.x[k], strict=True)
            start = ", ".join(f"{name} = {value:.4g}" for name, value in pairs)
            return [
                f"the model yields no finite {', '.join(bad)} at the end of interval {k}, from {start}: try bounds "
                "that keep the plan inside the domain of the model, more integration steps, or another start"
            ]
    return []


def _worst_row(ctrl: Any) -> list[str]:
    stats = ctrl.stats
    if stats.violated_row is None:
        return []
    return [
        f"row {stats.violated_row!r} at node {stats.violated_node} is violated by {stats.violation:.3g}: make it soft "
        "(soft=(l1, l2)), widen it, or choose RealTimeIteration(relaxation=...)"
    ]


def _advice(ctrl: Any) -> list[str]:
    """What to try, by the status and the options of the package."""
    status, options, lines = ctrl.status, str(ctrl.description.options), []
    if status in (Status.ITERATION_LIMIT, Status.STALLED):
        kkt = ctrl.kkt()
        part = max(vars(kkt), key=lambda name: float(np.nan_to_num(vars(kkt)[name], nan=np.inf)))
        lines.append(f"largest residual: {part} {vars(kkt)[part]:.1e}")
        if "hessian=GaussNewton(" in options:
            lines.append("Gauss-Newton steps ignore curvature and may cycle: try Options(hessian=ExactHessian())")
        lines.append("call solve() before the first step(), or start from another plan: write ctrl.x and ctrl.u")
    elif status == Status.NUMERICAL_FAILURE:
        if "regularization=None" in options:
            lines.append("the Hessian may be indefinite: try ExactHessian(regularization=Mirror())")
        if "precision='single'" in options:
            lines.append('rounding may be the cause: try Options(precision="double")')
        lines.append("check the scales of states, controls and rows; after further failures the plan restarts")
    elif status == Status.NOT_PREPARED:
        lines.append("call prepare() before feedback(), or step()")
    return lines
