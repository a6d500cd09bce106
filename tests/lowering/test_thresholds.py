"""Every threshold of the C has a name, and its reason stands beside its definition."""

from __future__ import annotations

import re

import pytest

from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.lowering.unit.macros import arithmetic
from verification.rendered import texts
from verification.samples import SAMPLES

REASONS = {macro.name: macro.note for macro in arithmetic("double") if macro.note}
#: Folders whose numbers are those of their mathematics: series, and programs that are no part of a controller.
MATHEMATICS = ("math", "lanes", "derivatives", "firmware")
#: Numbers that formulas contain.
IN_FORMULAS = {"0", "0.0", "0.5", "1", "1.0", "2", "3"}


def test_parts_contain_no_threshold_without_a_name() -> None:
    found = []
    for path in template_directory().rglob("*.c"):
        if path.relative_to(template_directory()).parts[0] not in MATHEMATICS:
            numbers = set(re.findall(r"\bR\(([\d.e+-]+)\)", path.read_text(encoding="utf-8"))) - IN_FORMULAS
            found += [f"{path.name}: R({number})" for number in numbers]
    assert sorted(found) == ["riccati_interior_point_start.c: R(4)"]  # of a quadratic equation


@pytest.mark.parametrize("name", ["cart_pole", "ring interior", "counted quasi-Newton"])
def test_the_reason_of_every_threshold_is_in_the_package(name: str) -> None:
    sample = next(s for s in SAMPLES if s.name == name)
    unit = next(text for path, text in texts(sample).items() if path.endswith(".c") and path != "main.c")
    lines = unit.splitlines()
    defined = [(i, m[1]) for i, line in enumerate(lines) if (m := re.match(r"#define ((?:TOL|FACTOR)_\w+) ", line))]
    assert defined
    above = {macro: " ".join(lines[i - 2 : i + 1]).replace("  * ", " ") for i, macro in defined}
    assert [macro for macro, text in above.items() if f"/* {REASONS[macro]}" not in text] == []


def test_reasons_stand_alone() -> None:
    """A package prints some of them, in no order on which another one relies."""
    assert not [reason for reason in REASONS.values() if re.match(r"the same|then|it ", reason)]
    assert len(set(REASONS.values())) == len(REASONS)
