"""Strangers: python -m benchmarks.strangers [--part loops|solve] [--scale S] [--json FILE] [--table FILE]

It ends with an exit status of 1 if a figure is beyond its limit. ``--table`` writes the loops with and without
iterations and relaxation, and ``--remedies`` what advice changes, in place of the tables of a Markdown file
(docs/strangers.md).
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.lib import strangers
from benchmarks.lib.base import commits
from benchmarks.lib.report import Report, finish, replace_table
from benchmarks.lib.run import Run
from verification.strangers import remedies


def main() -> int:
    """The command line."""
    command = argparse.ArgumentParser("benchmarks.strangers", description=__doc__)
    parts = {"loops": strangers.measure, "solve": strangers.measure_solve}
    command.add_argument("--part", choices=parts, help="closed loops or cold starts of solve() alone (default both)")
    command.add_argument("--scale", metavar="S", type=float, default=1.0, help="share of the loops (default all)")
    command.add_argument("--json", metavar="FILE", help="write all records")
    command.add_argument("--table", metavar="FILE", type=Path, help="write the table of this file anew, and stop")
    command.add_argument("--remedies", metavar="FILE", type=Path, help="fly the remedies of its second table, and stop")
    options = command.parse_args()
    if not 0 < options.scale <= 1:
        command.error(f"--scale {options.scale:g}: expected a share, more than 0 and at most 1")
    for path, column, made in (
        (options.table, "problem", strangers.table),
        (options.remedies, "failure", remedies.table),
    ):
        if path:
            replace_table(path, column, made())
    if options.table or options.remedies:
        return 0
    report, run = Report(), Run(options.scale, commits(), Path())
    report.topic = "strangers"
    for part in [options.part] if options.part else parts:
        parts[part](report, run)
    return finish(report, run, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
