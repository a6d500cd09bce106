"""Gauss-Newton / SQP real-time iteration: one QP per sample, split into preparation and feedback phase.

prepare(): (shift,) linearise, Hessian, condense, factorise. feedback(xhat): embed, solve, expand, full step, u_0
([H11] section 2.2, [Q14] algorithm 3, algorithms.md 4). solve() iterates the same pieces to convergence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from nmpc_codegen.components.allowed import Number, Words, check_options, option
from nmpc_codegen.components.base import Counts, Defaults, Dims, Seam
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Field, Size, Struct, Table
from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.model import ModelFunctions, operations

SHIFTS = (None, "repeat", "periodic", "resample")
MAX_TRIALS = 30
MEMORY = 8


@dataclass(frozen=True)
class RealTimeIteration(Defaults):
    """One QP per sample, full step. ``shift``: how the plan moves before every prepare but the first.

    None: it stays. "repeat": by one interval, the last control is repeated and the tail integrated. "periodic": by one
    interval, the first control becomes the last, states are integrated anew, accumulators start at 0. "resample": the
    old plan is read ``sampling_time`` (s) later, on any grid. "repeat" and "periodic" are right only if the sampling
    time equals the first interval.

    ``relaxation``: l1 weight at which hard rows on states are relaxed at a sample whose QP is infeasible; the status is
    RELAXED then. None: the status is INFEASIBLE and the plan stays.
    """

    shift: str | None = option(None, Words(SHIFTS))
    sampling_time: float | None = option(None, Number(optional=True, unit="s"))
    relaxation: float | None = option(None, Number(optional=True))

    seam: ClassVar[Seam] = "algorithm"
    name: ClassVar[str] = "real_time_iteration"
    template: ClassVar[str] = "algorithms/real_time_iteration.c"
    needs: ClassVar[tuple[Seam, ...]] = ("integrator", "hessian", "condensing")
    supports: ClassVar[frozenset[str]] = frozenset(
        {"general cost", "integrated cost", "accumulators", "free initial state", "soft rows", "coupled rows"}
    )

    def __post_init__(self) -> None:
        check_options(self, self.seam)
        if (self.sampling_time is not None) != (self.shift == "resample"):
            raise OptionError(
                f'RealTimeIteration.sampling_time: {self.sampling_time!r} with shift={self.shift!r}; shift="resample" '
                "needs it, others not (--set algorithm.shift=... --set algorithm.sampling_time=...)"
            )

    @property
    def switches(self) -> Mapping[str, int]:
        """How shift() moves the plan, without an option by one interval; whether infeasible QPs are relaxed."""
        return {
            "SHIFT_RESAMPLE": int(self.shift == "resample"),
            "SHIFT_PERIODIC": int(self.shift == "periodic"),
            "RELAX": int(self.relaxation is not None),
        }

    def check(self, problem: Problem) -> None:
        """Moving by an interval needs intervals of one length, reading between nodes a differential equation."""
        if self.shift in ("repeat", "periodic") and not problem.uniform:
            raise OptionError(
                f'RealTimeIteration(shift="{self.shift}") moves the plan by one interval and clashes with a '
                'non-uniform grid; expected shift="resample", sampling_time=... '
                "(--set algorithm.shift=resample --set algorithm.sampling_time=...)"
            )
        if self.shift == "resample" and problem.discrete:
            raise OptionError(
                'RealTimeIteration(shift="resample") (--set algorithm.shift=resample) reads the plan between nodes '
                "and clashes with a discrete map"
            )

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Which components of x_0 are measured, which accumulate; times of the nodes for shift="resample"."""
        flags = tuple(int(i in problem.accumulators) for i in range(problem.nx))
        measured = tuple(int(i not in (*problem.accumulators, *problem.free_initial)) for i in range(problem.nx))
        accumulators = (
            Table("is_accumulator", "int", flags, "1: the state starts at 0 at every sample"),
            Table("is_measured", "int", measured, "1: x_0 is what is measured"),
            Table(
                "relaxation_weight",
                "real",
                (math.inf if self.relaxation is None else float(self.relaxation),),
                "l1 penalty of hard rows whose QP is infeasible; infinite: they stay hard",
            ),
        )
        if self.shift == "resample":
            times = tuple(math.fsum(problem.dt[:k]) for k in range(problem.N + 1))
            return (
                *accumulators,
                Table("node_time", "real", times, "t_k"),
                Table("sampling_time", "real", (float(self.sampling_time or 0.0),), "the plan is read so much later"),
            )
        return accumulators

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (
            ("SHIFT", int(self.shift is not None), "1: step() moves the plan before preparing"),
            ("MAX_TRIALS", MAX_TRIALS, "halvings of the step in the line search of solve()"),
            ("MEMORY", MEMORY, "merit values that the line search of solve() remembers"),
        )

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Linearisation of every node, multipliers (members of the solver), results."""
        nodes = Size("N + 1", dims.N.value + 1)
        return (
            Struct(
                "node",
                "linearisation of a path node",
                (
                    Field("S", (dims.nx, dims.nz), "[A_k B_k] = d Phi / d(x, u)", "data"),
                    Field("b", (dims.nx,), "gap Phi(x_k, u_k) - x_{k+1}", "data"),
                    Field("g", (dims.nz,), "gradient (q_k, r_k)", "data"),
                    Field("h", (dims.nh,), "general rows", "data"),
                    Field("J", (dims.nh, dims.nz), "their Jacobian [C_k D_k]", "data"),
                ),
                shape=(dims.N,),
            ),
            Struct(
                "terminal",
                "linearisation of the terminal node",
                (
                    Field("g", (dims.nx,), "gradient q_N", "data"),
                    Field("h", (dims.nh_N,), "general rows", "data"),
                    Field("J", (dims.nh_N, dims.nx), "their Jacobian C_N", "data"),
                ),
            ),
            *_coupled_and_step(dims),
            _line_search(dims),
            Struct(
                "solver",
                "",
                (
                    Field("lam", (nodes, dims.nx), "multipliers of the dynamics; lam_0 of x_0 = xhat", "iterate"),
                    Field("mu_x", (nodes, dims.nx), "multipliers of the state bounds, > 0 at the upper one", "iterate"),
                    Field("mu_u", (dims.N, dims.nu), "multipliers of the control bounds", "iterate"),
                    Field("mu", (dims.N, dims.nh), "multipliers of the general path rows", "iterate"),
                    Field("mu_N", (dims.nh_N,), "multipliers of the general terminal rows", "iterate"),
                    Field("eta", (dims.ne,), "multipliers of the coupled rows", "iterate"),
                    Field("xhat", (dims.nx,), "state measured at the last feedback", "keep"),
                    Field("prepared", (), "1 between prepare and feedback", "keep", "int32"),
                    Field("samples", (), "feedbacks since init or reset", "keep", "int32"),
                    Field("failing", (), "1: the last QP had no solution, 2: nor had the one before", "keep", "int32"),
                    Field(
                        "reference_changed",
                        (),
                        "1: gradients are renewed in feedback",
                        "keep",
                        "int32",
                        only="SET_REFERENCE",
                    ),
                ),
            ),
        )

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        """The linearisation of all nodes; a gap is one subtraction per state."""
        interval, path, terminal = model.interval, model.path, model.terminal
        derivatives = (interval.linearize, path.gradient) if interval.curved is None else (interval.curved,)
        node = operations(*derivatives, path.rows) + OpCount(add=dims.nx.value)
        return {"linearize": node * dims.N.value + operations(terminal.gradient, terminal.rows)}


def _coupled_and_step(dims: Dims) -> tuple[Struct, ...]:
    """Linearisation of the coupled rows, solution of the QP."""
    nodes = Size("N + 1", dims.N.value + 1)
    return (
        Struct(
            "coupled",
            "linearisation of the coupled rows",
            (
                Field("r", (dims.ne,), "values r(x_0, x_N)", "data"),
                Field("J_0", (dims.ne, dims.nx), "Jacobian E_0 = d r / d x_0", "data"),
                Field("J_N", (dims.ne, dims.nx), "Jacobian E_N = d r / d x_N", "data"),
            ),
        ),
        Struct(
            "step",
            "solution of the QP",
            (
                Field("dx", (nodes, dims.nx), "step of the states", "result"),
                Field("du", (dims.N, dims.nu), "step of the controls", "result"),
                Field("mult_u", (dims.N, dims.nu), "multipliers of the control bounds", "result"),
                Field("mult", (dims.ng,), "multipliers of the rows", "result"),
            ),
        ),
    )


def _line_search(dims: Dims) -> Struct:
    """Memory of solve() beyond that of the real-time iteration."""
    nodes = Size("N + 1", dims.N.value + 1)
    return Struct(
        "sqp",
        "line search of solve()",
        (
            Field("x", (nodes, dims.nx), "states before the step", "scratch"),
            Field("u", (dims.N, dims.nu), "controls before the step", "scratch"),
            Field("dx", (nodes, dims.nx), "step of the states", "scratch"),
            Field("du", (dims.N, dims.nu), "step of the controls", "scratch"),
            Field("dx_full", (nodes, dims.nx), "the same before the second-order correction", "scratch"),
            Field("du_full", (dims.N, dims.nu), "likewise", "scratch"),
            Field("b", (dims.N, dims.nx), "gaps at a trial point", "scratch"),
            Field("gap_weight", (), "weight of the gaps in the merit function", "scratch"),
            Field("row_weight", (), "weight of the rows; penalty of the elastic QP", "scratch", only="HARD_ROWS"),
            Field("recent", (Size("MEMORY", MEMORY),), "last merit values", "scratch"),
            Field("elastic", (), "1: the last QP was infeasible and relaxed", "scratch", "int32", only="HARD_ROWS"),
        ),
        only="SOLVE",
    )
