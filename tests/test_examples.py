"""The examples run as their users run them, and the folder that the crane exports builds on its own."""

from __future__ import annotations

import importlib
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import problems
import pytest
from conftest import require_tool

from examples import crane
from nmpc_codegen import export, open_package
from nmpc_codegen.analyse import analyse

matplotlib.use("Agg")

EXAMPLES = sorted(p.stem for p in (Path(__file__).parents[1] / "examples").glob("*.py") if p.stem != "__init__")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The exported crane."""
    directory = tmp_path_factory.mktemp("crane")
    export(crane.build_ocp(), None, directory, name="crane")
    return directory


def run(command: list[str], where: Path) -> str:
    done = subprocess.run(command, cwd=where, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def assert_loop(output: str) -> None:
    """main.c prints the closed loop of the Python controller from (2, 0, 0, 0)."""
    lines = output.splitlines()
    assert len(lines) == 30
    c, x = problems.controller("crane", "verify"), np.array([2.0, 0.0, 0.0, 0.0])
    for k, line in enumerate(lines):
        words = line.split()
        assert words[:3] == [str(k), "ok", "x"]
        printed = [float(word) for word in re.findall(r"-?\d+\.\d{6}", line)]
        u = c.step(x)
        np.testing.assert_allclose(printed, [*x, *u], rtol=0, atol=1e-6)
        x = c.integrate(x, u, 0.3)
    assert np.abs(x).max() < 2e-2


def test_crane_main(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It exports the package, runs the loop and draws the picture."""
    crane.main(str(tmp_path / "c"), str(tmp_path / "loop.png"))
    files = {p.name for p in (tmp_path / "c").iterdir()}
    assert files == {"crane.c", "crane.h", "crane.json", "main.c", "CMakeLists.txt", "README.md"}
    picture = matplotlib.image.imread(tmp_path / "loop.png")
    assert min(picture.shape[:2]) > 200
    assert picture[..., :3].std() > 0.01
    printed = capsys.readouterr().out
    assert "bytes of memory" in printed
    assert "50" in printed


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_example_states_a_problem(name: str) -> None:
    module: Any = importlib.import_module(f"examples.{name}")
    assert (module.__doc__ or "").strip()
    assert callable(module.main)
    problem = analyse(module.build_ocp())
    assert problem.N >= 1
    assert problem.path.ny >= 1


def test_example_runs_through_open_package(folder: Path) -> None:
    """What was exported is what build() runs, bit for bit."""
    ours, exported = problems.controller("crane"), open_package(folder)
    x = np.array([2.0, 0.0, 0.0, 0.0])
    for _ in range(10):
        u = ours.step(x)
        np.testing.assert_array_equal(u, exported.step(x))
        x = ours.integrate(x, u, 0.3)


def test_command_of_the_readme_builds_and_runs(folder: Path, tmp_path: Path) -> None:
    compiler = require_tool("cc")
    command = re.search(r"^    (cc .*)$", (folder / "README.md").read_text(), flags=re.MULTILINE)
    assert command is not None
    _, *arguments = shlex.split(command[1])
    warnings = ["-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror"]
    where = tmp_path / "copy"
    where.mkdir()
    for file in folder.iterdir():
        (where / file.name).write_bytes(file.read_bytes())
    run([compiler, *warnings, *arguments], where)
    assert_loop(run(["./crane"], where))


def test_cmake_builds_and_runs(folder: Path, tmp_path: Path) -> None:
    cmake = require_tool("cmake")
    run([cmake, "-S", str(folder), "-B", str(tmp_path)], tmp_path)
    run([cmake, "--build", str(tmp_path)], tmp_path)
    assert_loop(run(["./crane_main"], tmp_path))


def test_cortex_m_compiles(folder: Path, tmp_path: Path) -> None:
    """Freestanding use: code and constants only, no data of its own."""
    compiler = require_tool("arm")
    flags = ["-std=c99", "-O2", "-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "-Wall", "-Werror"]
    run([compiler, *flags, "-c", str(folder / "crane.c"), "-o", "crane.o"], tmp_path)
    sizes = run([compiler.replace("gcc", "size"), "crane.o"], tmp_path).splitlines()[1].split()
    text, data, bss = (int(v) for v in sizes[:3])
    assert data == bss == 0
    assert 0 < text < 64 * 1024


def test_readme_tells_the_sizes(folder: Path) -> None:
    readme = (folder / "README.md").read_text()
    for word in (str(problems.controller("crane").nbytes), "-ffast-math", "| x | p, v, phi, omega |"):
        assert word in readme
    assert not re.search(r"\b(None|Undefined)\b|\{\{|\{%", readme)
