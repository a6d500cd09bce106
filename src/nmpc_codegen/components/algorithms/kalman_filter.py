"""The extended Kalman filter in square-root form needs no plan and no QP.

    xhat, L with P = L L', for every measurement y_i with the standard deviation sigma_i:
        e = y_i - h_i(xhat),  f = L' (dh_i/dx)',  s = sigma_i^2 + f'f:   xhat += L f e / s,
        L -= L f f' / (s + sqrt(s) sigma_i)
    to the next sample:  xhat = Phi(xhat, u),   [L 0] Q = [A L, B diag(std)] by reflections

States are clipped to the bounds of rows on single states.

Kaminski, Bryson and Schmidt, Discrete square root filtering, IEEE TAC 16 (1971); the first two lines are Potter's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import nmpc_codegen.components.algorithms.estimators as measuring
from nmpc_codegen.components.base import Algorithm, Core, Dims, Seam
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.signals import EntryPoint
from nmpc_codegen.package.struct_layout import Field, Struct


@dataclass(frozen=True)
class KalmanFilter(Algorithm):
    """The extended Kalman filter is the algorithm of ``ocp.estimator(..., kind="ekf")``, without options."""

    name: ClassVar[str] = "kalman_filter"
    template: ClassVar[str] = "algorithms/kalman_filter.c"
    needs: ClassVar[tuple[Seam, ...]] = ("integrator",)
    core: ClassVar[frozenset[Core]] = frozenset()
    supports: ClassVar[frozenset[str]] = measuring.SUPPORTS

    def check(self, problem: Problem) -> None:
        """Raise OptionError unless the problem is that of a filter."""
        measuring.check(self, problem, "ekf")

    def entries(self, features: Features) -> tuple[EntryPoint, ...]:
        """Return the entry points: a sample, the sensors, the covariance, a restart."""
        of_features = (measuring.estimate(features), measuring.measure(features))
        return (*of_features, measuring.COVARIANCE, measuring.RESTART)

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Return standard deviations, thresholds, and the bounds to which states are clipped."""
        return measuring.tables(problem)

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return measuring.sizes(dims)

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        return {}

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs of the filter."""
        stats = Struct("stats", "results of the last sample", measuring.INNOVATION)
        own = (*measuring.own_fields(dims), Field("stats", (), "results of the last sample", "result", "stats"))
        return (*measuring.structs(dims), stats, Struct("solver", "", own))
