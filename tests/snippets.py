"""The code of the documents, run as a reader would run it: fenced blocks in their order, in one folder."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
FENCE = re.compile(r"^```(\w+)(?: (file|run)(?:=(\S+))?)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its file ("" if it is only run), its text."""

    language: str
    file: str
    text: str

    @property
    def states_a_problem(self) -> bool:
        """True for a Python text that nmpc-export accepts."""
        return self.language == "python" and "OCP(" in self.text


def blocks(document: str) -> list[Block]:
    """The fenced blocks of a document, in order."""
    text = (ROOT / document).read_text(encoding="utf-8")
    return [Block(m[1], m[3] or "", m[4]) for m in FENCE.finditer(text)]


def documents() -> list[str]:
    """README.md and docs/*.md, as far as they contain code."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    return [str(path.relative_to(ROOT)) for path in found if FENCE.search(path.read_text(encoding="utf-8"))]


def run(command: list[str], folder: Path, search: tuple[Path, ...]) -> str:
    """Run a command in a folder with Python looking into ``search`` first; its output."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, search)),
        "PATH": os.pathsep.join([str(folder / "bin"), os.environ["PATH"]]),
        "MPLBACKEND": "Agg",
    }
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def install_command(folder: Path) -> None:
    """Write nmpc-export of this tree to bin/ of a folder, where run() finds it."""
    tool = folder / "bin" / "nmpc-export"
    tool.parent.mkdir()
    tool.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m nmpc_codegen.cli "$@"\n', encoding="utf-8")
    tool.chmod(0o755)


def changed(text: str, difference: str) -> str:
    """The text with a difference applied; the text that the difference expects must occur exactly once."""
    lines = difference.splitlines()
    old = "\n".join(line[1:] for line in lines if line[0] in " -")
    new = "\n".join(line[1:] for line in lines if line[0] in " +")
    assert text.count(old) == 1, old
    return text.replace(old, new)


def copy_tree(folder: Path) -> None:
    """Copy the compiler with its examples to a folder, for pages that edit it."""
    for name in ("src", "templates", "examples"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))


def entries(text: str, section: str) -> set[str]:
    """Names that a section of a docstring explains."""
    found = re.findall(rf"^(?:{section}):\n((?:    .*\n|\n)*)", text + "\n", re.MULTILINE)
    return set(re.findall(r"^    (\w+):", "\n".join(found), re.MULTILINE))
