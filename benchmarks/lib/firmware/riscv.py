"""Packages compiled for a 32-bit RISC-V core with picolibc: flash memory, functions that they need, linking."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from benchmarks.lib.firmware.loops import loops, package, small
from benchmarks.lib.report import Report
from nmpc_codegen.firmware.toolchain import ARITHMETIC, LEVELS, SECTIONS, Level
from verification.quality import ALLOWED
from verification.robustness.work import Loop

PREFIX = "riscv64-unknown-elf-"
#: A core with a floating-point unit for single precision, and picolibc.
CORE = ("-march=rv32imafc", "-mabi=ilp32f", "--specs=picolibc.specs")
#: Memory of the linker script of picolibc.
MEMORY = ("-Wl,--defsym=__flash_size=0x400000", "-Wl,--defsym=__ram_size=0x400000")


def cores(report: Report, scale: float) -> None:
    """The small controllers of all loops."""
    for loop in loops():
        flash: dict[Level, int] = {}
        for level in LEVELS:
            flash[level], foreign, linked = compiled(loop, level)
            case = f"{loop.name}, small, -{level}, rv32imafc" + (f": {', '.join(foreign)}" if foreign else "")
            report.add("riscv_foreign_functions", len(foreign), case=case, limit=0, profile=level)
            report.add("riscv_not_linked", int(not linked), case=case, limit=0, profile=level)
        best = min(flash, key=lambda level: flash[level])
        note = f"{loop.name}, small, -{best}, rv32imafc"
        report.add(f"{loop.name}_flash_bytes_riscv", flash[best], "B", case=note, profile=best)


def compiled(loop: Loop, level: Level) -> tuple[int, list[str], bool]:
    """Bytes of code and constants, functions besides math.h and memcpy, memset, and whether a program links."""
    name, sources = package(loop, small(loop))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for path in (f"{name}.h", f"{name}.c"):
            (folder / path).write_text(sources[path], encoding="utf-8")
        program = f'#include "{name}.h"\nstatic {name}_solver_t s;\nint main(void) {{ return (int){name}_init(&s); }}\n'
        (folder / "main.c").write_text(program, encoding="utf-8")
        flags = [*CORE, f"-{level}", *ARITHMETIC, *SECTIONS]
        _run(folder, "gcc", *flags, "-c", f"{name}.c", "-o", "package.o")
        undefined = {line.split()[-1] for line in _run(folder, "nm", "-u", "package.o").splitlines()}
        text, data = map(int, _run(folder, "size", "package.o").splitlines()[1].split()[:2])
        command = [f"{PREFIX}gcc", *flags, *MEMORY, "main.c", "package.o", "-lm", "-o", "program.elf"]
        linked = subprocess.run(command, cwd=folder, capture_output=True, check=False).returncode == 0
    return text + data, sorted(undefined - ALLOWED), linked


def _run(folder: Path, tool: str, *arguments: str) -> str:
    command = [f"{PREFIX}{tool}", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout
