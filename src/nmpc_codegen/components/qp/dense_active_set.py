"""The dense dual active-set solver solves the condensed QP.

    min 1/2 z'Hz + g'z   s.t.  lower <= (z, A z) <= upper

The method of Goldfarb and Idnani (1983) in the coordinates of H = C C', with an orthonormal basis of the working set.
The preparation phase factorises at the predicted working set; the feedback phase needs two substitutions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nmpc_codegen.components.allowed import Whole, check_options, option
from nmpc_codegen.components.base import EVERY_USE, QpSolver
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.struct_layout import Field, Struct

if TYPE_CHECKING:
    from nmpc_codegen.components.base import Counts, Dims, StageMatrices

#: Largest numbers in closed loops with disturbances (verification/robustness and strangers): iterations of a QP per
#: variable and row, and proximal steps for a semidefinite Hessian. The default caps are CAUTION times as large.
ITERATIONS_NEEDED, PROXIMAL_STEPS_NEEDED = 3.4, 17
CAUTION = 2

#: Default cap on the iterations of a QP with few variables and rows.
LEAST_ITERATIONS = 50

#: Cap on the proximal steps of a QP.
PROXIMAL_STEPS = math.ceil(CAUTION * PROXIMAL_STEPS_NEEDED)


@dataclass(frozen=True)
class DenseActiveSet(QpSolver):
    """A dual active-set method solves the condensed QP, accurate to rounding.

    The method starts with the working set of the previous QP.

    Args:
        max_iterations: largest number of changes of the working set in one feedback phase; None: 6.8 (NV + NG), at
            least 50.
    """

    name: ClassVar[str] = "dense_active_set"
    template: ClassVar[str] = "qp/dense_active_set.c"
    takes: ClassVar[str] = "condensed"
    chosen_for: ClassVar[tuple[str, ...]] = ("speed", "size")
    supports: ClassVar[frozenset[str]] = EVERY_USE

    max_iterations: int | None = option(None, Whole(optional=True))

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    def _cap(self, dims: Dims) -> int:
        needed = math.ceil(CAUTION * ITERATIONS_NEEDED * (dims.qp.nv + dims.ng))
        return self.max_iterations or max(LEAST_ITERATIONS, needed)

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """Return the iteration cap."""
        cap = self._cap(dims)
        steps = min(cap, PROXIMAL_STEPS)
        variables = f"{CAUTION * ITERATIONS_NEEDED:g} ({dims.qp.nv.text} + {dims.ng.text}), at least {LEAST_ITERATIONS}"
        why = "as the options say" if self.max_iterations else f"{variables}: {CAUTION} times what closed loops need"
        proximal = f"{CAUTION} times what closed loops with a semidefinite Hessian need, and no more than iterations"
        return (
            ("QP_MAX_ITERATIONS", cap, f"cap on the active-set iterations of one QP, {why}"),
            ("QP_MAX_PROXIMAL_STEPS", steps, f"cap on the proximal steps of one QP, {proximal}"),
            (
                "QP_MAX_SEARCHES",
                cap + 2 * steps,
                "cap on the searches for violated rows: one per iteration, two per step",
            ),
        )

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs of the QP: data, result, factors and working set."""
        nv, ng, ld, ldh = dims.qp.nv, dims.ng, dims.qp.ld, dims.qp.ldh
        rows = dims.constraints
        contradiction = "if INFEASIBLE: weights of a contradiction"
        return (
            *_working_memory(dims),
            Struct(
                "qp",
                "condensed QP and its active-set factorisation",
                (
                    Field("H", (ldh, ld), "Hessian (lower triangle); later D, L and L' of L D L'", "scratch"),
                    Field("A", (ng, ldh), "general rows", "scratch"),
                    Field("curvature", (dims.qp.nsl,), "quadratic penalties of the slacks", "scratch"),
                    Field("g", (nv,), "gradient", "scratch"),
                    Field("lower", (rows,), "lower bounds of variables, then of general rows", "scratch"),
                    Field("upper", (rows,), "upper bounds", "scratch"),
                    Field("terms", (ng,), "magnitude of the terms that the bounds of a general row sum up", "scratch"),
                    Field("z", (nv,), "minimiser", "result"),
                    Field("mult", (rows,), "multipliers, > 0 at the upper bound, < 0 at the lower", "result"),
                    Field("inverse", (ld,), "D^{-1/2}", "scratch"),
                    Field("work", (), "factors of the working set; free before qp_factorize", "scratch", "work"),
                    Field("R_inverse", (ld,), "inverse diagonal of R", "scratch"),
                    Field("lam", (ld,), "multipliers of the rows in the working set", "scratch"),
                    Field("y0", (ld,), "unconstrained minimiser, y = D^{1/2} L'z", "scratch"),
                    Field("x", (ld,), "z = C^{-T} y", "scratch"),
                    Field("accepted", (rows,), "violation of a row that is accepted as rounding", "scratch"),
                    Field("scale", (), "|y0|, and the terms that saturated rows add to it", "scratch"),
                    Field("penalty", (rows,), "l1 penalty of a row; infinite: hard", "keep", only=lambda f: f.elastic),
                    Field("certificate", (rows,), contradiction, "result", only=lambda f: f.solve),
                    Field("proximal", (ld,), "diagonal E added to a semidefinite Hessian", "scratch"),
                    Field("center", (ld,), "centre of the proximal term", "scratch"),
                    Field("direction", (ld,), "direction of the last proximal step", "scratch"),
                    Field("total", (), "s'(H + E)s of that step; 0: no conjugate direction follows", "scratch"),
                    Field("step", (), "length of the proximal step", "scratch"),
                    Field("row", (ld,), "rows in the working set, in the order of the basis", "scratch", "int32"),
                    Field(
                        "side", (rows,), "+-1: in the set at upper, lower bound; +-2: saturated; or 0", "keep", "int32"
                    ),
                    Field("snapshot", (rows,), "earlier values of side, to detect cycles", "scratch", "int32"),
                    Field("nw", (), "number of rows in the working set", "scratch", "int32"),
                    Field("factorized", (), "1: qp_factorize has succeeded", "scratch", "int32"),
                    Field("strict", (), "1: rounding errors are judged by the terms of a row", "scratch", "int32"),
                    Field("semidefinite", (), "1: a pivot of H may be zero, E is not zero", "scratch", "int32"),
                    Field("face", (), "value of changes when the direction was set", "scratch", "int32"),
                    Field("elastic", (), "1: a row has a finite penalty", "scratch", "int32", only=lambda f: f.elastic),
                    Field("iterations", (), "active-set iterations of the last qp_solve", "result", "int32"),
                    Field("searches", (), "searches for violated rows in the last qp_solve", "scratch", "int32"),
                    Field("proximal_steps", (), "proximal steps in the last qp_solve", "scratch", "int32"),
                    Field("changes", (), "changes of the working set in the last qp_solve", "result", "int32"),
                    Field("dropped", (), "equalities left out as redundant", "result", "int32"),
                    Field("relaxed", (), "elastic rows that are violated", "result", "int32"),
                ),
            ),
        )

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        """Return the range of ``nw``: the working set has at most as many rows as the QP has variables."""
        return {"nw": (0, dims.qp.nv)}

    def cost(self, dims: Dims, model: StageMatrices) -> Counts:
        """Count the functions whose operations depend only on sizes (padded columns included)."""
        n, slacks = dims.qp.ldh, dims.qp.ld - dims.qp.ldh
        panels = n // 4
        # Per panel b: entries to the right of it, and to the left.
        right = sum(n - 4 * k - 4 for k in range(panels))
        block = OpCount(add=6, mul=6)
        scale = OpCount(mul=n + slacks)
        substitution = block * panels + OpCount(add=4, mul=4) * right
        return {
            "qp_factorize_hessian": _factorization(dims),
            "qp_forward": substitution + scale,
            "qp_backward": substitution + scale,
        }

    def search(self, dims: Dims) -> OpCount:
        """Estimate a search: a quarter of the variables change, at about 2 n (n + ng) operations of each kind."""
        n = dims.qp.nv
        return OpCount(add=2, mul=2) * (n * (n + dims.ng)) * max(1, n // 4)


def _working_memory(dims: Dims) -> tuple[Struct, ...]:
    """Return the factors of the working set, and a union.

    Through the union, the caller may use the memory of the factors before they are computed.
    """
    basis = (
        Field("Q", (dims.qp.ld, dims.qp.ld), "rows: orthonormal basis of the normals in the working set", "scratch"),
        Field("R", (dims.qp.ld, dims.qp.ld), "row j: coefficients of normal j in that basis (R transposed)", "scratch"),
        Field("y", (dims.qp.ld,), "minimiser on the working set", "scratch"),
        Field("m", (dims.qp.ld,), "normal of the row under consideration, in y", "scratch"),
        Field("v", (dims.qp.ld,), "part of m outside the span of the working set", "scratch"),
        Field("d", (dims.qp.ld,), "coefficients of m in the basis", "scratch"),
    )
    alternatives = (Field("basis", (), "from qp_factorize to the end of the feedback", "scratch", "basis"),)
    return (
        Struct("basis", "factors of the working set, vectors of an iteration", basis),
        Struct("work", "memory of phases that do not overlap", alternatives, union=True),
    )


def _factorization(dims: Dims) -> OpCount:
    """Count L D L' of a positive definite H, panel by panel."""
    n, ld = dims.qp.nv - dims.qp.nsl, dims.qp.ldh
    slacks = dims.qp.ld - ld
    total = OpCount(sqrt=ld + slacks, div=slacks)
    for b in range(0, ld, 4):
        total += OpCount(add=10, mul=20, div=4)
        total += OpCount(add=6, mul=10) * (ld - b - 4)
        below = max(0, n - b - 4)  # the j-th row below takes 4 ceil(j / 4) entries
        whole, rest = divmod(below, 4)
        lanes = 4 * (whole + 1) * (2 * whole + rest)
        total += OpCount(add=4, mul=4) * lanes + OpCount(mul=4) * below
    return total
