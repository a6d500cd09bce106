"""The command of the benchmarks: what it says of a wrong word, and a record with its baseline."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def benchmarks(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--only", "time"), "--only time: expected all, or some of times, sizes"),
        (("--base", "no-such-commit"), "--base no-such-commit: there is no such commit"),
        (("--scale", "2"), "--scale 2: expected a share"),
    ],
)
def test_wrong_words(arguments: tuple[str, ...], said: str) -> None:
    done = benchmarks(*arguments)
    assert done.returncode == 2
    assert said in done.stderr


TABLE = """
from benchmarks import speed
from benchmarks.lib.report import Report
from benchmarks.lib.speed.loops import LOOPS

assert set(speed.LINES) == {loop.name for loop in LOOPS}
report = Report()
report.topic = "times"
for loop in speed.LINES:
    for form, total in ((speed.BUILT, 20.0), ("portable", 123.4), ("native", 4.56)):
        report.add("total", total, "us", case=f"{loop}, {form}")
        report.add("feedback", total / 10, "us", case=f"{loop}, {form}")
        if loop != "cart_pole":
            report.add("to best peer", total / 50, case=f"{loop}, {form}")
print(speed.table(report), end="")
"""


def test_table_of_times() -> None:
    """A line per loop; the best peer's time on this machine is that of a form over its ratio."""
    done = subprocess.run([sys.executable, "-c", TABLE], cwd=ROOT, capture_output=True, text=True, check=True)
    head, rule, *lines = done.stdout.splitlines()
    assert head.count("|") == rule.count("|") == 8
    assert lines[0] == "| crane, terminal constraint | 20, 2 | 123, 12 | 4.6, 0.46 | 50 | 0.40 | 0.09 |"
    assert "| cart-pole, N = 20 | 20, 2 | 123, 12 | 4.6, 0.46 |  |  |  |" in lines
    assert len(lines) == 9


@pytest.mark.slow
def test_what_grew_is_marked(tmp_path: Path) -> None:
    """The operations of the crane, against a baseline in which they are 3 % and 1 % fewer."""
    assert benchmarks("--only", "counts", "--json", str(tmp_path / "now.json")).returncode == 0
    found = json.loads((tmp_path / "now.json").read_text(encoding="utf-8"))
    for record in found["records"]:
        if record["case"] in ("crane", "cstr"):
            record["value"] /= 1.03 if record["case"] == "crane" else 1.01
    (tmp_path / "before.json").write_text(json.dumps(found), encoding="utf-8")
    done = benchmarks("--only", "counts", "--baseline", str(tmp_path / "before.json"))
    assert "counts/crane/linearisation" in done.stdout
    assert "counts/cstr/linearisation" not in done.stdout
    assert "3 figures grew" in done.stdout
