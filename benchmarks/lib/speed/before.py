"""single_lane_ratio: exported C of this tree over that of the commit before lanes, in turn in the same run."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path

from benchmarks.lib.closed_loop import compile_driver
from benchmarks.lib.house.commits import has_commit, packages_of
from benchmarks.lib.house.ratios import in_turn, scenario_of
from benchmarks.lib.house.timed import TIMED
from benchmarks.lib.report import Report
from nmpc_codegen import generate

#: The last commit without lanes.
BASE = "ba65e1e"
LIMIT = 1.03
RUNS, STEPS = 40, 400


def measure(report: Report, runs: int = RUNS, steps: int = STEPS) -> None:
    """Absent without the commit."""
    if not has_commit(BASE):
        print(f"single_lane_ratio: this tree is no clone that has the commit {BASE}")
        return
    old = packages_of(BASE, [sample.name for sample in TIMED])
    for sample in TIMED:
        prefix = sample.make().name
        with ExitStack() as stack:
            folders = [Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(2)]
            pair = (dict(old[sample.name]), generate(sample.make(), sample.options))
            programs = [compile_driver(files, prefix, folder) for files, folder in zip(pair, folders, strict=True)]
            times = in_turn(programs, scenario_of(sample), runs, steps)
        before, after = (min(t.total for t in found) for found in times)
        report.add("single_lane_ratio", after / before, f"to {BASE}", case=prefix, limit=LIMIT, n=runs * steps)
