"""The components share sizes that follow from a problem and the form of its QP."""

from __future__ import annotations

from collections.abc import Mapping

from nmpc_codegen.components.base import Condensing, Dims, QpDims
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.options import Goal
from nmpc_codegen.package.struct_layout import Size


def dimensions(
    problem: Problem, condensing: Condensing | None, constant_hessian: bool, goal: Goal = "speed", banded: int = 0
) -> Dims:
    """Return all shared sizes.

    ``condensing`` is None without a QP; with ``constant_hessian`` one path block serves all nodes; ``banded`` is the
    number of last states that act on no other state. Leading dimensions of stage matrices are rounded up, unless the
    package is to be small.
    """
    p = problem
    sizes = {
        "N": (p.N, "intervals"),
        "NX": (p.nx, "states"),
        "NXHAT": (p.measured, "states of the user"),
        "NU": (p.nu, "controls"),
        "NZ": (p.nx + p.nu, "NX + NU"),
        "NP": (p.np, "parameters"),
        "NY": (p.path.ny, "path residuals"),
        "NY_N": (p.terminal.ny, "terminal residuals"),
        "NW": (_weight_entries(p.path), "entries of the path weight"),
        "NW_N": (_weight_entries(p.terminal), "entries of the terminal weight"),
        "NH": (p.path.nh, "general path rows"),
        "NH_N": (p.terminal.nh, "general terminal rows"),
        "NR": (len(p.rows), "scalar rows with bounds"),
        "NQ": (1 if constant_hessian else p.N, "path Hessian blocks"),
        "NF": (len(p.free_initial), "free components of x_0"),
        "NE": (p.coupled_rows, "coupled rows"),
        "NG": (len(p.qp_rows), "scalar rows of all nodes besides control bounds"),
        "NALG": (len(p.newton_names), "algebraic variables that Newton's method solves for"),
        "NM": (p.estimation.ny if p.estimation else 0, "measurements"),
        "NIN": (p.estimation.nu if p.estimation else 0, "controls of the plant"),
    }
    fields = {"NY_N": "ny_N", "NW_N": "nw_N", "NH_N": "nh_N", "N": "N"}
    return Dims(
        **_sizes(sizes, fields),
        condensed=None if condensing is None else _qp_dims(p, condensing),
        end_rows=len(p.end_rows),
        banded=banded,
        estimation=p.estimation,
        multiple=1 if goal == "size" else PANEL,
    )


def _qp_dims(problem: Problem, condensing: Condensing) -> QpDims:
    shape = condensing.qp_shape(problem)
    sizes = {
        "NVU": (shape.controls, "controls that are variables of the QP"),
        "NV": (shape.variables, "variables of the QP"),
        "NSL": (shape.slacks, "slack variables of the QP"),
        "LDV": (-(-shape.variables // PANEL) * PANEL, "NV rounded up to a multiple of 4"),
        "LDH": (
            -(-(shape.variables - shape.slacks) // PANEL) * PANEL,
            "length of a row of H and A, a multiple of 4",
        ),
    }
    return QpDims(**_sizes(sizes, {"LDV": "ld", "LDH": "ldh"}))


def _sizes(values: Mapping[str, tuple[int, str]], fields: Mapping[str, str]) -> dict[str, Size]:
    """Return {field: size} by macro; a field is its macro in lower case unless ``fields`` names it."""
    return {fields.get(name, name.lower()): Size(name, value, doc) for name, (value, doc) in values.items()}


def _weight_entries(stage: Stage) -> int:
    return stage.ny if stage.diagonal_weight else stage.ny**2
