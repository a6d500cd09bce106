"""The object code of a package needs nothing but memcpy, memset and functions of math.h."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from conftest import require_tool

from nmpc_codegen import generate
from nmpc_codegen.firmware.toolchain import LEVELS, Level, compile_flags
from nmpc_codegen.targets import TARGETS
from verification.quality import ALLOWED
from verification.samples import SAMPLES, Sample

#: Samples that are compiled in every run: every QP solver and algorithm.
FEW = ("crane", "crane scalar", "cart_pole size", "controls interior", "states augmented", "bare shooting")
STUBS = """
typedef unsigned long size;
void *memcpy(void *to, const void *from, size n)
{
    for (size i = 0; i < n; i++) ((char *)to)[i] = ((const char *)from)[i];
    return to;
}
void *memset(void *to, int value, size n)
{
    for (size i = 0; i < n; i++) ((char *)to)[i] = (char)value;
    return to;
}
"""


def undefined(sample: Sample, level: Level, folder: Path) -> set[str]:
    """Undefined symbols of the object for a core with a floating-point unit of its precision."""
    target = TARGETS["cortex-m4f" if sample.options.precision == "single" else "cortex-m7"]
    sources = generate(sample.make(), sample.options, name="package")
    for path in ("package.h", "package.c"):
        (folder / path).write_text(sources[path])
    command = [require_tool("arm"), *compile_flags(target, level), "-c", "package.c", "-o", "package.o"]
    subprocess.run(command, cwd=folder, check=True)
    listing = subprocess.run(
        [require_tool("arm-none-eabi-nm"), "-u", "package.o"], cwd=folder, capture_output=True, text=True, check=True
    )
    return {line.split()[-1] for line in listing.stdout.splitlines()}


def samples() -> list[object]:
    with_c = [s for s in SAMPLES if s.options.qp is None or s.options.qp.name != "osqp"]
    return [pytest.param(s, id=s.name, marks=() if s.name in FEW else pytest.mark.slow) for s in with_c]


@pytest.mark.few(1)
@pytest.mark.parametrize("sample", samples())
def test_functions_that_a_package_needs(sample: Sample, tmp_path: Path) -> None:
    for level in LEVELS if sample.name in FEW else LEVELS[:1]:
        assert undefined(sample, level, tmp_path) <= ALLOWED


def test_the_names_of_the_few_exist() -> None:
    assert set(FEW) <= {s.name for s in SAMPLES}


def test_linking_without_a_library(tmp_path: Path) -> None:
    """Two functions of the application and the functions of math.h are all that the linker asks for."""
    sample = next(s for s in SAMPLES if s.name == "crane scalar")
    needed = undefined(sample, "O2", tmp_path) - {"memcpy", "memset"}
    (tmp_path / "stubs.c").write_text(STUBS + "".join(f"float {f}(float x) {{ return x; }}\n" for f in sorted(needed)))
    flags = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-O1", "-fno-builtin"]
    command = [
        require_tool("arm"),
        *flags,
        "-nostdlib",
        "-Wl,--entry=package_step",
        "package.o",
        "stubs.c",
        "-o",
        "all.elf",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (tmp_path / "stubs.c").write_text(STUBS.replace("memset", "other"))
    assert "memset" in subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False).stderr
