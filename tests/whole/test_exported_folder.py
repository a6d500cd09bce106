"""The folder that the crane is exported to: it runs in Python, builds by the command of its README and with CMake."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import require_target, require_tool

from examples import crane
from nmpc_codegen import Options, build, export, open_package


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
    c, x = build(crane.build_ocp(), profile="verify"), np.array([2.0, 0.0, 0.0, 0.0])
    for k, line in enumerate(lines):
        words = line.split()
        assert words[:3] == [str(k), "ok", "x"]
        printed = [float(word) for word in re.findall(r"-?\d+\.\d{6}", line)]
        u = c.step(x)
        np.testing.assert_allclose(printed, [*x, *u], rtol=0, atol=1e-6)
        x = c.integrate(x, u, 0.3)
    assert np.abs(x).max() < 2e-2


def test_example_runs_through_open_package(folder: Path) -> None:
    """The exported files are those that build() runs, bit for bit."""
    ours, exported = build(crane.build_ocp(), profile="fast"), open_package(folder)
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


def test_the_folder_of_this_machine_builds_and_runs(tmp_path: Path) -> None:
    """By the command of its README and with CMake, with the flags of the target."""
    require_target("x86-64-v3")
    folder = tmp_path / "crane"
    export(crane.build_ocp(), Options(target="x86-64-v3"), folder)
    command = re.search(r"^    gcc (.*)$", (folder / "README.md").read_text(), flags=re.MULTILINE)
    assert command is not None
    assert "-march=x86-64-v3" in command[1]
    run([require_tool("gcc"), *shlex.split(command[1])], folder)
    assert_loop(run(["./crane"], folder))
    test_cmake_builds_and_runs(folder, tmp_path / "build")


def test_cmake_builds_and_runs(folder: Path, tmp_path: Path) -> None:
    cmake = require_tool("cmake")
    tmp_path.mkdir(exist_ok=True)
    run([cmake, "-S", str(folder), "-B", str(tmp_path)], tmp_path)
    run([cmake, "--build", str(tmp_path)], tmp_path)
    assert_loop(run(["./crane_main"], tmp_path))


def test_cmake_of_another_project(folder: Path, tmp_path: Path) -> None:
    """As a subfolder, without the example; and installed, found by find_package()."""
    cmake = require_tool("cmake")
    (tmp_path / "application.c").write_text("#include <crane.h>\nint main(void) { return CRANE_NX != 4; }\n")
    head, end = (
        "cmake_minimum_required(VERSION 3.13)\nproject(application C)\n",
        "add_executable(application application.c)\n",
    )
    end += "target_link_libraries(application PRIVATE crane::crane)\n"
    (tmp_path / "CMakeLists.txt").write_text(f'{head}add_subdirectory("{folder}" crane)\n{end}')
    run([cmake, "-S", ".", "-B", "inside"], tmp_path)
    run([cmake, "--build", "inside"], tmp_path)
    run(["./inside/application"], tmp_path)
    assert not list((tmp_path / "inside").rglob("crane_main"))
    run([cmake, "-S", str(folder), "-B", "alone", "-DCMAKE_INSTALL_PREFIX=" + str(tmp_path / "installed")], tmp_path)
    run([cmake, "--build", "alone", "--target", "install"], tmp_path)
    (tmp_path / "CMakeLists.txt").write_text(f"{head}find_package(crane REQUIRED)\n{end}")
    run([cmake, "-S", ".", "-B", "outside", f"-DCMAKE_PREFIX_PATH={tmp_path / 'installed'}"], tmp_path)
    run([cmake, "--build", "outside"], tmp_path)
    run(["./outside/application"], tmp_path)


def test_readme_begins_with_the_call_sequence(folder: Path, tmp_path: Path) -> None:
    """It compiles, the build follows, and the table lists every file of the folder."""
    compiler, readme = require_tool("cc"), (folder / "README.md").read_text()
    (block,) = re.findall(r"```c\n(.*?)```", readme, flags=re.DOTALL)
    (tmp_path / "calls.c").write_text(block)
    warnings = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    run([compiler, *warnings, f"-I{folder}", "-c", "calls.c", "-o", "calls.o"], tmp_path)
    places = [
        readme.index(word) for word in ("crane_step(", "    cc -std=c99", "| `crane.h` |", "| p | m |", "has chosen")
    ]
    assert places == sorted(places)
    assert set(re.findall(r"^\| `([\w.]+)` \|", readme, flags=re.MULTILINE)) == {file.name for file in folder.iterdir()}
    assert "| 0 | p_end | 0 | CRANE_ROW_P_END | 10 | hard |" in readme


def test_cortex_m_compiles(folder: Path, tmp_path: Path) -> None:
    """Freestanding use: only code and constants, no data of its own."""
    compiler = require_tool("arm")
    flags = ["-std=c99", "-O2", "-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "-Wall", "-Werror"]
    run([compiler, *flags, "-c", str(folder / "crane.c"), "-o", "crane.o"], tmp_path)
    sizes = run([compiler.replace("gcc", "size"), "crane.o"], tmp_path).splitlines()[1].split()
    text, data, bss = (int(v) for v in sizes[:3])
    assert data == bss == 0
    assert 0 < text < 64 * 1024


def test_readme_tells_the_sizes(folder: Path) -> None:
    readme = (folder / "README.md").read_text()
    for word in (
        str(build(crane.build_ocp(), profile="test").nbytes),
        "-ffast-math",
        "| phi | rad | x[CRANE_X_PHI] | state, initially 0 |",
    ):
        assert word in readme
    assert not re.search(r"(?<!=)\b(None|Undefined)\b|\{\{|\{%", readme)
