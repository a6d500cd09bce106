"""The header has the user's names: indices in the vectors of the interface, with units, bounds and scales; rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from nmpc_codegen.frontend.completion.complete import CompleteProblem
from nmpc_codegen.frontend.problem import Row, Stage
from nmpc_codegen.ir.cmodule import Enum
from nmpc_codegen.package.signals import Signal, c_constants, nodes


def enums(problem: CompleteProblem) -> tuple[Enum, ...]:
    """Return the enums of a problem; enums without a name are left out."""
    size, nx, parameters = problem.scales.z, problem.nx, problem.own_parameters
    limits = {(row.kind, row.index): row for row in problem.rows if row.nodes and min(row.nodes) < problem.N}
    states = [_z(unit, size[i], limits.get(("state", i))) for i, unit in enumerate(_units(problem.own_states))]
    controls = [_z(unit, size[nx + i], limits.get(("control", i))) for i, unit in enumerate(_units(problem.controls))]
    of_algebra = _units(problem.algebra.signals) if problem.algebra else []
    of_parameters = [[u] for u in _units(parameters)]
    found = (
        _enum("X", problem.state_names[: problem.measured], "indices of the states in x", states),
        _enum("U", problem.control_names, "indices of the controls in u", controls),
        _enum("Z", problem.algebraic_names, "indices of the algebraic variables in z", [[unit] for unit in of_algebra]),
        _enum("P", [e for s in parameters for e in s.elements], "indices of the parameters in p", of_parameters),
        _residuals("Y", problem.path, "indices of the residuals in yref and W"),
        _residuals("Y_N", problem.terminal, "indices of the terminal residuals in yref_N and W_N"),
        _enum(
            "ROW",
            [r.name for r in problem.rows],
            f"argument row of set_bounds{' and set_soft' if any(r.soft for r in problem.rows) else ''}",
            map(_row, problem.rows),
        ),
        _enum("PARAM", [s.name for s in parameters], "argument param of set_parameter", map(_value, parameters)),
    )
    return tuple(enum for enum in found if enum.names)


def _enum(stem: str, names: Sequence[str], doc: str, notes: Iterable[Sequence[str]]) -> Enum:
    said = (", ".join(part.replace("*/", "* /") for part in parts if part) for parts in notes)
    return Enum(stem, c_constants(names), doc, tuple(f" /* {text} */" if text else "" for text in said))


def _units(signals: Iterable[Signal]) -> list[str]:
    """Return the unit of every element."""
    return [signal.unit for signal in signals for _ in signal.elements]


def _z(unit: str, scale: float, row: Row | None) -> list[str]:
    """Return unit, bounds and scale of a state or control."""
    return [unit, f"{row.lower:g} .. {row.upper:g}" if row else "", f"scale {scale:.2g}"]


def _residuals(stem: str, stage: Stage, doc: str) -> Enum:
    often = Counter(stage.y_names)
    names = [name if often[name] == 1 else f"{name}_{i}" for i, name in enumerate(stage.y_names)]
    return _enum(stem, names, doc, [[f"reference {value:g}"] for value in stage.reference])


def _row(row: Row) -> list[str]:
    where = f" at {'node' if len(row.nodes) == 1 else 'nodes'} {nodes(row.nodes)}" if row.nodes else ""
    return [
        f"{row.lower:g} .. {row.upper:g}{where}",
        row.strictness if row.soft else "",
    ]


def _value(parameter: Signal) -> list[str]:
    between = "" if len(parameter.low) != 1 else f"{parameter.low[0]:g} .. {parameter.high[0]:g}"
    return [parameter.unit, f"declared {', '.join(f'{value:g}' for value in parameter.value[:4])}", between]
