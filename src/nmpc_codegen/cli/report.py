"""A package is reported in a few lines, with -v in full, and as entries of --json."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmpc_codegen.cli.messages import one_line
from nmpc_codegen.cli.printing import Printer
from nmpc_codegen.errors import OptionError

if TYPE_CHECKING:
    from nmpc_codegen.compiler import Package

WIDTH = 100  # columns of a short line


def report_files(printer: Printer, name: str, directory: Path, paths: Sequence[Path], folder: Path) -> None:
    """Print folder, number and size of the files; with -v every file."""
    from rich.table import Table

    sizes = {os.path.relpath(path, directory): path.stat().st_size for path in sorted(paths)}
    printer.note("name", name)
    printer.note("folder", str(directory))
    printer.note("files", sizes)
    printer.stage(one_line(f"{name} in {folder}: {len(sizes)} files, {sum(sizes.values()):,} bytes"))
    if printer.verbose:
        files = Table("file", "bytes")
        files.columns[1].justify = "right"
        for path, size in sizes.items():
            files.add_row(one_line(path), f"{size:,}")
        printer.table(files)


def report_package(printer: Printer, package: Package, folder: Path, ring: int) -> None:
    """Print files, choices and memory; with -v all reasons, operations of every function and the worst case.

    ``ring`` is the size of the dumps in bytes.
    """
    report_files(printer, package.name, package.directory, package.files, folder)
    for key in ("choices", "warnings", "ram_bytes", "operations"):
        if key in package.report and (key != "operations" or printer.verbose):
            printer.note(key, package.report[key])
    for choice in package.report.get("choices", ()):
        line = f"chosen  {choice}"
        printer.line(line if printer.verbose else shorten(line))
    if "ram_bytes" in package.report:
        bytes_of_struct = f"{package.report['ram_bytes']:,} bytes of solver struct"
        printer.line(f"memory  {bytes_of_struct}, all that the code needs except its stack")
    if ring:
        printer.note("dumps_bytes", ring)
        printer.line(f"dumps   {ring:,} bytes more")
    if not printer.verbose:
        printer.line("(-v: reasons in full, files, operations, worst case)")
    else:
        report_operations(printer, package.report.get("operations", {}))
        printer.line(f"worst   {_worst(package)}")


def shorten(text: str) -> str:
    """Shorten a text to at most WIDTH columns: whole words, no open parenthesis, and an ellipsis for the rest."""
    if len(text) <= WIDTH:
        return text
    cut = text[: WIDTH - 3].rpartition(" ")[0]
    if cut.count("(") > cut.count(")"):
        cut = cut.rpartition("(")[0]
    return f"{cut.rstrip(',;: ')} ..."


def _worst(package: Package) -> str:
    """Return the worst case of a sample in words."""
    from nmpc_codegen.analysis import worst_case

    paths = [f"{package.name}.{ending}" for ending in ("h", "c", "json")]
    try:
        found = worst_case({path: (package.directory / path).read_text(encoding="utf-8") for path in paths})
    except OptionError as error:
        return str(error)
    return ", ".join(f"{phase} {count:,}" for phase, count in found.items()) + " operations"


def report_operations(printer: Printer, operations: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table of the operations of every function, the largest first."""
    from rich.table import Table

    counts = {function: sum(count.values()) for function, count in operations.items()}
    if not counts:
        return
    table = Table("operations per call", *next(iter(operations.values())), "all")
    table.columns[0].overflow = "fold"
    for column in table.columns[1:]:
        column.justify = "right"
    for function in sorted(counts, key=lambda function: -counts[function]):
        numbers = [*operations[function].values(), counts[function]]
        table.add_row(function, *(f"{number:,}" for number in numbers))
    printer.table(table)
