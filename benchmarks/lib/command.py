"""The command line that the topics share: some parts or all of them, a table, and a file of records."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Collection, Iterable

from benchmarks.lib.report import Report


def parser(doc: str | None, parts: Iterable[str]) -> argparse.ArgumentParser:
    """A parser with --json and --only; a topic may add options of its own."""
    found = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    found.add_argument("--json", metavar="FILE", help="write one record per key")
    found.add_argument("--only", metavar="PARTS", help=f"some of {', '.join(parts)}")
    return found


def add_scale(command: argparse.ArgumentParser) -> None:
    """--scale, for topics that count many cases."""
    command.add_argument("--scale", metavar="S", type=float, default=1.0, help="share of the counts that are asked for")


def chosen(command: argparse.ArgumentParser, options: argparse.Namespace, parts: Collection[str]) -> list[str]:
    """The parts that --only names, else all; an unknown name ends the program with an error."""
    names = options.only.split(",") if options.only else list(parts)
    if unknown := sorted(set(names) - set(parts)):
        command.error(f"--only {','.join(unknown)}: expected some of {', '.join(parts)}")
    return names


def measure(
    report: Report, names: Iterable[str], part: Callable[[str], None], json: str | None, note: str = ""
) -> None:
    """Run the parts one after another, print the table, and write it to the file ``json``."""
    start = time.perf_counter()
    for name in names:
        begin = time.perf_counter()
        part(name)
        report.add("benchmark_seconds", time.perf_counter() - begin, "s", case=name, profile="")
    report.print()
    print(f"{time.perf_counter() - start:.0f} s{note}")
    if json:
        report.write(json)
