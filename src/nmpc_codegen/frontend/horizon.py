"""A problem can be stated over another number of intervals of the same length."""

from __future__ import annotations

from copy import copy

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.ocp import OCP


def with_horizon(ocp: OCP, N: int) -> OCP:
    """Return a copy of the problem with N intervals, for compiling; both share their statements.

    Raises:
        ProblemError: the intervals differ, or a statement names nodes or blocks of intervals.
    """
    if ocp.dt is not None and len(set(ocp.dt)) > 1:
        raise ProblemError(f"'{ocp.name}': its intervals differ, so that no other number of them is the same problem")
    if ocp.blocks or any(isinstance(statement.at, tuple) for statement in ocp.statements):
        raise ProblemError(f"'{ocp.name}': hold= or at= names nodes of its own grid")
    twin = copy(ocp)
    twin.__dict__["N"] = N
    twin.__dict__["dt"] = None if ocp.dt is None else (ocp.dt[0],) * N
    return twin
