"""Packages and caches that cannot be trusted: mutated descriptions under AddressSanitizer, faults of the cache."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.lib.doors import cache_faults
from benchmarks.lib.doors.mutated_package import SANITIZED
from benchmarks.lib.report import Report
from nmpc_codegen.runtime.build import find_compiler
from tests.problems import sources

ROOT = Path(__file__).parents[3]
TOY = ROOT / "tests" / "data" / "toy"
MUTATIONS = 200  # of each package
CRASHES = 5  # a package with this many crashes is not tried any further


def measure(report: Report) -> None:
    """Keys memory_errors, mutation_wrong_errors, mutations_opened, cache_faults_survived."""
    with tempfile.TemporaryDirectory() as temporary:
        generated = Path(temporary) / "parameters"
        generated.mkdir()
        for path, text in sources("parameters").items():
            (generated / path).write_text(text, encoding="utf-8")
        library = sanitizer()
        for name, folder in (("toy", TOY), ("parameters", generated)) if library else ():
            if "heap-buffer-overflow" not in sanitized(library, str(folder)).stderr:
                raise RuntimeError(f"{name}: AddressSanitizer does not see a read beside a buffer")
            lines, crashes = campaign(folder, MUTATIONS, library)
            wrong = [line for line in lines if " wrong" in line]
            options = {"case": name, "n": MUTATIONS, "profile": SANITIZED.name}
            report.add("memory_errors", len(crashes), limit=0, **options)
            report.add("mutation_wrong_errors", len(wrong) + MUTATIONS - len(lines) - len(crashes), limit=0, **options)
            report.add("mutations_opened", sum(" opened " in line for line in lines), **options)
            for line in (*wrong, *crashes):
                print(f"{name}: {line}", file=sys.stderr)
    for case, fault in cache_faults.FAULTS.items():
        if fault in cache_faults.AS_ROOT and not cache_faults.is_root():
            report.add("cache_faults_skipped", 1, case=f"{case}: only root can give files away", profile="test")
        else:
            report.add(
                "cache_faults_survived", cache_faults.survived(fault), case=case, limit=1, at_least=True, profile="test"
            )


def sanitizer() -> str:
    """Path of the AddressSanitizer library that the compiler links; empty without one."""
    command = [*find_compiler(), "-print-file-name=libasan.so"]
    path = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    return path if Path(path).is_absolute() else ""


def sanitized(library: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run mutated_package.py under AddressSanitizer."""
    environment = {
        **os.environ,
        "LD_PRELOAD": library,
        "ASAN_OPTIONS": "detect_leaks=0",
        "PYTHONMALLOC": "malloc",
        "PYTHONPATH": os.pathsep.join((str(ROOT / "src"), str(ROOT))),
    }
    command = [sys.executable, "-m", "benchmarks.lib.doors.mutated_package", *arguments]
    return subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)


def campaign(folder: Path, count: int, library: str) -> tuple[list[str], list[str]]:
    """(one line per completed mutation, one line per crash)."""
    lines: list[str] = []
    crashes: list[str] = []
    first = 0
    while first < count and len(crashes) < CRASHES:
        run = sanitized(library, str(folder), str(first), str(count))
        printed = run.stdout.splitlines()
        if run.returncode == 0:
            return [*lines, *printed], crashes
        if not printed:
            raise RuntimeError(f"the campaign does not start: {run.stderr[-2000:]}")
        lines += printed[:-1]
        summary = [line for line in run.stderr.splitlines() if "SUMMARY" in line or "Error" in line]
        crashes.append(f"{printed[-1]}: exit {run.returncode}: {' '.join(summary[-2:])}")
        first = int(printed[-1].split()[0]) + 1
    return lines, crashes


if __name__ == "__main__":
    report = Report("packages and caches that cannot be trusted")
    measure(report)
    report.print()
