"""What nmpc-export prints: in short, as JSON, nothing; and the ring of dumps that it adds."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from nmpc_codegen.cli import main
from tests.snippets import ROOT


def test_short_lines_fit_100_columns_and_say_what_is_done(
    state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a terminal, too: seconds, and what begins."""
    file = state_problem("ocp = cart()")
    assert main([file, "-o", str(tmp_path / "c"), "--simulate", "5"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 100 for line in lines if str(tmp_path) not in line)
    stages = [line for line in lines if re.match(r"\[ *\d+\.\d s\] ", line)]
    assert [
        word in line for word, line in zip(("reading", "generating C", " files, ", "5 samples"), stages, strict=True)
    ]
    seconds = [float(line[1:].split()[0]) for line in stages]
    assert seconds == sorted(seconds)


def test_json(state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One object on the output, with all that the text says, and of an error that."""
    folder = tmp_path / "c"
    assert main([state_problem("ocp = cart()"), "-o", str(folder), "--check", "--simulate", "5", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["passed"] is True
    assert found["files"] == {path.name: path.stat().st_size for path in folder.iterdir()}
    assert found["ram_bytes"] == json.loads((folder / "cart.json").read_text())["report"]["ram_bytes"]
    assert found["check"]["errors"]["u"] <= found["check"]["limits"]["u"]
    assert found["simulation"]["failures"] == 0
    assert main([state_problem("ocp = 3"), "--json"]) == 1
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"error": captured.err.strip(), "passed": False}


def test_json_of_a_file_that_prints(state_problem: Any, tmp_path: Path) -> None:
    """What the file prints goes to the errors."""
    file = state_problem("print('hello')\nocp = cart()")
    command = [sys.executable, "-m", "nmpc_codegen.cli", file, "-o", "c", "--json", "--dumps", "2", "--max-ram", "100k"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert json.loads(done.stdout)["dumps_bytes"] > 2 * json.loads(done.stdout)["ram_bytes"]
    assert b"hello" in done.stderr


def test_dumps_count_as_memory(state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = state_problem("ocp = cart()")
    assert main([file, "-o", str(tmp_path / "c"), "--dumps", "100", "--max-ram", "20k"]) == 1
    assert "bytes of solver struct and dumps" in capsys.readouterr().err
    assert main([file, "-o", str(tmp_path / "c"), "--dumps", "0"]) == 1
    assert "dumps is 0; expected the number of samples" in capsys.readouterr().err


def test_quiet(state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([state_problem("ocp = cart()"), "-o", str(tmp_path / "c"), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_dumps(state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([state_problem("ocp = cart()"), "-o", str(tmp_path / "c"), "--dumps", "3"]) == 0
    assert "#define CART_DUMPS_SLOTS 3 " in (tmp_path / "c" / "cart_dumps.h").read_text()
    assert "## Dumps" in (tmp_path / "c" / "README.md").read_text()
