"""Common parts of the condensing components that keep stages: positions of the QP rows, and embedding of the bounds.

A coupled row is a row of x_N. The given components of x_0 shift its bounds; the free ones are additional states of
every stage, which are constant copies.
"""

from __future__ import annotations

from bisect import bisect_left

from nmpc_codegen.components.base import Dims
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.package.opcount import OpCount


def copied_states(problem: Problem) -> tuple[int, ...]:
    """Free components of x_0 that are carried to x_N for the coupled rows: all of them if there are coupled rows."""
    return problem.free_initial if problem.coupled_rows else ()


def stage_tables(problem: Problem, block: int) -> tuple[Table, ...]:
    """Tables of the QP rows for stages of ``block`` intervals; tables that the problem does not need are left out.

    A bound of the first state of a block, or of x_N, is a bound of the stage's state; every other row is general.
    """
    N = problem.N
    stages = -(-N // block)
    stage = [stages if k == N else k // block for k, _, _, _ in problem.qp_rows]
    bounds = [index if kind == 0 and (k == N or k % block == 0) else -1 for k, kind, index, _ in problem.qp_rows]
    first = [bisect_left(stage, k) for k in range(stages + 2)]

    def table(name: str, values: list[int], doc: str) -> Table:
        return Table(name, "int", tuple(values), doc)

    rows = (
        table("stage_first", first, "first QP row of stage k"),
        table("stage_of_row", stage, "stage of QP row m"),
        table("stage_state", bounds, "state that QP row m bounds, or -1: general row"),
    )
    copies = (table("copied_state", list(copied_states(problem)), "state whose value in x_0 is copy c"),)
    free = [int(i in problem.free_initial) for i in range(problem.nx)]
    given = (table("is_free", free, "1: x_0 is not given"),)
    return (
        *rows,
        *copies,
        *given,
    )


def embed_cost(dims: Dims) -> OpCount:
    """Operations on two bounds per control and row, and on E_0 dx_0 of the coupled rows."""
    rows = dims.N.value * dims.nu.value + dims.ng.value
    coupled = dims.ne.value * dims.nx.value
    return OpCount(add=2 * rows + coupled, mul=coupled)
