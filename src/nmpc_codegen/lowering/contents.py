"""The README.md of a package states how many lines of its .c each part has, and which options shorten the .c."""

from __future__ import annotations

import re
from collections.abc import Iterator

from nmpc_codegen.lowering.unit.pipeline import LAST_HEADING
from nmpc_codegen.package.features import Features

_SECTION = re.compile(r"^/\* ==== (.*?) =+ \*/$", re.MULTILINE)
_LAST = _SECTION.findall(LAST_HEADING)[0]
#: Name of the text above the first section.
DEFINITIONS = "sizes, names, tolerances and tables"


def lines_by_section(unit: str) -> dict[str, int]:
    """Return {section: number of lines}, in the order of the text."""
    found: dict[str, int] = {}
    texts = _SECTION.split(unit)
    for title, text in zip((DEFINITIONS, *texts[1::2]), texts[::2], strict=True):
        name = title if title != _LAST else "solve()"
        found[name] = found.get(name, 0) + text.count("\n")
    return found


def shorter(features: Features) -> Iterator[tuple[str, str]]:
    """Yield (option, what it removes) for the options that would shorten this package."""
    if features.solve:
        yield "solve=False", "solve() and the functions that only it needs, about a fifth of the lines"
    if features.has_qp and features.iterates:
        yield "algorithm.iterations=1", "the search after the first QP of a sample, about a twentieth of the lines"
    if features.relax and features.relaxation:
        yield "algorithm.relaxation=None", "the relaxation of hard rows in an infeasible QP, about 100 lines"
    if not features.small:
        second = " and a second method for QPs" if features.has_qp else ""
        yield "goal=size", f"straight-line code{second}, a fifth to two fifths of the lines, but samples take longer"
