"""Results of the calls of a controller: status, residuals, counters, solution, diagnosis."""

from __future__ import annotations

import math
from collections.abc import Callable, Container
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
        "no plan was found that satisfies the constraints; the control is safe but not optimal",
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
    SUBPROBLEM_FAILED = (
        12,
        "a subproblem was given up",
        "an iteration of solve() was given up by its QP solver, and so was its relaxation",
    )
    NOT_CONVERGED = (
        13,
        "the plan does not satisfy the model to the tolerance",
        "the QP was solved and the control is safe, but the plan is far from the model or its rows",
    )

    @property
    def is_failure(self) -> bool:
        """True unless the control is that of a QP with all its rows: OK, or NOT_CONVERGED, where more samples help."""
        return self not in (Status.OK, Status.NOT_CONVERGED)

    def __str__(self) -> str:
        return f"{self.name}: {self.meaning}"

    def __format__(self, spec: str) -> str:
        if spec[-1:] in _INTEGER_TYPES:
            return int.__format__(self, spec)
        return format(str(self), spec)


#: Last letters of a format specification that ask for a number.
_INTEGER_TYPES = tuple("bcdeEfFgGnoxX%")


#: The residuals that every algorithm has.
KKT_PARTS = ("stationarity", "equality", "inequality", "complementarity")


@dataclass(frozen=True)
class Kkt:
    """Largest violation of each part of the optimality conditions.

    ``relative``: the largest of all, divided by 1 + the magnitudes of the terms that it sums; solve() stops when it is
    at most ``tol``, which therefore means the same in all units.
    """

    stationarity: float
    equality: float
    inequality: float
    complementarity: float
    relative: float = math.nan  # of an algorithm without it

    def __str__(self) -> str:
        return ", ".join(f"{part} {value:.1e}" for part, value in self.parts.items())

    @classmethod
    def read(cls, value: Callable[[str], Any], members: Container[str] = KKT_PARTS) -> Kkt:
        """From ``value`` of the parts that a C struct with these members has."""
        return cls(**{part: float(value(part)) for part in cls.__dataclass_fields__ if part in members})

    @property
    def parts(self) -> dict[str, float]:
        """The residuals as they are, by their names."""
        return {part: getattr(self, part) for part in KKT_PARTS}


#: What is said of a constant Hessian to which the present data do not belong.
STALE = (
    "the constant Hessian M belongs to other parameters, weights or bounds than the present ones: convergence may be "
    "slow or fail; compute M again for these, or return to the declared ones"
)


