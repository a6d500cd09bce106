"""Moving horizon estimation by real-time iterations: the states of the last N intervals that fit all measurements best.

A sample moves the window by one node, linearises it at its last estimate and solves one QP, or a few. What the interval
that leaves the window tells of the state at its end is kept as arrival cost 1/2 |x_0 - xbar|^2_P^-1: one step of the
square-root Kalman filter, linearised at the estimate of the window, with the measurements that have left it and no
other. So the estimate of a linear problem without rows is that of the Kalman filter for every N.

Huber's loss is minimised by weights of the residuals, min(1, c / |r|), which follow the estimate.

Rao, Rawlings and Mayne, IEEE TAC 48 (2003), section III; Kuhl et al., Computers and Chemical Engineering 35 (2011).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import nmpc_codegen.components.algorithms.estimators as measuring
from nmpc_codegen.components.algorithms.real_time_iteration import RealTimeIteration
from nmpc_codegen.components.algorithms.row_scales import tolerance_table
from nmpc_codegen.components.algorithms.shifts import initial_tables
from nmpc_codegen.components.allowed import Number, Whole, check_options, option
from nmpc_codegen.components.base import Algorithm, Core, Counts, Dims, Parts, Seam
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.model import ModelFunctions
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.signals import EntryPoint
from nmpc_codegen.package.struct_layout import Field, Struct

#: What an estimator takes over of the iteration: its QP and its structs.
_ITERATION = RealTimeIteration(shift=None, iterations=1, relaxation=None)

#: Members of its structs that watch a plan from sample to sample.
_OF_CONTROL = frozenset(
    {
        "prepared",
        "failures",
        "probation",
        "unconverged",
        "unsettled",
        "lam_before",
        "violated_row",
        "violated_node",
        "first_control",
    }
    | {"violation", "sqp_iterations"}
)


@dataclass(frozen=True)
class MovingHorizon(Algorithm):
    """The algorithm of ``ocp.estimator(..., kind="mhe")``.

    Args:
        iterations: QPs of a sample at most; there is another one while the estimate moves by more than ``tolerance``,
            or a gap of the window is larger.
        tolerance: in the scale of a state. With a larger gap after the last iteration the sample is NOT_CONVERGED, and
            the estimate is that of the filter.
    """

    iterations: int = option(3, Whole(most=100))
    tolerance: float = option(0.1, Number())

    name: ClassVar[str] = "moving_horizon"
    template: ClassVar[str] = "algorithms/moving_horizon.c"
    needs: ClassVar[tuple[Seam, ...]] = ("integrator", "hessian", "condensing", "qp")
    default_hessian: ClassVar[str | None] = "gauss_newton"
    core: ClassVar[frozenset[Core]] = frozenset({"nodes", "multipliers", "products"})
    supports: ClassVar[frozenset[str]] = measuring.SUPPORTS

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    def check(self, problem: Problem) -> None:
        """Raise OptionError unless the problem is that of a window."""
        measuring.check(self, problem, "mhe")

    def check_parts(self, parts: Parts) -> None:
        """Raise OptionError for another Hessian than that of residuals."""
        if parts.hessian is None or parts.hessian.name != "gauss_newton":
            raise OptionError(
                f"hessian: an estimator minimises residuals; expected GaussNewton() instead of {parts.hessian!r}"
            )

    def entries(self, features: Features) -> tuple[EntryPoint, ...]:
        """A sample, the sensors, late measurements, the covariance, a new start."""
        return (
            *(measuring.estimate(features), measuring.measure(features)),
            *(measuring.CORRECT, measuring.COVARIANCE, measuring.RESTART),
        )

    @property
    def places(self) -> Mapping[str, str]:
        """Reference and weight of the cost of x_0 are those of the arrival cost."""
        return {"start_yref": "(s)->arrival.mean", "start_W": "&(s)->information[0][0]"}

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        return (*initial_tables(problem), *measuring.tables(problem), tolerance_table(self.tolerance))

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (*measuring.sizes(dims), ("ITERATIONS", self.iterations, "QPs of a sample, at most"))

    def absent_sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return _ITERATION.absent_sizes(dims)

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Those of an iteration, the window and its arrival cost."""
        members = (
            Field("arrival", (), "what is known of x_0 before the window", "keep", "filter"),
            Field("information", (dims.nx, dims.nx), "the inverse of its covariance", "keep"),
            Field("expected", (), "what the measurements are compared with", "keep", "filter"),
            Field("window", (), "node of the present sample", "keep", "int32"),
            *measuring.own_fields(dims),
        )
        shared = (
            replace(s, fields=tuple(f for f in s.fields if f.name not in _OF_CONTROL)) for s in _ITERATION.structs(dims)
        )
        told = Struct("stats", "", measuring.INNOVATION)
        return (*measuring.structs(dims), *shared, told, Struct("solver", "", members))

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        return {"window": (0, dims.N)}

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        return _ITERATION.cost(dims, model)
