"""The command line of topics that are measured by a command of their own."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from benchmarks.lib.base import commits
from benchmarks.lib.report import Report, finish, replace_table
from benchmarks.lib.run import Run
from benchmarks.topics import TOPICS


def main(name: str, doc: str | None, *topics: str, table: tuple[str, Callable[[], str]] | None = None) -> int:
    """Run topics as python -m benchmarks.<name> [--scale S] [--json FILE]; the exit status is 1 if a figure is beyond
    its limit. ``table``: the first column of a table, and what makes it, for --table FILE."""
    command = argparse.ArgumentParser(
        f"benchmarks.{name}", description=doc, formatter_class=argparse.RawTextHelpFormatter
    )
    command.add_argument("--scale", metavar="S", type=float, default=1.0, help="share of the runs (default all)")
    command.add_argument("--json", metavar="FILE", help="write all records")
    if table:
        command.add_argument("--table", metavar="FILE", type=Path, help="write the table of this file anew, and stop")
    options = command.parse_args()
    if not 0 < options.scale <= 1:
        command.error(f"--scale {options.scale:g}: expected a share, more than 0 and at most 1")
    if table and options.table:
        replace_table(options.table, table[0], table[1]())
        return 0
    report, run = Report(), Run(options.scale, commits(), Path())
    for report.topic in topics:
        TOPICS[report.topic](report, run)
    return finish(report, run, options.json)
