"""The table of the rows, and the functions that read it."""

from __future__ import annotations

import re

import pytest

from nmpc_codegen.lowering.rows import COLUMNS, row_functions, row_ranges
from nmpc_codegen.package.signals import IMPOSED_KINDS
from verification.rendered import lowered, texts
from verification.samples import SAMPLES

NAMED = {sample.name: sample for sample in SAMPLES}


@pytest.mark.parametrize("name", ["path dense", "final dense", "ring dense", "everything dense", "states riccati"])
def test_the_table_holds_the_rows(name: str) -> None:
    module = lowered(NAMED[name])
    found = row_functions(module)
    values = dict(found["columns"])
    stored = found["tables"][0].columns if found["tables"] else ()
    numbers = [
        list(map(int, re.findall(r"-?\d+", row)))
        for t in found["tables"]
        for row in re.findall(r"\{[^{}]*\}", " ".join(t.lines))
    ]
    for m, row in enumerate(module.rows):
        for column, entry in zip(COLUMNS, row, strict=True):
            if column in stored:
                assert numbers[m][stored.index(column)] == entry
            elif column != "kind":
                assert values[column] in (str(entry), "N" if entry == module.value("N") else "")
    assert len(numbers) in (0, len(module.rows))


def test_a_kind_that_all_rows_have_is_no_column() -> None:
    """Branches for other kinds are not in the package."""
    unit = texts(NAMED["states riccati"])["states.c"]
    assert "row_is_state" not in unit
    assert "row_is_coupled" not in unit
    assert re.search(r"row_constant\(const solver_t \*s, int m\)\n\{\n    return s->x\[row_node\(m\)\]", unit)
    assert "row_is_state(m)" in texts(NAMED["everything dense"])["everything.c"]


def test_rows_of_one_node_have_no_node_in_the_table() -> None:
    unit = texts(NAMED["final dense"])["final.c"]
    assert "row_node" not in unit
    assert "node" not in unit[unit.index("static const struct {") : unit.index("row_data[")]


def test_what_is_known_of_rows() -> None:
    """Least and greatest value of every function, against the rows."""
    for name in ("path dense", "everything dense", "states riccati", "final dense", "bare dense"):
        module = lowered(NAMED[name])
        found = row_ranges(module)
        for i, column in enumerate(COLUMNS):
            values = [row[i] for row in module.rows] or [0]
            assert column == "kind" or found[f"row_{column}"] == (min(values), max(values))
        kinds = [row[1] for row in module.rows]
        for number, word in enumerate(IMPOSED_KINDS):
            assert found[f"row_is_{word}"] == (int(set(kinds) == {number}), int(number in kinds))
    assert row_ranges(lowered(NAMED["soft states dense"]))["row_is_soft"] == (1, 1)
    assert row_ranges(lowered(NAMED["soft rows dense"]))["row_is_soft"] == (0, 1)
    assert row_ranges(lowered(NAMED["path dense"]))["row_is_soft"] == (0, 0)
