"""Every topic of the benchmarks runs: at scale 0, with one case each."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: Topics that compile GNU C or count the instructions of gcc's; the others run what tcc compiles, if it is there.
OF_GCC = ("instructions", "stiff", "algebraic", "batch", "campaigns", "strangers")


def names(page: bool) -> list[str]:
    """Topics of the page, or all others, whose programs are on this machine."""
    code = "from benchmarks.topics import PAGE, chosen; import json; "
    code += f"print(json.dumps([t for t in chosen('all') if (t in PAGE) is {page}]))"
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    found: list[str] = json.loads(out)
    return found


@pytest.mark.few(1)
@pytest.mark.parametrize("page", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize("of_gcc", [False, True])
def test_every_topic_runs(page: bool, of_gcc: bool, tmp_path: Path, need: Callable[[str], str]) -> None:
    need("cc")
    need("cxx")
    chosen = [name for name in names(page) if (name in OF_GCC) == of_gcc]
    environment = dict(os.environ)
    if not of_gcc and shutil.which("tcc"):
        environment |= {"CC": "tcc", "C_INCLUDE_PATH": str(ROOT / "tests" / "tcc")}
    file = tmp_path / "records.json"
    command = [sys.executable, "-m", "benchmarks", "--scale", "0", "--only", ",".join(chosen), "--json", str(file)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    reported = {record["topic"] for record in json.loads(file.read_text(encoding="utf-8"))["records"]}
    assert set(chosen) - reported <= {"instructions", "sizes"}  # which need programs for all of their figures
