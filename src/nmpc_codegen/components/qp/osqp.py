"""OSQP solves the condensed QP by foreign code from the osqp package, for comparison in build().

    min 1/2 z'Hz + g'z   s.t.  lower <= (z, A z) <= upper

The generated solver has one static workspace, which all copies of a controller share. Every call loads all data again,
so its result depends only on these data and the starting point.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from nmpc_codegen.components.allowed import Number, Whole, check_options, option
from nmpc_codegen.components.base import EVERY_USE, QpSolver
from nmpc_codegen.errors import OptionError
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Size, Struct, only_if

if TYPE_CHECKING:
    from nmpc_codegen.components.base import Dims
    from nmpc_codegen.package.struct_layout import Precision


@dataclass(frozen=True)
class Osqp(QpSolver):
    """The osqp package generates a solver of the condensed QP, which is an oracle for build() only.

    Args:
        max_iterations: largest number of iterations of a solution.
        eps: absolute and relative tolerance of its residuals.
    """

    max_iterations: int = option(20_000, Whole())
    eps: float = option(1e-9, Number())

    name: ClassVar[str] = "osqp"
    template: ClassVar[str] = "qp/osqp.c"
    takes: ClassVar[str] = "condensed"
    chosen_for: ClassVar[tuple[str, ...]] = ()
    supports: ClassVar[frozenset[str]] = EVERY_USE - {"soft rows", "rows with an infinite penalty"}

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    def adds(self, features: Features) -> Features:
        """Return the features with results that satisfy their conditions up to ``eps``."""
        return replace(features, approximate=True)

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """Return the numbers of entries of the two matrices, which OSQP stores as compressed columns."""
        n = dims.qp.nv
        return (
            ("OSQP_P", n * (n + 1) // 2, "upper triangle of H by columns"),
            ("OSQP_A", n * (1 + dims.ng), "(I; A) by columns"),
        )

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs of the QP as condensing writes it, and as OSQP reads it."""
        nv, ng, ld = dims.qp.nv, dims.ng, dims.qp.ld
        rows = dims.constraints
        entries = {name: Size(name, value) for name, value, _ in self.sizes(dims)}
        return (
            Struct("basis", "memory lent to the caller", (Field("Q", (ld, ld), "a work matrix", "scratch"),)),
            Struct(
                "work",
                "memory of phases that do not overlap",
                (Field("basis", (), "while the Hessian is regularised", "scratch", "basis"),),
                union=True,
            ),
            Struct(
                "qp",
                "condensed QP, solved by OSQP",
                (
                    Field("H", (ld, ld), "Hessian (lower triangle)", "scratch"),
                    Field("A", (ng, ld), "general rows", "scratch"),
                    Field("work", (), "memory lent to the caller", "scratch", "work"),
                    Field("g", (nv,), "gradient", "scratch"),
                    Field("lower", (rows,), "lower bounds of variables, then of general rows", "scratch"),
                    Field("upper", (rows,), "upper bounds", "scratch"),
                    Field("penalty", (rows,), "infinite: every row is hard", "keep", only=lambda f: f.elastic),
                    Field(
                        "terms", (ng,), "not used: magnitude of the terms that the bounds of a row sum up", "scratch"
                    ),
                    *only_if(False, Field("curvature", (dims.qp.nsl,), "not used: OSQP has no slacks", "scratch")),
                    Field("z", (nv,), "minimiser", "result"),
                    Field("mult", (rows,), "multipliers, > 0 at the upper bound, < 0 at the lower", "result"),
                    Field("certificate", (rows,), "if INFEASIBLE: weights of a contradiction", "result"),
                    Field("P_x", (entries["OSQP_P"],), "upper triangle of H by columns", "scratch"),
                    Field("A_x", (entries["OSQP_A"],), "(I; A) by columns", "scratch"),
                    *only_if(
                        dims.ng > 0,
                        Field("side", (rows,), "not used: OSQP has no working set", "scratch", "int32"),
                    ),
                    Field("iterations", (), "iterations of the last qp_solve", "result", "int32"),
                    Field("changes", (), "always 0", "result", "int32"),
                    Field("dropped", (), "always 0", "result", "int32"),
                    Field("relaxed", (), "always 0", "result", "int32"),
                ),
            ),
        )

    def foreign_sources(self, prefix: str, precision: Precision, dims: Dims) -> Mapping[str, str]:
        """Return OSQP's embedded C for dense matrices of this size, with a wrapper: {path in osqp/: text}.

        Raises:
            OptionError: the precision is single; the embedded code is generated in double precision.
        """
        if precision != "double":
            raise OptionError(
                "Osqp() (--set qp=osqp) clashes with precision='single' (--set precision=single): its embedded "
                "code is in double precision"
            )
        nv, ng = dims.qp.nv, dims.ng
        with tempfile.TemporaryDirectory(prefix="osqp-") as temporary:
            self._generate(Path(temporary), prefix, nv, ng)
            files = {
                f"osqp/{path.relative_to(temporary).as_posix()}": path.read_text(encoding="utf-8")
                for path in sorted(Path(temporary).rglob("*.[ch]"))
                if path.name != "emosqp.c"
            }
        sizes = {"rows": nv + ng, "columns": nv, "P": nv * (nv + 1) // 2, "A": nv * (1 + ng)}
        names = {"prefix": prefix, "rho": RHO, **sizes}
        files[f"osqp/{prefix}_osqp.c"] = WRAPPER % names
        return {path: _without_dates(text) for path, text in files.items()}

    def _generate(self, folder: Path, prefix: str, nv: int, ng: int) -> None:
        import osqp  # imported only here, because it loads slowly
        import scipy.sparse as sparse

        P = sparse.csc_matrix(np.triu(np.full((nv, nv), 1e-3)) + nv * np.eye(nv))
        A = sparse.vstack([sparse.identity(nv), sparse.csc_matrix(np.ones((ng, nv)))], format="csc")
        solver = osqp.OSQP()
        solver.setup(
            *(P, np.zeros(nv), A, -np.ones(nv + ng), np.ones(nv + ng)),
            verbose=False,
            eps_abs=self.eps,
            eps_rel=self.eps,
            eps_prim_inf=1e-8,
            eps_dual_inf=1e-8,
            max_iter=self.max_iterations,
            rho=RHO,
            adaptive_rho_interval=25,
            check_termination=10,
        )
        solver.codegen(str(folder), parameters="matrices", prefix=f"{prefix}_", force_rewrite=True)


def _without_dates(text: str) -> str:
    """Return the C text without the lines that contain the date of generation."""
    return "\n".join(line for line in text.splitlines() if "autogenerated by OSQP on" not in line) + "\n"


#: Weight of the rows before OSQP adapts it.
RHO = 0.1

#: The only file that calls OSQP; it clips infinite bounds to OSQP_INFTY.
WRAPPER = """#include "osqp.h"
#include "%(prefix)s_workspace.h"

#include <string.h>

int %(prefix)s_osqp_solve(const double *P, const double *A, const double *g, const double *lower, const double *upper,
    double *z, double *mult, double *certificate, int *iterations);

int %(prefix)s_osqp_solve(const double *P, const double *A, const double *g, const double *lower, const double *upper,
    double *z, double *mult, double *certificate, int *iterations)
{
    static OSQPFloat l[%(rows)d], u[%(rows)d];
    OSQPSolver *solver = &%(prefix)s_solver;
    int c;
    for (c = 0; c < %(rows)d; c++) {
        l[c] = (lower[c] < -OSQP_INFTY) ? -OSQP_INFTY : lower[c];
        u[c] = (upper[c] > OSQP_INFTY) ? OSQP_INFTY : upper[c];
    }
    if (osqp_update_data_mat(solver, P, OSQP_NULL, %(P)d, A, OSQP_NULL, %(A)d) != 0 ||
        osqp_update_data_vec(solver, g, l, u) != 0 || osqp_warm_start(solver, z, mult) != 0 ||
        osqp_solve(solver) != 0) {
        return 0;
    }
    *iterations = (int)solver->info->iter;
    if (solver->info->status_val != OSQP_SOLVED) {
        (void)osqp_update_rho(solver, %(rho)s); /* adapted to data that may never come again */
    }
    if (solver->info->status_val == OSQP_PRIMAL_INFEASIBLE) {
        (void)memcpy(certificate, solver->solution->prim_inf_cert, sizeof(double) * %(rows)d);
        return OSQP_PRIMAL_INFEASIBLE;
    }
    (void)memcpy(z, solver->solution->x, sizeof(double) * %(columns)d);
    (void)memcpy(mult, solver->solution->y, sizeof(double) * %(rows)d);
    return (int)solver->info->status_val;
}
"""
