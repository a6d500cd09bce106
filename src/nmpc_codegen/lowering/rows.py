"""The rows of the QP form a table, which the functions of core/rows.c.jinja read.

A row has a node, a kind (bound of a state, general row, coupled row), its component of x, h or r, and the row of the
user to which it belongs. The functions row_node(m), row_index(m), ... of a package read the table. If all rows have the
same entry in a column, the function returns that entry, and the exporter removes code for other entries.
"""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap
from typing import Any

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.package.signals import IMPOSED_KINDS

#: Column of the table -> its meaning.
COLUMNS = {
    "node": "its node",
    "kind": "its kind",
    "index": "its component of x, h or r",
    "id": "the row of the user",
}
WIDTH = 112


@dataclass(frozen=True)
class RowTable:
    """A row table has the columns in which rows differ, with lines of C text for some rows each."""

    columns: tuple[str, ...]
    meaning: str
    size: int
    lines: tuple[str, ...]


def row_functions(module: CModule) -> dict[str, Any]:
    """Return the names for core/rows.c.jinja."""
    entries = {name: [row[i] for row in module.rows] for i, name in enumerate(COLUMNS)}
    kinds = sorted(set(entries["kind"]))
    stored = tuple(name for name, values in entries.items() if len(set(values)) > 1)
    columns = [(name, _entry(name, entries[name], module)) for name in COLUMNS if name != "kind"]
    columns += [
        (f"is_{word}", _is_kind(number, kinds)) for number, word in enumerate(IMPOSED_KINDS) if word != "general"
    ]
    constants = [f"ROW_{IMPOSED_KINDS[number].upper()} = {number}" for number in kinds]
    node = set(entries["node"])
    where = _entry("node", entries["node"], module) if len(node) == 1 else "row_node(m)"
    copies = {"shared": "1" if where == "N" else "0" if len(node) == 1 else "row_node(m) == N", "node": where}
    layout = module.layouts["bounds"]
    place = "default_{}" if layout == "fixed" else f"s->{{}}[{copies[layout]}]"
    return {
        "kinds": [("kind", constants)] if "kind" in stored else [],
        "tables": [_table(stored, entries)] if stored else [],
        "columns": columns,
        "lower": place.format("lower"),
        "upper": place.format("upper"),
    }


def row_ranges(module: CModule) -> dict[str, tuple[int, int]]:
    """Return {function of rows: (least, greatest return value)}."""
    entries = {name: [row[i] for row in module.rows] or [0] for i, name in enumerate(COLUMNS)}
    found = {f"row_{name}": (min(values), max(values)) for name, values in entries.items() if name != "kind"}
    for number, word in enumerate(IMPOSED_KINDS):
        kinds = [int(kind == number) for kind in entries["kind"]] if module.rows else [0]
        found[f"row_is_{word}"] = (min(kinds), max(kinds))
    sizes = module.sizes
    found["row_is_soft"] = (int(not sizes["HARD_ROWS"] and sizes["SOFT_ROWS"] > 0), int(sizes["SOFT_ROWS"] > 0))
    return found


def _entry(name: str, values: list[int], module: CModule) -> str:
    """Return the result of the function of a column."""
    if len(set(values)) > 1:
        return f"row_data[m].{name}"
    if not values:
        return "0"
    return "N" if name == "node" and values[0] == module.value("N") else str(values[0])


def _is_kind(number: int, kinds: list[int]) -> str:
    """Return the C condition that row m is of a kind."""
    if number not in kinds:
        return "0"
    return "1" if len(kinds) == 1 else f"row_data[m].kind == ROW_{IMPOSED_KINDS[number].upper()}"


def _table(stored: tuple[str, ...], entries: dict[str, list[int]]) -> RowTable:
    columns = [entries[name] for name in stored]
    rows = ["{" + ", ".join(map(str, row)) + "}" for row in zip(*columns, strict=True)]
    text = ", ".join(row.replace(" ", "_") for row in rows)  # a row stays on one line
    lines = tuple(line.replace("_", " ") for line in wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False))
    return RowTable(stored, ", ".join(COLUMNS[name] for name in stored), len(rows), lines)
