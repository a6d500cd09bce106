"""Callgrind counts instructions of functions, a measure that other processes do not disturb."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

#: Functions of closed_loop.c that run the controller, not the plant.
PHASES = ("preparation", "feedback_phase")


def available() -> bool:
    """Return True if valgrind is installed."""
    return shutil.which("valgrind") is not None


def instructions(program: Path, arguments: Sequence[str], functions: Iterable[str]) -> int | None:
    """Count the instructions between entry and return of these functions, which the program calls.

    Returns None if valgrind does not know an instruction; 3.19 does not know vmovq between registers in one of its two
    encodings.
    """
    tool = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
    tool += [f"--toggle-collect={function}" for function in functions]
    done = subprocess.run([*tool, str(program), *arguments], check=False, capture_output=True, text=True)
    if done.returncode and "did not recognise" in done.stderr:
        return None
    found = re.search(r"Collected : (\d+)", done.stderr)
    if done.returncode or found is None or int(found[1]) == 0:
        raise ValueError(f"callgrind has counted nothing:\n{done.stderr}")
    return int(found[1])


def profile(program: Path, arguments: Sequence[str], functions: Iterable[str] = ()) -> dict[str, int]:
    """Count the instructions of every function, without those that it calls; clones of a function are added up.

    ``functions``: limits the count to the time between their entry and return.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = f"{folder}/instructions"
        tool = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}"]
        tool += [f"--toggle-collect={function}" for function in functions]
        subprocess.run([*tool, str(program), *arguments], check=True, capture_output=True)
        command = ["callgrind_annotate", "--threshold=100", out]
        text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found: dict[str, int] = {}
    for count, symbol in re.findall(r"^\s*([\d,]+) \([^)]*\)\s+\S*?:(\S+)", text, re.M):
        name = symbol.split(".")[0]
        found[name] = found.get(name, 0) + int(count.replace(",", ""))
    return found
