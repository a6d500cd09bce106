"""Comments of parts: phrases that depend on the package, entries of contracts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import nmpc_codegen
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.lowering.unit.comments import without_entries, word_comments
from verification.rendered import lowered
from verification.samples import SAMPLES

KNOWN = Constants({"NE": 0, "SOLVE": 1, "NSL": 2})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/* A general [if NE > 0: or coupled] row. */", "/* A general row. */"),
        ("/* Rows[if NE > 0:, coupled ones too]. */", "/* Rows. */"),
        ("/* Rows[if SOLVE:, those of solve() too]. */", "/* Rows, those of solve() too. */"),
        ("/* [if NE > 0: Coupled. else: None.] Others. */", "/* None. Others. */"),
        ("/* [if NE == 0 && NSL > 1: Both.] */", "/* Both. */"),
        ("/* [if ABSENT: Of others.] One. */", "/* One. */"),
        ("/* [if SOLVE: certificate[] holds f[i].] */", "/* certificate[] holds f[i]. */"),
        ("    int x; /* one[if NE > 0: or two] */", "    int x; /* one */"),
    ],
)
def test_phrases(text: str, expected: str) -> None:
    assert word_comments(text, KNOWN) == expected
    assert word_comments(f"before();\n{text}\nafter();", KNOWN) == f"before();\n{expected}\nafter();"


def test_code_is_no_comment() -> None:
    code = 'x[if_zero: 0];\nprintf("[if NE: a]");\n/* none */'
    assert word_comments(code, KNOWN) == code


def test_a_paragraph_is_filled_again_and_what_stands_apart_is_not() -> None:
    """A phrase may be broken over lines; formulas and lists keep their lines, those that become empty go."""
    text = """/* Contract
 *
 *     a = b [if NE > 0: + c]
 *     [if NE > 0: c = d]
 *     e = f
 *
 * The rest of it [if NE > 0: is as long as this
 * and] is short, and its lines are filled
 * again, to the end of it. */"""
    assert (
        word_comments(text, KNOWN)
        == """/* Contract
 *
 *     a = b
 *     e = f
 *
 * The rest of it is short, and its lines are filled again, to the end of it. */"""
    )
    assert word_comments("/* A\n *     a = b\n * [if NE > 0: C.] */", KNOWN) == "/* A\n *     a = b */"
    margin = "    "
    long = f"{margin}/* [if SOLVE: {'word ' * 30}end.] */"
    lines = word_comments(long, KNOWN).split("\n")
    assert len(lines) == 2
    assert all(len(line) <= 120 for line in lines)
    assert lines[1].startswith(f"{margin} * ")
    assert lines[1].endswith("end. */")


def test_a_whole_package_has_every_phrase() -> None:
    assert word_comments("/* A [if NE > 0: coupled else: general] row. */", None) == "/* A coupled row. */"


def test_a_condition_on_data_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\[if k > 0: ...\]: expected a condition on sizes"):
        word_comments("/* [if k > 0: later] */", KNOWN)


def test_conditions_name_what_some_package_has() -> None:
    """A misspelt name would count as 0 everywhere."""
    package = Path(nmpc_codegen.__file__).parent / "components"
    files = [*template_directory().rglob("*.c"), *template_directory().rglob("*.jinja"), *package.rglob("*.py")]
    parts = "".join(file.read_text(encoding="utf-8") for file in files)
    named = set(re.findall(r"[A-Z]\w*", " ".join(re.findall(r"\[if\s+([^:\]]+):", parts))))
    assert {"NE", "SOLVE", "ELASTIC"} < named
    assert named <= set().union(*(lowered(sample).sizes for sample in SAMPLES))


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


def test_a_phrase_behind_a_word_begins_with_a_mark() -> None:
    """Its blank is that in front of the bracket: without one, the words would be one word."""
    glued = re.compile(r"\w\[if [^:\]]*: \w")
    assert [p.name for p in template_directory().rglob("*.c*") if glued.search(p.read_text(encoding="utf-8"))] == []
