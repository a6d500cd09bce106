"""Robustness against newcomers and careless machines: command line, files, warnings, untrusted packages, the cache."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

from benchmarks.lib.doors import doors_cli, doors_files, doors_trust, doors_warnings
from benchmarks.lib.report import Report

PARTS: dict[str, Callable[[Report], None]] = {
    "cli": doors_cli.measure,
    "warnings": doors_warnings.measure,
    "files": doors_files.measure,
    "trust": doors_trust.measure,
}


def main() -> None:
    """Run all parts, or some of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", metavar="FILE", help="write one record per key")
    parser.add_argument("--only", metavar="PARTS", help=f"some of {', '.join(PARTS)}")
    options = parser.parse_args()
    report, start = Report("doors"), time.perf_counter()
    for name in options.only.split(",") if options.only else PARTS:
        begin = time.perf_counter()
        PARTS[name](report)
        report.add("benchmark_seconds", time.perf_counter() - begin, "s", case=name, profile="")
    report.print()
    print(f"{time.perf_counter() - start:.0f} s")
    if options.json:
        report.write(options.json)


if __name__ == "__main__":
    main()
