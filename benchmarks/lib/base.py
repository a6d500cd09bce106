"""A base commit is checked out, and its own code makes its closed loops and figures."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.lib.run import RefusedError

ROOT = Path(__file__).parents[2]
ENTRY = "benchmarks/__main__.py"


@dataclass(frozen=True)
class Base:
    """A base is a commit, checked out in a folder."""

    name: str
    folder: Path

    def run(self, module: str, *arguments: str) -> None:
        """Run a module of that commit with its own sources; raise RefusedError if it fails."""
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(self.folder / "src"), str(self.folder)])}
        command = [sys.executable, "-m", module, *arguments]
        done = subprocess.run(command, cwd=self.folder, env=environment, check=False, stdout=subprocess.DEVNULL)
        if done.returncode:
            raise RefusedError(f"--base {self.name}: {module} of that commit failed")


@contextmanager
def checkout(commit: str, folder: Path) -> Iterator[Base]:
    """Yield a checkout of the commit in this folder.

    Raises:
        RefusedError: there is no such commit, or it is too old: its benchmarks are not of this kind.
    """
    found = _git("rev-parse", "--short", "--verify", "--quiet", f"{commit}^{{commit}}")
    if found.returncode:
        raise RefusedError(f"--base {commit}: there is no such commit in this repository")
    name = found.stdout.strip()
    if _git("cat-file", "-e", f"{name}:{ENTRY}").returncode:
        raise RefusedError(f"--base {commit}: that commit has no {ENTRY}; expected a commit that has one")
    place = folder / "base"
    added = _git("worktree", "add", "--detach", str(place), name)
    if added.returncode:
        raise RefusedError(f"--base {commit}: git worktree failed: {added.stderr.strip()}")
    try:
        yield Base(name, place)
    finally:
        _git("worktree", "remove", "--force", str(place))


def head() -> str:
    """Return the short name of the checked-out commit, with + if files differ from it; empty without git."""
    described = _git("describe", "--always", "--dirty=+", "--exclude=*")
    return described.stdout.strip() if described.returncode == 0 else ""


def commits() -> int:
    """Return the number of commits that lead to the checked-out one; 0 without git."""
    counted = _git("rev-list", "--count", "HEAD")
    return int(counted.stdout) if counted.returncode == 0 else 0


def _git(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
