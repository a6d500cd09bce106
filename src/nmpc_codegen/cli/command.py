"""The command leads from arguments to an exit status."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmpc_codegen.cli.arguments import check_usage, parser
from nmpc_codegen.cli.messages import message
from nmpc_codegen.cli.printing import Printer, ReaderLeftError, drop_output, isolate, own_streams, saying_warnings
from nmpc_codegen.cli.report import report_files, report_operations, report_package

if TYPE_CHECKING:
    from nmpc_codegen.cli.problem_file import FoundProblem
    from nmpc_codegen.firmware.delivery import Variant


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    try:
        with own_streams(whole_process=argv is None) as printer:
            return _main(argv, printer)
    except ReaderLeftError as left:
        drop_output()
        if left.args:
            print(f"error: {left}", file=sys.stderr)
        return 1


def _main(argv: Sequence[str] | None, printer: Printer) -> int:
    made = parser()
    try:
        arguments = made.parse_args(argv)
        check_usage(made, arguments)
    except SystemExit as stop:
        return int(stop.code or 0)
    try:
        return _run(arguments, printer)
    except BaseException as error:
        if isinstance(error, ReaderLeftError):
            raise
        if arguments.verbose:
            printer.trace(error)
        text = message(error, arguments.problem)
        printer.error(text)
        if arguments.json:
            printer.note("error", text)
            printer.document(passed=False)
        return 1


def _run(arguments: argparse.Namespace, printer: Printer) -> int:
    from nmpc_codegen.cli.listing import list_options

    if arguments.list_options:
        list_options(printer)
        return 0
    printer.settle(arguments.verbose, arguments.quiet or arguments.json)
    passed = (_derivatives if arguments.derivatives else _export)(arguments, printer)
    if arguments.json:
        printer.document(passed)
    return 0 if passed else 1


def _export(arguments: argparse.Namespace, printer: Printer) -> bool:
    """Write a package and do everything else that was requested; return False if a check failed."""
    from nmpc_codegen.cli.campaign import CampaignRun
    from nmpc_codegen.cli.check import check
    from nmpc_codegen.cli.firmware import Firmware
    from nmpc_codegen.compiler import compile, export
    from nmpc_codegen.options import Options, common_options
    from nmpc_codegen.runtime.compilers import find_compiler
    from nmpc_codegen.runtime.native import check_target

    runs = arguments.check or arguments.simulate is not None or arguments.campaign is not None
    if runs:
        find_compiler()
    firmware = Firmware(arguments, printer)
    if arguments.target is not None:
        firmware.look_for_tools(Options(target=arguments.target))
    stated = _problem(arguments, printer)
    ocp, options, estimator = stated.ocp, stated.options, stated.estimator
    firmware.look_for_tools(options)
    name = ocp.name if arguments.name is None else arguments.name
    if runs:
        check_target(name, options.machine)
    folder = Path(arguments.output or Path("out") / name)
    beside = None if estimator is None else lambda: compile(estimator, common_options(options))
    flights = CampaignRun(arguments, stated, name, printer)
    variant: Variant = lambda **changes: compile(ocp, replace(options, **changes), name)  # noqa: E731
    more = firmware.hook(name, variant, beside, flights.fly)
    given: dict[str, Any] = {"allow_foreign": arguments.allow_foreign, "force": arguments.force, "more": more}
    given |= {"estimator": estimator, "dumps": arguments.dumps}
    with saying_warnings(printer):
        printer.stage(f"{name}: generating C, N={ocp.N}")
        package = export(ocp, options, str(folder), name=name, **given)
        report_package(printer, package, folder, firmware.ring)
        passed = firmware.report(printer)
        passed = flights.report(printer) and passed
        if arguments.check:
            printer.stage("compiling with all warnings, solving, and asking IPOPT")
            passed = check(ocp, options, folder, name, printer) and passed
        if arguments.simulate is not None:
            passed = _simulate(arguments, folder, name, printer) and passed
    return passed


def _derivatives(arguments: argparse.Namespace, printer: Printer) -> bool:
    """Write a package of derivatives and print its files and operations."""
    from nmpc_codegen import derivatives

    stated = _problem(arguments, printer)
    ocp, options, outputs = stated.ocp, stated.options, stated.outputs
    outputs = outputs() if callable(outputs) else outputs
    name = f"{ocp.name}_derivatives" if arguments.name is None else arguments.name
    folder = Path(arguments.output or Path("out") / name)
    with saying_warnings(printer):
        printer.stage(f"{name}: generating C")
        package = derivatives.export(ocp, outputs, options, folder, name, force=arguments.force, second_order=True)
    report_files(printer, package.name, package.directory, package.files, folder)
    operations = {f: count.as_dict() for f, count in package.operations.items()}
    printer.note("operations", operations)
    report_operations(printer, operations)
    return True


def _problem(arguments: argparse.Namespace, printer: Printer) -> FoundProblem:
    """Return the statement of the file with the changes of the command line.

    Derivatives use the integrator and the precision of the file, and no other option of a controller.
    """
    import numpy as np

    from nmpc_codegen.cli.problem_file import load_problem
    from nmpc_codegen.cli.settings import apply_settings

    printer.stage(f"reading {arguments.problem}")
    with isolate(printer, arguments.problem, arguments.verbose, arguments.json), np.errstate():
        stated = load_problem(Path(arguments.problem))
    options = stated.options
    if arguments.derivatives:
        options = type(options)(integrator=options.integrator, precision=options.precision)
    settings = [] if arguments.target is None else [("target", arguments.target)]
    for setting in arguments.settings:
        key, _, text = setting.partition("=")
        settings.append((key.strip(), text.strip()))
    return stated._replace(options=apply_settings(options, settings))


def _simulate(arguments: argparse.Namespace, folder: Path, name: str, printer: Printer) -> bool:
    """Print the summary of a closed loop; return False if more samples failed than allowed."""
    from nmpc_codegen.runtime.loops.simulate import simulate
    from nmpc_codegen.runtime.open_folder import open_package

    samples, allowed = arguments.simulate, arguments.allow_failures or 0
    printer.stage(f"compiling, and simulating {samples:,} samples")
    controller = open_package(str(folder), name=name)
    log = simulate(controller, controller.description.x_initial, samples)
    printer.line(log.summary())
    printer.note("simulation", {"samples": samples, "failures": log.failures, "summary": log.summary().splitlines()})
    if arguments.plot is not None:
        log.plot(arguments.plot)
        printer.line(f"picture: {arguments.plot}")
        printer.note("picture", arguments.plot)
    if log.failures > allowed:
        limit = f", --allow-failures {allowed}" if allowed else ""
        why = "; ".join(line.strip() for line in log.first_failure.splitlines())
        printer.error(f"simulation FAILED: {log.failures} of {samples} samples{limit}; {why}")
    return log.failures <= allowed
