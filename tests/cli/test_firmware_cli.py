"""--target, --verify and budgets on the command line."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import require_tool

from examples import crane
from nmpc_codegen import Options, export, generate, worst_case
from nmpc_codegen.cli import main
from nmpc_codegen.package.seal import intact
from nmpc_codegen.runtime import compilers
from nmpc_codegen.runtime.native import runs
from nmpc_codegen.targets import TARGETS

PROBLEM = str(Path(__file__).parents[2] / "examples" / "crane.py")


COMMAND = [PROBLEM, "--set", "precision=single", "--set", "solve=False"]
#: Files that name the optimisation level.
OF_LEVEL = ("CMakeLists.txt", "README.md")
TARGET = ["--target", "cortex-m4f", "--level", "Os", "--verify", "--max-ram", "7000"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the crane for a target."""
    for tool in ("cc", "arm", "qemu"):
        require_tool(tool)
    folder = tmp_path_factory.mktemp("exported") / "crane"
    assert main([*COMMAND, "-o", str(folder), *TARGET]) == 0
    return folder


def test_files_of_an_export_for_a_target(exported: Path, tmp_path: Path) -> None:
    """Files are sealed; they are those of export(), but for the optimisation level; exporting again is safe."""
    export(crane.build_ocp(), Options(precision="single", solve=False, target="cortex-m4f"), tmp_path)
    for path in tmp_path.iterdir():
        expected = path.read_bytes().splitlines()
        found = (exported / path.name).read_bytes().splitlines()
        if path.name in OF_LEVEL:
            expected = [line.replace(b" -O2 ", b" -Os ") for line in expected[:-1]]
            found = found[:-1]
        assert found == expected, "a target changes nothing else that others write"
    files = {p.relative_to(exported).as_posix(): p.read_bytes() for p in exported.rglob("*") if p.is_file()}
    assert {"certificate.md", "firmware/replay.c", "firmware/Makefile", "zephyr/module.yml"} <= set(files)
    assert all(intact(data) for data in files.values())
    copied = files["arduino/crane/src/crane.c"].splitlines()[:-1]
    assert copied == files["crane.c"].splitlines()[:-1]


def test_a_certificate_does_not_outlive_its_package(exported: Path, tmp_path: Path) -> None:
    """Another package in the same folder takes away what certified the old one, but for what somebody has edited."""
    folder = tmp_path / "crane"
    shutil.copytree(exported, folder)
    options = Options(precision="single", solve=False, target="cortex-m4f")
    for name in ("certificate.md", "firmware/Makefile", "arduino/crane/src/crane.c"):
        assert (folder / name).exists()
    export(crane.build_ocp(), options, folder, force=True)  # the same C: it is still certified
    assert (folder / "certificate.md").exists()
    (folder / "firmware" / "Makefile").write_text("# mine\n" + (folder / "firmware" / "Makefile").read_text())
    (folder / "firmware" / "notes.txt").write_text("mine")
    with pytest.warns(UserWarning, match="belonged to the package before|is of the package that was replaced") as said:
        export(crane.build_ocp(), replace(options, precision="double"), folder)
    assert len(said) == 2
    left = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    own = {"crane.c", "crane.h", "crane.json", "main.c", "CMakeLists.txt", "README.md"}
    assert left == own | {"firmware/Makefile", "firmware/notes.txt"}


def test_certificate_of_an_export(exported: Path) -> None:
    found = json.loads((exported / "certificate.json").read_text())
    assert found["emulated"]["mismatches"] == 0
    assert found["emulated"]["samples"] == 200
    assert found["flash_bytes"] < 29_500
    assert found["flash_bytes"] + found["library_bytes"] < 30_700
    page = (exported / "certificate.md").read_text()
    assert f"{found['flash_bytes']:,}" in page
    assert "All 200 samples agree with the host" in page
    assert hashlib.sha256((exported / "crane.c").read_bytes()).hexdigest() in page
    assert "-Os" in page
    assert all(" -Os " in (exported / file).read_text() for file in OF_LEVEL)


