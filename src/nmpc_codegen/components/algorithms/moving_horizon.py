"""Moving horizon estimation by real-time iterations finds the states of the last N intervals that fit the measurements.

A sample moves the window by one node, linearises it at its last estimate and solves one QP, or a few. The information
of the interval that leaves the window is kept as arrival cost 1/2 |x_0 - xbar|^2_P^-1. The arrival cost is updated by
one step of the square-root Kalman filter, linearised at the estimate of the window, with exactly the measurements that
have left the window. Without rows, the estimate of a linear problem therefore equals that of the Kalman filter for
every N.

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

#: The real-time iteration whose QP and structs the estimator uses.
_ITERATION = RealTimeIteration(shift=None, iterations=1, relaxation=None)

#: Members of its structs that only controllers use.
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
    """Moving horizon estimation is the algorithm of ``ocp.estimator(..., kind="mhe")``.

    Args:
        iterations: largest number of QPs in a sample; another QP follows while the estimate moves, or a gap of the
            window is larger, than ``tolerance``.
        tolerance: limit of these in the scale of a state. If a gap is larger after the last iteration, the sample is
            NOT_CONVERGED, and the estimate is that of the filter.
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
        """Raise OptionError for a Hessian other than that of residuals."""
        if parts.hessian is None or parts.hessian.name != "gauss_newton":
            raise OptionError(
                f"hessian: an estimator minimises residuals; expected GaussNewton() instead of {parts.hessian!r}"
            )

    def entries(self, features: Features) -> tuple[EntryPoint, ...]:
        """Return the entry points: a sample, the sensors, late measurements, the covariance, a restart."""
        return (
            *(measuring.estimate(features), measuring.measure(features)),
            *(measuring.CORRECT, measuring.COVARIANCE, measuring.RESTART),
        )

    @property
    def places(self) -> Mapping[str, str]:
        """Return where reference and weight of the cost of x_0 are stored: in the arrival cost."""
        return {"start_yref": "(s)->arrival.mean", "start_W": "&(s)->information[0][0]"}

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        return (*initial_tables(problem), *measuring.tables(problem), tolerance_table(self.tolerance))

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (*measuring.sizes(dims), ("ITERATIONS", self.iterations, "QPs of a sample, at most"))

    def absent_sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return _ITERATION.absent_sizes(dims)

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs of an iteration, and those of the window and its arrival cost."""
        members = (
            Field("arrival", (), "mean and covariance of x_0 before the window", "keep", "filter"),
            Field("information", (dims.nx, dims.nx), "inverse of that covariance", "keep"),
            Field("expected", (), "predicted measurements", "keep", "filter"),
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