@dataclass(frozen=True)
class Stats:
    """Statistics of the last call. Times (ns) are those of the C calls alone.

    ``violated_row``, ``violated_node``, ``violation``: after INFEASIBLE or RELAXED the hard row (by the user's name)
    that the last step of the QP violates most, its node, and the violation; else None, None and 0.
    ``newton_iterations``, ``accepted``, ``faces``, ``cg_iterations``, ``shifts``, ``negative_curvature``: those of the
    augmented Lagrangian, whose ``violation`` is the largest gap or violation of a hard row in its scale; else 0. Single
    shooting has them without ``shifts``, and ``simulations`` of the plan.
    ``residual``: of the plan at which the QP of the last sample was linearised: its largest gap in the scale of the
    state, and the largest difference of a hard row from what the step before predicted for it, in the scale of the row;
    above ``RealTimeIteration(tolerance=...)`` the status is NOT_CONVERGED. Of the augmented Lagrangian and of single
    shooting it is that of the plan itself. ``repairs``: linearisations that prepare() has added to lower it.
    ``kkt``: of the present plan.
    ``first_deviation``: largest difference between the control of feedback_finish() and that of feedback_first().
    ``stale_hessian``: parameters, weights or bounds are not those for which a constant Hessian was computed.
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
    first_deviation: float = 0.0
    newton_iterations: int = 0
    accepted: int = 0
    cg_iterations: int = 0
    faces: int = 0
    shifts: int = 0
    negative_curvature: int = 0
    simulations: int = 0
    residual: float = 0.0
    repairs: int = 0

    def __str__(self) -> str:
        lines = [*(self._newton() if self.newton_iterations else self._qp())]
        lines += [
            f"plan: residual {self.residual:.1e} after {self.repairs} repairs",
            f"KKT: {self.kkt}",
            f"time: prepare {self.prepare_ns / 1e3:.1f} us, feedback {self.feedback_ns / 1e3:.1f} us",
        ]
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


# Diagnosis ------------------------------------------------------------------------------------------------------------


def diagnosis(ctrl: Any, measured: Array) -> str:
    """Why the last call of a Controller was not OK: node, state or row by its name, and what to try.

    ``measured``: the state (nx,) that it was given.
    """
    status = ctrl.status
    stale = [_stale(ctrl)] if ctrl.stats.stale_hessian else []
    if status == Status.OK:
        return "\n".join([str(status), *_left_by_samples(ctrl), *stale])
    broken = _broken_plan(ctrl, measured) or _broken_model(ctrl)
    lines = [str(status), *broken, *_worst_row(ctrl), *_advice(ctrl), *stale]
    return "\n".join(dict.fromkeys(lines))


def _stale(ctrl: Any) -> str:
    """STALE, and which parameters and bounds have other values than the declared ones."""
    description, changed = ctrl.description, []
    p, declared = ctrl.member("p"), [v for s in description.parameters for v in s.value]
    if p.size:
        differs = np.any(p != np.asarray(declared, dtype=p.dtype), axis=0)
        changed += [name for name, other in zip(ctrl.names.parameters, differs, strict=True) if other]
    for i, row in enumerate(description.rows if ctrl.member("lower").size else ()):
        bounds = ((ctrl.view("lower")[:, i], row.lower), (ctrl.view("upper")[:, i], row.upper))
        if any(np.any(present != present.dtype.type(bound)) for present, bound in bounds):
            changed.append(row.name)
    return f"{STALE} (not at their declared values: {', '.join(changed)})" if changed else STALE


#: Relative KKT residual of a sample above which steps with another Hessian than that of solve() may be the cause.
FAR_FROM_OPTIMAL = 0.01


def _solves_exactly(ctrl: Any) -> bool:
    """Whether solve() has the exact Hessian although samples have another."""
    return "hessian=GaussNewton(" in str(ctrl.description.options) and "in_solve" in ctrl.description.members("curved")


def _left_by_samples(ctrl: Any) -> list[str]:
    """That the plan is not optimal, which may be due to the steps of the samples."""
    if not _solves_exactly(ctrl) or not ctrl.kkt().relative > FAR_FROM_OPTIMAL:
        return []
    return [
        f"the plan is not optimal, relative KKT residual {ctrl.kkt().relative:.1e}: where it does not fall from sample "
        "to sample, Gauss-Newton steps leave the optimum that solve() finds: try Options(hessian=ExactHessian())"
    ]


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
    hard = "relaxation=None" in str(ctrl.description.options)
    choose = ', or choose RealTimeIteration(relaxation="auto")' if hard else ""
    return [
        f"row {stats.violated_row!r} at node {stats.violated_node} is violated by {stats.violation:.3g}: make it soft, "
        f"soft=(l1, l2), or widen it{choose}"
    ]


def _largest_gap(ctrl: Any) -> list[str]:
    """Where the plan is farthest from the model, in units of the state's largest value."""
    ends = [np.asarray(ctrl.integrate(ctrl.x[k], ctrl.u[k], dt)) for k, dt in enumerate(ctrl.description.dt)]
    gaps = np.abs(np.array(ends) - ctrl.x[1:])
    relative = gaps / (1e-9 + np.max(np.abs(ctrl.x), axis=0))
    if not np.all(np.isfinite(relative)) or np.max(relative) < 1e-6:
        return []
    node, i = np.unravel_index(int(np.argmax(relative)), relative.shape)
    return [
        f"the plan misses the model most in state {ctrl.names.states[i]} at node {node + 1}: by {gaps[node, i]:.3g}"
    ]


def _advice(ctrl: Any) -> list[str]:
    """What to try, by the status and the options of the package."""
    status, options, lines = ctrl.status, str(ctrl.description.options), []
    if status in (Status.ITERATION_LIMIT, Status.STALLED, Status.SUBPROBLEM_FAILED):
        lines += _largest_gap(ctrl)
        kkt = ctrl.kkt()
        part = max(kkt.parts, key=lambda name: float(np.nan_to_num(kkt.parts[name], nan=np.inf)))
        lines.append(f"largest residual: {part} {kkt.parts[part]:.1e}")
        if "hessian=GaussNewton(" in options and not _solves_exactly(ctrl):
            lines.append("Gauss-Newton steps ignore curvature and may cycle: try Options(hessian=ExactHessian())")
        if status == Status.SUBPROBLEM_FAILED:
            lines.append("the QP solver gave up: try another, Options(qp=...), or scale states, controls and rows")
        lines.append("call solve() before the first step(), or start from another plan: write ctrl.x and ctrl.u")
    elif status == Status.NUMERICAL_FAILURE:
        if "regularization=None" in options:
            lines.append("the Hessian may be indefinite: try ExactHessian(regularization=Mirror())")
        if "precision='single'" in options:
            lines.append('rounding may be the cause: try Options(precision="double")')
        lines.append("check the scales of states, controls and rows; after further failures the plan restarts")
        lines.append("try another QP solver, Options(qp=...), or Options(hessian=GaussNewton())")
    elif status == Status.NOT_CONVERGED:
        lines += _largest_gap(ctrl)
        lines.append(
            f"residual of the plan that was linearised: {ctrl.stats.residual:.2g}; one QP per sample does not follow it"
        )
        if "repair=0" in options:
            lines.append("let prepare() repair the plan: RealTimeIteration(repair=3)")
        lines.append("call solve() before the first step(), sample more often, or bound the states")
    elif status == Status.NOT_PREPARED:
        lines.append("call prepare() before feedback(), or step()")
    return lines
