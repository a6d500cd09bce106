"""The command line prints plain text, on streams that the problem file cannot disturb."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

from rich.console import Console

from nmpc_codegen.cli.messages import message, one_line, printable


class ReaderLeftError(Exception):
    """The output cannot be written: its reader is gone, as in ``nmpc-export ... | head -1``, or it fails."""

    @classmethod
    def of(cls, error: OSError) -> ReaderLeftError:
        """Return the error for an OSError while output was written."""
        gone = isinstance(error, BrokenPipeError)
        return cls() if gone else cls(f"the output cannot be written: {error.strerror or error}")


class Printer:
    """A printer prints output and errors.

    Unencodable characters are escaped, and markup in names is not interpreted.
    """

    def __init__(self, output: TextIO, errors: TextIO) -> None:
        self._begin = time.monotonic()
        self._facts: dict[str, Any] = {}
        self.verbose = self._quiet = False
        self._output = Console(file=output, markup=False, emoji=False, highlight=False)
        self._errors = Console(file=errors, markup=False, emoji=False, highlight=False)

    def settle(self, verbose: bool, quiet: bool) -> None:
        """Set how much is printed from now on; ``quiet``: only errors and the document."""
        self.verbose, self._quiet = verbose, quiet

    def stage(self, text: str) -> None:
        """Announce a stage, after the seconds since the start."""
        self.line(f"[{time.monotonic() - self._begin:5.1f} s] {text}")

    def note(self, key: str, value: Any) -> None:
        """Add an entry to the document of --json."""
        self._facts[key] = value

    def document(self, passed: bool) -> None:
        """Print all entries as one JSON object."""
        text = json.dumps(_plain({**self._facts, "passed": passed}), indent=1, allow_nan=False)
        self._print(self._output, text, soft_wrap=True)

    def line(self, text: str, style: str = "") -> None:
        """Print each line of the text as a line of output, never wrapped."""
        if self._quiet:
            return
        for part in text.split("\n"):
            self._print(self._output, printable(part), style=style, soft_wrap=True)

    def table(self, table: Any) -> None:
        """Print a rich table."""
        if self._quiet:
            return
        self._print(self._output, table)

    def trace(self, error: BaseException) -> None:
        """Print the traceback of an exception on the error stream."""
        try:
            text = "".join(traceback.format_exception(error))
        except Exception:  # even reading an exception may fail
            text = "".join(traceback.format_tb(error.__traceback__))
        for line in text.splitlines():
            self._print(self._errors, printable(line), soft_wrap=True)

    def error(self, text: str, style: str = "red") -> None:
        """Print one line on the error stream."""
        self._print(self._errors, one_line(text), style=style, soft_wrap=True)

    def _print(self, console: Console, what: Any, **options: Any) -> None:
        try:
            console.print(what, **options)
        except SystemExit:  # rich exits the program when a pipe breaks
            raise ReaderLeftError from None
        except OSError as error:
            raise ReaderLeftError.of(error) from None


def _plain(value: Any) -> Any:
    """Convert a value for JSON; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if hasattr(value, "tolist"):  # arrays and numbers of NumPy
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


@contextlib.contextmanager
def own_streams(whole_process: bool) -> Iterator[Printer]:
    """Replace sys.stdout and sys.stderr by duplicates, which escape characters that they cannot encode.

    If ``whole_process``, they remain until the process ends, when the interpreter flushes the rest of the problem
    file's output.
    """
    before = sys.stdout, sys.stderr, sys.unraisablehook, threading.excepthook
    output, errors = _duplicate(sys.stdout), _duplicate(sys.stderr)
    sys.stdout, sys.stderr = output, errors
    try:
        yield Printer(output, errors)
        output.flush()
    except OSError as error:
        raise ReaderLeftError.of(error) from None
    finally:
        if not whole_process:
            sys.stdout, sys.stderr, sys.unraisablehook, threading.excepthook = before


def _duplicate(stream: TextIO | None) -> TextIO:
    """Return a separate stream to the same file as the given one; the given one if it has no file."""
    if stream is None:  # the caller has closed it
        return open(os.devnull, "w", encoding="utf-8")
    try:
        number = os.dup(stream.fileno())
    except (AttributeError, OSError, ValueError):
        return stream
    return open(number, "w", buffering=1, encoding=stream.encoding, errors="backslashreplace")


def drop_output() -> None:
    """Discard buffered output whose reader is gone, also when the interpreter exits."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.__stdout__):
        with contextlib.suppress(AttributeError, OSError, ValueError):
            os.dup2(nowhere, stream.fileno())  # type: ignore[union-attr]
    os.close(nowhere)


@contextlib.contextmanager
def isolate(printer: Printer, file: str, verbose: bool, aside: bool = False) -> Iterator[None]:
    """Give the problem file separate streams, and undo its changes to the interpreter.

    With ``aside``, both streams are that of errors. Its warnings, and exceptions in its threads and finalisers, are
    printed on one line each.
    """
    ours = sys.stdout, sys.stderr
    saved = sys.stdin, sys.excepthook, sys.displayhook, sys.argv, sys.path
    folder, limit, path = os.getcwd(), sys.getrecursionlimit(), sys.path[:]
    sys.stdout, sys.stderr = _duplicate(sys.stderr if aside else sys.stdout), _duplicate(sys.stderr)
    if not verbose:
        sys.unraisablehook = lambda raised: printer.error(message(raised.exc_value or raised.exc_type(), file))
        threading.excepthook = lambda raised: printer.error(message(raised.exc_value or raised.exc_type(), file))
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning(printer)
            yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(Exception):
                stream.flush()
        sys.stdout, sys.stderr = ours
        sys.stdin, sys.excepthook, sys.displayhook, sys.argv, sys.path = saved
        sys.path[:] = path
        os.chdir(folder)
        sys.setrecursionlimit(limit)


@contextlib.contextmanager
def saying_warnings(printer: Printer) -> Iterator[None]:
    """Print the text of each warning of the package on one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda text, *_, **__: printer.error(f"warning: {text}", style="yellow")
        yield


def _show_warning(printer: Printer) -> Any:
    def show(text: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any) -> None:
        printer.error(f"{os.path.basename(filename)}, line {lineno}: {category.__name__}: {text}", style="yellow")

    return show
