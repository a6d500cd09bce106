"""--target, --verify and the budgets: what they add to an export, and what is printed about it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping

from rich.table import Table

from nmpc_codegen.cli.arguments import BUDGETS
from nmpc_codegen.cli.printing import Printer
from nmpc_codegen.firmware.budgets import Budgets, parsed
from nmpc_codegen.firmware.certificate import Certificate
from nmpc_codegen.firmware.delivery import Delivery, deliver, sentences
from nmpc_codegen.firmware.forms import Form
from nmpc_codegen.firmware.targets import LEVELS, find_target
from nmpc_codegen.package.seal import sealed_beside

#: Makes the package for every goal: goal -> its files.
Goals = Callable[[], Mapping[str, Mapping[str, str]]]


class Firmware:
    """The flags of an export for a target; ``more`` is the hook of export(), after which there is a delivery."""

    def __init__(self, arguments: argparse.Namespace, name: str, goals: Goals) -> None:
        given = {flag: getattr(arguments, f"max_{flag}") for flag in BUDGETS}
        limits = {flag: parsed(f"--max-{flag}", text) for flag, text in given.items() if text is not None}
        self._budgets, self._name, self._goals = Budgets(**limits), name, goals
        self._target = None if arguments.target is None else find_target(arguments.target)
        self._level, self._run = arguments.level or LEVELS[0], arguments.verify
        self._delivery = Delivery({}, None, None)

    def more(self, sources: Mapping[str, str]) -> dict[str, str]:
        """Further files of the package, sealed; it raises an error if a budget is exceeded or a tool is missing."""
        checks = (self._target, self._level, self._budgets, self._run)
        self._delivery = deliver(sources, self._name, *checks, self._goals)
        return sealed_beside(self._delivery.files, sources)

    def report(self, printer: Printer) -> bool:
        """Print certificate and verdict; return False if host and target disagree."""
        certificate, verdict = self._delivery.certificate, self._delivery.verdict
        if certificate is not None:
            _print(printer, certificate)
            _print_forms(printer, self._delivery.forms)
        if verdict is None:
            return True
        printer.line(sentences(verdict).replace("\n\n", "\n"))
        for line in () if verdict.passed else ("target and host DISAGREE",):
            printer.line(line, style="red")
        return verdict.passed


def _print_forms(printer: Printer, forms: tuple[Form, ...]) -> None:
    table = Table("--goal", "level", "solver struct", "code and constants", "stack")
    for column in table.columns[2:]:
        column.justify = "right"
    for f in forms:
        table.add_row(f.goal, f"-{f.level}", *(f"{size:,}" for size in (f.struct_bytes, f.flash_bytes, f.stack_bytes)))
    printer.table(table)


def _print(printer: Printer, certificate: Certificate) -> None:
    table = Table(f"{certificate.core}, -{certificate.level}", "bytes")
    table.columns[1].justify = "right"
    rows = {
        "solver struct": certificate.struct_bytes,
        "code and constants": certificate.flash_bytes,
        "code and constants without solve()": certificate.flash_bytes_without_solve,
        "code of libraries": certificate.library_bytes,
        "worst-case stack": certificate.stack_worst,
    }
    for what, size in rows.items():
        table.add_row(what, f"{size:,}")
    printer.table(table)
    if certificate.double_functions and certificate.precision == "single":
        printer.line(f"double precision in software: {', '.join(certificate.double_functions)}", style="yellow")
    if certificate.arithmetic == "software":
        printer.line(f"{certificate.core} computes {certificate.precision} precision in software", style="yellow")
