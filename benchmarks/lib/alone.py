"""The command line of topics that are measured by a command of their own."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.lib.base import commits
from benchmarks.lib.report import Report, finish
from benchmarks.lib.run import Run
from benchmarks.topics import TOPICS


def main(name: str, doc: str | None, *topics: str) -> int:
    """Run topics as python -m benchmarks.<name> [--scale S] [--json FILE]; the exit status is 1 if a figure is beyond
    its limit."""
    command = argparse.ArgumentParser(
        f"benchmarks.{name}", description=doc, formatter_class=argparse.RawTextHelpFormatter
    )
    command.add_argument("--scale", metavar="S", type=float, default=1.0, help="share of the runs (default all)")
    command.add_argument("--json", metavar="FILE", help="write all records")
    options = command.parse_args()
    if not 0 < options.scale <= 1:
        command.error(f"--scale {options.scale:g}: expected a share, more than 0 and at most 1")
    report, run = Report(), Run(options.scale, commits(), Path())
    for report.topic in topics:
        TOPICS[report.topic](report, run)
    return finish(report, run, options.json)
