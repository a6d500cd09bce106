"""A warm-started active-set solver uses the Riccati recursion, so that its time is linear in the horizon length.

    min  sum_k 1/2 z_k'Q_k z_k + g_k'z_k + 1/2 x_N'Q_N x_N + g_N'x_N   s.t.  x_{k+1} = S_k z_k + b_k,
    lower <= (u, rows) <= upper

The preparation phase runs the recursion at the predicted working set, and sweeps through the stages once for every row
in this set; if the set is right, the feedback phase is one forward substitution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from nmpc_codegen.components.allowed import Named, Whole, check_options, option
from nmpc_codegen.components.base import USES_OF_STAGES, QpSolver, Seam
from nmpc_codegen.components.qp.riccati import (
    riccati_cost,
    riccati_search,
    riccati_sizes,
    riccati_structs,
    stage_qp_fields,
    units_structs,
)
from nmpc_codegen.components.qp.riccati_interior_point import CROSSOVER, RiccatiInteriorPoint, interior_point_struct
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Size, Struct, only_if

if TYPE_CHECKING:
    from nmpc_codegen.components.base import Counts, Dims, StageMatrices
    from nmpc_codegen.package.opcount import OpCount


#: Default cap on the number of working sets that are tried: one and a half times the largest number in closed loops
#: with disturbances (verification/robustness and strangers).
MAX_ITERATIONS = 30

#: Cap on the working sets that are tried from one that is expected to be close to that of the solution.
MAX_POLISH = 5


_FALLBACK = RiccatiInteriorPoint()
_FALLBACKS: dict[str, RiccatiInteriorPoint | None] = {"riccati_interior_point": _FALLBACK, "None": None}


def _joint(dims: Dims) -> int:
    """Return the cap on the rows in the Schur complement: more rows than states are rarely independent.

    It is at least 2: in loops over pairs of rows, GCC 11 and 12 warn of the second element of arrays with one element.
    """
    return max(2, min(dims.ng, dims.nx)) if dims.ng else 0


def _schur_struct(dims: Dims) -> Struct:
    """Return the struct for rows of the working set as equations."""
    joint, stages = Size("QP_MAX_JOINT", _joint(dims)), dims.N
    ldx = Size("LDX", riccati_sizes(dims)[0][1])
    return Struct(
        "schur",
        "rows of the working set as equations",
        (
            Field("push", (stages, joint, dims.nu), "gradient of the controls for a unit multiplier", "scratch"),
            Field("pull", (joint, ldx), "gradient of x_0 for a unit multiplier", "scratch"),
            Field("complement", (joint, joint), "L D L' of the Schur complement, 1 / D on the diagonal", "scratch"),
            Field("origin", (joint,), "values of the rows for dx_0 = 0", "scratch"),
            Field("member", (joint,), "members of the working set", "scratch", "int32"),
            Field("joint", (), "number of members", "scratch", "int32"),
            Field("active", (), "1: rows in the set are equations; 0: they have weights", "scratch", "int32"),
            Field("applies", (), "1: the method applies", "scratch", "int32"),
            Field("swept", (), "1: the Schur complement is up to date", "scratch", "int32"),
            Field("shifted", (), "1: the vectors of the substitution contain corrections", "scratch", "int32"),
            Field("weighted", (), "number of further QPs in which rows have weights", "keep", "int32"),
        ),
    )


@dataclass(frozen=True)
class RiccatiActiveSet(QpSolver):
    """An active-set method solves the QP on stages, accurate to rounding; time and memory are linear in N.

    Args:
        max_iterations: largest number of working sets that are tried in one feedback phase; None: 30.
        fallback: the method that takes over, with its options, once the number of changes has failed to decrease three
            times. It continues until its iterate indicates a working set, from which the active-set method finishes.
            With None, a QP for which no working set is found ends with ITERATION_LIMIT even if it is infeasible (with
            INFEASIBLE only for crossed bounds), and the package is smaller.
    """

    name: ClassVar[str] = "riccati_active_set"
    template: ClassVar[str] = "qp/riccati_active_set.c"
    needs: ClassVar[tuple[Seam, ...]] = ("condensing",)
    takes: ClassVar[str] = "stages"
    chosen_for: ClassVar[tuple[str, ...]] = ("speed",)
    supports: ClassVar[frozenset[str]] = USES_OF_STAGES

    max_iterations: int | None = option(None, Whole(optional=True))
    fallback: RiccatiInteriorPoint | None = option(_FALLBACK, Named(_FALLBACKS, (RiccatiInteriorPoint,)))

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    def adds(self, features: Features) -> Features:
        """Return the features with the interior point method if it is the fall-back."""
        return replace(features, interior_point=self.fallback is not None)

    @property
    def _cap(self) -> int:
        return self.max_iterations or MAX_ITERATIONS

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """Return leading dimensions and caps."""
        why = "as the options say" if self.max_iterations else "1.5 times what closed loops need"
        return (
            *riccati_sizes(dims),
            ("QP_MAX_ITERATIONS", self._cap, f"cap on the working sets of one feedback phase, {why}"),
            ("QP_MAX_POLISH", min(self._cap, MAX_POLISH), "cap on the working sets near a solution"),
            ("QP_MAX_REFINEMENTS", 20, "cap on the corrections of one minimiser"),
            *(self._joint_sizes(dims) if dims.ng else ()),
            *(self._fallback_sizes(self.fallback) if self.fallback is not None else ()),
        )

    def absent_sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (*self._joint_sizes(dims), *self._fallback_sizes(_FALLBACK))

    def _joint_sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("QP_MAX_JOINT", _joint(dims), "cap on the rows of the Schur complement"),)

    def _fallback_sizes(self, fallback: RiccatiInteriorPoint) -> tuple[tuple[str, int, str], ...]:
        return (
            ("QP_MAX_RISES", 3, "number of times that the changes may fail to become fewer"),
            ("IPM_CROSSOVER", 1, CROSSOVER),
            ("IPM_MAX_ITERATIONS", fallback.max_iterations, "cap on the interior point iterations of one QP"),
        )

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs of the recursion, of the QP and of its working set."""
        ng, nx = dims.ng, dims.nx
        nodes = dims.nodes
        history = Size("QP_MAX_ITERATIONS + 1", self._cap + 1)
        units, noise = units_structs(dims)
        measured = self.fallback is not None or ng > 0
        corrected = (Field("lam", (nodes, nx), "multipliers of the dynamics while refining", "scratch"),)
        return (
            *only_if(measured, *units),
            *riccati_structs(dims, only_if(measured, noise), corrected),
            *only_if(ng, _schur_struct(dims)),
            *only_if(self.fallback, interior_point_struct(dims, True)),
            Struct(
                "qp",
                "working set of the stage QP",
                (
                    *stage_qp_fields(dims),
                    Field("target", (ng,), "bounds of rows in the set when the vectors were formed", "scratch"),
                    Field("center", (ng,), "multipliers of rows in the set when the vectors were formed", "scratch"),
                    Field("value", (ng,), "values of the rows", "scratch"),
                    Field("root", (ng,), "root of the curvature of the cost along a row", "scratch"),
                    Field("weight", (ng,), "weight of a row while it is in the set", "scratch"),
                    Field("scale", (dims.nz,), "largest entry of every component of (x, u)", "scratch"),
                    Field("size", (dims.nz,), "largest terms of the components of the gradient", "scratch"),
                    Field("residual", (), "relative residual on the working set", "scratch"),
                    Field("raised", (ng,), "number of times that the weight was raised", "keep", "int32"),
                    Field("history", (history,), "hashes of the working sets of this solve", "scratch", "int32"),
                    *only_if(ng, Field("scaled", (), "origin of root: SCALES_NONE, EARLIER, OWN", "keep", "int32")),
                    Field("rough", (), "1: the minimiser has errors beyond rounding", "scratch", "int32"),
                    Field("refined", (), "1: the minimiser on the working set is exact", "scratch", "int32"),
                    Field("stale", (), "last stage whose factors are out of date, or -1", "scratch", "int32"),
                    Field("stale_vectors", (), "last stage whose vectors are out of date, or -1", "scratch", "int32"),
                    Field("factorized", (), "state of the factors: FACTORS_NONE, READY, OTHER", "scratch", "int32"),
                    Field("refinements", (), "refinement steps in the last qp_solve", "result", "int32"),
                    Field("exact", (), "1: the result is the minimiser on side[], to rounding", "result", "int32"),
                ),
            ),
        )

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        """Return the ranges of stages, and of sides of the interior point method."""
        stages = (-1, dims.N)
        sides: Mapping[str, tuple[int, int]] = {} if self.fallback is None else self.fallback.ranges(dims)
        return {"stale": stages, "stale_vectors": stages, "joint": (0, _joint(dims)), **sides}

    def cost(self, dims: Dims, model: StageMatrices) -> Counts:
        """Count the recursion and its substitutions; a warm-started sample needs one of each."""
        return riccati_cost(dims)

    def search(self, dims: Dims) -> OpCount:
        """Estimate a search, in which the fall-back finds the working set."""
        return riccati_search(dims)
