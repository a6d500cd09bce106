"""Robustness against newcomers and careless machines: command line, files, warnings, untrusted packages, the cache."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.lib import command
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
    parser = command.parser(__doc__, PARTS)
    options = parser.parse_args()
    names, report = command.chosen(parser, options, PARTS), Report("doors")
    command.measure(report, names, lambda name: PARTS[name](report), options.json)


if __name__ == "__main__":
    main()
