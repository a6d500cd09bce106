"""Comments of parts: entries of contracts, no condition on what a package has."""

from __future__ import annotations

from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.lowering.unit.contracts import without_entries


def test_entries_of_functions_that_are_not_there() -> None:
    contract = """/* Contract
 *   first     once
 *   second, third(x)  later,
 *             in two lines
 *   API(last)   always
 * Here: nothing. */"""
    assert without_entries(contract, {"first", "second", "third", "API"}) == contract
    assert without_entries(contract, {"first", "API"}) == contract.replace(
        " *   second, third(x)  later,\n *             in two lines\n", ""
    )
    assert "third" in without_entries(contract, {"third"})
    assert "Here: nothing." in without_entries(contract, set())


def test_comments_have_no_conditions() -> None:
    """They state what holds in every package, or stand beside the code that goes with them."""
    assert [p.name for p in template_directory().rglob("*.c*") if "[if " in p.read_text(encoding="utf-8")] == []
