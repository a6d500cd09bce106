"""The figures and tables of the papers: all can be drawn, numbers with an oracle hold, and all are on the page."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "papers.md"

#: Paper -> figures and tables with data in it; others show notation, parameters or the compiler's own interface.
EXHIBITS = {
    "H11": ("Table 1", "Table 2", "Fig. 5", "Fig. 6"),
    "Q14": ("Table I", "Table III", "Fig. 1"),
    "HSJ": ("Fig. 1", "Fig. 2"),
    "Z20": ("Fig. 1", "Fig. 2", "Fig. 3", "Fig. 4"),
    "T09": (
        *("Fig. 6.3", "Fig. 6.4", "Fig. 6.6", "Fig. 6.7", "Fig. 6.8", "Fig. 6.9", "Fig. 6.10", "Fig. 6.11"),
        *("Fig. 6.12", "Fig. 6.13", "Fig. 6.14", "Fig. 6.15", "Table 6.3", "Table 6.4", "Table 6.7"),
        *("Fig. 7.1", "Fig. 7.2", "Fig. 7.3"),
    ),
}


def places(page: str, paper: str) -> set[str]:
    """What the headings of a paper's part name: "Figs. 6.7, 6.8" are two figures."""
    part = page.split(f"\n## {paper}: ")[1].split("\n## ")[0]
    found = set()
    for heading in re.findall(r"^### (.*?): ", part, re.M):
        kind = ""
        for word in heading.split(", "):
            head, _, number = word.rpartition(" ")
            kind = head.replace("Figs.", "Fig.").replace("Tables", "Table") or kind
            found.add(f"{kind} {number}")
    return found


#: That whose figures are drawn soonest.
QUICK = ("HSJ",)


@pytest.mark.parametrize("paper", [p if p in QUICK else pytest.param(p, marks=pytest.mark.slow) for p in EXHIBITS])
def test_every_figure_can_be_drawn(paper: str, tmp_path: Path, need: Callable[[str], str]) -> None:
    """At scale 0; the exit status says whether a number misses its limit."""
    need("cc")
    need("cxx")
    environment = dict(os.environ)
    if shutil.which("tcc"):
        environment |= {"CC": "tcc", "C_INCLUDE_PATH": str(ROOT / "tests" / "tcc")}
    command = [sys.executable, "-m", "benchmarks.papers", "--scale", "0", "--only", paper, "--folder", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout[-2000:]}{done.stderr[-3000:]}"
    page = (tmp_path / "papers.md").read_text(encoding="utf-8")
    assert set(EXHIBITS[paper]) <= places(page, paper)
    assert set(re.findall(r"papers/\w+\.png", page)) == {f"papers/{p.name}" for p in tmp_path.glob("papers/*.png")}


def test_no_figure_is_missing_on_the_page() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for paper, wanted in EXHIBITS.items():
        assert set(wanted) <= places(page, paper), paper
    linked = set(re.findall(r"\]\(([\w/]+\.png)\)", page))
    assert all((PAGE.parent / name).is_file() for name in linked)
    assert {f"papers/{p.name}" for p in PAGE.parent.glob("papers/*.png")} == {p for p in linked if "/" in p}


def test_wrong_words() -> None:
    command = [sys.executable, "-m", "benchmarks.papers", "--only", "H12"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--only H12: expected some of H11" in done.stderr
