"""The shares of functions in the time of a sample are measured by perf, or by callgrind's instructions.

The measured code is the same, except that functions that are called once stay functions, so that they have a share of
their own.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.lib import callgrind
from benchmarks.lib.speed.loops import LOOPS, for_target, module_of, package_of, without_avx512
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.targets import NATIVE
from verification.closed_loop import Scenario, compile_driver, run_driver
from verification.robustness.work import Loop

NAMES = tuple(loop.name for loop in LOOPS)
RUNS = 40
#: Shares below this one are left out of the table.
LEAST = 0.005


def show(name: str) -> None:
    """Print the table of one loop, for the target of this machine; raise RuntimeError if there is no tool."""
    loop = next(loop for loop in LOOPS if loop.name == name)
    with tempfile.TemporaryDirectory() as folder:
        if shutil.which("perf"):
            total, shares, tool = _by_perf(loop, Path(folder))
        elif shutil.which("valgrind"):
            total, shares, tool = _by_callgrind(loop, Path(folder))
        else:
            raise RuntimeError("--where needs perf (package linux-perf) or valgrind; neither is installed")
    table = Table("function", "share", "us", title=f"{name}: {total:.3g} us per sample, shares by {tool}")
    for function, share in shares:
        table.add_row(function, f"{100 * share:.1f} %", f"{share * total:.3f}")
    Console().print(table)


def _program(loop: Loop, folder: Path) -> Path:
    flags = (*PROFILES["fast"].flags, "-fno-inline-functions-called-once")
    return compile_driver(package_of(loop), module_of(loop).name, folder, flags)


def _command(program: Path, scenario: Scenario, runs: int, steps: int) -> list[str]:
    return [str(program), str(runs), str(steps), *scenario.arguments()]


def _by_perf(loop: Loop, folder: Path) -> tuple[float, list[tuple[str, float]], str]:
    program, data = _program(for_target(loop, NATIVE), folder), folder / "samples"
    total = run_driver(program, loop.scenario, runs=5, steps=loop.steps).total
    record = ["perf", "record", "-q", "-e", "cpu-clock", "-F", "5000", "-o", str(data)]
    record += _command(program, loop.scenario, RUNS, loop.steps)
    subprocess.run(record, check=True, stdout=subprocess.DEVNULL)
    report = ["perf", "report", "-i", str(data), "--stdio", "--no-children", "-g", "none", "-F", "sample,symbol"]
    text = subprocess.run(report, check=True, capture_output=True, text=True).stdout
    return total, _shares(re.findall(r"^\s*(\d+)\s+\[\.\]\s+(\S+)", text, re.M)), "time (perf)"


def _by_callgrind(loop: Loop, folder: Path) -> tuple[float, list[tuple[str, float]], str]:
    program = _program(without_avx512(loop), folder)
    total = run_driver(program, loop.scenario, runs=5, steps=loop.steps).total
    found = callgrind.profile(program, [str(1), str(loop.steps), *loop.scenario.arguments()])
    return total, _shares((str(count), name) for name, count in found.items()), "instructions (callgrind)"


#: Functions of the measuring program.
OUTSIDE = re.compile(r"main|ascending|microseconds|msort|clock_gettime|printf|strto|memset_avx|_dl_|_start")


def _shares(found: Iterable[tuple[str, str]]) -> list[tuple[str, float]]:
    """Return the functions of the controller and their shares, largest first."""
    counts: dict[str, int] = {}
    for count, symbol in found:
        name = symbol.split(".")[0]
        if not OUTSIDE.search(name):
            counts[name] = counts.get(name, 0) + int(count)
    whole = sum(counts.values())
    ranked = sorted(counts.items(), key=lambda item: -item[1])
    return [(name, count / whole) for name, count in ranked if count >= LEAST * whole]
