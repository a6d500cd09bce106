"""The time from the import in Python to a loaded controller of the crane is measured with empty caches."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run

PROGRAM = """
import sys, time
start = time.perf_counter()
from nmpc_codegen import build, export
imported = time.perf_counter()
from examples.crane import build_ocp
ocp = build_ocp()
export(ocp, None, sys.argv[1])
exported = time.perf_counter()
build(ocp)
print(imported - start, exported - imported, time.perf_counter() - exported)
"""
ROUNDS = 3


def measure(report: Report, asked: Run) -> None:
    """Measure import, export, build: the least of some rounds, in seconds."""
    rounds = []
    for _round in range(asked.share(ROUNDS)):
        with tempfile.TemporaryDirectory() as folder:
            environment = {**os.environ, "NMPC_CODEGEN_CACHE": folder}
            command = [sys.executable, "-c", PROGRAM, folder]
            out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
            rounds.append([float(word) for word in out.split()])
    for name, seconds in zip(("import", "export", "build"), zip(*rounds, strict=True), strict=True):
        report.add(name, min(seconds), "s", case="crane", n=ROUNDS)
    report.add("in all", min(map(sum, rounds)), "s", case="crane", n=ROUNDS, limit=3.5)
