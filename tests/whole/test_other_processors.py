"""Units for several shooting nodes at once on other processors than this one's: ARM64, and x86 without AVX."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import require_tool

from nmpc_codegen.host.unit import host_unit
from nmpc_codegen.lowering.render import render
from nmpc_codegen.runtime.build import PROCESSOR_VARIABLE, WARNINGS, host
from verification.c_harness import module_of
from verification.samples import SAMPLES
from verification.timed import TIMED

KNOWN = {sample.name: sample for sample in (*TIMED, *SAMPLES)}
#: Dense and stage solvers, exact Hessians, single precision, loops.
CHOSEN = ("crane", "timed cstr", "timed bioreactor", "crane riccati single", "everything looped")
#: Lanes are GNU C.
STRICT = ("-std=gnu99", "-O1", *(flag for flag in WARNINGS if flag not in ("-std=c99", "-pedantic")))


def write(folder: Path, name: str, lanes: int) -> str:
    """Write the exported package and unit.c, its form with several lanes; returns the name of the package."""
    sample = KNOWN[name]
    module = module_of(sample.make(), sample.options)
    for path, text in {**render(module), "unit.c": host_unit(module, lanes, avx512=False)}.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return module.name


def run(folder: Path, *command: str) -> str:
    """Output of a command, which must succeed silently."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout


def numbers(table: str) -> np.ndarray:
    """The numbers that main.c prints."""
    return np.array([[float(word) for word in line.split() if word[-1].isdigit()] for line in table.splitlines()])


@pytest.mark.few(1)
@pytest.mark.filterwarnings("ignore::nmpc_codegen.ProblemWarning")
@pytest.mark.parametrize("lanes", [2, 8])
@pytest.mark.parametrize("name", CHOSEN)
def test_arm64(name: str, lanes: int, tmp_path: Path) -> None:
    """No warning, and the closed loop of main.c is that of the exported C on this machine."""
    gcc, arm, emulator = (require_tool(tool) for tool in ("gcc", "aarch64", "qemu-aarch64"))
    package = write(tmp_path, name, lanes)
    run(tmp_path, arm, *STRICT, "-c", "unit.c", "-o", "unit.o")
    run(tmp_path, arm, "-std=c99", "unit.o", "main.c", "-static", "-o", "arm", "-lm")
    run(tmp_path, gcc, "-std=c99", "-O1", f"{package}.c", "main.c", "-o", "here", "-lm")
    found, expected = (numbers(run(tmp_path, *program)) for program in ((emulator, "./arm"), ("./here",)))
    assert expected.shape[0] == 30
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3 if "single" in name else 2e-6)


@pytest.mark.few(1)
@pytest.mark.parametrize("processor", ["x86-64-v2", "x86-64-v3"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_vectors_longer_than_the_registers(compiler: str, processor: str, tmp_path: Path) -> None:
    """Eight lanes without AVX-512 and without AVX2: functions that take such vectors are inlined."""
    require_tool(compiler)
    if "x86" not in run(tmp_path, compiler, "-dumpmachine"):
        pytest.skip("no processor of this family")
    write(tmp_path, "crane riccati single", 8)
    command = [compiler, f"-march={processor}", *STRICT, "-c", "unit.c", "-o", "unit.o"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "warning:" not in done.stderr  # notes on the ABI of old versions of GCC are none


@pytest.mark.parametrize(("processor", "lanes"), [("x86-64-v2", 1), ("x86-64-v3", 4), ("x86-64-v4", 8)])
def test_detection_obeys_the_variable(processor: str, lanes: int, tmp_path: Path) -> None:
    """The variable is read when the package is loaded."""
    if "x86" not in run(tmp_path, require_tool("gcc"), "-dumpmachine"):
        pytest.skip("no processor of this family")
    program = "from nmpc_codegen.runtime.build import host; print(host(None, 'fast').lanes)"
    environment = {**os.environ, PROCESSOR_VARIABLE: processor, "CC": "gcc"}
    found = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert int(found.stdout) == lanes
    assert host(1, "fast").lanes == 1
