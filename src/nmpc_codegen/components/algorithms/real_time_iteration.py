"""The Gauss-Newton / SQP real-time iteration solves one QP per sample, split into preparation and feedback phase.

prepare(): (shift,) linearise, Hessian, condense, factorise. feedback(xhat): embed, solve, expand, full step, u_0.
solve() iterates these operations to convergence.

Houska, Ferreau and Diehl, Automatica 47 (2011), section 2.2; Quirynen et al., CDC 2014, algorithm 3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import nmpc_codegen.components.algorithms.hooked_parts as at_hooks
from nmpc_codegen.components.algorithms.row_scales import tolerance_table
from nmpc_codegen.components.algorithms.shifts import (
    SHIFTS,
    check_sampling_time,
    check_shift,
    decide_shift,
    initial_tables,
    resample_reach,
    resample_tables,
    resample_time,
    with_shift,
)
from nmpc_codegen.components.allowed import Number, Whole, Words, check_options, option
from nmpc_codegen.components.base import (
    EVERY_USE,
    MEASUREMENTS,
    Algorithm,
    Core,
    Counts,
    Dims,
    HookedPart,
    Parts,
    Seam,
    spell,
)
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.model import ModelFunctions, operations
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.signals import Argument, EntryPoint
from nmpc_codegen.package.struct_layout import Field, Size, Struct

_XHAT = Argument("xhat", "real", ("NX",))
_U0 = Argument("u0", "real", ("NU",))
SAMPLE = (
    EntryPoint(
        "feedback",
        "Feedback phase: compute u0 for the measured xhat; u0 is finite and inside its bounds on every return.",
        (_XHAT,),
        (_U0,),
    ),
    EntryPoint("step", "Call prepare, then feedback.", (_XHAT,), (_U0,)),
)
SOLVE = EntryPoint(
    "solve",
    "Iterate from the present plan, with globalisation, until the relative KKT residual, kkt.relative, is at most tol "
    "or max_iterations is reached; kkt and stats describe the outcome.",
    (_XHAT, Argument("tol", "real"), Argument("max_iterations", "int")),
)


def _prepare(moves: bool) -> EntryPoint:
    steps = ", ".join([*["move the plan to the next sample"] * moves, "linearise, condense, factorise"])
    failed = "A call that fails leaves the plan unchanged; feedback restarts a plan that fails repeatedly."
    return EntryPoint("prepare", f"Preparation phase: {steps}. {failed}")


def shift_entry(shift: str | None) -> EntryPoint:
    """Return the entry point that shifts the plan; if ``shift`` is not None, samples shift the plan as well."""
    again = " Every sample except the first does this itself, so that a call moves the plan once more." if shift else ""
    return EntryPoint("shift", f"Move the plan by one interval.{again}")


MAX_TRIALS = 30
FILTER = 16
MAX_ATTEMPTS = 3
# Shifts of an indefinite Hessian in solve(), each four times the last one, and bisections of the last interval.
MAX_SHIFTS = 24
BISECTIONS = 3
#: Largest number of departures of solve() from saddles without a better plan, and of iterations of one departure.
DEPARTURES, DEPARTURE = 2, 20
#: With at least this tolerance no plan is judged.
UNJUDGED = 1e30
#: Price of a relaxed row at the first node, relative to that at the last one, after RELAXED_SAMPLES relaxed samples in
#: a row.
LEAST_PRICE, RELAXED_SAMPLES = 1e-6, 10
#: Factor by which the price recovers more slowly in samples that are OK.
SLOWER = 4
#: A mark that no time has passed since solve().
SOLVED = Field("solved", (), "1: the plan is that of the last solve(), not yet shifted", "keep", "int32")
SAMPLES = Field("samples", (), "feedbacks since init or reset", "keep", "int32")


def state_size(dims: Dims) -> Field:
    """Return the member with the largest states of the last plan that was OK."""
    return Field("state_size", (dims.nx,), "largest states of the last plan that was OK", "keep")


@dataclass(frozen=True)
class RealTimeIteration(Algorithm):
    """A sample solves one QP and takes its full step, and iterates further until the plan is near a solution.

    Args:
        shift: shift of the plan before every prepare() except the first. None: no shift. "repeat": by one interval; the
            last control is repeated and the last state integrated. "periodic": by one interval; the first control
            becomes the last one, the states are integrated again, and accumulators start at 0. "resample": the old plan
            is evaluated ``sampling_time`` later, on any grid. "auto": "periodic" if coupled rows compare x_N with a
            measured x_0; None if parts of x_0 are not measured, or the grid is not uniform; else "resample" if a
            ``sampling_time`` is given that differs from the interval, otherwise "repeat".
        sampling_time: time between samples (the OCP's unit of time); with "repeat" and "periodic" it must be one
            interval. None: one interval.
        iterations: largest number of QPs in a sample. The first one is that of the real-time iteration. If it fails, or
            its step leads to a plan far from a solution, iterations of solve() follow until the plan is near one. 1:
            none follow; with shift=None and relaxation=None this is the scheme of the literature.
        tolerance: stats.residual above which the plan after a sample is far from a solution, so that the status is
            NOT_CONVERGED. It is the largest of the gaps, the violations of hard rows and the relative KKT residual.
            1e30: no plan is judged.
        relaxation: "auto": hard rows on states are relaxed in a sample whose QP is infeasible; the status is then
            RELAXED. A violation of the size of its row costs 1e4 units of the cost, and less at early nodes while
            samples stay RELAXED. None: the status is INFEASIBLE, and the plan does not change.

    Examples:
        >>> from nmpc_codegen import Options, RealTimeIteration
        >>> options = Options(algorithm=RealTimeIteration(sampling_time=0.02))
    """

    shift: str | None = option("auto", Words(("auto", *SHIFTS)))
    sampling_time: float | None = option(None, Number(optional=True, unit="s"))
    iterations: int = option(10, Whole(most=100))
    tolerance: float = option(0.1, Number())
    relaxation: str | None = option("auto", Words(("auto", None)))

    name: ClassVar[str] = "real_time_iteration"
    template: ClassVar[str] = "algorithms/real_time_iteration.c"
    needs: ClassVar[tuple[Seam, ...]] = ("integrator", "hessian", "condensing", "qp")
    default_hessian: ClassVar[str | None] = "gauss_newton"
    core: ClassVar[frozenset[Core]] = frozenset({"nodes", "multipliers", "products", "kkt"})
    supports: ClassVar[frozenset[str]] = EVERY_USE - {MEASUREMENTS}

    def __post_init__(self) -> None:
        check_options(self, self.seam)
        check_sampling_time("RealTimeIteration", self.shift, self.sampling_time)

    def decide(self, problem: Problem, small: bool) -> tuple[RealTimeIteration, tuple[str, ...]]:
        """Choose the shift for "auto", and one iteration in a package that has no solve()."""
        shift, reasons = decide_shift(self.shift, self.sampling_time, problem)
        found = replace(self, shift=shift, sampling_time=resample_time(shift, self.sampling_time, problem))
        if self.iterations > 1 and small:
            found = replace(found, iterations=1)
            reasons.append('iterations: 1; goal="size" without solve()')
        return found, tuple(reasons)

    def check_parts(self, parts: Parts) -> None:
        """Raise OptionError for a QP solver without a working set if the Hessian is made convex on the working set."""
        hessian = Features() if parts.hessian is None else parts.hessian.adds(Features())
        if hessian.regularize_reduced and parts.qp is not None and parts.qp.adds(Features()).approximate:
            raise OptionError(
                f"{spell(parts.qp)} has no working set and clashes with a Hessian that is "
                "made convex on one; expected ExactHessian(Mirror(level='stage')) "
                "(--set hessian.regularization.level=stage), GaussNewton() or another QP solver"
            )

    def entries(self, features: Features) -> tuple[EntryPoint, ...]:
        """Return the entry points: both phases of a sample, a sample in one call, the shift, and solve()."""
        prepare = _prepare(self.shift is not None)
        return (prepare, *SAMPLE, shift_entry(self.shift), *((SOLVE,) if features.solve else ()))

    def adds(self, features: Features) -> Features:
        """Return the features with the kind of shift(), relaxation of hard rows, and further iterations."""
        return replace(
            with_shift(features, self.shift),
            relax=self.relaxation is not None,
            iterates=self.iterations > 1,
            judges=self.tolerance < UNJUDGED,
        )

    def hooked_parts(self, features: Features) -> tuple[HookedPart, ...]:
        """Return the parts that options, Hessian and rows add to a sample."""
        failure = at_hooks.RELAXATION if self.relaxation is not None else at_hooks.VIOLATION
        goes_on = features.iterates and features.judges
        wanted = (
            (at_hooks.SHIFT, self.shift is not None),
            (at_hooks.REFERENCES, features.set_reference),
            (failure, features.hard_rows),
            (at_hooks.BENT_ROWS, features.nonlinear_rows),
            (at_hooks.NEARNESS, features.judges),
            (at_hooks.ITERATIONS, goes_on),
            (at_hooks.FIRST_SAMPLE, goes_on),
        )
        return tuple(part for part, present in wanted if present)

    def check(self, problem: Problem) -> None:
        """Raise OptionError for a shift that clashes with the grid."""
        check_shift("RealTimeIteration", self.shift, self.sampling_time, problem)

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Return flags of accumulators and measured components of x_0, prices of relaxed rows, node times."""
        least = LEAST_PRICE ** (1 / problem.N)
        prices = (
            Table("least_price", "real", (least,), "least price of a relaxed row, relative to that at the next node"),
            Table(
                "price_change",
                "real",
                (least ** (1 / RELAXED_SAMPLES), least ** (-1 / RELAXED_SAMPLES / SLOWER)),
                "change of that ratio by a sample that is relaxed, and by one that is OK",
            ),
        )
        tolerance = tolerance_table(self.tolerance)
        return (
            *initial_tables(problem),
            *prices,
            tolerance,
            *resample_tables(self.shift, self.sampling_time, problem),
        )

    def reach(self, problem: Problem) -> float:
        """Return for shift="resample" the longest time from a node of the old plan to a new node.

        Rounding may place a new node after the next old node.
        """
        return resample_reach(self.shift, self.sampling_time, problem)

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (
            ("SAMPLE_ITERATIONS", self.iterations, "QPs of a sample, at most"),
            ("RESTART_SAMPLES", at_hooks.RESTART_SAMPLES, "failed samples in a row after which a plan starts anew"),
            ("CHECKED", at_hooks.CHECKED, "samples of which one checks the optimality of its plan"),
            ("SHIFT", int(self.shift is not None), "1: step() moves the plan before preparing"),
            ("MAX_TRIALS", MAX_TRIALS, "halvings of a step in a line search"),
            ("MAX_ATTEMPTS", MAX_ATTEMPTS, "new starts of a search where rows cannot be satisfied, at most"),
            ("DEPARTURES", DEPARTURES, "departures from saddles that lead to no better plan, at most"),
            ("DEPARTURE", DEPARTURE, "iterations of a departure, at most"),
            ("MAX_SHIFTS", MAX_SHIFTS, "shifts of an indefinite Hessian that are tried"),
            ("BISECTIONS", BISECTIONS, "bisections of the last interval of shifts"),
            ("FILTER", FILTER, "pairs of violation and cost that a search does not accept again"),
        )

    def absent_sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("LANES", 1, "blocks that are decomposed at once"),)

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs for the solution of the QP, counters, and data kept between samples."""
        keep = (
            Field("xhat", (dims.nx,), "state measured at the last feedback", "keep"),
            Field("prepared", (), "1 between prepare and feedback", "keep", "int32"),
            replace(SAMPLES, only=lambda f: self.shift or f.iterates or f.judges),
            replace(SOLVED, only=lambda f: f.solve and self.shift),
            state_size(dims),
            Field(
                *("most_iterations", (), "QPs that a sample may take, at most SAMPLE_ITERATIONS", "keep", "int32"),
                only=lambda f: f.iterates,
            ),
            *at_hooks.watch_fields(dims),
        )
        results = (
            Field("step", (), "solution of the QP", "data", "step"),
            Field("stats", (), "counters", "result", "stats"),
            Field(
                "kkt",
                (),
                "KKT residuals that were evaluated last",
                "result",
                "kkt",
                only=lambda f: f.search or f.judges,
            ),
        )
        return (
            _stats(),
            _step(dims),
            _measures(),
            _hessian_struct(dims),
            _trial(dims),
            _search(dims),
            Struct("solver", "", (*keep, *results)),
        )

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        """Return the ranges of members: a sample of one iteration runs no part of solve()."""
        several = int(self.iterations > 1)
        return {"in_solve": (0, several), "most_iterations": (1, self.iterations), "entries": (0, FILTER)}

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        """Count the linearisation of all nodes; a gap is one subtraction per state."""
        interval, path, terminal = model.interval, model.path, model.terminal
        derivatives = (interval.linearize, path.gradient) if interval.curved is None else (interval.curved,)
        node = operations(*derivatives, path.rows) + OpCount(add=dims.nx)
        at_ends = operations(model.start.gradient, terminal.gradient, terminal.rows, model.coupled)
        added = OpCount(add=dims.nx if model.start.gradient.writes else 0)
        return {"linearize": node * dims.N + at_ends + added + model.following * (dims.N + 1)}


def _stats() -> Struct:
    """Return the counters of the last sample, and the row that the sample could not satisfy."""

    def count(name: str, doc: str) -> Field:
        return Field(name, (), doc, "result", "int32")

    return Struct(
        "stats",
        "counters of the last feedback or solve",
        (
            count("qp_iterations", "iterations of the last QP"),
            count("active_set_changes", "changes of the working set in the last QP"),
            count("dropped_rows", "redundant rows left out of the working set"),
            count("relaxed_rows", "soft or relaxed rows that are violated"),
            Field("sqp_iterations", (), "iterations of the last search", "result", "int32", only=lambda f: f.search),
            Field("iterations", (), "QPs of the last sample", "result", "int32", only=lambda f: f.iterates),
            Field(
                *("stale_hessian", (), "1: the Hessian belongs to other data than the present ones", "result", "int32"),
                only=lambda f: f.tuned,
            ),
            count("violated_row", "hard row that is infeasible (INFEASIBLE) or relaxed (RELAXED), or -1"),
            count("violated_node", "its node, or -1"),
            Field("violation", (), "violation of violated_row by the last step of the QP", "result"),
            Field("residual", (), "residual of the plan: scaled gaps, hard rows, relative KKT residual", "result"),
        ),
    )


def _step(dims: Dims) -> Struct:
    """Return the struct for the solution of the QP."""
    nodes = dims.nodes
    return Struct(
        "step",
        "solution of the QP",
        (
            Field("dx", (nodes, dims.nx), "step of the states", "result"),
            Field("du", (dims.N, dims.nu), "step of the controls", "result"),
            Field("mult_u", (dims.N, dims.nu), "multipliers of the control bounds", "result"),
            Field("mult", (dims.ng,), "multipliers of the rows", "result"),
        ),
    )


def _measures() -> Struct:
    """Return the struct for the measures by which solve() compares two points."""
    return Struct(
        "measures",
        "measures of a point",
        (
            Field("violation", (), "violation of gaps, initial condition and rows, in their scales", "scratch"),
            Field("cost", (), "cost with the penalties of the soft rows", "scratch"),
        ),
        only=lambda f: f.search,
    )


def _hessian_struct(dims: Dims) -> Struct:
    """Return the struct for the exact Hessian of solve(), and for making it convex."""
    nodes = dims.nodes
    return Struct(
        "curved",
        "exact Hessian of a search, symmetric blocks, z = (x, u)",
        (
            Field("Q", (dims.N, dims.nz, dims.nz), "path blocks", "scratch"),
            Field("Q_N", (dims.nx, dims.nx), "terminal block", "scratch"),
            Field("g", (nodes, dims.nz), "gradients without the terms of held rows", "scratch"),
            Field("P", (dims.nx, dims.nx), "cost to go", "scratch"),
            Field("M", (dims.nz, dims.nz), "cost to go of a stage", "scratch"),
            Field("T", (dims.nx, dims.nz), "P [A B]", "scratch"),
            Field("unit", (dims.nz,), "curvature that is typical of each variable", "scratch"),
            Field("weight_u", (dims.N, dims.nu), "weight of the controls that are held, else 0", "scratch"),
            Field("target_u", (dims.N, dims.nu), "bounds at which they are held", "scratch"),
            Field("weight", (dims.ng,), "weight of the rows that are held, else 0", "scratch"),
            Field("target", (dims.ng,), "bounds at which they are held", "scratch"),
            Field("hold", (), "factor of the weights", "scratch"),
            Field("shift", (), "smallest shift that made the last indefinite Hessian convex", "scratch"),
            Field("used", (), "shift of the last QP", "scratch"),
            Field("proximal", (), "shift of a Hessian that is only semidefinite", "scratch"),
            Field("damping", (), "shift of every Hessian while steps are short", "scratch"),
            Field("in_solve", (), "1: this is the Hessian of the QP", "scratch", "int32"),
        ),
        only=lambda f: f.curved,
    )


def _trial(dims: Dims) -> Struct:
    """Return the struct for a step of a QP that is tried at several lengths."""
    nodes = dims.nodes
    return Struct(
        "trial",
        "a step that is tried at several lengths",
        (
            Field("x", (nodes, dims.nx), "states before the step", "scratch"),
            Field("u", (dims.N, dims.nu), "controls before the step", "scratch"),
            Field("step", (), "the step at its full length", "scratch", "step"),
            Field("lam", (nodes, dims.nx), "multipliers of the QP", "scratch", only=lambda f: f.keeps_multipliers),
            Field("length", (), "length of the last step", "scratch"),
            Field("elastic", (), "1: the last QP was infeasible and relaxed", "scratch", "int32"),
        ),
        only=lambda f: f.search,
    )


def _departs(features: Features) -> bool:
    return features.saddles and features.solve


def _search(dims: Dims) -> Struct:
    """Return the struct for the search of solve()."""
    weight, infeasible = "penalty of the rows in the elastic QP", "1: one of them ended where rows contradict"
    return Struct(
        "sqp",
        "search for a solution",
        (
            Field("state_scale", (dims.nx,), "scales of the states", "scratch"),
            Field("row_weight", (), weight, "scratch", only=lambda f: f.hard_rows),
            Field("filter", (Size("FILTER", FILTER),), "pairs of the filter", "scratch", "measures"),
            Field("entries", (), "entries of the filter", "scratch", "int32"),
            Field("restoring", (), "1: steps only have to reduce the violation", "scratch", "int32"),
            Field("base", (), "measures before the step", "scratch", "measures"),
            Field("slope", (), "slope of the cost along the step", "scratch"),
            Field("gain", (), "predicted reduction of the violation by the step", "scratch"),
            Field("cost_unit", (), "how much the cost may change", "scratch"),
            Field("cost_scale", (), "largest slope of the cost", "scratch"),
            Field("most_violation", (), "violation that is never accepted", "scratch"),
            Field("attempts", (), "number of new starts", "scratch", "int32"),
            Field("departures", (), "departures that found no better plan", "scratch", "int32", only=_departs),
            Field("probes", (), "saddles that have been left", "scratch", "int32", only=lambda f: f.saddles),
            Field(
                "hasty", (), "1: in a sample, which has few iterations", "scratch", "int32", only=lambda f: f.iterates
            ),
            Field(
                *("linearized", (), "1: the present point is linearised", "scratch", "int32"),
                only=lambda f: f.iterates,
            ),
            Field(
                *("before", (), "relative KKT residual before the last iteration", "scratch"),
                only=lambda f: f.iterates and f.curved,
            ),
            Field("infeasible", (), infeasible, "scratch", "int32", only=lambda f: f.hard_rows),
            Field(
                *("resumes", (), "set to 1 before solve() goes on from where it reached its limit", "scratch", "int32"),
                only=lambda f: f.solve,
            ),
        ),
        only=lambda f: f.search,
    )