def test_sizes_of_both_goals(exported: Path) -> None:
    """Loops are smaller and need more stack; the form that was exported is among them."""
    found = json.loads((exported / "certificate.json").read_text())
    forms = {(form["goal"], form["level"]): form for form in found["forms"]}
    assert set(forms) == {(goal, level) for goal in ("speed", "size") for level in ("O2", "Os")}
    assert forms["speed", "Os"]["flash_bytes"] == found["flash_bytes"]
    for level in ("O2", "Os"):
        assert forms["size", level]["flash_bytes"] < forms["speed", level]["flash_bytes"]
        assert forms["size", level]["struct_bytes"] <= forms["speed", level]["struct_bytes"]
    row = forms["size", "Os"]
    assert (
        f"| size | -Os | {row['struct_bytes']:,} | {row['flash_bytes']:,} |"
        in (exported / "certificate.md").read_text()
    )


def ran(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_makefile_and_self_test(exported: Path, tmp_path: Path) -> None:
    """The Makefile builds everything; the self-test passes on the board, and fails with another expected control."""
    make, folder = require_tool("make"), tmp_path / "crane"
    shutil.copytree(exported, folder)
    built = ran([make, "-C", "firmware", "all"], folder)
    assert built.returncode == 0, built.stderr
    assert built.stderr == ""
    assert ran([make, "-C", "firmware", "selftest"], folder).returncode == 0
    assert ran([make, "-C", "firmware", "run"], folder).returncode == 0
    lines = (folder / "firmware" / "uart.txt").read_text().splitlines()
    assert len([line for line in lines if line.startswith("S ")]) == 200
    source = folder / "firmware" / "selftest.c"
    begin, brace, rest = source.read_text().partition("expected_u[SAMPLES][NU] = {\n    { ")
    source.write_text(f"{begin}{brace}0.25F + {rest}")
    assert ran([make, "-C", "firmware", "selftest"], folder).returncode == 2
    assert "Error 1" in ran([make, "-C", "firmware", "selftest"], folder).stderr, "one sample differs"


def test_cmake_for_the_target(exported: Path, tmp_path: Path) -> None:
    cmake = require_tool("cmake")
    configure = [cmake, "-S", str(exported / "firmware"), "-B", str(tmp_path)]
    done = ran([*configure, f"-DCMAKE_TOOLCHAIN_FILE={exported / 'firmware' / 'toolchain.cmake'}"], tmp_path)
    assert done.returncode == 0, done.stderr
    done = ran([cmake, "--build", str(tmp_path)], tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "selftest.elf").is_file()


def test_the_budget_is_checked_by_the_compiler(exported: Path, tmp_path: Path) -> None:
    shutil.copytree(exported, tmp_path / "crane")
    budget = tmp_path / "crane" / "firmware" / "budget.c"
    assert "<= 7000u" in budget.read_text()
    budget.write_text(budget.read_text().replace("7000u", "6000u"))
    done = ran([require_tool("make"), "-C", "firmware", "budget.o"], tmp_path / "crane")
    assert done.returncode != 0
    assert "ram_budget" in done.stderr


def test_module_and_libraries(exported: Path, tmp_path: Path) -> None:
    """Zephyr's CMake adds the right file under its own commands; library.json is JSON; the Arduino sources compile."""
    cmake, compiler = require_tool("cmake"), require_tool("arm")
    commands = ("zephyr_include_directories", "zephyr_library_named", "zephyr_library_compile_options")
    stubs = "".join(f"function({name})\nendfunction()\n" for name in commands)
    stubs += 'function(zephyr_library_sources f)\nget_filename_component(p "${f}" REALPATH)\n'
    stubs += 'if(NOT EXISTS "${p}")\nmessage(FATAL_ERROR "no ${p}")\nendif()\nmessage("adds ${p}")\nendfunction()\n'
    script = tmp_path / "script.cmake"
    script.write_text(f"{stubs}set(CONFIG_CRANE 1)\ninclude({exported / 'zephyr' / 'CMakeLists.txt'})\n")
    assert f"adds {exported.resolve() / 'crane.c'}" in ran([cmake, "-P", str(script)], tmp_path).stderr
    library = json.loads((exported / "library.json").read_text())
    assert library["build"]["srcFilter"] == ["-<*>", "+<crane.c>"]
    source = exported / "arduino" / "crane" / "src"
    flags = ["-mcpu=cortex-m4", "-mthumb", "-O1", "-fsyntax-only"]
    assert ran([compiler, *flags, "-I", str(source), str(source / "crane.c")], tmp_path).returncode == 0
    sketch = next((exported / "arduino" / "crane" / "examples").rglob("*.ino")).read_text()
    (tmp_path / "sketch.cpp").write_text(f"unsigned long millis();\n{sketch}")
    done = ran([compiler, *flags, "-I", str(source), "-x", "c++", "sketch.cpp"], tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("target", "tools"),
    [
        ("aarch64", ("cc", "aarch64", "qemu-aarch64")),
        ("x86-64-v3", ("cc", "qemu-x86_64")),
        ("riscv32", ("cc", "riscv", "qemu-riscv32")),
    ],
)
def test_verified_targets(
    target: str, tools: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for tool in tools:
        require_tool(tool)
    assert main([PROBLEM, "-o", str(tmp_path), "--target", target, "--verify"]) == 0
    out = capsys.readouterr().out
    assert "All 200 samples agree with" in out
    assert f"target: {target}" in out
    assert (tmp_path / "certificate.md").exists() == (target == "riscv32")


def test_the_smallest_firmware(tmp_path: Path) -> None:
    """Single shooting without solve(): its worst case is known."""
    require_tool("arm")
    options = ["--target", "cortex-m4f", "--set", "algorithm=adjoint_shooting", "--set", "solve=False"]
    assert main([PROBLEM, "-o", str(tmp_path / "crane"), *options]) == 0
    assert json.loads((tmp_path / "crane" / "certificate.json").read_text())["flash_bytes"] < 25_000


def test_what_another_machine_runs_is_not_simulated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nor checked; nothing is written."""
    require_tool("cc")
    target = next(name for name in ("aarch64", "x86-64-v3") if not runs(TARGETS[name]))
    for flags in (["--simulate", "5"], ["--check"]):
        assert main([PROBLEM, "-o", str(tmp_path / "c"), "--target", target, *flags]) == 1
        assert f"crane is written for {target}" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


def test_exceeded_budgets_leave_no_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "c"
    assert main([PROBLEM, "-o", str(folder), "--max-ram", "6k"]) == 1
    err = capsys.readouterr().err
    size = json.loads(generate(crane.build_ocp())["crane.json"])["report"]["ram_bytes"]
    assert f"--max-ram 6144: crane takes {size:,} bytes" in err
    assert "try --set solve=False" in err
    worst = worst_case(generate(crane.build_ocp()))["sample"]
    for target in ("portable", "x86-64-v3"):
        assert main([PROBLEM, "-o", str(folder), "--target", target, "--max-operations", str(worst - 1)]) == 1
        err = capsys.readouterr().err
        assert f"--max-operations {worst - 1}: crane takes {worst:,} operations of a sample at most, 1 too many" in err
        assert "a smaller --set algorithm.iterations=..." in err
    assert not folder.exists()
    assert main([PROBLEM, "-o", str(folder), "--max-ram", "18k", "--max-operations", str(worst)]) == 0


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["--verify"], 1, "--verify: the target portable is every machine"),
        (["--level", "Os"], 1, "--level needs --target cortex-m3, cortex-m4f, cortex-m7, riscv32: on portable"),
        (["--max-stack", "4k", "--target", "x86-64-v3"], 1, "--max-stack needs --target cortex-m3"),
        (["--target", "z80"], 2, "invalid choice: 'z80'"),
        (["--max-ram", "much"], 1, "expected a number of at least 1"),
    ],
)
def test_wrong_usage(
    arguments: list[str], status: int, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([PROBLEM, "-o", str(tmp_path / "c"), *arguments]) == status
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "there", "says"),
    [
        (["--target", "cortex-m7"], (), "apt install gcc-arm-none-eabi libnewlib-arm-none-eabi"),
        (["--target", "cortex-m7"], ("gcc",), "apt install gcc-arm-none-eabi"),
        (["--target", "cortex-m3", "--verify"], ("gcc", "nm", "size", "objdump"), "apt install qemu-system-arm"),
        (["--check"], (), "no C compiler"),
        (["--simulate", "5"], (), "no C compiler"),
    ],
)
def test_missing_tools_are_named_before_the_work(
    flags: list[str],
    there: tuple[str, ...],
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The problem file is not even run."""
    monkeypatch.setattr(compilers, "find_spec", lambda _: None)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    for program in there:
        (tmp_path / f"arm-none-eabi-{program}").write_text("#!/bin/sh\n")
        (tmp_path / f"arm-none-eabi-{program}").chmod(0o755)
    (tmp_path / "problem.py").write_text("raise SystemExit('it was run')\n")
    assert main([str(tmp_path / "problem.py"), "-o", str(tmp_path / "c"), *flags]) == 1
    assert says in capsys.readouterr().err
    assert not (tmp_path / "c").exists()
