"""The Riccati interior point solver solves the stage QP.

    min sum_k 1/2 z_k'Q_k z_k + g_k'z_k   s.t.  x_{k+1} = S_k z_k + b_k,   lower <= (u, J z) <= upper,   z = (x, u)

The predictor-corrector method of Mehrotra (1992); every iteration is one Riccati recursion and two substitutions, so
its cost is linear in the number of stages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from nmpc_codegen.components.allowed import Whole, check_options, option
from nmpc_codegen.components.base import USES_OF_STAGES, QpSolver, Seam
from nmpc_codegen.components.qp.riccati import riccati_sizes, riccati_structs, stage_qp_fields, units_structs
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Size, Struct, only_if

if TYPE_CHECKING:
    from nmpc_codegen.components.base import Dims

#: Default cap on the iterations.
MAX_ITERATIONS = 80


#: Meaning of the size IPM_CROSSOVER.
CROSSOVER = "1: the iterations may end once they indicate a working set; 0: they start near the multipliers before"


def interior_point_struct(dims: Dims, crossover: bool) -> Struct:
    """Return the struct ``ipm`` of the solver: iterate and directions of the method.

    With ``crossover``, another method may take over.
    """
    ng = dims.ng
    rows, sides = _rows_and_sides(dims)
    soft = Size(f"2 * {ng.text}", 2 * ng)
    nodes = dims.nodes
    before = Field("before", (rows,), "multipliers of the rows in the previous QP", "scratch")
    return Struct(
        "ipm",
        "interior point iterate of the stage QP",
        (
            Field("gradient", (nodes, dims.nz), "g + Q z of the stages", "scratch"),
            Field("v", (rows,), "values of the rows", "scratch"),
            Field("origin", (rows,), "values of the rows at the first point", "scratch"),
            Field("dv", (rows,), "direction of v", "scratch"),
            *only_if(not crossover, before),
            Field("y", (ng,), "multipliers of equations", "scratch"),
            Field("stiffness", (ng,), "weights of equations", "scratch"),
            Field("weight", (rows,), "weights of the rows", "scratch"),
            Field("proximal", (dims.nz,), "term added to the diagonal of a singular Hessian", "scratch"),
            Field("force", (rows,), "multipliers after a step that leaves v unchanged", "scratch"),
            Field("t", (sides,), "distance to the bound", "scratch"),
            Field("lam", (sides,), "multiplier of a side", "scratch"),
            Field("r", (sides,), "residual of the distance", "scratch"),
            Field("omega", (sides,), "weight", "scratch"),
            Field("dt", (sides,), "correction of the products t lam, later the direction of t", "scratch"),
            Field("dlam", (sides,), "constant part of the direction of lam, later the direction", "scratch"),
            Field("e", (soft,), "violation of a soft side", "scratch"),
            Field("kappa", (soft,), "multiplier of e >= 0", "scratch"),
            Field("r_e", (soft,), "residual of l1 + l2 e = lam + kappa", "scratch"),
            Field("compliance", (soft,), "1 / (l2 + kappa / e)", "scratch"),
            Field("de", (soft,), "direction of e", "scratch"),
            Field("dkappa", (soft,), "correction of the products e kappa, later the direction of kappa", "scratch"),
            *_progress(dims, not crossover),
            *only_if(crossover, Field("crossing", (), "TO_THE_END, CROSS_OVER or HANDED_OVER", "scratch", "int32")),
        ),
    )


def _rows_and_sides(dims: Dims) -> tuple[Size, Size]:
    return dims.constraints, Size(f"2 * ( {dims.constraints.text} )", 2 * dims.constraints)


def _progress(dims: Dims, warm: bool) -> tuple[Field, ...]:
    """Return the fields of the struct ``ipm`` that are not vectors of real numbers."""
    rows, sides = _rows_and_sides(dims)
    stretched = Field("stretched", (), "1: the next step is stretched towards the equations", "scratch", "int32")
    return (
        Field("mu", (), "mean of t lam and e kappa", "scratch"),
        Field("unit", (), "largest cost of a single row", "scratch"),
        Field("primal", (), "largest relative residual of the rows", "scratch"),
        Field("merit", (), "residuals of the rows and products, relative to their tolerance", "scratch"),
        Field("slope", (), "gradient of the Lagrangian, relative to its tolerance", "scratch"),
        Field("step", (), "length of the last step", "scratch"),
        *only_if(dims.ng, Field("slow", (), "value of primal when the last step was stretched", "scratch")),
        Field("stiffening", (), "divisor of the regularisation of the rows", "scratch"),
        Field("stiffest", (), "upper limit of stiffening", "scratch"),
        Field("damping", (), "cost of moving a row across its range in the first factorisation", "scratch"),
        Field("proximity", (), "factor by which the proximal term has been reduced", "scratch"),
        Field("least_pivot", (), "value added to pivots that are zero", "scratch"),
        Field("place", (sides,), "twice the row of a side, plus 1 for an upper side", "scratch", "int32"),
        Field("kind", (rows,), "inequality, equation or given control", "scratch", "int32"),
        Field("sides", (), "number of finite bounds of inequalities", "scratch", "int32"),
        Field("hard", (), "number of hard sides, which come first", "scratch", "int32"),
        *only_if(
            warm,
            Field("warm", (), "1: the multipliers of the previous QP are used", "scratch", "int32"),
            Field("solved", (), "1: the last QP was solved", "keep", "int32"),
        ),
        Field("begun", (), "iterations before the present attempt", "scratch", "int32"),
        Field("deferred", (), "1: the point may suffice, but the residuals still decrease", "scratch", "int32"),
        Field("closed_gaps", (), "number of times that the gaps of the dynamics were closed", "scratch", "int32"),
        *only_if(dims.ng, stretched),
        Field("probing", (), "1: violated inequalities end the iterations", "scratch", "int32"),
        Field("ready", (), "1: the first factorisation is done", "scratch", "int32"),
    )


@dataclass(frozen=True)
class RiccatiInteriorPoint(QpSolver):
    """An interior point method solves the QP on stages; time and memory are linear in N.

    The method starts near the multipliers of the previous QP.

    Args:
        max_iterations: largest number of factorisations in one feedback phase.
    """

    max_iterations: int = option(MAX_ITERATIONS, Whole())

    name: ClassVar[str] = "riccati_interior_point"
    template: ClassVar[str] = "qp/riccati_interior_point.c"
    needs: ClassVar[tuple[Seam, ...]] = ("condensing",)
    takes: ClassVar[str] = "stages"
    chosen_for: ClassVar[tuple[str, ...]] = ("size",)
    supports: ClassVar[frozenset[str]] = USES_OF_STAGES

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    def adds(self, features: Features) -> Features:
        """Return the features with the interior point method."""
        return replace(features, interior_point=True)

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """Return the leading dimensions of the recursion, the cap on the iterations, and the mark of their end."""
        return (
            *riccati_sizes(dims),
            ("IPM_MAX_ITERATIONS", self.max_iterations, "cap on the interior point iterations of one QP"),
            ("IPM_CROSSOVER", 0, CROSSOVER),
        )

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        """Return the range of sides: every row has at most two."""
        sides = (0, 2 * (dims.qp.nv + dims.ng))
        return {"sides": sides, "hard": sides}

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs of the recursion, the method and the QP."""
        units, noise = units_structs(dims)
        qp = Struct("qp", "bounds and results of the stage QP", stage_qp_fields(dims))
        return (*units, *riccati_structs(dims, (noise,)), interior_point_struct(dims, False), qp)
