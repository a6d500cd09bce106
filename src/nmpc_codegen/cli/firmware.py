"""--target, --verify and the budgets add files to an export, and print a report."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping

from rich.table import Table

from nmpc_codegen.cli.arguments import BUDGETS
from nmpc_codegen.cli.printing import Printer
from nmpc_codegen.errors import OptionError
from nmpc_codegen.firmware.budgets import BYTES, OPERATIONS, Budgets, parse_size
from nmpc_codegen.firmware.certificate import Certificate, Form
from nmpc_codegen.firmware.delivery import CampaignWords, Delivery, Variant, deliver, deliver_estimator, sentences
from nmpc_codegen.firmware.process import compiler_for, emulator_command
from nmpc_codegen.firmware.toolchain import LEVELS, require
from nmpc_codegen.lowering.beside.dumps import ring_bytes
from nmpc_codegen.options import Options
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.seal import seal_beside, without_seal
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.compilers import find_compiler
from nmpc_codegen.targets import TARGETS, Target


class Firmware:
    """The flags of an export are those for a target; ``hook`` as a part of the export makes a delivery."""

    def __init__(self, arguments: argparse.Namespace, printer: Printer) -> None:
        self._printer, self._dumps = printer, arguments.dumps
        self.ring = 0  # bytes of the requested dumps
        given = {flag: getattr(arguments, f"max_{flag}") for flag in BUDGETS}
        limits = {
            flag: parse_size(f"--max-{flag}", text, OPERATIONS if flag == "operations" else BYTES)
            for flag, text in given.items()
            if text is not None
        }
        self._budgets, self._delivery = Budgets(**limits), Delivery({}, None, None)
        self._estimator = self._delivery
        self._level, self._run = arguments.level or LEVELS[0], arguments.verify
        stated = {"level": arguments.level, "max-flash": self._budgets.flash, "max-stack": self._budgets.stack}
        self._of_boards = [f"--{flag}" for flag, value in stated.items() if value is not None]

    def look_for_tools(self, options: Options) -> None:
        """Check, before any work, for the programs that the flags need on the target of the options.

        Raises:
            OptionError: a flag needs a microcontroller, or the target cannot be verified.
            BuildError: a program is missing; the message says what to install.
        """
        target = options.machine
        if target.board is not None:
            require(target, emulator=self._run)
            find_compiler()
        elif self._of_boards:
            boards = ", ".join(t.name for t in TARGETS.values() if t.board)
            raise OptionError(f"{self._of_boards[0]} needs --target {boards}: on {target.name} it has no meaning")
        elif self._run:
            emulator_command(target)
            compiler_for(target)

    def hook(
        self,
        name: str,
        variant: Variant,
        beside: Callable[[], Sources] | None = None,
        fly: Callable[[Mapping[str, str]], CampaignWords | None] = lambda _: None,
    ) -> Callable[[Mapping[str, str]], dict[str, str]]:
        """Return the function that export() calls before it writes anything.

        ``variant`` generates the package with other options, ``beside`` that of an estimator; ``fly`` runs a campaign
        with the package, if one was requested.
        """

        def more(sources: Mapping[str, str]) -> dict[str, str]:
            """Return further files, sealed; raise an error if a budget is exceeded or a tool fails."""
            flown = fly(sources)
            description = PackageDescription.from_json(sources[f"{name}.json"])
            self._announce(TARGETS[description.target])
            self.ring = ring_bytes(description, self._dumps) if self._dumps else 0
            how = self._level, self._budgets, self._run, variant, flown, self.ring
            self._delivery = deliver(sources, name, *how)
            files = dict(self._delivery.files)
            if flown is not None:
                readme = files.get("README.md") or without_seal(sources["README.md"])
                files["README.md"] = f"{readme.rstrip()}\n\n## Campaign\n\n{flown.sentences}\n"
            if beside is not None and self._delivery.certificate is not None:
                package = beside()
                self._estimator = deliver_estimator(package, package.description.name, self._level, self._run)
                files |= self._estimator.files
            return seal_beside(files, sources)

        return more

    def _announce(self, target: Target) -> None:
        """Announce long work: the certificate of a microcontroller, the emulation."""
        if target.board is not None or self._run:
            work = (["certifying"] if target.board else []) + (["replaying a loop"] if self._run else [])
            self._printer.stage(f"{' and '.join(work)} for {target.name}")

    def report(self, printer: Printer) -> bool:
        """Print certificate and verdict; return False if host and target disagree."""
        passed = [_report(printer, found) for found in (self._delivery, self._estimator)]
        return all(passed)


def _report(printer: Printer, found: Delivery) -> bool:
    """Print the results for one package; return False if host and target disagree."""
    certificate, verdict = found.certificate, found.verdict
    if certificate is not None:
        printer.note(f"certificate of {certificate.name}", certificate.as_dict())
    if verdict is not None:
        printer.note("emulated", verdict.as_dict())
    if certificate is not None:
        _print(printer, certificate)
        if found.forms:
            _print_forms(printer, found.forms)
    if verdict is None:
        return True
    printer.line(sentences(verdict).replace("\n\n", "\n"))
    for line in () if verdict.passed else ("target and host DISAGREE",):
        printer.line(line, style="red")
    return verdict.passed


def _print_forms(printer: Printer, forms: tuple[Form, ...]) -> None:
    table = Table("goal", "level", "solver struct", "code and constants", "stack")
    for column in table.columns[2:]:
        column.justify = "right"
    for f in forms:
        table.add_row(f.goal, f"-{f.level}", *(f"{size:,}" for size in (f.struct_bytes, f.flash_bytes, f.stack_bytes)))
    printer.table(table)


def _print(printer: Printer, certificate: Certificate) -> None:
    table = Table(f"{certificate.name}: {certificate.core}, -{certificate.level}", "bytes")
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
