"""Times of this tree over those of an earlier commit in the same run: closed loops in C, run alternately."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path

from benchmarks.lib import scenarios
from benchmarks.lib.closed_loop import Scenario, Timing, compile_driver, run_driver
from benchmarks.lib.hessian import bioreactor
from benchmarks.lib.house.commits import has_commit, packages_of
from benchmarks.lib.house.timed import TIMED, Sample
from benchmarks.lib.report import Report
from nmpc_codegen import generate

#: The commit whose times are the reference.
BASE = "fe7a182"
LIMIT = 1.15
#: Runs of each package, one at a time; the best run counts.
RUNS, STEPS = 40, 400


def measure(report: Report, runs: int = RUNS, steps: int = STEPS) -> None:
    """<name>_total_ratio: minimum over runs of the median step, new over old. Absent without the commit."""
    if not has_commit(BASE):
        print(f"times: this tree is no clone that has the commit {BASE}; no ratios")
        return
    old = packages_of(BASE, [sample.name for sample in TIMED])
    for sample in TIMED:
        problem = sample.name.removeprefix("timed ")
        new = generate(sample.make(), sample.options)
        with ExitStack() as stack:
            folders = [Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(2)]
            prefix = sample.make().name
            programs = [
                compile_driver(dict(files), prefix, folder)
                for files, folder in zip((old[sample.name], new), folders, strict=True)
            ]
            times = in_turn(programs, scenario_of(sample), runs, steps)
        before, after = (min(t.total for t in found) for found in times)
        report.add(f"{problem}_total_ratio", after / before, f"to {BASE}", limit=LIMIT, n=runs * steps)
        report.add(f"{problem}_total_us", after, "us", n=runs * steps)
        failed = [max(t.failed for t in found) for found in times]
        report.add(f"{problem}_more_failed_steps", failed[1] - failed[0], limit=0, n=runs * steps)


def in_turn(programs: list[Path], scenario: Scenario, runs: int, steps: int) -> list[list[Timing]]:
    """Timings of every program; each round runs all of them once, in alternating order."""
    times: list[list[Timing]] = [[] for _ in programs]
    for k in range(runs):
        order = range(len(programs)) if k % 2 == 0 else reversed(range(len(programs)))
        for i in order:
            times[i].append(run_driver(programs[i], scenario, runs=1, steps=steps))
    return times


def scenario_of(sample: Sample) -> Scenario:
    """The closed loop of a timed problem."""
    own = {"timed crane": scenarios.CRANE_LOOP, "timed bioreactor": bioreactor.TIMING}
    if sample.name in own:
        return own[sample.name]
    return next(e.scenario() for e in scenarios.EXAMPLES if f"timed {e.name}" == sample.name)
