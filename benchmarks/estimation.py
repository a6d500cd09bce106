"""Estimators: python -m benchmarks.estimation [--scale S] [--json FILE]

Moving horizon estimators beside the Kalman filter on linear plants, beside the extended Kalman filter and the estimate
from all measurements by IPOPT on three nonlinear ones, with bad sensors, and in closed loops. It ends with an exit
status of 1 if a figure is beyond its limit.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.lib import estimation
from benchmarks.lib.base import commits
from benchmarks.lib.report import Report, finish
from benchmarks.lib.run import Run


def main() -> int:
    """The command line."""
    command = argparse.ArgumentParser(
        "benchmarks.estimation", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    command.add_argument("--scale", metavar="S", type=float, default=1.0, help="share of the runs (default all)")
    command.add_argument("--json", metavar="FILE", help="write all records")
    options = command.parse_args()
    if not 0 < options.scale <= 1:
        command.error(f"--scale {options.scale:g}: expected a share, more than 0 and at most 1")
    report, run = Report(), Run(options.scale, commits(), Path())
    report.topic = "estimation"
    estimation.measure(report, run)
    return finish(report, run, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
