"""What the condensing components that keep stages share: where QP rows stand in them, and the embedding of bounds."""

from __future__ import annotations

from nmpc_codegen.cmodule import Table
from nmpc_codegen.component import Dims
from nmpc_codegen.kernel import OpCount
from nmpc_codegen.problem import Problem


def free_coupled(problem: Problem, name: str) -> str | None:
    """On stages a coupled row is a terminal row, which needs x_0 to be known: why condensing ``name`` refuses."""
    if not (problem.coupled_rows and problem.free_initial):
        return None
    coupled = ", ".join(row.name for row in problem.rows if row.kind == "coupled")
    return (
        f"{problem.name} couples x_0 and x_N ({coupled}) with free_initial components, which condensing {name!r} "
        "does not support; choose full"
    )


def stage_tables(problem: Problem, block: int) -> tuple[Table, ...]:
    """Tables of the QP rows for stages of ``block`` intervals.

    A bound of the first state of a block, or of x_N, is a bound of the stage's state; every other row is general.
    """
    N = problem.N
    stages = -(-N // block)
    stage = [stages if k == N else k // block for k, _, _, _ in problem.qp_rows]
    bounds = [index if kind == 0 and (k == N or k % block == 0) else -1 for k, kind, index, _ in problem.qp_rows]
    first = [sum(at < k for at in stage) for k in range(stages + 2)]

    def table(name: str, values: list[int], doc: str) -> Table:
        return Table(name, "int", tuple(values), doc)

    return (
        table("stage_first", first, "first QP row of stage k"),
        table("stage_of_row", stage, "stage of QP row m"),
        table("stage_state", bounds, "state that QP row m bounds, or -1: general row"),
    )


def embed_cost(dims: Dims) -> OpCount:
    """Two bounds per control and row, and E_0 dx_0 of the coupled rows."""
    rows = dims.N.value * dims.nu.value + dims.ng.value
    coupled = dims.ne.value * dims.nx.value
    return OpCount(add=2 * rows + coupled, mul=coupled)
