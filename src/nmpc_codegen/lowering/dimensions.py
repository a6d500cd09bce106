"""Problem and shape of its QP -> the sizes that components share."""

from __future__ import annotations

from collections.abc import Mapping

from nmpc_codegen.components.base import Dims, QpDims, QpShape
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.ir.cmodule import Size
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.options import Goal


def multiple_of(goal: Goal) -> int:
    """To which leading dimensions of stage matrices are rounded up: small ones have no padding."""
    return 1 if goal == "size" else PANEL


def dimensions(problem: Problem, shape: QpShape | None, constant_hessian: bool, multiple: int = PANEL) -> Dims:
    """All shared sizes; ``shape`` is None without a QP; ``constant_hessian``: one path block serves all nodes.

    Leading dimensions of stage matrices are rounded up to a multiple of ``multiple``.
    """
    p = problem
    sizes = {
        "N": p.N,
        "NX": p.nx,
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
    }
    fields = {"NY_N": "ny_N", "NW_N": "nw_N", "NH_N": "nh_N", "N": "N"}
    condensed = None if shape is None else _qp_dims(p, shape)
    return Dims(**_sizes(sizes, fields), condensed=condensed, end_rows=len(p.end_rows), multiple=multiple)


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
