"""CPU time of the test-suite from an empty cache of builds."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.lib.report import Report
from nmpc_codegen.runtime.cache import CACHE_VARIABLE

ROOT = Path(__file__).parents[3]
LIMIT = 650.0


def measure(report: Report, command: tuple[str, ...] = ("-m", "pytest", "-q", "-n", "auto")) -> None:
    """test_suite_cpu_seconds: user and system time of pytest, its workers and the compilers that they run."""
    with tempfile.TemporaryDirectory() as cache:
        before = os.times()
        done = subprocess.run(
            [sys.executable, *command],
            cwd=ROOT,
            env={**os.environ, CACHE_VARIABLE: cache},
            capture_output=True,
            text=True,
        )
        after = os.times()
    seconds = after.children_user + after.children_system - before.children_user - before.children_system
    report.add("test_suite_cpu_seconds", seconds, "s", limit=LIMIT, profile="empty cache")
    report.add("test_suite_failed", float(done.returncode != 0), limit=0)
    if done.returncode:
        print(done.stdout[-3000:] + done.stderr[-3000:])
