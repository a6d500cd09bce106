"""The sizes that follow from a problem and the form of its QP, which the components share."""

from __future__ import annotations

from collections.abc import Mapping

from nmpc_codegen.components.base import Dims, QpDims, QpShape
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.options import Goal
from nmpc_codegen.package.memory import Size

#: Sizes that components share -> what they are.
DOCS: Mapping[str, str] = {
    "N": "intervals",
    "NX": "states",
    "NXHAT": "states of the user",
    "NU": "controls",
    "NZ": "NX + NU",
    "NP": "parameters",
    "NY": "path residuals",
    "NY_N": "terminal residuals",
    "NW": "entries of the path weight",
    "NW_N": "entries of the terminal weight",
    "NH": "general path rows",
    "NH_N": "general terminal rows",
    "NR": "scalar rows with bounds",
    "NQ": "path Hessian blocks",
    "NF": "free components of x_0",
    "NE": "coupled rows",
    "NS": "stages of the QP",
    "NUS": "controls of a stage of the QP",
    "NXS": "states of a stage: NX and copies of components of x_0",
    "NZS": "NXS + NUS",
    "NV": "variables of the QP",
    "NSL": "slack variables of the QP",
    "NG": "scalar rows of all nodes besides control bounds",
    "NALG": "algebraic variables that Newton's method solves for",
    "NM": "measurements",
    "NIN": "controls of the plant",
    "LDV": "NV rounded up to a multiple of 4",
    "LDH": "length of a row of H and A, a multiple of 4",
}


def multiple_of(goal: Goal) -> int:
    """To which leading dimensions of stage matrices are rounded up: small ones have no padding."""
    return 1 if goal == "size" else PANEL


def dimensions(
    problem: Problem, shape: QpShape | None, constant_hessian: bool, multiple: int = PANEL, banded: int = 0
) -> Dims:
    """All shared sizes; ``shape`` is None without a QP; ``constant_hessian``: one path block serves all nodes.

    Leading dimensions of stage matrices are rounded up to a multiple of ``multiple``.
    """
    p = problem
    sizes = {
        "N": p.N,
        "NX": p.nx,
        "NXHAT": p.measured,
        "NU": p.nu,
        "NZ": p.nx + p.nu,
        "NP": p.np,
        "NY": p.path.ny,
        "NY_N": p.terminal.ny,
        "NW": _weight_entries(p.path),
        "NW_N": _weight_entries(p.terminal),
        "NH": p.path.nh,
        "NH_N": p.terminal.nh,
        "NR": len(p.rows),
        "NQ": 1 if constant_hessian else p.N,
        "NF": len(p.free_initial),
        "NE": p.coupled_rows,
        "NG": len(p.qp_rows),
        "NALG": len(p.newton_names),
        "NM": p.estimation.ny if p.estimation else 0,
        "NIN": p.estimation.nu if p.estimation else 0,
    }
    fields = {"NY_N": "ny_N", "NW_N": "nw_N", "NH_N": "nh_N", "N": "N"}
    condensed = None if shape is None else _qp_dims(p, shape)
    return Dims(
        **_sizes(sizes, fields),
        condensed=condensed,
        end_rows=len(p.end_rows),
        banded=banded,
        estimation=p.estimation,
        multiple=multiple,
    )


def _qp_dims(problem: Problem, shape: QpShape) -> QpDims:
    sizes = {
        "NS": shape.stages,
        "NUS": shape.controls,
        "NXS": problem.nx + shape.copies,
        "NZS": problem.nx + shape.copies + shape.controls,
        "NV": shape.variables,
        "NSL": shape.slacks,
        "LDV": -(-shape.variables // PANEL) * PANEL,
        "LDH": -(-(shape.variables - shape.slacks) // PANEL) * PANEL,
    }
    return QpDims(**_sizes(sizes, {"LDV": "ld", "LDH": "ldh"}))


def _sizes(values: Mapping[str, int], fields: Mapping[str, str]) -> dict[str, Size]:
    """Field -> size, by macro; a field is its macro in lower case unless ``fields`` names it."""
    return {fields.get(name, name.lower()): Size(name, value) for name, value in values.items()}


def _weight_entries(stage: Stage) -> int:
    return stage.ny if stage.diagonal_weight else stage.ny**2
