"""Docstrings and comments contain none of the idioms in the table of CONTRIBUTING.md."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tests.repository.test_architecture import ROOT, SOURCE, TEMPLATES

#: Idiom -> term to take.
IDIOMS = dict(re.findall(r'^\| "(.+?)" \| (.+?) \|$', (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.M))
PATTERN = re.compile(rf"(?<![`\w])(?:{'|'.join(map(re.escape, IDIOMS))})(?![`\w])", re.IGNORECASE)
COMMENT = {".py": r"#.*", **dict.fromkeys((".c", ".h", ".jinja"), r"/\*.*?\*/")}
NODES = (ast.Module, ast.ClassDef, ast.FunctionDef)


def idioms_of(text: str) -> list[str]:
    """Return the idioms in a text, whose lines may begin with a mark of comments."""
    return PATTERN.findall(re.sub(r"\s*\n\s*[*#:]*\s*", " ", text))


def idioms_in(path: Path) -> list[str]:
    """Return the idioms in the docstrings and comments of a file."""
    text = path.read_text(encoding="utf-8")
    nodes = [n for n in ast.walk(ast.parse(text if path.suffix == ".py" else "")) if isinstance(n, NODES)]
    comments = re.findall(COMMENT[path.suffix], text, re.S if path.suffix != ".py" else 0)
    return idioms_of("\n".join([*(ast.get_docstring(n) or "" for n in nodes), *comments]))


def test_no_text_contains_an_idiom() -> None:
    files = [path for folder in (SOURCE, TEMPLATES) for path in folder.rglob("*") if path.suffix in COMMENT]
    found = {str(path): idioms for path in files if "lanes" not in str(path) and (idioms := idioms_in(path))}
    assert {path: [(idiom, IDIOMS[idiom.lower()]) for idiom in idioms] for path, idioms in found.items()} == {}


def test_idioms_are_found_across_lines() -> None:
    assert len(IDIOMS) >= 30
    assert [idioms_of(text) for text in ("a plan of\n * late", "`alone`, latency")] == [["of late"], []]
