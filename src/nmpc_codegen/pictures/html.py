"""Pages and tables for notebooks are HTML without scripts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.runtime.records.trace import Trace

Array = NDArray[np.float64]

#: Head of the table of rows of a problem.
ROWS = ("lower", "row", "upper", "unit", "nodes", "")

#: Largest number of rows of a table; of more, the first ones and the number of others are shown.
SHOWN = 40


def page(title: str, text: str, tables: Iterable[str]) -> str:
    """Return a title in bold followed by a text, with tables below."""
    lines = "<br>".join(map(escape, text.splitlines()))
    return f"<div><p><b>{escape(title)}</b>: {lines}</p>{''.join(tables)}</div>"


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table with numbers to six digits; "" without rows."""
    lines = [_line("th", head), *(_line("td", row) for row in rows)]
    return f"<table>{''.join(lines)}</table>" if rows else ""


def shorten(rows: Sequence[tuple[object, ...]]) -> list[tuple[object, ...]]:
    """Return the first SHOWN rows of one kind, and the number of further rows."""
    more = [("", f"and {len(rows) - SHOWN} more")] if len(rows) > SHOWN else []
    return [*rows[:SHOWN], *more]


def ranges(groups: Iterable[tuple[str, Sequence[Trace], Array]]) -> str:
    """Return a table of quantities with first, last, least and largest values: kind, traces, values (n, traces)."""
    found: list[tuple[object, ...]] = []
    for kind, traces, values in groups:
        lines: list[tuple[object, ...]] = []
        for trace, column in zip(traces, values.T, strict=True):
            ends = (column[0], column[-1], column.min(), column.max()) if len(column) else ("",) * 4
            lines.append((kind, trace.name, trace.unit, *ends))
        found += shorten(lines)
    return table(("", "name", "unit", "first", "last", "least", "most"), found)


def _line(tag: str, cells: Sequence[object]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(_in_short(cell))}</{tag}>' for cell in cells)}</tr>"


def _in_short(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    return ("∞" if value > 0 else "-∞") if math.isinf(value) else f"{value:.6g}"
