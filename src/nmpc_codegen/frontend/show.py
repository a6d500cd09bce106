"""An OCP is described in one line."""

from __future__ import annotations

from nmpc_codegen.frontend.statement import Declared, StatedProblem
from nmpc_codegen.package.signals import horizon, list_some


def in_one_line(ocp: StatedProblem) -> str:
    """Return name, grid, signals by name, and number of rows."""
    kinds = {"states": ocp.states, "controls": ocp.controls, "algebraic variables": ocp.algebraics}
    kinds["parameters"] = ocp.parameters
    parts = [f"{kind} {list_some(elements_of(declared))}" for kind, declared in kinds.items() if declared]
    rows = sum(len(statement.names) for statement in ocp.statements)
    return f"<OCP {ocp.name}: {'; '.join([grid_of(ocp), *parts])}; rows: {rows}>"


def elements_of(declared: list[Declared]) -> list[str]:
    """Return the names of all elements."""
    return [element for d in declared for element in d.signal.elements]


def grid_of(ocp: StatedProblem) -> str:
    """Return intervals and horizon as text."""
    return f"N={horizon(ocp.dt or (1.0,) * ocp.N, ocp.time_unit, ocp.dt is None or bool(ocp.discrete))}"
