"""The flags, and every usage error that can be seen before the problem's file is run."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

from nmpc_codegen.cli.messages import one_line
from nmpc_codegen.options import PRECISIONS

#: Samples that --simulate runs at most: a log of more of them does not fit in memory.
MAX_SAMPLES = 1_000_000

EPILOG = (
    "The file defines `ocp`, or one of the functions problem() and build_ocp() that return it; `options`, or a "
    "function options() that returns them, is optional. problem() may also return a pair (OCP, Options). If nothing "
    "has these names, the only OCP among the names of the file is taken. "
    "Exit status: 0 done; 1 the problem, the options or the check failed; 2 wrong usage."
)


class Parser(argparse.ArgumentParser):
    """Usage errors on one line, whatever characters the arguments have."""

    def error(self, message: str) -> NoReturn:
        super().error(one_line(message))


def parser() -> Parser:
    """All flags of nmpc-export."""
    made = Parser(
        prog="nmpc-export",
        description="Write a self-contained C99 package that solves the optimal control problem of a Python file.",
        epilog=EPILOG,
    )
    add = made.add_argument
    add("problem", nargs="?", metavar="problem.py", help="file that states the problem")
    add("-o", "--output", metavar="DIR", help="folder to write (default: out/<name>)")
    add("--name", help="name of the package, prefix of every C name (default: the problem's)")
    add("--hessian", metavar="WORD", help="Hessian of the QP, see --list-options")
    add("--qp", metavar="WORD", help="QP solver, see --list-options")
    add("--allow-foreign", action="store_true", help="let OSQP's own generated code stand beside the package")
    add("--force", action="store_true", help="replace files that are not unchanged ones of an earlier export")
    add("--precision", choices=PRECISIONS, help="working precision")
    add(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="settings",
        help="any option by its dotted name, e.g. integrator.steps=3; may be repeated",
    )
    add("--check", action="store_true", help="compile with warnings as errors, solve, compare with IPOPT")
    add("--simulate", type=int, metavar="STEPS", help="closed loop from the declared initial state")
    add("--plot", metavar="FILE", help="picture of the simulation (.png, .pdf, .svg)")
    add("--list-options", action="store_true", help="print every component, its options and their values, and exit")
    add("-v", "--verbose", action="store_true", help="the whole report; tracebacks")
    return made


def check_usage(made: Parser, arguments: argparse.Namespace) -> None:
    """Usage errors that argparse does not see by itself; error() leaves with status 2."""
    for message in _mistakes(arguments):
        made.error(message)


def _mistakes(arguments: argparse.Namespace) -> Iterator[str]:
    if arguments.problem is None and not arguments.list_options:
        yield "the file that states the problem is missing"
    for flag in ("problem", "output", "name", "plot"):
        value = getattr(arguments, flag)
        if value is not None and (not value.strip() or "\0" in value):
            yield f"{'problem.py' if flag == 'problem' else f'--{flag}'} {value!r}: expected a name that is not empty"
    if arguments.simulate is not None and not 1 <= arguments.simulate <= MAX_SAMPLES:
        yield f"--simulate {arguments.simulate}: expected at least one step and at most {MAX_SAMPLES:,}"
    for setting in arguments.settings:
        if "=" not in setting or not setting.partition("=")[0].strip():
            yield f"--set {setting}: expected KEY=VALUE, e.g. integrator.steps=3"
    if arguments.plot is not None and arguments.simulate is None:
        yield "--plot needs --simulate STEPS"
    for flag, look in (("output", _folder), ("plot", _picture)):
        value = getattr(arguments, flag)
        try:
            if value is not None:
                yield from look(Path(value))
        except OSError as error:  # a name too long, say
            yield f"--{flag} {value}: {error.strerror}"


def _folder(path: Path) -> Iterator[str]:
    """Why there cannot be a package: the folder, or what it is to stand in, is none or cannot be written."""
    there = next(p for p in (path.absolute(), *path.absolute().parents) if os.path.lexists(p))
    _name_fits(path)
    if not there.is_dir():
        yield f"--output {path}: {there} is not a folder"
    elif not os.access(there, os.W_OK | os.X_OK):
        yield f"--output {path}: {there} cannot be written"


def _name_fits(path: Path) -> None:
    """OSError if the file system refuses the name, for its length say; a name that is merely free is fine."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return


def _picture(path: Path) -> Iterator[str]:
    """Why there cannot be a picture."""
    from matplotlib.backend_bases import FigureCanvasBase

    formats = FigureCanvasBase.get_supported_filetypes()
    if path.suffix.lower().removeprefix(".") not in formats:
        yield f"--plot {path}: unknown format {path.suffix!r}; expected one of {', '.join(f'.{f}' for f in formats)}"
    elif path.is_dir() or not path.absolute().parent.is_dir():
        yield f"--plot {path}: expected a file in a folder that exists"
    elif not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
        yield f"--plot {path}: cannot be written"
