"""A notebook shows an OCP as tables."""

from __future__ import annotations

import numpy as np

from nmpc_codegen.frontend.show import elements_of, grid_of
from nmpc_codegen.frontend.statement import ResidualTerm, StatedProblem, Statement
from nmpc_codegen.package.signals import list_some, nodes, units
from nmpc_codegen.pictures.html import ROWS, page, shorten, table

LONGEST = 80  # largest number of characters of an expression
STAGES = {"start": "node 0", "path": "nodes 0..N-1", "terminal": "node N"}


def in_html(ocp: StatedProblem) -> str:
    """Return signals with units and values, rows with bounds, and terms of the cost."""
    return page(
        f"OCP {ocp.name}",
        "\n".join([grid_of(ocp), *_incomplete(ocp)]),
        [
            table(("", "name", "unit", "value", ""), _signals(ocp)),
            table(
                ROWS,
                shorten([r for s in ocp.statements for r in _row_lines(ocp, s)]),
            ),
            table(("cost", "at", "weight", "reference"), shorten([row for r in ocp.residuals for row in _terms(r)])),
            table(
                ("general cost", "at", ""),
                [(_short(c.expression), STAGES[c.stage], "integrated" if c.integrate else "") for c in ocp.costs],
            ),
        ],
    )


def _incomplete(ocp: StatedProblem) -> list[str]:
    """Return lines on what must still be stated before a controller can be built."""
    names = elements_of(ocp.states)
    known = {*ocp.derivatives, *ocp.maps, *ocp.slopes}
    open_states = [name for i, name in enumerate(names) if i not in known]
    missing = [f"the dynamics of {list_some(open_states)}"] if open_states else []
    missing += [] if ocp.states else ["a state"]
    missing += [] if ocp.controls or ocp.free else ["a control"]
    missing += [] if ocp.residuals or ocp.costs else ["a cost"]
    wanted = sum(d.signal.size for d in ocp.algebraics) + sum(i not in ocp.derivatives for i in ocp.slopes)
    missing += [f"{wanted - len(ocp.equations)} algebraic equations"] if wanted > len(ocp.equations) else []
    return [f"still missing: {', '.join(missing)}"] if missing else []


def _signals(ocp: StatedProblem) -> list[tuple[object, ...]]:
    marks = {"free at node 0": ocp.free, "accumulator": ocp.accumulators, "cyclic": ocp.cyclic_states}
    found: list[tuple[object, ...]] = []
    for kind, declared in (
        *(("state", ocp.states), ("control", ocp.controls)),
        *(("algebraic", ocp.algebraics), ("parameter", ocp.parameters)),
    ):
        lines: list[tuple[object, ...]] = []
        for signal in (d.signal for d in declared):
            for i, (name, value) in enumerate(zip(signal.elements, signal.value, strict=True)):
                notes = [mark for mark, which in marks.items() if kind == "state" and signal.offset + i in which]
                if signal.low:
                    notes.append(f"{signal.low[i]:g} .. {signal.high[i]:g}")
                lines.append((kind, name, signal.unit, "" if kind == "control" else value, ", ".join(notes)))
        found += shorten(lines)
    return found


def _row_lines(ocp: StatedProblem, statement: Statement) -> list[tuple[object, ...]]:
    known = units(*([d.signal for d in of] for of in (ocp.states, ocp.controls, ocp.algebraics)))
    at = statement.at if isinstance(statement.at, str) else "x_0, x_N" if statement.at is None else nodes(statement.at)
    l1, l2 = statement.soft or (0.0, 0.0)
    costs = [text for text, weight in ((f"{l1:g} v", l1), (f"½ {l2:g} v²", l2)) if weight]
    dt = " times dt_k" if statement.scaled else ""
    soft = "hard" if statement.soft is None else f"soft, violation v costs {' + '.join(costs) or 0}{dt}"
    soft = "hard, may become soft" if l1 == float("inf") else soft
    found: list[tuple[object, ...]] = []
    for i, name in enumerate(statement.names):
        element = ocp.element(statement.expression[i])
        unit = known.get(element.name, "") if element else ""
        found.append((float(statement.lower[i]), name, float(statement.upper[i]), unit, at, soft))
    return found


def _short(expression: object) -> str:
    text = str(expression)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def _terms(residual: ResidualTerm) -> list[tuple[object, ...]]:
    """Return one row per element, with its weight and the number of entries off the diagonal."""
    diagonal = np.diag(residual.weight)
    coupled = np.count_nonzero(residual.weight - np.diag(diagonal), axis=1)
    scaled = " dt" if residual.scale_with_dt else ""
    return [
        (f"½ ({name})²", STAGES[residual.stage], f"{w:.6g}{scaled}{f' ({n} off the diagonal)' if n else ''}", float(y))
        for name, w, n, y in zip(residual.names, diagonal, coupled, residual.reference, strict=True)
    ]
