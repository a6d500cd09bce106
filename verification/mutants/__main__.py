"""The command puts the faults of mutants.py into a copy of the project, one at a time, and runs the nearest tests.

    python -m verification.mutants [NUMBER ...]

A fault is caught if a test fails; an error before the first test does not count. The exit status is 1 if a fault
survives.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from verification.mutants.mutants import MUTANTS, Mutant

ROOT = Path(__file__).parents[2]
COPIED = ("src", "templates", "tests", "verification", "examples", "pyproject.toml")
SECONDS = 240  # of the tests of a fault


def copy_project(folder: Path) -> None:
    """Copy the files that the tests need."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder / name)


def put(mutant: Mutant, folder: Path) -> str:
    """Put the fault into the copy and return the text before.

    Raises ValueError unless the text that it replaces occurs once.
    """
    path = folder / mutant.path
    text = path.read_text(encoding="utf-8")
    if text.count(mutant.before) != 1:
        raise ValueError(f"{mutant.path} contains {mutant.before!r} {text.count(mutant.before)} times; expected once")
    path.write_text(text.replace(mutant.before, mutant.after), encoding="utf-8")
    return text


def run(mutant: Mutant, folder: Path) -> tuple[bool, str]:
    """Return whether the tests detect the fault, and the first test that does."""
    text = put(mutant, folder)
    try:
        environment = {**os.environ, "PYTHONPATH": str(folder / "src")}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "2", "-p", "no:cacheprovider", *mutant.tests]
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=SECONDS
        )
    finally:
        (folder / mutant.path).write_text(text, encoding="utf-8")
    first = re.search(r"^FAILED (\S+)", done.stdout, re.M)
    return first is not None, first[1] if first else done.stdout.strip().splitlines()[-1]


def main() -> None:
    """Run all faults, or those whose numbers are given."""
    numbers = [int(word) for word in sys.argv[1:]] or range(1, len(MUTANTS) + 1)
    survived = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy_project(folder)
        for number in numbers:
            mutant, start = MUTANTS[number - 1], time.perf_counter()
            caught, by = run(mutant, folder)
            survived += not caught
            word = "caught" if caught else "SURVIVED"
            print(f"{number:2}  {word:8}  {time.perf_counter() - start:4.0f} s  {mutant.name}: {by}", flush=True)
    print(f"{len(numbers) - survived} of {len(numbers)} faults caught")
    sys.exit(survived > 0)


if __name__ == "__main__":
    main()
