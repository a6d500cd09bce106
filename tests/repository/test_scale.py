"""A scale at the door: how many lines of code a room may have.

A line of code is one that holds more than a comment, a docstring or nothing. Whoever needs a higher limit raises it
and writes beside it what the lines have bought.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

from tests.repository.test_architecture import ROOT

#: Room -> the largest number of lines of code, and what the last raise has bought.
LIMITS: dict[str, tuple[int, str]] = {
    "src/analysis": (640, "no function with more than ten branches"),
    "src/campaigns": (1800, "flights with verdicts, by any workers, kept as they come; options and weights by them"),
    "src/cli": (1065, "the page of a campaign, which stood in campaigns"),
    "src/components": (6113, "what every member of the scratch memory of a scheme holds, in its comment"),
    "src/decisions": (893, "what chose in lowering: integrator, Hessian, condensing, QP solver; trials that are kept"),
    "src/derivatives": (820, "derivatives of implicit schemes"),
    "src/economic": (1685, "steady states of implicit schemes, as expressions"),
    "src/firmware": (1105, "dumps in budgets and libraries"),
    "src/frontend": (3475, "controls whose slope vanishes, first plans and scales from residuals"),
    "src/ir": (
        2845,
        "sweeps cut into stages, straight programs into parts; no result that nothing reads, in loops as well",
    ),
    "src/lowering": (4557, "three numbers with their reasons that were options of components"),
    "src/oracle": (585, "algebraic variables of stages and nodes as variables of the NLP"),
    "src/package": (1218, "deviations from MISRA C, which every package for a board states"),
    "src/pictures": (1220, "one room for what is drawn, which stood in runtime and campaigns"),
    "src/runtime": (6740, "bounds over the samples of many loops, tables of flights"),
    "site": (265, "pages that are files elsewhere, parts that programs print, options with their rules, dead links"),
    "templates": (19403, "a plan of single shooting that leads nowhere is forgotten"),
    "tests": (28650, "the passes of a unit run once for the same items, whatever test states it"),
    "verification": (
        9978,
        "contracts of all packages, which stood in tests for one component each; faults in rooms that were new",
    ),
    "benchmarks": (3942, "these draws"),
    "examples": (1820, "a thousand flights past a pillar, the best period of the fermentation"),
}

#: All lines that are counted, and those at the top of src/nmpc_codegen: whoever adds lines takes them from somewhere,
#: or raises this limit, too, and writes here what the whole has bought.
WHOLE = (99421, "options that nobody was better off with have left")

_IGNORED = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
_BLANKED = re.compile(r"/\*.*?\*/|\{#.*?#\}", re.DOTALL)


def lines_of_python(text: str) -> int:
    """Return the number of lines with a token of code; docstrings are none."""
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _IGNORED:
            found.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", None)
        first = body[0] if isinstance(body, list) and body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
            found -= set(range(first.lineno, (first.end_lineno or 0) + 1))
    return len(found)


def lines_of_c(text: str) -> int:
    """Return the number of lines that are not empty without their comments."""
    bare = _BLANKED.sub(lambda found: "\n" * found[0].count("\n"), text)
    return sum(1 for line in bare.split("\n") if line.strip())


def lines_of(room: Path) -> int:
    """Return the lines of code below a folder."""
    total = 0
    for path in room.rglob("*"):
        if path.suffix == ".py":
            total += lines_of_python(path.read_text(encoding="utf-8"))
        elif path.suffix in (".c", ".h", ".jinja") or path.name == "Makefile":
            total += lines_of_c(path.read_text(encoding="utf-8"))
    return total


def rooms() -> dict[str, Path]:
    """Name -> folder: the rooms of src, and the other folders with code."""
    of_source = (ROOT / "src" / "nmpc_codegen").iterdir()
    found = {f"src/{path.name}": path for path in sorted(of_source) if (path / "__init__.py").exists()}
    return found | {
        name: ROOT / name for name in ("templates", "tests", "verification", "benchmarks", "examples", "site")
    }


def test_every_room_has_a_limit() -> None:
    assert set(LIMITS) == set(rooms())


@pytest.mark.parametrize("room", LIMITS)
def test_a_room_does_not_outgrow_its_limit(room: str) -> None:
    limit, _ = LIMITS[room]
    assert lines_of(rooms()[room]) <= limit, "delete first; a higher limit needs a sentence on what it buys"


def test_the_whole_does_not_outgrow_its_limit() -> None:
    top = (ROOT / "src" / "nmpc_codegen").glob("*.py")
    whole = sum(map(lines_of, rooms().values())) + sum(lines_of_python(p.read_text(encoding="utf-8")) for p in top)
    limit, _ = WHOLE
    assert whole <= limit, "take lines from somewhere; a higher limit needs a sentence on what the whole has bought"


def test_lines_are_counted() -> None:
    assert (
        lines_of_python(
            '"""Text\n\nof two."""\n\nx = 1  # one\n# none\n\ndef f():\n    """None."""\n    return """a\nb"""\n'
        )
        == 4
    )
    assert lines_of_c("/* none\n */\nint x; /* one */\n\n{# none #}\n#endif\n") == 2
