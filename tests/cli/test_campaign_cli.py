"""--campaign: flights of the package, what the file states of them, README and certificate."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import require_tool

from nmpc_codegen.cli import main
from nmpc_codegen.package.seal import intact

PROBLEM = """
import casadi as ca
from nmpc_codegen import OCP, Uniform
from nmpc_codegen.campaigns import Box

ocp = OCP("point", T=1.0, N=4)
x, u = ocp.state("x", unit="m", initial=1.0), ocp.control("u")
k = ocp.parameter("k", value=1.0, bounds=(0.5, 2))
ocp.dynamics({x: k * u})
ocp.least_squares(ca.vertcat(x, u), [1.0, 0.1], names=["x", "u"])
ocp.subject_to(-1, u, 1)
"""
STATED = 'campaign = dict(starts={"x": Box(-1, 1)}, noise=Uniform(0.01), success={"x": %g}, steps=40, seed=3)\n'


def run(folder: Path, text: str, *more: str) -> int:
    (folder / "point.py").write_text(PROBLEM + text)
    return main([str(folder / "point.py"), "-o", str(folder / "out"), *more])


def test_a_campaign_with_the_arguments_of_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, STATED % 0.1, "--campaign", "200", "--plot", str(tmp_path / "a.png")) == 0
    said = capsys.readouterr().out
    assert "point: 200 flights of 40 samples" in said
    assert "lost: 0, 0 %; of all such flights 0 to 1.83 %" in said
    assert (tmp_path / "a.png").stat().st_size > 10_000
    readme = (tmp_path / "out" / "README.md").read_bytes()
    assert intact(readme)
    assert b"200 closed loops of 40 samples, 0.25 s each, seed 3" in readme
    assert b"Drawn for each: `start.x`, `plant.k`, noise Uniform(half_width=0.01)." in readme
    assert b"They had to arrive: `x` within 0.1." in readme
    assert run(tmp_path, STATED % 0.1, "--campaign", "200") == 0
    assert (tmp_path / "out" / "README.md").read_bytes() == readme  # no time enters it


def test_flights_that_are_lost_are_a_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, STATED % 1e-9, "--campaign", "20") == 1
    said = capsys.readouterr()
    assert "campaign FAILED: 20 of 20 flights are lost" in said.err
    assert "did not arrive" in said.out
    assert run(tmp_path, STATED % 1e-9, "--campaign", "20", "--allow-failures", "20") == 0


@pytest.mark.parametrize(
    ("text", "more", "status", "message"),
    [
        ("", ["--campaign", "0"], 2, "--campaign 0: expected at least one flight"),
        ("", ["--campaign", "2", "--derivatives"], 2, "--campaign belongs to a controller"),
        ("", ["--plot", "a.png"], 2, "--plot needs --simulate STEPS or --campaign FLIGHTS"),
        ("campaign = 3", ["--campaign", "2"], 1, "campaign is a int; expected a dictionary"),
        ('campaign = {"flight": 3}', ["--campaign", "2"], 1, "campaign: no argument 'flight'"),
        ('campaign = {"starts": {"y": 1}}', ["--campaign", "2"], 1, "there is no 'y'"),
    ],
)
def test_wrong_campaigns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, more: list[str], status: int, message: str
) -> None:
    assert run(tmp_path, text, *more) == status
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_function_of_the_product_is_no_statement(tmp_path: Path) -> None:
    """A file may import campaign() for its own use, or state its arguments by a function."""
    assert run(tmp_path, "from nmpc_codegen.campaigns import campaign\n", "--campaign", "5") == 0
    assert run(tmp_path, "def campaign():\n    return {'steps': 7}\n", "--campaign", "5") == 0
    assert "5 closed loops of 7 samples" in (tmp_path / "out" / "README.md").read_text()


def test_a_certificate_with_a_campaign(tmp_path: Path) -> None:
    """Of the package for a microcontroller, with the bits that it has there."""
    for tool in ("cc", "arm"):
        require_tool(tool)
    assert run(tmp_path, STATED % 0.1, "--campaign", "50", "--target", "cortex-m4f") == 0
    found = json.loads((tmp_path / "out" / "certificate.json").read_text())["campaign"]
    assert found["flights"] == 50
    assert found["lost"] == 0
    assert found["interval"] == [0.0, pytest.approx(0.0711, abs=1e-4)]
    assert found["drawn"] == ["start.x", "plant.k"]
    page = (tmp_path / "out" / "certificate.md").read_text()
    assert "## Campaign\n\n50 closed loops of 40 samples" in page
    assert all(intact(p.read_bytes()) for p in (tmp_path / "out").iterdir() if p.is_file())
